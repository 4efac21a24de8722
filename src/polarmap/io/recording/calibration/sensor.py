"""What no calibration knows of a camera: its sensor, from the camera file of the sequence."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from polarmap.errors import InputError
from polarmap.io.recording.calibration.file_storage import read_values

CAMERA_FILE_NAME = "camera.yaml"
SENSOR_KEYS = (
    "polarization", "mosaic", "angle_direction", "bit_depth", "bit_alignment", "pixel_format", "black_level", "colour",
    "demosaic", "noise", "frame_rate", "depth_scale", "images", "photometric",
    "calibration",
)  # fmt: skip
"""The keys of a camera file that are not of the lens; in a calibration file they may stand as lines of their own."""

_MOSAIC = "`mosaic: [90, 45, 135, 0]` (the block's angles row by row)"
_DIRECTION = "`angle_direction: counterclockwise` (or clockwise)"
_DEPTH = "`bit_depth: 8` (or 10, 12, 16)"


def find_camera_file(sequence: Path) -> Path | None:
    """The camera.yaml of a sequence's folder; of a single picture, that beside it or in the folder above."""
    folders = [sequence] if sequence.is_dir() else [sequence.parent, sequence.parent.parent]
    return next((folder / CAMERA_FILE_NAME for folder in folders if os.path.exists(folder / CAMERA_FILE_NAME)), None)


def sensor_of(sequence: Path, calibration: Path) -> dict[str, Any]:
    """What the camera file of a sequence says of the sensor; nothing where that is the calibration itself, or missing.

    Paths of photometric files are absolute. Raises InputError where the camera file cannot be read.
    """
    own = find_camera_file(sequence)
    if own is None or own.resolve() == calibration.resolve():
        return {}
    values = read_values(own)
    sensor = {key: values[key] for key in SENSOR_KEYS if key in values} if isinstance(values, dict) else {}
    if isinstance(files := sensor.get("photometric"), dict):
        sensor["photometric"] = {key: os.path.abspath(own.parent / str(name)) for key, name in files.items()}
    return sensor


def require_sensor(program: str, keys: Mapping[str, Any]) -> None:
    """Raise InputError, with the lines to add, where the keys do not say how polarizers lie or how deep a pixel is."""
    plain = keys.get("polarization") == "none"
    lines = {} if plain else {"mosaic": _MOSAIC, "angle_direction": _DIRECTION}
    if "pixel_format" not in keys:
        lines["bit_depth"] = _DEPTH
    missing = [line for key, line in lines.items() if key not in keys]
    if not missing:
        return
    other = ", or `polarization: none` for a plain camera," if "mosaic" not in keys and not plain else ""
    raise InputError(
        f"a calibration of {program}, which does not know the sensor; add the lines {', '.join(missing)}{other} to "
        + ("the" if program == "COLMAP" else "it, or to the")
        + " sequence's camera.yaml"
    )
