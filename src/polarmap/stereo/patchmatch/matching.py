"""How well a plane matches: 1 - NCC of support windows, in the views that a pixel tries.

Arguments that several kernels share: image, float32 H×W; sources, V views packed by `pack`, flat; M, b: V×3×3 and V×3,
the homography of a plane, see `method`; q, gu, gv: a plane; chosen: views that a pixel tries, best first, uint8 …×N;
offsets: of the window's samples, float32 2×25; inverse_colour, noise, best: constants.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import FINITE_MATH, njit

SIDE = 5  # samples along one side of the support window
SAMPLES = SIDE * SIDE
UNMATCHED = np.float32(2.0)  # the largest cost 1 - NCC
LEAST_Z = np.float32(1e-3)  # z in a source over z in the reference; nearer points are beside the camera or behind it
_LEVELS = np.float32(65535.0)  # of 16 bits
_f32 = np.float32


@njit(parallel=True)
def pack(image, white):
    """Four neighbouring pixels in one number, so that one fetch has all that bilinear interpolation needs.

    image: float32 H×W, 0 to `white`, which becomes 65535. Returns uint64 H×W: the pixel in the lowest 16 bits, then its
    neighbours to the right, below, and below to the right.
    """
    height, width = image.shape
    packed = np.empty((height, width), np.uint64)
    scale = _LEVELS / white
    for v in prange(height):
        below = min(v + 1, height - 1)
        left = _sixteen_bits(image[v, 0], scale) | _sixteen_bits(image[below, 0], scale) << np.uint64(32)
        for u in range(width):
            x = min(u + 1, width - 1)
            right = _sixteen_bits(image[v, x], scale) | _sixteen_bits(image[below, x], scale) << np.uint64(32)
            packed[v, u] = left | right << np.uint64(16)
            left = right
    return packed


@njit
def _sixteen_bits(value, scale):
    return np.uint64(min(max(value * scale + _f32(0.5), _f32(0.0)), _LEVELS))


@njit(fastmath=FINITE_MATH, forceinline=True)
def reference_window(image, u, v, offsets, inverse_colour, values, weights):
    """Fill the window's values and bilateral weights; returns weight sum, mean and variance."""
    height, width = image.shape
    centre = image[v, u]
    total = _f32(0.0)
    first = _f32(0.0)
    second = _f32(0.0)
    for i in range(SAMPLES):
        y = min(max(v + np.int64(offsets[1, i]), 0), height - 1)
        x = min(max(u + np.int64(offsets[0, i]), 0), width - 1)
        value = image[y, x]
        fall = _f32(1.0) + (value - centre) * (value - centre) * inverse_colour
        weight = _f32(1.0) / (fall * fall)
        values[i] = value
        weights[i] = weight
        total += weight
        first += weight * value
        second += weight * value * value
    mean = first / total
    return total, mean, max(second / total - mean * mean, _f32(0.0))


@njit(fastmath=FINITE_MATH, forceinline=True)
def view_cost(s, q, gu, gv, u, v, M, b, values, weights, stats, offsets, sources, height, width, unit, noise):
    """1 - NCC of the window under a plane in source `s`; the homography is linearized at the centre.

    unit: what 1 is in a packed source. The inner loop is one piece so that LLVM makes it a gather over all samples.
    Whole arrays and an index are passed, not slices: each slice would cost two atomic reference counts a call.
    """
    hz = M[s, 2, 0] * u + M[s, 2, 1] * v + M[s, 2, 2] + b[s, 2] * q
    if hz < LEAST_Z:
        return UNMATCHED
    scale = _f32(1.0) / hz
    cx = (M[s, 0, 0] * u + M[s, 0, 1] * v + M[s, 0, 2] + b[s, 0] * q) * scale
    cy = (M[s, 1, 0] * u + M[s, 1, 1] * v + M[s, 1, 2] + b[s, 1] * q) * scale
    x_max = _f32(width - 2)
    y_max = _f32(height - 2)
    if cx < _f32(1.0) or cy < _f32(1.0) or cx > x_max or cy > y_max:
        return UNMATCHED
    tu = M[s, 2, 0] + b[s, 2] * gu
    tv = M[s, 2, 1] + b[s, 2] * gv
    xu = (M[s, 0, 0] + b[s, 0] * gu - cx * tu) * scale
    xv = (M[s, 0, 1] + b[s, 0] * gv - cx * tv) * scale
    yu = (M[s, 1, 0] + b[s, 1] * gu - cy * tu) * scale
    yv = (M[s, 1, 1] + b[s, 1] * gv - cy * tv) * scale
    first = _f32(0.0)
    second = _f32(0.0)
    cross = _f32(0.0)
    row = np.int32(width)
    source = np.uint64(s) * np.uint64(height) * np.uint64(width)
    for i in range(SAMPLES):
        x = min(max(cx + offsets[0, i] * xu + offsets[1, i] * xv, _f32(0.0)), x_max)
        y = min(max(cy + offsets[0, i] * yu + offsets[1, i] * yv, _f32(0.0)), y_max)
        column = np.int32(x)
        line = np.int32(y)
        fx = x - _f32(column)
        fy = y - _f32(line)
        packed = sources[source + np.uint64(line * row + column)]
        upper = np.uint32(packed & np.uint64(0xFFFFFFFF))
        lower = np.uint32(packed >> np.uint64(32))
        left = _f32(np.int32(upper & np.uint32(0xFFFF)))
        above = left + fx * (_f32(np.int32(upper >> np.uint32(16))) - left)
        left = _f32(np.int32(lower & np.uint32(0xFFFF)))
        below = left + fx * (_f32(np.int32(lower >> np.uint32(16))) - left)
        value = above + fy * (below - above)
        weighted = weights[i] * value
        first += weighted
        second += weighted * value
        cross += weighted * values[i]
    total, mean, variance = stats
    inverse = _f32(1.0) / (total * unit)
    source_mean = first * inverse
    source_variance = max(second * inverse / unit - source_mean * source_mean, _f32(0.0))
    covariance = cross * inverse - source_mean * mean
    return _f32(1.0) - covariance / np.sqrt((source_variance + noise) * (variance + noise))


@njit(fastmath=FINITE_MATH, forceinline=True)
def plane_cost(
    q, gu, gv, u, v, M, b, values, weights, stats, offsets, sources, height, width, unit, noise, best, costs, chosen,
    row, column, limit,
):  # fmt: skip
    """Mean cost of the `best` of the views in chosen[row, column] in which the plane matches best; `costs` is scratch.

    As soon as it is sure that it will not be below `limit`, something that is not below it.
    """
    views = chosen.shape[2]
    share = _f32(1.0) / _f32(best)
    total = _f32(0.0)
    for i in range(views):
        cost = view_cost(
            chosen[row, column, i], q, gu, gv, _f32(u), _f32(v), M, b, values, weights, stats, offsets, sources, height,
            width, unit, noise,
        )  # fmt: skip
        place = i
        while place > 0 and costs[place - 1] > cost:
            costs[place] = costs[place - 1]
            place -= 1
        costs[place] = cost
        total = _f32(0.0)
        for k in range(best - (views - 1 - i)):  # the views to come may cost nothing
            total += costs[k]
        if total * share >= limit:
            break
    return total * share
