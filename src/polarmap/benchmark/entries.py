"""One figure of a sequence and a method over the seeds: its median and spread, or why there is none."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from polarmap.benchmark.cells import CellResult


@dataclass(frozen=True)
class Figure:
    """A figure of cells: its path in `CellResult.figures`, what tables call it, and how they write it.

    factor: what it is multiplied by first, 100 for per cent. digits: decimals.
    """

    path: str
    title: str
    digits: int
    factor: float = 1.0


@dataclass(frozen=True)
class Entry:
    """What stands in one place of a table.

    median, low, high: in the table's units, NaN unless `source` is measured or published.
    seeds: how many runs they are over; 0 for what is published. marks: numbers of notes below the table.
    """

    source: Literal["measured", "published", "failed", "not run"]
    median: float = float("nan")
    low: float = float("nan")
    high: float = float("nan")
    seeds: int = 0
    digits: int = 0
    marks: tuple[int, ...] = ()


@dataclass
class Notes:
    """Notes below a table, numbered from 1 in the order in which they are met."""

    lines: list[str] = field(default_factory=list)

    def mark(self, line: str) -> int:
        """The number of a note, which is added if it is new."""
        if line not in self.lines:
            self.lines.append(line)
        return self.lines.index(line) + 1


def measured(results: Sequence[CellResult | None], figure: Figure, notes: Notes) -> Entry | None:
    """The entry for the results of all seeds, None standing for those not run; None where nothing could be measured.

    A failed run is left out of the median, and noted.
    """
    failed = [result for result in results if result is not None and result.status == "failed"]
    marks = tuple(notes.mark(line) for line in _failures(failed))
    values = [value for result in results if (value := _value(result, figure)) == value]
    if values:
        low, median, high = float(np.min(values)), float(np.median(values)), float(np.max(values))
        return Entry("measured", median, low, high, len(values), figure.digits, marks)
    if failed:
        return Entry("failed", marks=marks)
    return Entry("not run") if all(result is None for result in results) else None


def mean(entries: Sequence[Entry | None], digits: int) -> Entry | None:
    """The mean of the medians, without a spread; None unless all are measured."""
    if not entries or not all(entry is not None and entry.source == "measured" for entry in entries):
        return None
    value = float(np.mean([entry.median for entry in entries]))
    return Entry("measured", value, value, value, 1, digits)


def printed(value: float | None, digits: int, factor: float = 1.0) -> Entry | None:
    """The entry for a figure that the paper printed; None for its dashes."""
    if value is None:
        return None
    return Entry("published", factor * value, factor * value, factor * value, 0, digits)


def _value(result: CellResult | None, figure: Figure) -> float:
    if result is None or result.status != "complete":
        return float("nan")
    return figure.factor * result.figures.get(figure.path, float("nan"))


def _failures(failed: Sequence[CellResult]) -> list[str]:
    """A line for each reason, with the seeds that failed for it."""
    seeds: dict[tuple[str, str, str | None], list[str]] = {}
    for result in failed:
        seeds.setdefault((result.sequence, result.method, result.reason), []).append(str(result.seed))
    return [
        f"{sequence}, {method}, seed {', '.join(numbers)}: failed: {reason}"
        for (sequence, method, reason), numbers in seeds.items()
    ]
