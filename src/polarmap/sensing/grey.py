"""Kernels that make grey images of raw pixels, integers up to full scale: black and scale as float32."""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit


@njit
def scaled(picture, black, scale):
    """(picture - black) · scale, at least 0, float32 H×W."""
    height, width = picture.shape
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            out[y, x] = max((np.float32(picture[y, x]) - black) * scale, np.float32(0))
    return out


@njit
def mean_of_blocks(mosaic, black, scale):
    """The mean of each 2×2 block of a mosaic 2H×2W, as `scaled`, float32 H×W."""
    height, width = mosaic.shape[0] // 2, mosaic.shape[1] // 2
    quarter = np.float32(0.25)
    out = np.empty((height, width), np.float32)
    for y in range(height):
        upper, lower, line = mosaic[2 * y], mosaic[2 * y + 1], out[y]
        for x in range(width):
            left = np.uint64(2) * np.uint64(x)  # unsigned, so that it compiles to vector instructions
            right = left + np.uint64(1)
            total = np.float32(upper[left]) + np.float32(upper[right])  # exact: integers of 18 bits
            total += np.float32(lower[left]) + np.float32(lower[right])
            line[x] = max((quarter * total - black) * scale, np.float32(0))
    return out


@njit
def mean_of_pictures(pictures, black, scale):
    """The mean of four pictures 4×H×W, as `scaled`, float32 H×W."""
    _, height, width = pictures.shape
    quarter = np.float32(0.25)
    out = np.empty((height, width), np.float32)
    for y in range(height):
        for x in range(width):
            total = np.float32(pictures[0, y, x]) + np.float32(pictures[1, y, x])
            total += np.float32(pictures[2, y, x]) + np.float32(pictures[3, y, x])
            out[y, x] = max((quarter * total - black) * scale, np.float32(0))
    return out
