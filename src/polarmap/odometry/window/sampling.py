"""The residual pattern in other images: where its pixels are, and what is seen there.

Each loop over the eight pixels is short and free of branches, so that it becomes a few vector instructions.
"""

from __future__ import annotations

import numpy as np

from polarmap.jit import FAST_MATH, njit
from polarmap.odometry.pattern import PATTERN, PATTERN_SIZE


@njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
def project_pattern(pixel, d, KRKi, Kt, height, width, margin, u, v, inverse_z):
    """Where the pattern's pixels are in the target, and whether all are `margin` from its border and before it.

    pixel: (u, v) of the point in its host. u, v, inverse_z: float32 8 each, filled; z is that in the target over that
    in the host.
    """
    pu, pv = pixel[0], pixel[1]
    x = KRKi[0, 0] * pu + KRKi[0, 1] * pv + KRKi[0, 2] + d * Kt[0]
    y = KRKi[1, 0] * pu + KRKi[1, 1] * pv + KRKi[1, 2] + d * Kt[1]
    z = KRKi[2, 0] * pu + KRKi[2, 1] * pv + KRKi[2, 2] + d * Kt[2]
    right, bottom = np.float32(width) - margin, np.float32(height) - margin
    inside = True
    for k in range(PATTERN_SIZE):
        du, dv = PATTERN[k, 0], PATTERN[k, 1]
        depth = z + KRKi[2, 0] * du + KRKi[2, 1] * dv
        inverse = np.float32(1.0) / depth
        inverse_z[k] = inverse
        u[k] = (x + KRKi[0, 0] * du + KRKi[0, 1] * dv) * inverse
        v[k] = (y + KRKi[1, 0] * du + KRKi[1, 1] * dv) * inverse
        inside &= (depth > 0) & (u[k] >= margin) & (u[k] < right) & (v[k] >= margin) & (v[k] < bottom)
    return inside


@njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
def _bilinear(u, v):
    """Column and row, uint32, of the upper left of four pixels; weights of both upper and both lower ones."""
    x, y = np.uint32(u), np.uint32(v)
    fu, fv = u - np.float32(x), v - np.float32(y)
    w11 = fu * fv
    w10, w01 = fv - w11, fu - w11
    return x, y, np.float32(1.0) - fu - w10, w01, w10, w11


@njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
def sample_pattern(flat, start, row, u, v, values):
    """Intensity and gradients, bilinear, at eight places; all must be inside.

    flat: float32, images one after the other. start, row: uint64, where the image begins and how many numbers a row of
    it has; unsigned, since signed positions would be tested for counting from the end. values: float32 3×8, filled.
    """
    one, three = np.uint64(1), np.uint64(3)
    for k in range(PATTERN_SIZE):
        x, y, w00, w01, w10, w11 = _bilinear(u[k], v[k])
        upper = start + np.uint64(y) * row + three * np.uint64(x)
        lower = upper + row
        for channel in range(3):
            above = w00 * flat[upper] + w01 * flat[upper + three]
            values[channel, k] = above + w10 * flat[lower] + w11 * flat[lower + three]
            upper += one
            lower += one


@njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
def pattern_intensity(flat, row, u, v, values):
    """Intensity alone, as `sample_pattern` of the image that begins at 0; values: float32 8, filled."""
    three = np.uint64(3)
    for k in range(PATTERN_SIZE):
        x, y, w00, w01, w10, w11 = _bilinear(u[k], v[k])
        upper = np.uint64(y) * row + three * np.uint64(x)
        lower = upper + row
        above = w00 * flat[upper] + w01 * flat[upper + three]
        values[k] = above + w10 * flat[lower] + w11 * flat[lower + three]
