"""Files of a photometric calibration, as the TUM monoVO data set has them: pcalib.txt and vignette.png."""

from __future__ import annotations

import logging
import math
from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.photometric import PhotometricCalibration
from polarmap.errors import InputError
from polarmap.io.files import read_text
from polarmap.io.formats.images import read_picture

log = logging.getLogger(__name__)

_MAX_RESPONSE_BYTES = 1 << 22
_ENTRIES = (256, 1 << 16)  # from, to
_MOST_DARK = 0.5  # of a vignette; a fisheye's circle fills more


def read_photometric(camera_file: CameraFile) -> PhotometricCalibration | None:
    """The calibration that a camera file names, or None where it names none.

    Raises InputError where a file is not as documented, or the vignette's size is not the camera's.
    """
    files = camera_file.photometric
    if files is None or (files.response is None and files.vignette is None):
        return None
    size = camera_file.camera.width, camera_file.camera.height
    return PhotometricCalibration(
        None if files.response is None else read_response(files.response),
        None if files.vignette is None else read_vignette(files.vignette, size),
    )


def read_response(path: Path) -> np.ndarray:
    """The inverse response in a text file, scaled to go from 0 to 1, float32 N.

    The file has 256 to 65536 numbers separated by white space, the irradiance that each pixel value stands for,
    in any unit. Raises InputError where there are fewer, one is not finite or negative, or they do not increase.
    """
    path = Path(path)
    fields = read_text(path, _MAX_RESPONSE_BYTES).split()
    if not _ENTRIES[0] <= len(fields) <= _ENTRIES[1]:
        raise InputError(f"{path}: {len(fields)} numbers, expected {_ENTRIES[0]}, the irradiance of each pixel value")
    values = np.array([_number(path, field) for field in fields])
    if values.min() < 0:
        place = int(np.argmax(values < 0))
        raise InputError(f"{path}: number {place + 1} is {values[place]:g}; an irradiance is not negative")
    scaled = ((values - values[0]) / ((values[-1] - values[0]) or 1.0)).astype(np.float32)
    falling = np.diff(scaled) <= 0
    if values[-1] <= values[0] or falling.any():
        place = int(np.argmax(falling)) + 1
        raise InputError(f"{path}: number {place + 1} is not more than the one before; a response must increase")
    return scaled


def read_vignette(path: Path, size: tuple[int, int] | None = None) -> np.ndarray:
    """The vignette in a picture of 8 or 16 bits, scaled to a maximum of 1, float32 H×W in [0, 1].

    size: the (width, height) that it must have, if any. Raises InputError where it cannot be read or is black. Says so
    in a warning where it is 0 in more than half of the picture, of which odometry then sees nothing.
    """
    pixels = read_picture(Path(path), size).astype(np.float32)
    if pixels.max() == 0:
        raise InputError(f"{path}: all black; a vignette is brightest where the lens lets most light through")
    dark = float((pixels == 0).mean())
    if dark > _MOST_DARK:
        log.warning("%s: 0 in %.0f %% of its pixels, which odometry will not see", path, 100 * dark)
    return pixels / pixels.max()


def _number(path: Path, field: str) -> float:
    try:
        value = float(field)
    except ValueError:
        value = math.nan
    if not math.isfinite(value) or abs(value) > 1e30:
        raise InputError(f"{path}: {field[:40]!r} is no number that an irradiance can be")
    return value
