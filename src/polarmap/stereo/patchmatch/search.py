"""The search for planes: their cost, and red-black sweeps in which pixels try their neighbours' and random ones.

Only every `stride`-th pixel of the image may have a plane: arrays of planes are H'×W', and stand for the pixels (0, 0),
(0, stride) and so on. Arguments beyond those of `matching`: q, gu, gv, cost: of those pixels, float32 H'×W'; chosen:
uint8 H'×W'×N; active: bool H'×W', the others are left as they are; intrinsics: fx, fy, cx, cy; field: of
`polarization_field`, with its weight `turned`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import FINITE_MATH, njit
from polarmap.stereo.patchmatch.matching import SAMPLES, UNMATCHED, plane_cost, reference_window, view_cost
from polarmap.stereo.patchmatch.polarized_planes import plane_misfit

MORE_THAN_ANY = np.float32(3.0)  # cost; polarization adds less than 1 to UNMATCHED, at any weight below 0.25
_MAX_TAN = np.float32(6.0)  # tangent of the largest angle between a plane's normal and the viewing ray
_NEAR, _FAR = (1, 3), (5, 11)  # pixels: first and last distance of the neighbours whose planes are tried, by steps of 2
_REACH = np.float32(0.5 * np.sqrt(SAMPLES))  # samples from the window's centre to beyond its border
_f32 = np.float32


@njit(parallel=True, fastmath=FINITE_MATH)
def evaluate(
    image, sources, M, b, q, gu, gv, cost, chosen, active, stride, offsets, inverse_colour, unit, noise, best,
    intrinsics, field, turned,
):  # fmt: skip
    """Cost of each pixel's plane, and the views in which it matches best (Schönberger et al. choose so, too).

    turned: weight of the misfit of polarization, which is part of the cost. Pixels that are not active get a cost
    above any other.
    """
    height, width = image.shape
    views = M.shape[0]
    for j in prange(q.shape[0]):
        values = np.empty(SAMPLES, _f32)
        weights = np.empty(SAMPLES, _f32)
        costs = np.empty(views, _f32)
        v = j * stride
        for i in range(q.shape[1]):
            if not active[j, i]:
                cost[j, i] = MORE_THAN_ANY
                chosen[j, i, :] = 0
                continue
            u = i * stride
            stats = reference_window(image, u, v, offsets, inverse_colour, values, weights)
            for s in range(views):
                costs[s] = view_cost(
                    s, q[j, i], gu[j, i], gv[j, i], _f32(u), _f32(v), M, b, values, weights, stats, offsets, sources,
                    height, width, unit, noise,
                )  # fmt: skip
            total = _f32(0.0)
            for k in range(chosen.shape[2]):
                s = costs.argmin()
                chosen[j, i, k] = s
                if k < best:
                    total += costs[s]
                costs[s] = _f32(2.0) * UNMATCHED + costs[s]
            misfit = plane_misfit(q[j, i], gu[j, i], gv[j, i], u, v, intrinsics, field)
            cost[j, i] = total / _f32(best) + turned * misfit


@njit(fastmath=FINITE_MATH)
def _admissible(q, gu, gv, u, v, intrinsics, q_min, q_max):
    """Within the depth range and not seen edge-on: for a plane (α, β, γ), cos² of n to the ray is q²/(|n|²|ray|²)."""
    if q < q_min or q > q_max:
        return False
    fx, fy, cx, cy = intrinsics[0], intrinsics[1], intrinsics[2], intrinsics[3]
    x = (_f32(u) - cx) / fx
    y = (_f32(v) - cy) / fy
    alpha = gu * fx
    beta = gv * fy
    gamma = q - alpha * x - beta * y
    normal = alpha * alpha + beta * beta + gamma * gamma
    return normal * (_f32(1.0) + x * x + y * y) < q * q * (_f32(1.0) + _MAX_TAN * _MAX_TAN)


@njit
def _next_random(state):
    """Marsaglia's 32-bit xorshift: (state, a number in [-1, 1))."""
    state ^= (state << np.uint32(13)) & np.uint32(0xFFFFFFFF)
    state ^= state >> np.uint32(17)
    state ^= (state << np.uint32(5)) & np.uint32(0xFFFFFFFF)
    return state, _f32(state >> np.uint32(8)) * _f32(2.0 / 16777216.0) - _f32(1.0)


@njit(fastmath=FINITE_MATH)
def _best_neighbour(cost, i, j, side, first, last):
    """The pixel (column, row) of least cost at odd distances first..last on one side; (-1, -1) if there is none."""
    height, width = cost.shape
    di = 1 if side == 0 else (-1 if side == 1 else 0)
    dj = 1 if side == 2 else (-1 if side == 3 else 0)
    least = MORE_THAN_ANY
    best_i = -1
    best_j = -1
    for distance in range(first, last + 1, 2):
        x = i + di * distance
        y = j + dj * distance
        if x < 0 or y < 0 or x >= width or y >= height:
            break
        if cost[y, x] < least:
            least = cost[y, x]
            best_i = x
            best_j = y
    return best_i, best_j


@njit(parallel=True, fastmath=FINITE_MATH)
def sweep(
    image, sources, M, b, q, gu, gv, cost, chosen, active, stride, offsets, inverse_colour, unit, noise, best,
    intrinsics, field, turned, q_min, q_max, q_same, far, colour, trials, q_scale, slope_scale, seed,
):  # fmt: skip
    """Half a red-black sweep: pixels of one colour try their neighbours' planes, then random changes.

    q_same: a plane that differs by less from the present one, all over the window, is not tried. far: whether
    neighbours at more than three pixels are asked, too.
    """
    height, width = image.shape
    reach = _REACH * (offsets[0, 1] - offsets[0, 0])
    for j in prange(q.shape[0]):
        values = np.empty(SAMPLES, _f32)
        weights = np.empty(SAMPLES, _f32)
        costs = np.empty(chosen.shape[2], _f32)
        v = j * stride
        for i in range((j + colour) & 1, q.shape[1], 2):
            if not active[j, i]:
                continue
            u = i * stride
            stats = reference_window(image, u, v, offsets, inverse_colour, values, weights)
            best_q, best_gu, best_gv, least = q[j, i], gu[j, i], gv[j, i], cost[j, i]
            state = np.uint32((np.uint32(j * q.shape[1] + i) + seed * np.uint32(277803737)) * np.uint32(747796405) | 1)
            state, _ = _next_random(state)
            scale = _f32(1.0)
            for trial in range(8 + trials):
                if trial < 8:
                    near = trial < 4
                    if not (near or far):
                        continue
                    first, last = _NEAR if near else _FAR
                    x, y = _best_neighbour(cost, i, j, trial & 3, first, last)
                    if x < 0:
                        continue
                    new_gu, new_gv = gu[y, x], gv[y, x]
                    new_q = q[y, x] + new_gu * _f32((i - x) * stride) + new_gv * _f32((j - y) * stride)
                    change = abs(new_q - best_q) + reach * (abs(new_gu - best_gu) + abs(new_gv - best_gv))
                    if change < q_same:
                        continue
                else:
                    state, r0 = _next_random(state)
                    state, r1 = _next_random(state)
                    state, r2 = _next_random(state)
                    new_q, new_gu, new_gv = best_q, best_gu, best_gv
                    if trial & 1 == 0:
                        new_q += r0 * q_scale * scale
                    else:
                        new_gu += r1 * slope_scale * scale * best_q / intrinsics[0]
                        new_gv += r2 * slope_scale * scale * best_q / intrinsics[1]
                        scale *= _f32(0.5)
                if not _admissible(new_q, new_gu, new_gv, u, v, intrinsics, q_min, q_max):
                    continue
                misfit = turned * plane_misfit(new_q, new_gu, new_gv, u, v, intrinsics, field)
                new_cost = misfit + plane_cost(
                    new_q, new_gu, new_gv, u, v, M, b, values, weights, stats, offsets, sources, height, width, unit,
                    noise, best, costs, chosen, j, i, least - misfit,
                )  # fmt: skip
                if new_cost < least:
                    best_q, best_gu, best_gv, least = new_q, new_gu, new_gv, new_cost
            q[j, i], gu[j, i], gv[j, i], cost[j, i] = best_q, best_gu, best_gv, least
