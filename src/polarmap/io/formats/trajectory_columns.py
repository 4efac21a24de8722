"""Which column of a trajectory is which: by the names in its header, else by how many there are.

Names are compared by their parts, whatever joins them: `field.pose.orientation.x`, `q_RS_x []`, `qx` and `QuatX` are
all the quaternion's x.
"""

from __future__ import annotations

import re
from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.io.formats.text_table import TextTable, split_unit
from polarmap.io.formats.times import as_floats, clock_unit, parse_number, unit_word, units_by_step

NAMED = "timestamp tx ty tz qx qy qz qw"
"""A header that names all columns."""

_TUM_POSE, _EUROC_POSE = (1, 2, 3, 4, 5, 6, 7), (1, 2, 3, 5, 6, 7, 4)  # tx ty tz qx qy qz qw
_POSE_ROLES = ("tx", "ty", "tz", "qx", "qy", "qz", "qw")
_MATRIX_WIDTHS = {12: 12, 13: 12, 16: 16, 17: 16}
_UNIT_TOLERANCE = 0.02

_WORD = re.compile(r"[a-z0-9µ]+")
_CAMEL = re.compile(r"(?<=[a-z])(?=[A-Z])")
_ROTATION_WORDS = {"q", "quat", "quaternion", "orientation", "ori", "rotation", "rot", "attitude", "att"}
_ONE_WORD_ROTATION = re.compile(r"(?:q|quat|quaternion|orientation|ori|rotation|rot)([wxyz])")
_ONE_WORD_POSITION = re.compile(r"(?:t|p|pos|position|trans|translation|loc|location)?([xyz])")
_OTHER_MOTION = {
    "linear", "angular", "twist", "velocity", "vel", "v", "acceleration", "acc", "gyro", "bias", "b", "euler", "rpy",
    "covariance", "cov", "std", "sigma", "scale",
}  # fmt: skip
_TIME_WORDS = {"t", "time", "times", "timestamp", "timestamps", "stamp", "ts", "epoch"}
_COUNTERS = {"num", "no", "number", "index", "idx", "frame", "frames", "seq", "count", "i"}
_KINDS = {"id", "camera", "cam", "agent", "robot", "object", "body", "child", "name", "track"}


@dataclass(frozen=True)
class PoseColumns:
    """Positions of the columns of a trajectory, from 0.

    time: of the time; None where there is none. unit: its unit, of `polarmap.io.formats.times.UNITS`; None if not said.
    nanoseconds: of what a time in whole seconds leaves out; None if none. counter: whether `time` is named as the
    number of a frame. pose: tx ty tz qx qy qz qw; empty where the pose is a matrix. matrix: of its first number.
    width: of the matrix, 12 or 16 numbers.
    guessed: what was assumed without a header that says so, "" for nothing.
    """

    time: int | None
    unit: str | None = None
    nanoseconds: int | None = None
    counter: bool = False
    pose: tuple[int, ...] = ()
    matrix: int = 0
    width: int = 0
    guessed: str = ""

    @property
    def needed(self) -> int:
        """How many columns a line must have at least."""
        known = [self.time or 0, self.nanoseconds or 0, *self.pose, self.matrix + self.width - 1]
        return max(known) + 1


@dataclass(frozen=True)
class _Name:
    """A column's name taken apart. role: time, counter, tx to tz, qx to qw, or "" for another."""

    text: str
    parts: tuple[str, ...]
    role: str
    unit: str | None = None


def find_columns(table: TextTable, format: str = "auto") -> PoseColumns:
    """The columns of a trajectory with at least one row.

    format: tum, kitti or euroc decide what a file without a header means; auto goes by the columns.
    Raises InputError where a header leaves out a part of the pose or names it twice, or the number of columns has no
    meaning.
    """
    count = len(table.rows[0][1])
    for header in table.headers:
        names = tuple(_name(text) for text in header[:count])
        found = _by_names(table, names)
        if found is not None:
            _require_one_kind(table, names)
            return found
    if table.titled and count not in _MATRIX_WIDTHS:
        raise InputError(
            f"{table.path}: the header {' '.join(table.headers[0])[:80]!r} does not name time, position and "
            f"quaternion; write it such as '{NAMED}'"
        )
    return _by_count(table, count, format)


def _by_names(table: TextTable, names: tuple[_Name, ...]) -> PoseColumns | None:
    """The columns that a header names; None where it lacks one."""
    places: dict[str, list[int]] = defaultdict(list)
    for i, name in enumerate(names):
        places[name.role].append(i)
    if not all(places[role] for role in _POSE_ROLES) or not (places["time"] or places["counter"]):
        return None
    twice = next((role for role in _POSE_ROLES if len(places[role]) > 1), None)
    if twice is not None:
        both = " and ".join(repr(names[i].text[:40]) for i in places[twice][:2])
        raise InputError(f"{table.path}: {both} both give {twice}; keep the columns of one trajectory")
    pose = tuple(places[role][0] for role in _POSE_ROLES)
    if not places["time"]:
        return PoseColumns(places["counter"][0], counter=True, pose=pose)
    whole, rest = _time_columns(table, names, places["time"])
    unit = "s" if rest is not None else names[whole].unit
    if unit is None and table.first_comment.startswith("%time"):  # rostopic echo -p
        unit = "ns"
    return PoseColumns(whole, unit, rest, pose=pose)


def _time_columns(table: TextTable, names: tuple[_Name, ...], places: list[int]) -> tuple[int, int | None]:
    """The column of the time, and that of the nanoseconds beside its seconds."""
    stamps = [i for i in places if {"header", "stamp"} <= set(names[i].parts)]
    chosen = stamps or places
    if len(chosen) == 2:
        seconds, rest = chosen
        same = names[seconds].parts[:-1] == names[rest].parts[:-1]
        if same and (names[seconds].unit, names[rest].unit) == ("s", "ns"):
            return seconds, rest
    if len(chosen) > 1:
        both = " and ".join(repr(names[i].text[:40]) for i in chosen[:2])
        raise InputError(f"{table.path}: {both} are both times; keep one of the columns")
    return chosen[0], None


def _name(text: str) -> _Name:
    bare, unit = split_unit(text)
    parts = tuple(_WORD.findall(_CAMEL.sub("_", bare).lower()))
    unit = unit_word(unit)
    if not parts:
        return _Name(text, parts, "")
    last, before = parts[-1], set(parts[:-1])
    pose = _pose_role(last, before)
    if pose:
        return _Name(text, parts, pose)
    if unit_word(last) and (before & _TIME_WORDS or not before):
        return _Name(text, parts, "time", unit or unit_word(last))
    if last in _TIME_WORDS:
        return _Name(text, parts, "time", unit)
    return _Name(text, parts, "counter" if last in _COUNTERS else "")


def _pose_role(last: str, before: set[str]) -> str:
    if before & _OTHER_MOTION:
        return ""
    found = _ONE_WORD_ROTATION.fullmatch(last)
    if found:
        return "q" + found[1]
    if last in ("w", "x", "y", "z") and before & _ROTATION_WORDS:
        return "q" + last
    found = _ONE_WORD_POSITION.fullmatch(last)
    return "t" + found[1] if found else ""


def _require_one_kind(table: TextTable, names: tuple[_Name, ...]) -> None:
    """InputError where a column says that the lines are of several cameras or things."""
    for i, name in enumerate(names):
        if name.role or not name.parts or name.parts[-1] not in _KINDS:
            continue
        values = dict.fromkeys(fields[i] for _, fields in table.rows if i < len(fields))
        if 1 < len(values) < len(table.rows):
            first, second = list(values)[:2]
            raise InputError(
                f"{table.path}: column {name.text[:40]!r} has lines of {first[:40]!r} and of {second[:40]!r}; "
                "keep the lines of one camera"
            )


def _by_count(table: TextTable, count: int, format: str) -> PoseColumns:
    """What a file without a header means."""
    width = _MATRIX_WIDTHS.get(count)
    if width is not None and format in ("auto", "kitti") and not _is_euroc(table, count):
        time = None if width == count else 0
        return PoseColumns(time, matrix=count - width, width=width)
    if format == "euroc" or (format == "auto" and _is_euroc(table, count)):
        return PoseColumns(0, pose=_EUROC_POSE)
    if count == 8 and format in ("auto", "tum"):
        guessed = "t tx ty tz qx qy qz qw" if table.separator else ""
        return PoseColumns(0, pose=_TUM_POSE, guessed=guessed)
    expected = {"tum": (8, NAMED), "kitti": (12, "r11 r12 r13 tx r21 r22 r23 ty r31 r32 r33 tz")}
    if format in expected:
        number, columns = expected[format]
        raise InputError(f"{table.where(0)}: {count} columns, expected {number}: {columns}")
    raise InputError(
        f"{table.where(0)}: {count} columns are none of the known formats (tum: 8; kitti: 12 or 16, or 13 or 17 with a "
        f"time or a frame's number before; euroc: 8 or more after nanoseconds, with commas; log: 3); "
        f"a first line such as '{NAMED}' names the columns of any other"
    )


def _is_euroc(table: TextTable, count: int) -> bool:
    """Whether lines with commas and without a header begin with whole nanoseconds, a position, and a quaternion."""
    if table.separator != "," or count < 8:
        return False
    times = [parse_number(fields[0]) for _, fields in table.rows if fields]
    if any(time is None or time != time.to_integral_value() for time in times):
        return False
    values = as_floats(times)
    unit, by_step = clock_unit(values), units_by_step(values)
    if not (unit == "ns" or (unit is None and "ns" in by_step and "s" not in by_step)):
        return False
    return count == 8 or _are_unit([fields[4:8] for _, fields in table.rows])


def _are_unit(quaternions: list[tuple[str, ...]]) -> bool:
    numbers = [[parse_number(field) for field in fields] for fields in quaternions]
    if any(len(q) < 4 or None in q for q in numbers):
        return False
    norms = np.linalg.norm(np.array(numbers, float), axis=1)
    return bool((np.abs(norms - 1.0) < _UNIT_TOLERANCE).all())
