"""When the frames of a sequence were taken, and how long they were exposed.

timestamps.txt   a time a line in frame order (also beside the folder of the pictures, as KITTI's raw data have it)
exposures.txt    milliseconds, one number a line in frame order
times.txt        `name seconds [milliseconds]` a line (TUM monoVO), or times alone (KITTI)
rgb.txt          `seconds file` a line (TUM RGB-D), for pictures in rgb/
data.csv         `nanoseconds,file` a line (EuRoC), beside its folder data/

Any of the lists of times may name the frames or not. Times are seconds, milli-, micro- or nanoseconds, by a header or
by their size, or dates.
"""

from __future__ import annotations

import logging
import math
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path, PurePosixPath
from statistics import median
from typing import NamedTuple

from polarmap.data.times import Timestamp
from polarmap.errors import InputError
from polarmap.io.formats.images import PICTURE_SUFFIXES
from polarmap.io.formats.text_table import TextTable, read_table, split_unit
from polarmap.io.formats.times import (
    UNIT_NAMES,
    UNITS,
    as_floats,
    from_nanoseconds,
    parse_date,
    parse_number,
    seconds_text,
    timestamp,
    unit_of,
    unit_word,
)
from polarmap.io.recording.frame_order import FrameOrder

log = logging.getLogger(__name__)

_SHORTEST_EXPOSURE = 2e-5  # seconds
_LONGEST_EXPOSURE = 10.0
_AGREE = 1e-3  # seconds, of two files of times
_EVEN = 0.3  # of a step between times
_EXPOSURE_WORDS = ("exposure", "exp", "shutter")
_EXPECTED = "expected a frame's name, seconds, and milliseconds exposed, or times alone"


class Shot(NamedTuple):
    """When a frame was taken and how long it was exposed, seconds; NaN for what is not known."""

    timestamp: float = math.nan
    exposure: float = math.nan


def find_shots(folder: Path, pictures: Path, order: FrameOrder) -> list[Shot] | None:
    """Time and exposure of each frame, or None where no file of the sequence in `folder` tells its times.

    pictures: the folder of the pictures. Raises InputError where a file does not fit the frames. A second file of
    times that says something else is named in a warning.
    """
    files = _time_files(folder, pictures)
    if not files:
        return None
    shots = _read_shots(files[0], order)
    for other in files[1:]:
        if not _agrees(other, order, shots):
            log.warning("%s: times are those of this file; %s says otherwise and is not used", files[0], other)
    return shots


def with_exposures(folder: Path, shots: list[Shot], order: FrameOrder) -> list[Shot]:
    """The frames' shots with the exposures of exposures.txt where there is one; InputError where it does not fit."""
    path = folder / "exposures.txt"
    if not path.exists():
        return shots
    table = read_table(path)
    numbers = [_exposure(table.where(row), _only(table, row)) for row in range(len(table.rows))]
    lines = _lines_of_frames(path, len(numbers), order, "exposures")
    exposures = _exposures(path, [numbers[i] for i in lines], _unit(table, 0), shots)
    return [shot._replace(exposure=exposure) for shot, exposure in zip(shots, exposures, strict=True)]


def _time_files(folder: Path, pictures: Path) -> list[Path]:
    """The files of times that are there, the one that counts first."""
    beside = pictures.parent
    wanted = [folder / "timestamps.txt", beside / "timestamps.txt", folder / "times.txt", beside / "times.txt"]
    if pictures == folder:
        wanted = wanted[::2]
    wanted += [beside / "rgb.txt"] if pictures.name == "rgb" else []
    wanted += [beside / "data.csv"] if pictures.name == "data" else []
    return [path for path in dict.fromkeys(wanted) if path.exists()]


def _agrees(path: Path, order: FrameOrder, shots: list[Shot]) -> bool:
    try:
        others = _read_shots(path, order)
    except InputError:
        return False
    return all(abs(a.timestamp - b.timestamp) < _AGREE for a, b in zip(shots, others, strict=True))


def _read_shots(path: Path, order: FrameOrder) -> list[Shot]:
    table, names = read_table(path), list(order.indices)
    if _times_alone(table):
        lines = _lines_of_frames(path, len(table.rows), order, "times")
        times = _times(table, [" ".join(fields) for _, fields in table.rows], _unit(table, 0))
        _require_increasing(table, range(len(times)), times)
        shots = [Shot(times[i]) for i in lines]
        _require_gap_in_times(path, order, shots)
        return shots
    column = _name_column(table, names)
    rows = _rows_by_name(table, column, names)
    return _listed_shots(table, column, [_row_of(table, rows, name) for name in names], names)


def _times_alone(table: TextTable) -> bool:
    """Whether lines hold a time and nothing else."""
    joined = [" ".join(fields) for _, fields in table.rows]
    return all(len(fields) == 1 or parse_date(text) for (_, fields), text in zip(table.rows, joined, strict=True))


def _lines_of_frames(path: Path, lines: int, order: FrameOrder, what: str) -> Sequence[int]:
    """Which line of a file with one for each frame belongs to which frame.

    Where frames were lost, a file may have lines for them too: its first line is then that of the frame 0, or the
    lines are those of the first to the last frame.
    """
    numbers, lost = list(order.indices.values()), order.lost()
    if lines == len(numbers):
        return range(lines)
    if lost is not None and lines >= len(numbers):
        first, last = numbers[0], numbers[-1]
        if (first == 0 and lines > last) or lines == last - first + 1:
            return [number - first for number in numbers]
    missing = f" (frame {lost[0]} is missing)" if lost is not None else ""
    raise InputError(
        f"{path}: {lines} {what} for {len(numbers)} frames{missing}; each frame needs its own line, or list frames "
        "by name in times.txt"
    )


def _require_gap_in_times(path: Path, order: FrameOrder, shots: list[Shot]) -> None:
    """InputError where numbers of frames leave one out and evenly spaced times do not: they belong to other frames."""
    lost, numbers = order.lost(), list(order.indices.values())
    steps = [b - a for a, b in pairwise(numbers)]
    seconds = [b.timestamp - a.timestamp for a, b in pairwise(shots)]
    usual = [time for step, time in zip(steps, seconds, strict=True) if step == min(steps)]
    if lost is None or not usual:
        return
    typical = median(usual)
    even = all(abs(time - typical) < _EVEN * typical for time in seconds)
    if even and len(usual) > 1:
        raise InputError(
            f"{path}: frame {lost[0]} is missing, but the times go on evenly; take out its line, or renumber the frames"
        )


def _name_column(table: TextTable, names: list[str]) -> int:
    """The column that names the frames: where most of them are found, best with a picture's suffix."""
    count = min(len(fields) for _, fields in table.rows)
    wanted = set(names)

    def found(column: int) -> tuple[int, bool]:
        texts = [fields[column] for _, fields in table.rows]
        return sum(_stem(text) in wanted for text in texts), any(_stem(text) != text for text in texts)

    best = max(range(count), key=lambda column: (*found(column), -column))
    if found(best)[0]:
        return best
    suffixed = next((column for column in range(count) if found(column)[1]), None)
    return _number_column(table, names) if suffixed is None else suffixed


def _number_column(table: TextTable, names: list[str]) -> int:
    """The first column, of frames' numbers without their zeros; InputError where it is none."""
    numbers = {name.lstrip("0") for name in names if name.isdecimal()}
    if not any(fields[0].lstrip("0") in numbers for _, fields in table.rows):
        raise InputError(f"{table.where(0)}: no column names a frame, such as {names[0]}; {_EXPECTED}")
    return 0


def _rows_by_name(table: TextTable, column: int, names: list[str]) -> dict[str, int]:
    """The row of each name, and of each number without its zeros where names are numbers."""
    rows: dict[str, int] = {}
    for row, (_, fields) in enumerate(table.rows):
        name = _stem(fields[column])
        if name in rows:
            raise InputError(f"{table.where(row)}: the frame {name} a second time")
        rows[name] = row
    if not any(name in rows for name in names):
        rows |= {name: rows[name.lstrip("0") or "0"] for name in names if (name.lstrip("0") or "0") in rows}
    return rows


def _row_of(table: TextTable, rows: dict[str, int], name: str) -> int:
    if name in rows:
        return rows[name]
    raise InputError(
        f"{table.path}: none of its {len(table.rows)} lines names the frame {name} (the first names "
        f"{next(iter(rows))[:40]!r}); add a line for it, or take the picture away"
    )


def _stem(text: str) -> str:
    """The name of a frame without folder and a picture's suffix."""
    name = PurePosixPath(text.replace("\\", "/")).name
    suffix = PurePosixPath(name).suffix.lower()
    return name[: -len(suffix)] if suffix in (*PICTURE_SUFFIXES, ".raw", ".bin") else name


def _listed_shots(table: TextTable, column: int, rows: list[int], names: list[str]) -> list[Shot]:
    """Time and exposure of the frames in these rows, whose other columns they are."""
    count = len(table.rows[0][1])
    others = [i for i in range(count) if i != column]
    exposed = [i for i in others if any(word in _title(table, i) for word in _EXPOSURE_WORDS)]
    timed = [i for i in others if i not in exposed]
    dated = len(timed) > 1 and all(
        len(fields) > timed[1] and parse_date(f"{fields[timed[0]]} {fields[timed[1]]}") for _, fields in table.rows
    )
    time_columns, rest = (timed[:2], timed[2:]) if dated else (timed[:1], timed[1:])
    exposed = [*exposed, *rest]
    for row, (_, fields) in enumerate(table.rows):
        fits = time_columns and max(time_columns) < len(fields) <= max(count, column + 1)
        if not fits or len(exposed) > 1:
            raise InputError(f"{table.where(row)}: {len(fields)} columns, {_EXPECTED}")
    times = _times(table, [" ".join(f[i] for i in time_columns) for _, f in table.rows], _unit(table, time_columns[0]))
    chosen = [times[row] for row in rows]
    for (before, a), (after, b) in pairwise(zip(names, chosen, strict=True)):
        if b.nanoseconds <= a.nanoseconds:
            raise InputError(f"{table.path}: frame {after} does not come after {before}; times must increase")
    shots = [Shot(time) for time in chosen]
    if not exposed:
        return shots
    place = exposed[0]
    texts = [(table.where(row), table.rows[row][1]) for row in rows]
    numbers = [_exposure(where, fields[place]) if len(fields) > place else math.nan for where, fields in texts]
    exposures = _exposures(table.path, numbers, _unit(table, place), shots)
    return [Shot(time, exposure) for time, exposure in zip(chosen, exposures, strict=True)]


def _times(table: TextTable, texts: list[str], named: str | None) -> list[Timestamp]:
    dates = [parse_date(text) for text in texts]
    if texts and all(date is not None for date in dates):
        return [from_nanoseconds(date) for date in dates]
    values = [parse_number(text) for text in texts]
    if None in values:
        row = values.index(None)
        raise InputError(f"{table.where(row)}: {texts[row][:40]!r} is not one number; expected a time in seconds")
    unit = unit_of(str(table.path), as_floats(values), named)
    if not unit.sure:
        log.warning("%s: its times are taken for %s", table.path, UNIT_NAMES[unit.name])
    try:
        return [timestamp(value, unit.name) for value in values]
    except InputError as problem:
        raise InputError(f"{table.path}: {problem}") from None


def _require_increasing(table: TextTable, rows: Sequence[int], times: list[Timestamp]) -> None:
    for row, (before, after) in zip(rows[1:], pairwise(times), strict=True):
        if after.nanoseconds <= before.nanoseconds:
            raise InputError(
                f"{table.where(row)}: {seconds_text(after)} s does not come after {seconds_text(before)} s; "
                "times must increase"
            )


def _title(table: TextTable, column: int) -> str:
    """What a header with a name for each column calls this one, in lower case; "" without such a header."""
    count = max((len(fields) for _, fields in table.rows), default=0)
    header = next((names for names in table.headers if len(names) == count), None)
    return "" if header is None else header[column].lower()


def _unit(table: TextTable, column: int) -> str | None:
    """The unit that a header gives a column, in brackets or as (the end of) its name."""
    name, unit = split_unit(_title(table, column))
    return unit_word(unit) or unit_word(name.replace("_", " ").rpartition(" ")[2])


def _only(table: TextTable, row: int) -> str:
    fields = table.rows[row][1]
    if len(fields) != 1:
        text = " ".join(fields)[:40]
        raise InputError(f"{table.where(row)}: {text!r} is not one number; expected an exposure in milliseconds")
    return fields[0]


def _exposure(where: str, text: str) -> float:
    """An exposure in the file's unit; NaN for 0 or nan, which mean that it is not known."""
    try:
        exposure = float(text)
    except ValueError:
        raise InputError(f"{where}: {text[:40]!r} is not one number; expected an exposure in milliseconds") from None
    if exposure < 0 or math.isinf(exposure):
        raise InputError(f"{where}: {exposure} is not an exposure in milliseconds")
    return exposure or math.nan


def _exposures(path: Path, numbers: list[float], named: str | None, shots: list[Shot]) -> list[float]:
    """Exposures in seconds, from the numbers of a file in the unit that it names or in which they are possible.

    They are milliseconds unless that would be shorter than 20 µs, or longer than the time from frame to frame. Raises
    InputError where they could be seconds as well.
    """
    known = [number for number in numbers if not math.isnan(number)]
    if not known:
        return numbers
    unit = named or _exposure_unit(path, median(known), shots)
    return [number * 10.0 ** (UNITS[unit] - 9) for number in numbers]


def _exposure_unit(path: Path, typical: float, shots: list[Shot]) -> str:
    steps = [b.timestamp - a.timestamp for a, b in pairwise(shots) if b.timestamp > a.timestamp]
    longest = 1.5 * median(steps) if steps else _LONGEST_EXPOSURE
    seconds = {name: typical * 10.0 ** (power - 9) for name, power in UNITS.items()}
    possible = [name for name, value in seconds.items() if _SHORTEST_EXPOSURE <= value <= longest]
    hint = "name the unit in a first line such as '# exposure [s]'"
    if "ms" in possible and "s" in possible and steps:
        raise InputError(f"{path}: exposures such as {typical:g} may be seconds or milliseconds; {hint}")
    if "ms" in possible:
        return "ms"
    if len(possible) != 1:
        raise InputError(f"{path}: exposures such as {typical:g} are none in milliseconds; {hint}")
    log.warning("%s: exposures such as %g are taken for %s", path, typical, UNIT_NAMES[possible[0]])
    return possible[0]
