"""From another program's calibration to the keys of a camera file: whose it is, which size it is for, which sensor."""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.images import ImageHeader
from polarmap.io.recording.calibration import camodocal, colmap, euroc, kalibr, opencv, orb_slam, ros
from polarmap.io.recording.calibration.fields import Calibration
from polarmap.io.recording.calibration.file_storage import read_values
from polarmap.io.recording.calibration.picture_size import PictureSizes, picture_sizes, sizes_of
from polarmap.io.recording.calibration.sensor import SENSOR_KEYS, require_sensor, sensor_of

log = logging.getLogger(__name__)

_FORMATS: tuple[tuple[Callable[[Mapping], bool], Callable[[Mapping], Calibration]], ...] = (
    (kalibr.is_kalibr, kalibr.read_kalibr),
    (euroc.is_euroc, euroc.read_euroc),
    (ros.is_camera_info, ros.read_camera_info),
    (orb_slam.is_orb_slam, orb_slam.read_orb_slam),
    (camodocal.is_camodocal, camodocal.read_camodocal),
    (opencv.is_opencv, opencv.read_opencv),
)
_CENTRE = 0.15  # of the width or height, that a principal point may be from the middle


def camera_file_values(path: Path, sequence: Path | None = None, picture: ImageHeader | None = None) -> Any:
    """The keys of the camera file that another program's calibration stands for; of any other file, what it holds.

    sequence: the folder or picture that it is for, whose camera.yaml tells of the sensor, as far as the calibration
    file has no such lines itself, and whose pictures tell which size is meant. picture: what one of them says of
    itself, where they are in no files. What was taken from where is logged as a warning, in one line.
    Raises InputError, naming the file and what is to be written, where it is not readable, a lens model is not known
    here, several cameras are to choose from, the sizes do not fit, or nothing tells what sensor it is.
    """
    with naming(path):
        calibration, values = read_calibration(path)
        if calibration is None:
            return values
        borrowed = {} if sequence is None else sensor_of(sequence, path)
        own = own_sensor_keys(values)
        return _converted(path, calibration, own, borrowed, lambda keys: _sizes(sequence, picture, keys))


@contextmanager
def naming(path: Path) -> Iterator[None]:
    """Puts the file's name before what is said of it, where it is not there."""
    try:
        yield
    except InputError as problem:
        raise problem if str(problem).startswith(str(path)) else InputError(f"{path}: {problem}") from None


def read_calibration(path: Path, camera: str | None = None) -> tuple[Calibration | None, Any]:
    """What another program's calibration file says, None where it is none, and the values that the file holds.

    camera: which of several is meant, in place of the file's own line `camera: NAME`. Raises InputError where the file
    is not readable, or its lens model not known here.
    """
    values = None if colmap.is_colmap(path) else read_values(path)
    if camera is not None and isinstance(values, dict):
        values = {**values, "camera": camera}
    return _calibration(path, values), values


def own_sensor_keys(values: Any) -> dict[str, Any]:
    """The keys of a camera file that are not of the lens, as far as a calibration file has them as lines of its own."""
    return {key: values[key] for key in SENSOR_KEYS if values and key in values}


def camera_info_values(
    where: str, message: Mapping[str, Any], sensor: Mapping[str, Any], picture: ImageHeader
) -> dict[str, Any]:
    """The keys of a camera file by a camera_info message, given as it is printed, and what is known of the sensor.

    where: names the message. picture: of the camera; its size tells whether the message is of the mosaic or a channel.
    What was found is logged as a warning, in one line. Raises InputError where the message cannot be used.
    """
    try:
        calibration = ros.read_camera_info(message)
        return _converted(where, calibration, dict(sensor), {}, lambda keys: sizes_of("the picture", picture, keys))
    except InputError as problem:
        raise InputError(f"{where}: {problem}") from None


def _sizes(sequence: Path | None, picture: ImageHeader | None, keys: Mapping[str, Any]) -> PictureSizes | None:
    if sequence is None:
        return None
    return picture_sizes(sequence, keys) if picture is None else sizes_of(sequence.name, picture, keys)


def _calibration(path: Path, values: Any) -> Calibration | None:
    if values is None:
        return colmap.read_colmap(path) if colmap.is_colmap(path) else None
    if not isinstance(values, dict) or not all(isinstance(key, str) for key in values):
        return None
    return next((read(values) for recognize, read in _FORMATS if recognize(values)), None)


def _converted(
    path: Path | str,
    calibration: Calibration,
    own: dict[str, Any],
    borrowed: dict[str, Any],
    sizes_by: Callable[[Mapping[str, Any]], PictureSizes | None],
) -> dict[str, Any]:
    rate = {} if calibration.frame_rate is None else {"frame_rate": calibration.frame_rate}
    keys = {**rate, **borrowed, **own}
    sizes = sizes_by(keys)
    eight = sizes is not None and sizes.bits == 8 and not {"bit_depth", "pixel_format"} & keys.keys()
    keys |= {"bit_depth": 8} if eight else {}
    require_sensor(calibration.program, keys)
    camera, which = channel_camera(calibration, sizes)
    facts = [which, told_distortion(calibration)]
    facts += ["the sensor is that of the sequence's camera.yaml"] if borrowed.keys() - own.keys() else []
    facts += ["bit_depth 8 as in the pictures"] if eight else []
    log.warning("%s: %s; %s", path, told_program(calibration), "; ".join(facts))
    return {**lens_values(camera, calibration), **keys}


def told_program(calibration: Calibration) -> str:
    """Whose calibration it is, and of which camera, in words."""
    name = f" {calibration.camera}" if calibration.camera else ""
    return f"read as a calibration of {calibration.program}{name}"


def told_distortion(calibration: Calibration) -> str:
    """Its lens model in words."""
    return f"{calibration.distortion.model} distortion" if calibration.distortion else "no distortion"


def channel_camera(calibration: Calibration, sizes: PictureSizes | None) -> tuple[PinholeCamera, str]:
    """The camera of a channel (of a plain camera: of its picture), and what was found about sizes."""
    if calibration.size is None:
        calibration = replace(calibration, size=_size_by_centre(calibration, sizes))
    camera = PinholeCamera(*calibration.size, calibration.fx, calibration.fy, calibration.cx, calibration.cy)
    size = f"{camera.width}x{camera.height}"
    if sizes is None or calibration.size == sizes.channel:
        return camera, f"{size} is the size of a channel" if sizes is None or sizes.mosaic else f"{size}"
    if calibration.size in (sizes.mosaic, sizes.doubled):
        halved = camera.resized(sizes.channel[::-1])
        return halved, f"{size} is the size of the mosaic, so that all is halved for a channel"
    raise InputError(
        f"calibrated with pictures of {size}, but {sizes.name} has {sizes.told}; calibrate with pictures of that size, "
        "or write a camera.yaml with the numbers for it (docs/camera.md)"
    )


def _size_by_centre(calibration: Calibration, sizes: PictureSizes | None) -> tuple[int, int]:
    """The size whose middle is near the principal point, for files that do not tell their pictures' size."""
    for size in () if sizes is None else filter(None, (sizes.channel, sizes.mosaic)):
        x, y = (calibration.cx + 0.5) / size[0] - 0.5, (calibration.cy + 0.5) / size[1] - 0.5
        if max(abs(x), abs(y)) < _CENTRE:
            return size
    keys = "Camera.width and Camera.height" if calibration.program == "ORB-SLAM" else "image_width and image_height"
    raise InputError(f"does not tell the size of its pictures; add {keys}")


def lens_values(camera: PinholeCamera, calibration: Calibration) -> dict[str, Any]:
    """The keys of a camera file that are of the lens."""
    values: dict[str, Any] = {key: getattr(camera, key) for key in ("width", "height", "fx", "fy", "cx", "cy")}
    if calibration.distortion is not None:
        lens = calibration.distortion
        values["distortion"] = {"model": lens.model, "coefficients": list(lens.coefficients)}
    return values
