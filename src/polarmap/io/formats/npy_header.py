"""The header of NumPy's .npy format (numpy.lib.format), read without evaluating it as Python.

`\\x93NUMPY`, a major and a minor version byte, the header's length (uint16, from version 2 on uint32, little-endian)
and the header: `{'descr': '<f4', 'fortran_order': False, 'shape': (480, 640), }`, in any order.
"""

from __future__ import annotations

import re
from typing import IO, NamedTuple

import numpy as np

from polarmap.errors import InputError, quoted

_MAGIC = b"\x93NUMPY"
_LONGEST = 10_000  # bytes, as in NumPy
_MOST_DIMENSIONS = 32
_ENTRY = (
    r"""\s*['"](?:(?P<descr{0}>descr)['"]\s*:\s*['"](?P<kind{0}>[<>|=]?[a-zA-Z]\d{{0,4}})['"]"""
    r"""|(?P<order{0}>fortran_order)['"]\s*:\s*(?P<fortran{0}>True|False)"""
    r"""|(?P<shape{0}>shape)['"]\s*:\s*\((?P<sides{0}>[\d,\s]*)\))\s*"""
)
_HEADER = re.compile(r"\{" + ",".join(map(_ENTRY.format, range(3))) + r",?\s*\}\s*", re.ASCII)


class NpyHeader(NamedTuple):
    """An array's shape, whether its first index runs fastest, and its type."""

    shape: tuple[int, ...]
    fortran_order: bool
    dtype: np.dtype


def read_npy_header(file: IO[bytes]) -> NpyHeader:
    """The header at the file's position, which is then at the first value.

    Raises InputError (without the file's name) where it is none, or not that of an array of plain values.
    """
    start = file.read(8)
    if len(start) < 8 or not start.startswith(_MAGIC) or not 1 <= start[6] <= 3:
        raise InputError("not in NumPy's .npy format")
    size = 2 if start[6] == 1 else 4
    length = int.from_bytes(file.read(size), "little")
    text = file.read(length).decode("latin-1") if length <= _LONGEST else ""
    found = _HEADER.fullmatch(text)
    groups = found.groupdict() if found else {}
    values = {key.rstrip("012"): value for key, value in groups.items() if value is not None}
    if not {"descr", "order", "shape"} <= set(values):
        raise InputError(f"its header is not that of an array of numbers ({quoted(text[:60])})")
    return NpyHeader(_shape(values["sides"]), values["fortran"] == "True", _dtype(values["kind"]))


def _shape(text: str) -> tuple[int, ...]:
    sides = [side.strip() for side in text.split(",")]
    if sides[-1] == "":
        sides.pop()
    if len(sides) > _MOST_DIMENSIONS or not all(re.fullmatch(r"\d{1,18}", side, re.ASCII) for side in sides):
        raise InputError(f"its header gives a shape of ({text[:60].strip()}), which no array has")
    return tuple(map(int, sides))


def _dtype(text: str) -> np.dtype:
    try:
        return np.dtype(text)
    except (TypeError, ValueError):
        raise InputError(f"its header gives values of a type {text!r}, which NumPy does not have") from None
