"""Depth as .npy files, which most programs in Python write: one array, without pickle."""

from __future__ import annotations

import io
import math
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import read_bytes
from polarmap.io.formats.images import MAX_PIXELS
from polarmap.io.formats.npy_header import read_npy_header

_KINDS = ("f2", "f4", "f8", "u1", "u2", "u4", "i2", "i4")


def read_depth_array(path: Path, scale: float = 1.0) -> np.ndarray:
    """Depth z, float32 H×W, NaN where the value is not finite and positive.

    scale: values per metre. The array may be of floats or integers, H×W, with axes of length 1 before or after them.
    Raises InputError where the file is no such array or not as long as its header says.
    """
    data = read_bytes(Path(path), 8 * MAX_PIXELS + 4096)
    try:
        values = _array(data)
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None
    with np.errstate(invalid="ignore", over="ignore"):
        depth = values.astype(np.float32) / np.float32(scale)
    return np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan))


def _array(data: bytes) -> np.ndarray:
    file = io.BytesIO(data)
    shape, fortran_order, kind = read_npy_header(file)
    sides = [n for n in shape if n != 1]
    if len(sides) != 2 or kind.str[1:] not in _KINDS:
        raise InputError(f"{kind} {shape} is no depth map; expected one array of numbers, height x width")
    count, start = math.prod(shape), file.tell()
    if not 0 < count <= MAX_PIXELS or count * kind.itemsize != len(data) - start:
        raise InputError(f"{len(data) - start} bytes of values, but {shape} of {kind} take {count * kind.itemsize}")
    values = np.frombuffer(data, kind, count, start)
    return values.reshape(shape, order="F" if fortran_order else "C").reshape(sides)
