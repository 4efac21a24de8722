"""Cameras on a cable: the options that choose one, and how it is opened."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from polarmap.cli.common import warn
from polarmap.errors import InputError

LiveCameraPath = Annotated[
    Path, typer.Option("--camera", help="Camera file (docs/formats.md), or a calibration by OpenCV, ROS and others.",
                       metavar="FILE")
]  # fmt: skip
Cti = Annotated[
    Path | None,
    typer.Option("--cti", help="GenTL producer of the camera's maker, a .cti file (docs/live.md).", metavar="FILE"),
]
Basler = Annotated[bool, typer.Option("--basler", help="A camera of Basler's, in place of --cti.")]
DeviceName = Annotated[
    str | None,
    typer.Option("--device", help="Serial number or index of the camera, where there are several.", metavar="NAME"),
]
Features = Annotated[
    list[str] | None,
    typer.Option(
        "--feature",
        help="Set a GenICam feature first, such as ExposureTime=4000; may be repeated.",
        metavar="NAME=VALUE",
    ),
]
Frames = Annotated[int | None, typer.Option("--frames", min=1, help="End after so many frames.")]


@dataclass(frozen=True)
class CameraOptions:
    """Which camera, and how it is set."""

    camera: LiveCameraPath
    cti: Cti = None
    basler: Basler = False
    device: DeviceName = None
    feature: Features = None
    frames: Frames = None


@contextmanager
def open_camera(options: CameraOptions) -> Iterator[tuple]:
    """The open device and its `CameraFile`, set as told and found to fit each other; closed in the end."""
    from polarmap.io.cameras.basler import open_basler
    from polarmap.io.cameras.features import set_features, size_of, warn_of_features
    from polarmap.io.cameras.genicam import open_genicam
    from polarmap.io.cameras.stream_format import StreamFormat
    from polarmap.io.recording.camera_file import read_camera_file

    cti = options.cti
    if options.basler == (cti is not None):
        raise InputError("name the camera's driver: either --cti FILE, a GenTL producer, or --basler")
    camera_file = read_camera_file(options.camera)
    with open_basler(options.device) if cti is None else open_genicam(cti, options.device) as device:
        set_features(device, options.feature or [])
        size, pixel_format = size_of(device), device.feature("PixelFormat")
        if size is not None and pixel_format is not None:
            StreamFormat(camera_file, device.name, size, pixel_format)
        warn_of_features(device)
        yield device, camera_file


def say_losses(lost: int, missed: int, why_missed: str) -> None:
    """A warning for each kind of loss that there was."""
    if lost:
        warn(f"{lost} frames were lost on the way from the camera; see docs/live.md for causes")
    if missed:
        warn(f"{missed} frames were lost, since {why_missed}")
