"""Times that know their whole nanoseconds."""

from __future__ import annotations

from collections.abc import Iterable
from decimal import Decimal

import numpy as np

MOST_SECONDS = 9.2e9
"""Nanoseconds of a larger time, that of the year 2261, do not fit into 64 bits."""


class Timestamp(float):
    """Seconds that know their whole nanoseconds, which a float of seconds since 1970 cannot hold."""

    __slots__ = ("nanoseconds",)
    nanoseconds: int

    def __new__(cls, seconds: float, nanoseconds: int) -> Timestamp:
        made = super().__new__(cls, seconds)
        made.nanoseconds = nanoseconds
        return made

    def __getnewargs__(self) -> tuple[float, int]:
        return float(self), self.nanoseconds


def nanoseconds_of(time: float) -> int:
    """The whole nanoseconds of a time: those it knows, else those of its shortest decimal number."""
    known = getattr(time, "nanoseconds", None)
    return int(Decimal(repr(float(time))).scaleb(9).to_integral_value()) if known is None else known


def all_nanoseconds(times: Iterable[float]) -> np.ndarray:
    """`nanoseconds_of` of each, int64 N."""
    return np.array([nanoseconds_of(time) for time in times], np.int64)


def typical_step(values: np.ndarray) -> float | None:
    """The median difference of times that follow each other; None where there is none that is positive."""
    steps = np.diff(values)
    step = float(np.median(steps)) if len(steps) else 0.0
    return step if step > 0 else None
