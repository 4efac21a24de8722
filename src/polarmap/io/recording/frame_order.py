"""The order of frames and their numbers, from the names of their files.

Numbers count by value, padded with zeros or not, wherever in the name they stand: `img2_raw` comes before `img10_raw`.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass
from decimal import Decimal
from itertools import pairwise
from pathlib import Path

from polarmap.data.times import Timestamp
from polarmap.errors import InputError
from polarmap.io.formats.times import as_floats, clock_unit, timestamp

_NUMBER = re.compile(r"[0-9]+")
_SECONDS = re.compile(r"[0-9]{1,15}\.[0-9]{1,15}")
_CLOCK_PARTS = re.compile(r"(?P<before>.*?)(?P<whole>[0-9]{9,20})(?:[._-](?P<rest>[0-9]{1,9}))?")
_FIRST_CLOCK = 10**9  # numbers from here on in file names are times, not counters
_LEAST_TO_COUNT = 3  # names by which a number is known to count


@dataclass(frozen=True)
class FrameOrder:
    """Frames in order. indices: the number in each name, or its position where none counts. counter: which of the
    numbers in a name that is; None for positions."""

    indices: dict[str, int]
    counter: int | None = None

    def lost(self) -> tuple[str, str] | None:
        """The name of the first frame that was lost, and the frame before it; None where there is none.

        A sequence thinned evenly (every fourth frame) has no gap; one number left out is a lost frame.
        """
        steps = [after - before for before, after in pairwise(self.indices.values())]
        usual = min(steps, default=1)
        for (name, index), step in zip(self.indices.items(), steps, strict=False):
            if step != usual:
                return self._renumbered(name, index + usual), name
        return None

    def _renumbered(self, name: str, number: int) -> str:
        if self.counter is None:
            return str(number)
        found = list(_NUMBER.finditer(name))[self.counter]
        return f"{name[: found.start()]}{number:0{len(found[0])}d}{name[found.end() :]}"


def order_frames(folder: Path, names: list[str]) -> FrameOrder:
    """The order of the frames of these names, which must all differ.

    Raises InputError where two have the same numbers, or the numbers in the names give different orders.
    """
    if all(map(_SECONDS.fullmatch, names)):
        return _by_position(sorted(names, key=Decimal))
    shapes: dict[str, list[str]] = defaultdict(list)
    for name in names:
        shapes[_NUMBER.sub("#", name)].append(name)
    if len(shapes) > 1:
        _require_one_camera(folder, shapes)
        return _by_position(sorted(names, key=_natural))
    if len(names) == 1:
        return _single(names[0])
    return _by_numbers(folder, names)


def times_in_names(names: list[str]) -> list[Timestamp] | None:
    """When frames were taken whose names are times since 1970, or seconds; None where they are not or do not increase.

    `1403636579763555584`, `left_1403636579.763`, and seconds and nanoseconds as `1403636579_763555584`.
    """
    if all(map(_SECONDS.fullmatch, names)):
        return _increasing([timestamp(Decimal(name), "s") for name in names if len(name.partition(".")[0]) < 11], names)
    found = [_CLOCK_PARTS.fullmatch(name) for name in names]
    if not all(found) or len({parts["before"] for parts in found}) > 1:
        return None
    joined = [_joined(parts) for parts in found]
    if None in joined:
        return None
    unit = clock_unit(as_floats(joined))
    fractions = any(value != value.to_integral_value() for value in joined)
    if unit is None or (unit == "s" and not fractions) or (unit != "s" and fractions):
        return None
    return _increasing([timestamp(value, unit) for value in joined], names)


def _joined(parts: re.Match) -> Decimal | None:
    """The number in a name; None for seconds and nanoseconds apart that are not nine digits."""
    rest = parts["rest"]
    if rest is None:
        return Decimal(parts["whole"])
    point = parts[0][parts.end("whole")] == "."
    return Decimal(f"{parts['whole']}.{rest}") if point or len(rest) == 9 else None


def _increasing(times: list[Timestamp], names: list[str]) -> list[Timestamp] | None:
    in_order = len(times) == len(names) and all(a.nanoseconds < b.nanoseconds for a, b in pairwise(times))
    return times if in_order else None


def _by_position(names: list[str]) -> FrameOrder:
    return FrameOrder({name: position for position, name in enumerate(names)})


def _single(name: str) -> FrameOrder:
    found = list(_NUMBER.finditer(name))
    counts = found and found[-1].end() == len(name) and int(found[-1][0]) < _FIRST_CLOCK
    return FrameOrder({name: int(found[-1][0])}, len(found) - 1) if counts else _by_position([name])


def _natural(name: str) -> list[tuple[int, int | str]]:
    """A key by which texts sort as texts and numbers as numbers."""
    parts = re.split(r"([0-9]+)", name)
    return [(0, int(part)) if part.isdecimal() else (1, part) for part in parts if part]


def _require_one_camera(folder: Path, shapes: dict[str, list[str]]) -> None:
    """InputError where names of two kinds have the same numbers, such as left_1, left_2, right_1, right_2."""
    seen: dict[tuple[int, ...], str] = {}
    for names in shapes.values():
        numbers = {_numbers(name): name for name in names} if len(names) > 1 else {}
        shared = [key for key in numbers if key and key in seen]
        if len(shared) > 1:
            raise InputError(
                f"{folder}: {seen[shared[0]]} and {numbers[shared[0]]} have the same number; pictures of two cameras "
                "go into folders of their own"
            )
        seen |= numbers


def _by_numbers(folder: Path, names: list[str]) -> FrameOrder:
    """Names that differ in nothing but their numbers."""
    rows = {name: _numbers(name) for name in names}
    if len(set(rows.values())) < len(rows):
        raise InputError(f"{folder}: two frames have the same number; rename one of them")
    ordered = sorted(names, key=rows.__getitem__)
    _require_same_order(folder, ordered, sorted(names, key=_decimal_key))
    varying = [i for i in range(len(rows[names[0]])) if len({row[i] for row in rows.values()}) > 1]
    counters = [i for i in varying if _counts([row[i] for row in rows.values()])]
    for i in counters if len(names) >= _LEAST_TO_COUNT else ():
        _require_same_order(folder, ordered, sorted(names, key=lambda name, i=i: rows[name][i]))
    counter = _counter(names[0], ordered, rows, varying, counters)
    if counter is None:
        return _by_position(ordered)
    return FrameOrder({name: rows[name][counter] for name in ordered}, counter)


def _counter(
    shape: str, ordered: list[str], rows: dict[str, tuple[int, ...]], varying: list[int], counters: list[int]
) -> int | None:
    """Which of the numbers is the frame's: the first that differs, if it does in all, else one that counts evenly."""
    decimal = _decimals(shape)
    distinct = [i for i in varying[:1] if len({row[i] for row in rows.values()}) == len(rows)]
    for i in (*distinct, *counters):
        if i not in decimal and rows[ordered[-1]][i] < _FIRST_CLOCK:
            return i
    return None


def _counts(numbers: list[int]) -> bool:
    """Whether numbers are all different and evenly apart."""
    ordered = sorted(numbers)
    return len({after - before for before, after in pairwise(ordered)} - {0}) == 1 and len(set(ordered)) == len(ordered)


def _require_same_order(folder: Path, ordered: list[str], other: list[str]) -> None:
    place = next((i for i, (a, b) in enumerate(zip(ordered, other, strict=True)) if a != b), None)
    if place is not None:
        raise InputError(
            f"{folder}: the numbers in the names give two orders: {ordered[place]} or {other[place]} may come first; "
            "rename the frames so that one number counts them"
        )


def _numbers(name: str) -> tuple[int, ...]:
    return tuple(map(int, _NUMBER.findall(name)))


def _decimals(name: str) -> set[int]:
    """Which of the numbers in a name are parts of a decimal number."""
    found = list(_NUMBER.finditer(name))
    joined = [i for i, (a, b) in enumerate(pairwise(found)) if name[a.end() : b.start()] == "."]
    return {*joined, *(i + 1 for i in joined)}


def _decimal_key(name: str) -> tuple[Decimal, ...]:
    """The numbers in a name, those with a point as decimal numbers."""
    return tuple(map(Decimal, re.findall(r"[0-9]+(?:\.[0-9]+)?", name)))
