"""polarmap calibrate: black level, gains, and the polarizers' angles and efficiencies."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from polarmap.cli.camera import refuse_existing
from polarmap.cli.common import console, progress_bar
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.data.frame import Frame
    from polarmap.io.recording.sequence import Sequence

_Pictures = list[Path] | None


def calibrate(
    camera: Annotated[Path, typer.Option(help="Camera file of the sensor; the lens does not matter.", metavar="FILE")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Camera file to write.", metavar="FILE")],
    dark: Annotated[
        _Pictures,
        typer.Option(help="Pictures with the lens cap on: a folder, or a file; may be repeated.", metavar="PATH"),
    ] = None,
    flat: Annotated[
        _Pictures, typer.Option(help="Unsharp pictures of evenly lit white, of unpolarized light.", metavar="PATH")
    ] = None,
    polarizer: Annotated[
        _Pictures,
        typer.Option(help="The same through a linear polarizer, turned between the pictures.", metavar="PATH"),
    ] = None,
    angles: Annotated[
        str | None,
        typer.Option(
            help="The polarizer's angle in each of its pictures, in order of names, in degrees that turn as the camera "
            "file's labels do; left out, they are found.",
            metavar="A,B,...",
        ),
    ] = None,
    absolute: Annotated[
        bool, typer.Option("--absolute", help="--angles count from the picture's x axis, not from anywhere.")
    ] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
) -> None:
    """Measure a sensor's polarizers, and write them into a camera file.

    Dark pictures give the black level, flat fields the channels' gains, and pictures through a polarizer, best 10 to 12
    over 180 degrees, each channel's angle and efficiency. All have the same settings of the camera; none may be
    saturated. The middle of each picture is used. How to take them: docs/camera.md.

    Example: polarmap calibrate --camera camera.yaml --dark dark --flat flat --polarizer turned -o calibrated.yaml
    """
    from polarmap.io.recording.camera_file import read_camera_file, write_camera_file
    from polarmap.report.calibration_table import channel_table, picture_table, told_calibration
    from polarmap.sensing.calibration import calibrate_sensor

    refuse_existing(out, force)
    given = read_camera_file(camera)
    plain = replace(given, frame_rate=None, images=None)
    parts = [_recordings(paths, plain) for paths in (dark, flat, polarizer)]
    layouts = {recording.camera_file.layout for part in parts for recording in part}
    if len(layouts) > 1:
        raise InputError("some pictures are mosaics, others of one angle; give all in one way")
    asked = replace(given, layout=layouts.pop()) if layouts else given
    with progress_bar() as progress:
        task = progress.add_task("reading", total=sum(len(recording) for part in parts for recording in part))
        darks, flats, turned = (_frames(part, lambda: progress.advance(task)) for part in parts)
        result = calibrate_sensor(asked, darks, flats, turned, _angles(angles), absolute)
    write_camera_file(out, replace(result.camera_file, layout=given.layout))
    if result.fit is not None:
        console.print(channel_table(result.fit))
        console.print(picture_table(result.fit))
    for line in told_calibration(result):
        console.print(f"- {line}", markup=False, highlight=False, soft_wrap=True)
    console.print(f"camera file: {out}", soft_wrap=True)


def _recordings(paths: _Pictures, camera_file) -> list[Sequence]:
    from polarmap.io.recording.sequence import open_sequence

    return [open_sequence(path, camera_file) for path in paths or []]


def _frames(recordings: list[Sequence], done: Callable[[], None]) -> Iterator[Frame]:
    for recording in recordings:
        for frame in recording:
            yield frame
            done()


def _angles(text: str | None) -> list[float] | None:
    if text is None:
        return None
    try:
        angles = [float(part) for part in text.split(",")]
    except ValueError:
        angles = [math.nan]
    if not all(math.isfinite(angle) for angle in angles):
        raise InputError(f"--angles: {text[:60]!r} is no list of degrees such as 0,15,30,45")
    return angles
