"""A camera file of two things: another program's calibration, which knows the lens, and the name of the sensor."""

from __future__ import annotations

import os
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor_presets import SensorPreset, region_of
from polarmap.errors import InputError
from polarmap.io.recording.calibration.conversion import (
    channel_camera,
    lens_values,
    naming,
    own_sensor_keys,
    read_calibration,
    told_distortion,
    told_program,
)
from polarmap.io.recording.calibration.fields import Calibration
from polarmap.io.recording.calibration.picture_size import PictureSizes, picture_sizes
from polarmap.io.recording.camera_file import camera_file_of

_USUAL_BIT_DEPTH = 8
_DEMOSAIC = "edge-aware"


@dataclass(frozen=True)
class SensorChoice:
    """What is known of the sensor beside the calibration.

    preset: the sensor. picture: a raw picture of the camera, or a folder of some. offset: (x, y) on the sensor of the
    picture's first pixel. bit_depth, angle_direction: in place of what the picture and the preset say.
    """

    preset: SensorPreset
    picture: Path | None = None
    offset: tuple[int, int] | None = None
    bit_depth: int | None = None
    angle_direction: str | None = None


@dataclass(frozen=True)
class CalibratedCamera:
    """A camera file and how it came about, in short lines."""

    camera_file: CameraFile
    facts: tuple[str, ...]


def calibrated_camera(path: Path, sensor: SensorChoice, name: str | None = None) -> CalibratedCamera:
    """The camera of a calibration file (`io.recording.calibration`) and a sensor.

    Whether the calibration was made on the mosaic or on a channel is told by its size: that of the picture, else that
    of the sensor. For a region of the sensor, a calibration of the whole one is moved.
    name: which camera of several. Lines of the calibration file that are of the sensor come before the preset's.
    Raises InputError, naming the file, where it is no calibration, or the sizes do not fit.
    """
    with naming(path):
        calibration, values = read_calibration(path, name)
        if calibration is None:
            raise InputError(
                "no calibration of OpenCV, ROS, Kalibr, EuRoC, ORB-SLAM, VINS-Fusion or COLMAP is recognized in it "
                "(docs/formats.md); a camera file of polarmap is used as it is"
            )
        sizes = _sizes_of_picture(sensor)
        lens, facts = _lens(calibration, sensor, sizes)
        keys, told = _sensor_keys(sensor, sizes, own_sensor_keys(values))
        rate = {} if calibration.frame_rate is None else {"frame_rate": calibration.frame_rate}
        camera_file = camera_file_of(path, {**rate, **lens, **keys}, path.parent)
    return CalibratedCamera(camera_file, (told_program(calibration), *facts, told_distortion(calibration), *told))


def _sizes_of_picture(sensor: SensorChoice) -> PictureSizes | None:
    picture = sensor.picture
    if picture is None:
        if sensor.offset is not None:
            raise InputError("--offset: give a raw picture of the region too, with --picture")
        return None
    if not os.path.exists(picture):
        raise InputError(f"{picture}: no such file or folder")
    sizes = picture_sizes(picture, {})
    if sizes is None:
        raise InputError(f"{picture}: no picture in it tells its size; give a raw one as PNG, TIFF, PGM or BMP")
    _check_picture(sensor, sizes)
    return sizes


def _check_picture(sensor: SensorChoice, sizes: PictureSizes) -> None:
    preset, mosaic = sensor.preset, sizes.mosaic
    if mosaic is None:
        if preset.colour is not None:
            raise InputError(f"{sizes.name}: pictures of one angle must be grey; {preset.name} is a colour sensor")
        return
    size = _words(mosaic)
    if mosaic[0] % 2 or mosaic[1] % 2:
        raise InputError(f"{sizes.name}: {size} pixels are no mosaic of 2x2 blocks; both sides must be even")
    if not any(mosaic[0] <= width and mosaic[1] <= height for width, height in preset.sizes):
        raise InputError(f"{sizes.name}: {size} is more than an {preset.name} has ({_words(preset.sizes[-1])})")
    halves = {(width // 2, height // 2) for width, height in preset.sizes}
    if sensor.offset is None and mosaic in halves:
        raise InputError(
            f"{sizes.name}: {size} is half of an {preset.name}: a picture of one channel, or binned, and no mosaic; "
            "give a raw picture, or --offset X,Y if it is a region of the mosaic"
        )
    if sensor.offset is not None:
        ends = tuple(start + side for start, side in zip(sensor.offset, mosaic, strict=True))
        if ends[0] > preset.sizes[-1][0] or ends[1] > preset.sizes[-1][1]:
            raise InputError(
                f"--offset: the region ends at {_words(ends)}, beyond the {_words(preset.sizes[-1])} pixels"
            )


def _lens(
    calibration: Calibration, sensor: SensorChoice, sizes: PictureSizes | None
) -> tuple[dict[str, Any], tuple[str, ...]]:
    whole = _whole_sizes(sensor.preset)
    if sizes is None:
        return _lens_of_whole(calibration, whole)
    own = calibration.size is None or calibration.size in (sizes.channel, sizes.mosaic, sizes.doubled)
    larger = [each for each in whole if calibration.size in (each.channel, each.mosaic)]
    if own or not larger:
        camera, fact = channel_camera(calibration, sizes)
        return lens_values(camera, calibration), (fact,)
    if sensor.offset is None:
        raise InputError(
            f"calibrated with the whole {sensor.preset.name} ({_words(calibration.size)}), but {sizes.name} has "
            f"{sizes.told}; say where that region begins, with --offset X,Y"
        )
    camera, fact = channel_camera(calibration, larger[0])
    x, y = (start / 2 for start in sensor.offset)
    width, height = sizes.channel
    moved = replace(camera, width=width, height=height, cx=camera.cx - x, cy=camera.cy - y)
    return lens_values(moved, calibration), (fact, f"the centre is moved by {x:g}, {y:g} pixels of a channel")


def _lens_of_whole(calibration: Calibration, whole: list[PictureSizes]) -> tuple[dict[str, Any], tuple[str, ...]]:
    fitting = [each for each in whole if calibration.size in (None, each.channel, each.mosaic)]
    if not fitting:
        raise InputError(
            f"calibrated with pictures of {_words(calibration.size)}, but {whole[0].name} has {whole[0].told}; for a "
            "region of the sensor give a raw picture, with --picture"
        )
    camera, fact = channel_camera(calibration, fitting[0])
    return lens_values(camera, calibration), (fact,)


def _whole_sizes(preset: SensorPreset) -> list[PictureSizes]:
    name = f"an {preset.name}"
    return [PictureSizes(name, (w // 2, h // 2), (w, h), True, _USUAL_BIT_DEPTH) for w, h in preset.sizes]


def _sensor_keys(
    sensor: SensorChoice, sizes: PictureSizes | None, own: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    preset = sensor.preset
    layout, colour = region_of(preset, sensor.offset or (0, 0))
    of_angles = sizes is not None and sizes.mosaic is None
    bit_depth, facts = _bit_depth(sensor, sizes, own)
    keys: dict[str, Any] = {
        "mosaic": "none" if of_angles else list(layout.value),
        "angle_direction": sensor.angle_direction or preset.angle_direction.value,
        "colour": colour or "none",
        "demosaic": "split" if of_angles else _DEMOSAIC,
    }
    if preset.noise is not None:
        keys["noise"] = {"full_well": preset.noise.full_well, "read_noise": preset.noise.read_noise}
    given = {"angle_direction": sensor.angle_direction} if sensor.angle_direction else {}
    return {**keys, **own, **given, **bit_depth}, (*_told_layout(sensor, sizes, layout.value, colour), *facts)


def _bit_depth(
    sensor: SensorChoice, sizes: PictureSizes | None, own: Mapping[str, Any]
) -> tuple[dict[str, Any], tuple[str, ...]]:
    if sensor.bit_depth is not None:
        return {"bit_depth": sensor.bit_depth}, ()
    if {"bit_depth", "pixel_format"} & own.keys():
        return {}, ()
    if sizes is not None and sizes.bits != 8:
        known = ", ".join(map(str, sensor.preset.bit_depths[1:]))
        raise InputError(f"{sizes.name} has {sizes.bits} bits a pixel; say how many count, with --bit-depth ({known})")
    why = "as cameras send unless told otherwise; else --bit-depth" if sizes is None else "as in the picture"
    return {"bit_depth": _USUAL_BIT_DEPTH}, (f"bit_depth {_USUAL_BIT_DEPTH}, {why}",)


def _told_layout(
    sensor: SensorChoice, sizes: PictureSizes | None, block: tuple[int, ...], colour: str | None
) -> tuple[str, ...]:
    preset = sensor.preset
    if sizes is not None and sizes.mosaic is None:
        return ("one picture per angle",)
    order = f"{preset.name}, block {' '.join(map(str, block))} row by row" + (f", {colour}" if colour else "")
    if sizes is None or sizes.mosaic in preset.sizes:
        return (order,)
    region = f"{_words(sizes.mosaic)} is a region of its {_words(preset.sizes[0])}"
    if sensor.offset is not None:
        return (order, f"{region} from {sensor.offset[0]},{sensor.offset[1]} on")
    even = "multiples of 4" if preset.colour else "even numbers"
    return (order, f"{region}, which is taken to begin at {even} of columns and rows; if not, say so with --offset X,Y")


def _words(size: tuple[int, ...] | None) -> str:
    return "x".join(map(str, size or ()))
