"""Times in text, exactly: seconds, milli-, micro- or nanoseconds, or dates, as whole nanoseconds.

Seconds in double precision hold a time since 1970 only to 0.2 µs. So a time read from a file keeps the nanoseconds
that stand there, beside the seconds that everything computes with.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from datetime import datetime, timedelta
from decimal import Decimal, InvalidOperation
from typing import NamedTuple

import numpy as np

from polarmap.data.times import MOST_SECONDS, Timestamp, nanoseconds_of, typical_step
from polarmap.errors import InputError

UNITS = {"s": 9, "ms": 6, "us": 3, "ns": 0}
"""Units of time, and the power of ten that takes each to nanoseconds."""
UNIT_NAMES = {"s": "seconds", "ms": "milliseconds", "us": "microseconds", "ns": "nanoseconds"}

_UNIT_WORDS = {
    **dict.fromkeys(("s", "sec", "secs", "second", "seconds"), "s"),
    **dict.fromkeys(("ms", "msec", "msecs", "millisec", "millisecs", "millisecond", "milliseconds"), "ms"),
    **dict.fromkeys(("us", "µs", "usec", "usecs", "microsec", "microsecs", "microsecond", "microseconds"), "us"),
    **dict.fromkeys(("ns", "nsec", "nsecs", "nanosec", "nanosecs", "nanosecond", "nanoseconds"), "ns"),
}
_LONGEST = 60  # characters of a number
_LARGEST_POWER = 30
_CLOCK = (1e9, 4.1e9)  # seconds since 1970: 2001 to 2099
_STEPS = (1e-3, 10.0)  # seconds between poses or frames
_POSSIBLE_STEPS = (1e-5, 1e4)
_DATE = re.compile(
    r"(\d{4})[-/](\d\d?)[-/](\d\d?)[T ]+(\d\d?):(\d\d):(\d\d)(?:[.,](\d{1,12}))?\s*(Z|[+-]\d\d:?\d\d)?", re.IGNORECASE
)
_EPOCH = datetime(1970, 1, 1)


class Unit(NamedTuple):
    """A unit of time, of `UNITS`. sure: whether it could hardly be another."""

    name: str
    sure: bool


def unit_word(word: str) -> str | None:
    """The unit, of `UNITS`, that a word means, such as nsec; None for another word."""
    return _UNIT_WORDS.get(word.lower())


def parse_number(text: str) -> Decimal | None:
    """A finite decimal number of at most 60 characters, exactly; None where the text is none."""
    try:
        value = Decimal(text) if len(text) <= _LONGEST and "_" not in text else None
    except InvalidOperation:
        return None
    return value if value is not None and value.is_finite() and abs(value.adjusted()) <= _LARGEST_POWER else None


def parse_date(text: str) -> int | None:
    """Nanoseconds since 1970 of `YYYY-MM-DD hh:mm:ss.fffffffff`, in UTC unless it names another zone; None if none."""
    found = _DATE.fullmatch(text.strip()) if len(text) <= _LONGEST else None
    if found is None:
        return None
    *numbers, fraction, zone = found.groups()
    try:
        since = datetime(*map(int, numbers)) - _EPOCH - _zone(zone)
    except ValueError:
        return None
    whole = since.days * 86400 + since.seconds
    return whole * 10**9 + int((fraction or "").ljust(9, "0")[:9])


def _zone(text: str | None) -> timedelta:
    if text is None or text.upper() == "Z":
        return timedelta(0)
    digits = text[1:].replace(":", "")
    offset = timedelta(hours=int(digits[:2]), minutes=int(digits[2:]))
    return -offset if text[0] == "-" else offset


def timestamp(value: Decimal, unit: str) -> Timestamp:
    """A number of a unit as a time. Raises InputError beyond 292 years from 0."""
    exact = value.scaleb(UNITS[unit])
    if abs(exact) > MOST_SECONDS * 1e9:
        raise InputError(f"{cut(value)} is no time in {UNIT_NAMES[unit]}")
    return Timestamp(float(exact.scaleb(-9)), int(exact.to_integral_value()))


def from_nanoseconds(nanoseconds: int) -> Timestamp:
    """Whole nanoseconds as a time."""
    return Timestamp(nanoseconds / 10**9, nanoseconds)


def seconds_text(time: float) -> str:
    """Seconds as a decimal number that reads back as they are, nanoseconds included."""
    seconds = float(time)
    shortest, nanoseconds = repr(seconds), getattr(time, "nanoseconds", None)
    if nanoseconds is None or nanoseconds_of(seconds) == nanoseconds:
        return shortest
    sign = "-" if nanoseconds < 0 else ""
    return f"{sign}{abs(nanoseconds) // 10**9}.{abs(nanoseconds) % 10**9:09d}"


def clock_unit(values: np.ndarray) -> str | None:
    """The unit in which all of these are times of this century, counted from 1970; None where there is none.

    values: float64 N.
    """
    step = typical_step(values)
    for name, power in UNITS.items():
        factor = 10.0 ** (power - 9)
        magnitudes = values * factor
        possible = step is None or _POSSIBLE_STEPS[0] <= step * factor <= _POSSIBLE_STEPS[1]
        if len(values) and possible and ((magnitudes >= _CLOCK[0]) & (magnitudes <= _CLOCK[1])).all():
            return name
    return None


def units_by_step(values: np.ndarray) -> tuple[str, ...]:
    """The units in which times, float64 N, are from 1 ms to 10 s apart as poses and frames are; none if unsorted."""
    step = typical_step(values)
    if step is None:
        return ()
    return tuple(name for name, power in UNITS.items() if _STEPS[0] <= step * 10.0 ** (power - 9) < _STEPS[1])


def unit_of(where: str, values: np.ndarray, named: str | None = None) -> Unit:
    """The unit of the times in a file.

    values: float64 N as they stand there. named: the unit that the file says. Without it, times of this century tell
    it by their size, others by the step from one to the next; where there is none, they are seconds.
    Raises InputError where the file's own unit cannot be, or more than one other than seconds can.
    """
    if named is not None:
        step = typical_step(values)
        if step is not None and not _POSSIBLE_STEPS[0] <= step * 10.0 ** (UNITS[named] - 9) <= _POSSIBLE_STEPS[1]:
            raise InputError(f"{where}: its times are {UNIT_NAMES[named]} by header or format, but {step:g} apart")
        return Unit(named, sure=True)
    clock = clock_unit(values)
    if clock is not None:
        return Unit(clock, sure=True)
    units = units_by_step(values)
    if not units or "s" in units:
        return Unit("s", sure=True)
    if len(units) > 1:
        kinds = " or ".join(UNIT_NAMES[name] for name in units)
        raise InputError(
            f"{where}: times {typical_step(values):g} apart may be {kinds}; write seconds, or name the unit in a "
            "first line such as '# timestamp [us]'"
        )
    return Unit(units[0], sure=False)


def as_floats(values: Sequence[Decimal]) -> np.ndarray:
    """Exact numbers in double precision, float64 N."""
    return np.array([float(value) for value in values], float)


def cut(value: object) -> str:
    """A value for a message, at most 40 characters of it."""
    return str(value)[:40]
