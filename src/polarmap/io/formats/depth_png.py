"""Depth as 16-bit PNG files: the pixel value is depth · scale, 0 where there is none."""

from __future__ import annotations

import math
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.io.formats.images import read_image, write_image

_MAX_VALUE = 65535


def depth_png_scale(max_depth: float) -> float:
    """The largest scale 1, 2 or 5 times a power of ten at which `max_depth` still fits 16 bits.

    Raises InputError where `max_depth` is not positive and finite.
    """
    if not 0 < max_depth < math.inf:
        raise InputError(f"depth: the largest depth must be positive and finite, not {max_depth}")
    limit = _MAX_VALUE / max_depth
    decade = 10.0 ** math.floor(math.log10(limit))
    return max(step * decade for step in (0.5, 1.0, 2.0, 5.0) if step * decade <= limit)


def read_depth_png(path: Path, scale: float, size: tuple[int, int] | None = None) -> np.ndarray:
    """Depth z, float32 H×W, NaN where none. scale: pixel values per metre. size: expected (width, height).

    Raises InputError where the file is no complete 16-bit grey image of that size.
    """
    values = read_image(path, size=size, bits=16)
    depth = values.astype(np.float32)
    depth /= np.float32(scale)
    depth[values == 0] = np.nan
    return depth


def write_depth_png(path: Path, depth: np.ndarray, scale: float) -> None:
    """Write depth, float32 H×W; what is not finite and positive is written as 0, none.

    scale: pixel values per unit of depth, see `depth_png_scale`. Raises InputError where a depth does not fit
    16 bits at this scale, PolarmapError where the file cannot be written.
    """
    known = np.isfinite(depth) & (depth > 0)
    values = np.rint(np.where(known, depth, 0.0) * scale)
    if values.max(initial=0.0) > _MAX_VALUE:
        raise InputError(f"{path}: depth {np.nanmax(depth[known]):.6g} does not fit 16 bits at scale {scale:g}")
    values[known] = np.maximum(values[known], 1.0)
    write_image(path, values.astype(np.uint16))
