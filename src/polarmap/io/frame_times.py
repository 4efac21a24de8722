"""When the frames of a sequence were taken, and how long they were exposed.

timestamps.txt   seconds, one number a line in frame order
exposures.txt    milliseconds, one number a line in frame order
times.txt        `name seconds [milliseconds]` a line (TUM monoVO), or seconds alone (KITTI)
rgb.txt          `seconds file` a line (TUM RGB-D), for pictures in rgb/
data.csv         `nanoseconds,file` a line (EuRoC), beside its folder data/
"""

from __future__ import annotations

import math
from itertools import pairwise
from pathlib import Path, PurePosixPath
from typing import NamedTuple

from polarmap.errors import InputError
from polarmap.io.files import data_lines

_NOT_SECONDS = 1e11  # the year 5138; a time beyond it is in milli- or nanoseconds
_NOT_MILLISECONDS = 1e7


class Shot(NamedTuple):
    """When a frame was taken and how long it was exposed, seconds; NaN for what is not known."""

    timestamp: float = math.nan
    exposure: float = math.nan


def read_timestamps(path: Path) -> list[float]:
    """The times in a text file, seconds, one number a line.

    Raises InputError naming the line that is no finite number or does not come after the one before.
    """
    times: list[float] = []
    for line_number, text in data_lines(path):
        where = f"{path}, line {line_number}"
        time = _seconds(where, text)
        if times and time <= times[-1]:
            raise InputError(f"{where}: {time} s does not come after {times[-1]} s; times must increase")
        times.append(time)
    return times


def read_exposures(path: Path) -> list[float]:
    """The exposure times in a text file of milliseconds, one number a line; seconds, NaN for 0 or nan (not known).

    Raises InputError naming the line that is no such number.
    """
    return [_exposure(f"{path}, line {line_number}", text) for line_number, text in data_lines(path)]


def find_shots(folder: Path, pictures: Path, names: list[str]) -> list[Shot] | None:
    """Time and exposure of each frame, or None where no file of the sequence in `folder` tells its times.

    pictures: the folder of the pictures. names: those of the frames without suffix, in order. Raises InputError
    where a file does not fit the frames.
    """
    times, listed = folder / "timestamps.txt", _listing(folder, pictures)
    if times.exists() or listed is None:
        return _with_times(times, len(names)) if times.exists() else None
    path, shots = listed
    if shots is None:
        return _with_times(path, len(names))
    unknown = next((name for name in names if name not in shots), None)
    if unknown is not None:
        raise InputError(f"{path}: no line for the frame {unknown}")
    for before, after in pairwise(names):
        if shots[after].timestamp <= shots[before].timestamp:
            raise InputError(f"{path}: frame {after} does not come after {before}; times must increase")
    return [shots[name] for name in names]


def with_exposures(folder: Path, shots: list[Shot]) -> list[Shot]:
    """The frames' shots with the exposures of exposures.txt where there is one; InputError where it does not fit."""
    path = folder / "exposures.txt"
    if not path.exists():
        return shots
    exposures = read_exposures(path)
    _require_one_each(path, len(exposures), len(shots), "exposures")
    return [shot._replace(exposure=exposure) for shot, exposure in zip(shots, exposures, strict=True)]


def _with_times(path: Path, frames: int) -> list[Shot]:
    times = read_timestamps(path)
    _require_one_each(path, len(times), frames, "times")
    return [Shot(time) for time in times]


def _require_one_each(path: Path, found: int, frames: int, what: str) -> None:
    if found != frames:
        raise InputError(f"{path}: {found} {what} for {frames} frames; each frame needs its own line")


def _listing(folder: Path, pictures: Path) -> tuple[Path, dict[str, Shot] | None] | None:
    """The file that lists frames by name and what it says; nothing but the file where it has times alone."""
    if (path := folder / "times.txt").exists():
        lines = [(f"{path}, line {number}", text.split()) for number, text in data_lines(path)]
        alone = all(len(fields) == 1 for _, fields in lines)
        return path, None if alone else _by_name(_parse_times_line(*line) for line in lines)
    if pictures.name == "rgb" and (path := pictures.parent / "rgb.txt").exists():
        return path, _by_name(_parse_rgb_line(f"{path}, line {number}", text) for number, text in data_lines(path))
    if pictures.name == "data" and (path := pictures.parent / "data.csv").exists():
        return path, _by_name(_parse_csv_line(f"{path}, line {number}", text) for number, text in data_lines(path))
    return None


def _by_name(lines) -> dict[str, Shot]:
    shots: dict[str, Shot] = {}
    for where, name, shot in lines:
        if name in shots:
            raise InputError(f"{where}: the frame {name} a second time")
        shots[name] = shot
    return shots


def _parse_times_line(where: str, fields: list[str]) -> tuple[str, str, Shot]:
    if len(fields) not in (2, 3):
        raise InputError(f"{where}: {len(fields)} columns, expected a frame's name, seconds, and milliseconds exposed")
    exposure = _exposure(where, fields[2]) if len(fields) == 3 else math.nan
    return where, fields[0], Shot(_seconds(where, fields[1]), exposure)


def _parse_rgb_line(where: str, text: str) -> tuple[str, str, Shot]:
    fields = text.split()
    if len(fields) != 2:
        raise InputError(f"{where}: {len(fields)} columns, expected seconds and a file name")
    return where, PurePosixPath(fields[1]).stem, Shot(_seconds(where, fields[0]))


def _parse_csv_line(where: str, text: str) -> tuple[str, str, Shot]:
    fields = [field.strip() for field in text.split(",")]
    if len(fields) != 2 or not (fields[0].isascii() and fields[0].isdecimal() and len(fields[0]) < 20):
        raise InputError(f"{where}: {text[:40]!r} is not nanoseconds, a comma and a file name")
    return where, PurePosixPath(fields[1]).stem, Shot(int(fields[0]) / 1e9)


def _seconds(where: str, text: str) -> float:
    try:
        time = float(text)
    except ValueError:
        raise InputError(f"{where}: {text[:40]!r} is not one number; expected a time in seconds") from None
    if not math.isfinite(time) or abs(time) > _NOT_SECONDS:
        raise InputError(f"{where}: {time} is not a time in seconds")
    return time


def _exposure(where: str, text: str) -> float:
    try:
        exposure = float(text)
    except ValueError:
        raise InputError(f"{where}: {text[:40]!r} is not one number; expected an exposure in milliseconds") from None
    if exposure < 0 or exposure > _NOT_MILLISECONDS:
        raise InputError(f"{where}: {exposure} is not an exposure in milliseconds")
    return exposure / 1e3 or math.nan
