"""What calibration files hold, taken apart with errors that name the key."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from typing import Any

from polarmap.errors import InputError, quoted
from polarmap.geometry.distortion import Distortion


@dataclass(frozen=True)
class Calibration:
    """One camera of a calibration file.

    program: whose format it is, for messages. camera: its name in the file, empty where there is but one.
    size: (width, height) of the pictures that it was calibrated with; None where the file does not say.
    fx, fy, cx, cy: pixels of those pictures, the first pixel's centre at (0, 0).
    frame_rate: frames per second, where the file says so.
    """

    program: str
    camera: str
    size: tuple[int, int] | None
    fx: float
    fy: float
    cx: float
    cy: float
    distortion: Distortion | None = None
    frame_rate: float | None = None


def number(value: Any, name: str) -> float:
    """A finite number, also one that YAML takes for text, as 1e-5."""
    found = math.nan
    if isinstance(value, str | int | float) and not isinstance(value, bool):
        with suppress(ValueError, OverflowError):
            found = float(value)
    if not math.isfinite(found):
        raise InputError(f"{name}: {quoted(value)} is no finite number")
    return found


def numbers(value: Any, name: str, count: int | None = None) -> tuple[float, ...]:
    """A list of numbers, a list of rows of them, or a matrix as OpenCV and ROS write it: {rows, cols, data}."""
    if isinstance(value, Mapping):
        value = _data(value, name)
    if not isinstance(value, Sequence) or isinstance(value, str):
        raise InputError(f"{name}: {quoted(value)} is no list of numbers")
    flat = [item for row in value for item in (row if isinstance(row, list) else [row])]
    if count is not None and len(flat) != count:
        raise InputError(f"{name}: {len(flat)} numbers, expected {count}")
    return tuple(number(item, name) for item in flat)


def _data(matrix: Mapping[str, Any], name: str) -> Any:
    if "data" not in matrix:
        raise InputError(f"{name}: a matrix without data")
    data = matrix["data"]
    if isinstance(data, Sequence) and {"rows", "cols"} <= matrix.keys():
        rows, columns = (number(matrix[key], f"{name}.{key}") for key in ("rows", "cols"))
        if rows * columns != len(data):
            raise InputError(f"{name}: {rows:g}x{columns:g}, but {len(data)} numbers")
    return data


def size(width: Any, height: Any, names: str) -> tuple[int, int]:
    """(width, height) in pixels, both whole and positive."""
    found = number(width, names), number(height, names)
    if not all(side >= 1 and side.is_integer() for side in found):
        raise InputError(f"{names}: {quoted(width)} and {quoted(height)} are no image size")
    return int(found[0]), int(found[1])


def from_matrix(value: Any, name: str) -> tuple[float, float, float, float]:
    """fx, fy, cx, cy of a 3×3 camera matrix; InputError where it is none, or has skew."""
    fx, skew, cx, below, fy, cy, *last = numbers(value, name, 9)
    if below != 0 or tuple(last) != (0.0, 0.0, 1.0):
        raise InputError(f"{name}: not a camera matrix [fx, 0, cx, 0, fy, cy, 0, 0, 1]")
    if skew != 0:
        raise InputError(f"{name}: a skew of {skew:g} is not known here; calibrate again without it")
    return fx, fy, cx, cy


def first_of(mapping: Mapping[str, Any], names: Sequence[str]) -> str | None:
    """The first of these keys that a mapping has."""
    return next((name for name in names if name in mapping), None)


def required(mapping: Mapping[str, Any], name: str) -> Any:
    """A key's value; InputError where it is missing."""
    if name not in mapping:
        raise InputError(f"{name} is missing")
    return mapping[name]


def chosen(cameras: Sequence[str], wanted: Any) -> str:
    """Which of several cameras the file's line `camera: NAME` asks for; the only one where there is one."""
    if wanted is None and len(cameras) == 1:
        return cameras[0]
    if isinstance(wanted, str) and wanted in cameras:
        return wanted
    known = ", ".join(cameras)
    if wanted is None:
        raise InputError(f"holds {len(cameras)} cameras ({known}); choose one: add the line `camera: {cameras[0]}`")
    raise InputError(f"camera: {quoted(wanted)} is none of those in the file ({known})")
