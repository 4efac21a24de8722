"""Which picture belongs to which depth image: numbered folders, and lists of times and file names."""

from __future__ import annotations

import math
import os
import re
from collections.abc import Iterable
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import data_lines, reason
from polarmap.io.formats.images import PICTURE_SUFFIXES

PICTURE_FOLDERS = ("rgb", "color", "image", "images", "gray", "grey")

_NUMBER = re.compile(r"([0-9]{1,15})")


def only_folder(folder: Path, names: Iterable[str], what: str) -> Path:
    """The one folder of these names; InputError where there is none."""
    found = [folder / name for name in names if os.path.isdir(folder / name)]
    if not found:
        raise InputError(f"{folder}: no folder of {what}; expected {', '.join(f'{name}/' for name in names)}")
    if len(found) > 1:
        raise InputError(f"{folder}: both {found[0].name}/ and {found[1].name}/ hold {what}; keep one of them")
    return found[0]


def numbered(folder: Path, suffixes: tuple[str, ...] = PICTURE_SUFFIXES, prefix: str = "") -> dict[int, Path]:
    """The files of a folder whose names begin with `prefix`, by the first number after it, in order."""
    files: dict[int, Path] = {}
    try:
        paths = sorted(folder.iterdir())
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({reason(error)})") from None
    for path in paths:
        if not path.name.startswith(prefix) or path.suffix.lower() not in suffixes:
            continue
        number = _NUMBER.search(path.stem, len(prefix))
        if number is None:
            raise InputError(f"{path}: no number in its name, which must say the frame's")
        other = files.setdefault(int(number[1]), path)
        if other is not path:
            raise InputError(f"{path}: the same frame as {other.name}; keep one of them")
    if not files:
        raise InputError(f"{folder}: no {prefix}*{'/'.join(suffixes)} files")
    return dict(sorted(files.items()))


def paired(pictures: dict[int, Path], depths: dict[int, Path]) -> list[tuple[int, Path, Path]]:
    """(number, picture, depth) of frames that have both; InputError where one lacks the other."""
    for here, other, what in ((pictures, depths, "depth image"), (depths, pictures, "picture")):
        alone = next((number for number in here if number not in other), None)
        if alone is not None:
            folder = next(iter(other.values())).parent
            raise InputError(
                f"{folder}: no {what} for {here[alone].name} "
                f"({len(pictures)} pictures, {len(depths)} depth images; each frame needs both)"
            )
    return [(number, picture, depths[number]) for number, picture in pictures.items()]


def read_listing(path: Path) -> tuple[np.ndarray, list[Path]]:
    """Seconds, float64 N, and files of a list of `seconds file` a line (TUM RGB-D).

    Raises InputError naming the line where a column is missing, time does not increase, or a file lies outside.
    """
    times, files = [], []
    for number, text in data_lines(path):
        where = f"{path}, line {number}"
        fields = text.split()
        if len(fields) != 2:
            raise InputError(f"{where}: {len(fields)} columns, expected 2: seconds file")
        times.append(_seconds(where, fields[0]))
        files.append(inside(path.parent, fields[1], where))
        _require_later(where, times[-2:])
    if not times:
        raise InputError(f"{path}: no lines; expected 'seconds file' a line")
    return np.array(times), files


def read_associations(path: Path) -> list[tuple[float, Path, float, Path]]:
    """(time, picture, time, depth) of each line `time file time file`, in either order; the depth file says so.

    Raises InputError naming the line where a column is missing, the depth's time does not increase, or a file lies
    outside.
    """
    rows = []
    for number, text in data_lines(path):
        where = f"{path}, line {number}"
        fields = text.split()
        if len(fields) != 4:
            raise InputError(f"{where}: {len(fields)} columns, expected 4: time depth/file time rgb/file")
        (t1, file1), (t2, file2) = fields[:2], fields[2:]
        row = (
            _seconds(where, t1),
            inside(path.parent, file1, where),
            _seconds(where, t2),
            inside(path.parent, file2, where),
        )
        if "depth" not in file1 and "depth" not in file2:
            raise InputError(f"{where}: neither file has 'depth' in its name; expected depth/file and rgb/file")
        rows.append(row[2:] + row[:2] if "depth" in file1 else row)
        _require_later(where, [time for _, _, time, _ in rows[-2:]])
    if not rows:
        raise InputError(f"{path}: no lines; expected 'time depth/file time rgb/file' a line")
    return rows


def nearest_pairs(times: np.ndarray, others: np.ndarray, max_difference: float) -> list[tuple[int, int]]:
    """Positions (i, j) where times[i] and others[j] are each other's nearest, at most `max_difference` apart."""
    there, back = _nearest(times, others), _nearest(others, times)
    return [(i, int(j)) for i, j in enumerate(there) if back[j] == i and abs(times[i] - others[j]) <= max_difference]


def _nearest(times: np.ndarray, others: np.ndarray) -> np.ndarray:
    """For each time the position of the nearest of the others; both increase."""
    after = np.clip(np.searchsorted(others, times), 1, max(len(others) - 1, 1))
    before = after - 1
    after = np.minimum(after, len(others) - 1)
    return np.where(np.abs(times - others[before]) <= np.abs(others[after] - times), before, after)


def inside(folder: Path, name: str, where: str) -> Path:
    """The file of this name in a folder; InputError where the name leads out of it."""
    parts = name.replace("\\", "/").split("/")
    if any(part in ("", "..") or ":" in part or not part.isprintable() for part in parts):
        raise InputError(f"{where}: {name[:60]!r} is not the name of a file inside the recording")
    return folder / name


def _require_later(where: str, times: list[float]) -> None:
    """InputError where the second of two times does not come after the first."""
    if len(times) == 2 and times[1] <= times[0]:
        raise InputError(f"{where}: time {times[1]} s does not come after {times[0]} s; sort the lines")


def _seconds(where: str, text: str) -> float:
    try:
        value = float(text)
    except ValueError:
        value = math.nan
    if not math.isfinite(value):
        raise InputError(f"{where}: {text[:40]!r} is not a time in seconds")
    return value
