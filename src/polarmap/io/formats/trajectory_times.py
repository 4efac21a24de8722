"""The times of a trajectory's rows: in whatever unit, as dates, or as the numbers of the frames."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from decimal import Decimal
from pathlib import Path

import numpy as np

from polarmap.data.times import Timestamp, all_nanoseconds, nanoseconds_of
from polarmap.errors import InputError
from polarmap.io.formats.text_table import TextTable
from polarmap.io.formats.times import (
    UNIT_NAMES,
    UNITS,
    as_floats,
    clock_unit,
    from_nanoseconds,
    parse_date,
    parse_number,
    seconds_text,
    timestamp,
    unit_of,
    units_by_step,
)
from polarmap.io.formats.trajectory_columns import PoseColumns

log = logging.getLogger(__name__)

_SHARED_RANGE = 0.5  # of the times of poses and frames together


def read_times(
    table: TextTable, columns: PoseColumns, frames: Mapping[int, float] | None, usual: str | None = None
) -> tuple[list[Timestamp], list[int]]:
    """Times of the rows, and the positions of the rows that have one: others are of frames that are not there.

    frames: times in seconds of the frames that the poses are for, by number; None where they are not known.
    usual: the unit of times that could be of any, None to find it out.
    Raises InputError where a time is none or does not come after the one before, or its unit cannot be told.
    """
    times, kept = _times_of_rows(table, columns, frames, usual)
    _check_increasing(table, times, kept)
    return times, kept


def _times_of_rows(
    table: TextTable, columns: PoseColumns, frames: Mapping[int, float] | None, usual: str | None
) -> tuple[list[Timestamp], list[int]]:
    dates = [parse_date(fields[columns.time]) for _, fields in table.rows]
    if all(date is not None for date in dates):
        return [from_nanoseconds(date) for date in dates], list(range(len(dates)))
    values = [_parse_time(table, row, columns.time) for row in range(len(table.rows))]
    if columns.nanoseconds is not None:
        rest = [_parse_time(table, row, columns.nanoseconds) for row in range(len(table.rows))]
        values = [value + more.scaleb(-9) for value, more in zip(values, rest, strict=True)]
    if frames and columns.unit is None and _are_frame_numbers(table.path, values, columns, frames):
        kept = [i for i, value in enumerate(values) if int(value) in frames]
        return [_as_timestamp(frames[int(values[i])]) for i in kept], kept
    numbers = as_floats(values)
    named = columns.unit or (usual if clock_unit(numbers) is None else None)
    unit = _time_unit(table.path, numbers, named, frames)
    try:
        return [timestamp(value, unit) for value in values], list(range(len(values)))
    except InputError as problem:
        raise InputError(f"{table.path}: {problem}") from None


def _parse_time(table: TextTable, row: int, column: int) -> Decimal:
    text = table.rows[row][1][column]
    value = parse_number(text)
    if value is not None:
        return value
    try:
        float(text)
    except ValueError:
        raise InputError(f"{table.where(row)}: not all numbers; {text[:40]!r} is no time") from None
    raise InputError(
        f"{table.where(row)}: a number is NaN or infinite, or too large; leave out poses that are not known"
    )


def _time_unit(path: Path, values: np.ndarray, named: str | None, frames: Mapping[int, float] | None) -> str:
    """The unit of times, float64 N; where their size and steps leave it open, that in which they meet the frames'."""
    units = dict.fromkeys((*units_by_step(values), "s"))
    if named is None and frames and len(units) > 1 and clock_unit(values) is None:
        shared = {name: _overlap(values, name, frames) for name in units}
        best = max(units, key=lambda name: (shared[name], name == "s"))
        if shared[best] > 0:
            if best != "s":
                log.warning("%s: its times are taken for %s, which meet the frames' times", path, UNIT_NAMES[best])
            return best
    unit = unit_of(str(path), values, named)
    if not unit.sure:
        log.warning("%s: its times are taken for %s", path, UNIT_NAMES[unit.name])
    return unit.name


def _are_frame_numbers(
    path: Path, values: Sequence[Decimal], columns: PoseColumns, frames: Mapping[int, float]
) -> bool:
    """Whether the first column holds the numbers of frames and no times.

    They are whole, and as seconds they would share little with the frames' times. Raises InputError where they count
    otherwise than the frames, so that they may be shifted.
    """
    if any(value != value.to_integral_value() for value in values):
        return False
    if not columns.counter and (
        clock_unit(as_floats(values)) is not None or _overlap(as_floats(values), "s", frames) > _SHARED_RANGE
    ):
        return False
    numbers = {int(value) for value in values}
    if numbers <= frames.keys() or (len(numbers) > 1 and frames.keys() <= numbers):
        log.warning("%s: the first column is taken for the numbers of the frames", path)
        return True
    if columns.counter or len(numbers & frames.keys()) > len(numbers) // 2:
        raise InputError(
            f"{path}: numbers {min(numbers)} to {max(numbers)} in place of times, but the frames are {min(frames)} to "
            f"{max(frames)}; write times, or number both alike"
        )
    return False


def _overlap(values: np.ndarray, unit: str, frames: Mapping[int, float]) -> float:
    """The part that the ranges of poses and frames share, of both ranges together."""
    times = values * 10.0 ** (UNITS[unit] - 9)
    starts, ends = (times.min(), min(frames.values())), (times.max(), max(frames.values()))
    whole = max(ends) - min(starts)
    return max(0.0, min(ends) - max(starts)) / whole if whole > 0 else 0.0


def _as_timestamp(time: float) -> Timestamp:
    return time if isinstance(time, Timestamp) else Timestamp(float(time), nanoseconds_of(time))


def _check_increasing(table: TextTable, times: Sequence[Timestamp], rows: Sequence[int]) -> None:
    backward = np.diff(all_nanoseconds(times)) <= 0
    if backward.any():
        i = int(np.argmax(backward)) + 1
        raise InputError(
            f"{table.where(rows[i])}: time {seconds_text(times[i])} s does not come after "
            f"{seconds_text(times[i - 1])} s; sort the lines and remove duplicates"
        )
