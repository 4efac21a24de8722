"""Kernels that find the blocks a depth map touches and add it to them.

Projective truncated signed distance after Curless and Levoy 1996 and KinectFusion (Newcombe et al. 2011), on voxel
blocks (Nießner et al. 2013; InfiniTAM, Prisacariu et al. 2017). All sums are fixed-point integers, so what was added
can be taken out again to the last bit, in any order.
"""

from __future__ import annotations

import math

import numpy as np
from numba import prange

from polarmap.fusion.block_index import BLOCK_SIDE, COORDINATE_LIMIT, EMPTY, pack, probe, unpack
from polarmap.fusion.depth_view import DepthView
from polarmap.jit import FAST_MATH, njit

ONE = 1 << 16
"""Fixed-point 1 of the sums of weights, weighted distances and weighted greys."""

CHUNKS = 16


def touched_blocks(view: DepthView, voxel_size: float, truncation: float, limit: int) -> np.ndarray | None:
    """Keys, int64 ascending, of all blocks that a viewing ray meets within `truncation` (along z) of its depth.

    None where these are more than `limit`. Points outside the addressable blocks are left out, see
    `count_unaddressable`.
    """
    size = 1 << 12
    while size <= 8 * limit + (1 << 12):
        tables = np.full((CHUNKS, size), EMPTY)
        if _mark_touched(tables, view, BLOCK_SIDE * voxel_size, truncation):
            keys = np.unique(tables[tables != EMPTY])
            return keys if len(keys) <= limit else None
        size *= 4
    return None


def count_unaddressable(view: DepthView, voxel_size: float, truncation: float) -> int:
    """How many points of a depth map are left out because blocks within `truncation` of them have no number."""
    height, width = view.depth.shape
    fx, fy, cx, cy = view.intrinsics
    block_size, reach = BLOCK_SIDE * voxel_size, COORDINATE_LIMIT - 2.0
    x, y = (np.arange(width) - cx) / fx, (np.arange(height) - cy) / fy
    longest = np.sqrt(1.0 + np.abs(x).max() ** 2 + np.abs(y).max() ** 2) * (float(view.depth.max()) + truncation)
    if np.abs(view.centre).max() + longest < reach * block_size:
        return 0
    v, u = np.nonzero(view.depth)
    z, rays = view.depth[v, u].astype(float), np.stack([x[u], y[v], np.ones(len(u))], axis=1) @ view.rotation.T
    ends = [view.centre + d[:, None] * rays for d in (np.maximum(z - truncation, 0.0), z + truncation)]
    inside = np.logical_and(*((np.abs(end) < reach * block_size).all(axis=1) for end in ends))
    return int(np.count_nonzero(~inside))


@njit(parallel=True)
def _mark_touched(tables, view, block_size, truncation):
    """Fill one hash set a chunk of rows; False where one ran over half full, beyond which probing is slow."""
    fits = np.ones(CHUNKS, np.bool_)
    height = view.depth.shape[0]
    for chunk in prange(CHUNKS):
        first, last = chunk * height // CHUNKS, (chunk + 1) * height // CHUNKS
        fits[chunk] = _mark_rows(tables[chunk], view, first, last, block_size, truncation)
    return fits.all()


@njit(error_model="numpy", fastmath=FAST_MATH)
def _mark_rows(table, view, first, last, block_size, truncation):
    fx, fy, cx, cy = view.intrinsics
    R, origin = view.rotation / block_size, view.centre / block_size
    count = 0
    for v in range(first, last):
        y = (v - cy) / fy
        nowhere = np.int64(COORDINATE_LIMIT)
        before = nowhere, nowhere, nowhere, nowhere, nowhere, nowhere
        for u in range(view.depth.shape[1]):
            z = view.depth[v, u]
            if z <= 0.0:
                continue
            x = (u - cx) / fx
            ray = (
                R[0, 0] * x + R[0, 1] * y + R[0, 2],
                R[1, 0] * x + R[1, 1] * y + R[1, 2],
                R[2, 0] * x + R[2, 1] * y + R[2, 2],
            )
            near, far = max(z - truncation, 0.0), z + truncation
            p = (origin[0] + near * ray[0], origin[1] + near * ray[1], origin[2] + near * ray[2])
            q = (origin[0] + far * ray[0], origin[1] + far * ray[1], origin[2] + far * ray[2])
            ends = _floor(p[0]), _floor(p[1]), _floor(p[2]), _floor(q[0]), _floor(q[1]), _floor(q[2])
            steps = abs(ends[3] - ends[0]) + abs(ends[4] - ends[1]) + abs(ends[5] - ends[2])
            if steps <= 1 and ends == before:  # the same one or two blocks as of the pixel to the left
                continue
            before = ends
            count += _mark_segment(table, p, q, table.shape[0] // 2 - count)
            if 2 * count >= table.shape[0]:
                return False
    return True


@njit(error_model="numpy", fastmath=FAST_MATH)
def _mark_segment(table, p, q, room):
    """Put the blocks from p to q (block units) into the hash set, in order; how many were new, at most `room`."""
    if not (_addressable(p) and _addressable(q)):
        return 0
    i, j, k = _floor(p[0]), _floor(p[1]), _floor(p[2])
    steps = abs(_floor(q[0]) - i) + abs(_floor(q[1]) - j) + abs(_floor(q[2]) - k)
    step_i, next_i, delta_i = _march(p[0], q[0], i)
    step_j, next_j, delta_j = _march(p[1], q[1], j)
    step_k, next_k, delta_k = _march(p[2], q[2], k)
    new = _mark(table, pack(i, j, k))
    for _ in range(steps):
        if new >= room:
            break
        if next_i <= next_j and next_i <= next_k:
            i, next_i = i + step_i, next_i + delta_i
        elif next_j <= next_k:
            j, next_j = j + step_j, next_j + delta_j
        else:
            k, next_k = k + step_k, next_k + delta_k
        new += _mark(table, pack(i, j, k))
    return new


@njit(inline="always")
def _march(p, q, first):
    """Direction, share of the way from p to q at the first block border, and share between borders."""
    d = q - p
    if d == 0.0:
        return 0, 2.0, 2.0
    pace = 1.0 / d
    if d > 0.0:
        return 1, (first + 1 - p) * pace, pace
    return -1, (first - p) * pace, -pace


@njit(inline="always")
def _floor(x):
    """Like math.floor, which is a slow call."""
    n = np.int64(x)
    return n - (n > x)


@njit(inline="always")
def _mark(table, key):
    place = probe(table, key)
    if table[place] == key:
        return 0
    table[place] = key
    return 1


@njit(inline="always")
def _addressable(p):
    reach = COORDINATE_LIMIT - 2.0
    return abs(p[0]) < reach and abs(p[1]) < reach and abs(p[2]) < reach


@njit(parallel=True)
def accumulate(sums, slots, keys, view, voxel_size, truncation, sign):
    """Add (sign 1) or take out (sign -1) one view in the blocks `keys`, stored at `slots`.

    sums: int32 slots×8×8×8×3, per voxel the sums of weight·distance, weight and weight·grey, in units of 1/ONE;
    the distance in truncations, at most 1.
    """
    fx, fy, cx, cy = view.intrinsics
    K = np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])
    projection = K @ np.ascontiguousarray(view.rotation.T)
    steps = (projection * voxel_size).astype(np.float32)
    pixels = _packed(view)
    for b in prange(len(slots)):
        start = projection @ (_first_voxel(keys[b], voxel_size) - view.centre)
        _accumulate_block(sums[slots[b]], pixels, start.astype(np.float32), steps, np.float32(1.0 / truncation), sign)


@njit(parallel=True)
def _packed(view):
    """Depth, weight, and what a voxel gets of weight and grey, float32 H×W×4: what is read together lies together."""
    height, width = view.depth.shape
    pixels = np.empty((height, width, 4), np.float32)
    for v in prange(height):
        for u in range(width):
            weight = view.weight[v, u] * np.float32(ONE)
            pixels[v, u, 0], pixels[v, u, 1] = view.depth[v, u], weight
            pixels[v, u, 2] = np.float32(_rounded(weight))
            pixels[v, u, 3] = np.float32(_rounded(weight * view.grey[v, u]))
    return pixels


@njit(inline="always")
def _first_voxel(key, voxel_size):
    """World position of the centre of a block's voxel (0, 0, 0)."""
    i, j, k = unpack(key)
    return (np.array([i, j, k]) * BLOCK_SIDE + 0.5) * voxel_size


@njit(error_model="numpy", fastmath=FAST_MATH)
def _accumulate_block(sums, pixels, start, steps, per_truncation, sign):
    """One block, whose voxel (i, j, k) projects to the homogeneous pixel start + steps·(i, j, k)."""
    height, width, _ = pixels.shape
    right, bottom = np.float32(width - 0.5), np.float32(height - 0.5)
    half, one, zero = np.float32(0.5), np.float32(1.0), np.float32(0.0)
    a2, b2, z2 = steps[0, 2], steps[1, 2], steps[2, 2]
    for i in range(BLOCK_SIDE):
        for j in range(BLOCK_SIDE):
            f, g = np.float32(i), np.float32(j)
            a1 = start[0] + steps[0, 0] * f + steps[0, 1] * g
            b1 = start[1] + steps[1, 0] * f + steps[1, 1] * g
            z1 = start[2] + steps[2, 0] * f + steps[2, 1] * g
            line = sums[i, j]
            for k in range(BLOCK_SIDE):
                h = np.float32(k)
                z = z1 + z2 * h
                inverse = one / z
                u = (a1 + a2 * h) * inverse
                v = (b1 + b2 * h) * inverse
                if not (z > zero and u > -half and v > -half and u < right and v < bottom):
                    continue
                pixel = pixels[np.uint32(v + half), np.uint32(u + half)]
                nearest = pixel[0]
                distance = (nearest - z) * per_truncation
                if not (nearest > zero and distance > np.float32(-2.0)):
                    continue
                if distance < np.float32(2.0):  # else it is above 1, whatever interpolation changes
                    distance = (_depth_at(pixels, u, v, nearest, one / per_truncation) - z) * per_truncation
                if distance >= -one:
                    line[k, 0] += sign * _rounded(pixel[1] * min(distance, one))
                    line[k, 1] += sign * np.int32(pixel[2])
                    line[k, 2] += sign * np.int32(pixel[3])


@njit(inline="always")
def _depth_at(pixels, u, v, nearest, jump):
    """Depth at (u, v): bilinear where the four pixels around lie within `jump` of each other, else `nearest`."""
    if not (u >= np.float32(0.0) and v >= np.float32(0.0)):
        return nearest
    left, top = np.uint32(u), np.uint32(v)
    after, below = left + np.uint32(1), top + np.uint32(1)
    if after >= pixels.shape[1] or below >= pixels.shape[0]:
        return nearest
    a, b, c, d = pixels[top, left, 0], pixels[top, after, 0], pixels[below, left, 0], pixels[below, after, 0]
    low, high = min(min(a, b), min(c, d)), max(max(a, b), max(c, d))
    if low <= np.float32(0.0) or high - low > jump:
        return nearest
    s, t = u - np.float32(left), v - np.float32(top)
    upper, lower = a + s * (b - a), c + s * (d - c)
    return upper + t * (lower - upper)


@njit(inline="always")
def _rounded(x):
    return np.int32(x + math.copysign(np.float32(0.5), x))
