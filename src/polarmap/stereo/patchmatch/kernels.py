"""The kernels of PatchMatch: cost of planes, red-black sweeps, and the refinement of depth with its noise.

Arguments that several share: image, float32 H×W; sources, those of V views, flat; M, b: V×3×3 and V×3, the homography
of a plane, see `method`; q, gu, gv: the planes, float32 H×W each; cost: theirs; chosen: views that a pixel tries,
uint8 H×W×N; offsets: of the window's samples, float32 2×25; inverse_colour, noise, best: constants; intrinsics: fx, fy,
cx, cy; field: of `polarization_field`, with its weight `turned`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import FAST_MATH, FINITE_MATH, njit
from polarmap.stereo.patchmatch.polarized_planes import plane_misfit

SIDE = 5  # samples along one side of the support window
_SAMPLES = SIDE * SIDE
_UNMATCHED = np.float32(2.0)  # the largest cost 1 - NCC
_MAX_TAN = np.float32(6.0)  # tangent of the largest angle between a plane's normal and the viewing ray
_MORE_THAN_ANY = np.float32(3.0)  # cost; polarization adds less than 1 to _UNMATCHED, at any weight below 0.25
_LEAST_Z = np.float32(1e-3)  # z in a source over z in the reference; nearer points are beside the camera or behind it
_NEAR, _FAR = (1, 3), (5, 11)  # pixels: first and last distance of the neighbours whose planes are tried, by steps of 2
_LEAST_CURVATURE = np.float32(1e-4)  # of the cost, per step of q squared; below it rounding makes the minimum
_LARGEST_SHIFT = np.float32(0.5)  # steps of q, from the best of three to the parabola's minimum
_f32 = np.float32


@njit(fastmath=FINITE_MATH)
def _reference_window(image, u, v, offsets, inverse_colour, values, weights):
    """Fill the window's values and bilateral weights; returns weight sum, mean and variance."""
    height, width = image.shape
    centre = image[v, u]
    total = _f32(0.0)
    first = _f32(0.0)
    second = _f32(0.0)
    for i in range(_SAMPLES):
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


@njit(fastmath=FINITE_MATH)
def _view_cost(s, q, gu, gv, u, v, M, b, values, weights, stats, offsets, sources, height, width, noise):
    """1 - NCC of the window under a plane in source `s`; the homography is linearized at the centre.

    The inner loop is one piece so that LLVM makes it a gather over all samples. Whole arrays and an index are
    passed, not slices: each slice would cost two atomic reference counts a call.
    """
    hz = M[s, 2, 0] * u + M[s, 2, 1] * v + M[s, 2, 2] + b[s, 2] * q
    if hz < _LEAST_Z:
        return _UNMATCHED
    scale = _f32(1.0) / hz
    cx = (M[s, 0, 0] * u + M[s, 0, 1] * v + M[s, 0, 2] + b[s, 0] * q) * scale
    cy = (M[s, 1, 0] * u + M[s, 1, 1] * v + M[s, 1, 2] + b[s, 1] * q) * scale
    x_max = _f32(width - 2)
    y_max = _f32(height - 2)
    if cx < _f32(1.0) or cy < _f32(1.0) or cx > x_max or cy > y_max:
        return _UNMATCHED
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
    for i in range(_SAMPLES):
        x = min(max(cx + offsets[0, i] * xu + offsets[1, i] * xv, _f32(0.0)), x_max)
        y = min(max(cy + offsets[0, i] * yu + offsets[1, i] * yv, _f32(0.0)), y_max)
        column = np.int32(x)
        line = np.int32(y)
        fx = x - _f32(column)
        fy = y - _f32(line)
        k = source + np.uint64(line * row + column)
        above = sources[k] + fx * (sources[k + np.uint64(1)] - sources[k])
        k += np.uint64(width)
        below = sources[k] + fx * (sources[k + np.uint64(1)] - sources[k])
        value = above + fy * (below - above)
        weighted = weights[i] * value
        first += weighted
        second += weighted * value
        cross += weighted * values[i]
    total, mean, variance = stats
    source_mean = first / total
    source_variance = max(second / total - source_mean * source_mean, _f32(0.0))
    covariance = cross / total - source_mean * mean
    return _f32(1.0) - covariance / np.sqrt((source_variance + noise) * (variance + noise))


@njit(fastmath=FINITE_MATH)
def _cost(q, gu, gv, u, v, M, b, values, weights, stats, offsets, sources, height, width, noise, best, costs, chosen):
    """Mean cost of the `best` of the pixel's chosen views in which the plane matches best; `costs` is scratch."""
    views = chosen.shape[2]
    for i in range(views):
        costs[i] = _view_cost(
            chosen[v, u, i], q, gu, gv, _f32(u), _f32(v), M, b, values, weights, stats, offsets, sources, height, width,
            noise,
        )  # fmt: skip
    total = _f32(0.0)
    for i in range(best):
        for j in range(i + 1, views):
            if costs[j] < costs[i]:
                costs[i], costs[j] = costs[j], costs[i]
        total += costs[i]
    return total / _f32(best)


@njit(parallel=True, fastmath=FINITE_MATH)
def evaluate(
    image, sources, M, b, q, gu, gv, cost, chosen, offsets, inverse_colour, noise, best, intrinsics, field, turned
):  # fmt: skip
    """Cost of each pixel's plane, and the views in which it matches best (Schönberger et al. choose so, too).

    turned: weight of the misfit of polarization, which is part of the cost.
    """
    height, width = image.shape
    views = M.shape[0]
    for v in prange(height):
        values = np.empty(_SAMPLES, _f32)
        weights = np.empty(_SAMPLES, _f32)
        costs = np.empty(views, _f32)
        for u in range(width):
            stats = _reference_window(image, u, v, offsets, inverse_colour, values, weights)
            for s in range(views):
                costs[s] = _view_cost(
                    s, q[v, u], gu[v, u], gv[v, u], _f32(u), _f32(v), M, b, values, weights, stats, offsets, sources,
                    height, width, noise,
                )  # fmt: skip
            total = _f32(0.0)
            for i in range(chosen.shape[2]):
                s = costs.argmin()
                chosen[v, u, i] = s
                if i < best:
                    total += costs[s]
                costs[s] = _f32(2.0) * _UNMATCHED + costs[s]
            misfit = plane_misfit(q[v, u], gu[v, u], gv[v, u], u, v, intrinsics, field)
            cost[v, u] = total / _f32(best) + turned * misfit


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
def _best_neighbour(cost, u, v, side, first, last):
    """The pixel of least cost at odd distances first..last on one side; (-1, -1) outside the image."""
    height, width = cost.shape
    du = 1 if side == 0 else (-1 if side == 1 else 0)
    dv = 1 if side == 2 else (-1 if side == 3 else 0)
    least = _MORE_THAN_ANY
    best_u = -1
    best_v = -1
    for distance in range(first, last + 1, 2):
        x = u + du * distance
        y = v + dv * distance
        if x < 0 or y < 0 or x >= width or y >= height:
            break
        if cost[y, x] < least:
            least = cost[y, x]
            best_u = x
            best_v = y
    return best_u, best_v


@njit(parallel=True, fastmath=FINITE_MATH)
def sweep(
    image, sources, M, b, q, gu, gv, cost, chosen, offsets, inverse_colour, noise, best, intrinsics, field, turned,
    q_min, q_max, colour, trials, q_scale, slope_scale, seed,
):  # fmt: skip
    """Half a red-black sweep: pixels of one colour try their neighbours' planes, then random changes."""
    height, width = image.shape
    for v in prange(height):
        values = np.empty(_SAMPLES, _f32)
        weights = np.empty(_SAMPLES, _f32)
        costs = np.empty(chosen.shape[2], _f32)
        for u in range((v + colour) & 1, width, 2):
            stats = _reference_window(image, u, v, offsets, inverse_colour, values, weights)
            best_q, best_gu, best_gv, least = q[v, u], gu[v, u], gv[v, u], cost[v, u]
            state = np.uint32((np.uint32(v * width + u) + seed * np.uint32(277803737)) * np.uint32(747796405) | 1)
            state, _ = _next_random(state)
            scale = _f32(1.0)
            for trial in range(8 + trials):
                if trial < 8:
                    near = trial < 4
                    first, last = _NEAR if near else _FAR
                    x, y = _best_neighbour(cost, u, v, trial & 3, first, last)
                    if x < 0:
                        continue
                    new_gu, new_gv = gu[y, x], gv[y, x]
                    new_q = q[y, x] + new_gu * _f32(u - x) + new_gv * _f32(v - y)
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
                new_cost = _cost(
                    new_q, new_gu, new_gv, u, v, M, b, values, weights, stats, offsets, sources, height, width, noise,
                    best, costs, chosen,
                )  # fmt: skip
                new_cost += turned * plane_misfit(new_q, new_gu, new_gv, u, v, intrinsics, field)
                if new_cost < least:
                    best_q, best_gu, best_gv, least = new_q, new_gu, new_gv, new_cost
            q[v, u], gu[v, u], gv[v, u], cost[v, u] = best_q, best_gu, best_gv, least


@njit(fastmath=FINITE_MATH)
def _shift_by_depth(s, q, gu, gv, u, v, M, b):
    """How far in the reference image the match in source `s` moves per unit of q: (du, dv), (0, 0) behind it.

    The source point moves by (b_xy - x b_z)/h_z; the inverse of the homography's derivative carries that back.
    """
    hz = M[s, 2, 0] * u + M[s, 2, 1] * v + M[s, 2, 2] + b[s, 2] * q
    if hz < _LEAST_Z:
        return _f32(0.0), _f32(0.0)
    x = (M[s, 0, 0] * u + M[s, 0, 1] * v + M[s, 0, 2] + b[s, 0] * q) / hz
    y = (M[s, 1, 0] * u + M[s, 1, 1] * v + M[s, 1, 2] + b[s, 1] * q) / hz
    zu = M[s, 2, 0] + b[s, 2] * gu
    zv = M[s, 2, 1] + b[s, 2] * gv
    xu = M[s, 0, 0] + b[s, 0] * gu - x * zu
    xv = M[s, 0, 1] + b[s, 0] * gv - x * zv
    yu = M[s, 1, 0] + b[s, 1] * gu - y * zu
    yv = M[s, 1, 1] + b[s, 1] * gv - y * zv
    determinant = xu * yv - xv * yu
    dx = b[s, 0] - x * b[s, 2]
    dy = b[s, 1] - y * b[s, 2]
    return (yv * dx - xv * dy) / determinant, (xu * dy - yu * dx) / determinant


@njit(fastmath=FINITE_MATH)
def _structure(slope_u, slope_v, u, v, offsets, weights):
    """Weighted sums of the squared image gradient over the window: uu, uv, vv."""
    height, width = slope_u.shape
    uu = _f32(0.0)
    uv = _f32(0.0)
    vv = _f32(0.0)
    for i in range(_SAMPLES):
        y = min(max(v + np.int64(offsets[1, i]), 0), height - 1)
        x = min(max(u + np.int64(offsets[0, i]), 0), width - 1)
        uu += weights[i] * slope_u[y, x] * slope_u[y, x]
        uv += weights[i] * slope_u[y, x] * slope_v[y, x]
        vv += weights[i] * slope_v[y, x] * slope_v[y, x]
    return uu, uv, vv


@njit(fastmath=FAST_MATH)
def _depth_sigma(q, gu, gv, u, v, M, b, structure, total, noise, min_response):
    """Standard deviation of q by noise σ² in both images: var(q) = 2σ² / Σ w (∇I·e)², e the shift per unit of q.

    Of the squared central differences σ²|e|²/2 is noise and is taken off. The view that tells most counts. Infinite
    where the mean square gradient along e is below `min_response` σ².
    """
    uu, uv, vv = structure
    information = _f32(0.0)
    for s in range(M.shape[0]):
        eu, ev = _shift_by_depth(s, q, gu, gv, u, v, M, b)
        along = uu * eu * eu + _f32(2.0) * uv * eu * ev + vv * ev * ev
        length = eu * eu + ev * ev
        if along > min_response * noise * total * length:
            information = max(information, along - _f32(0.5) * noise * total * length)
    return np.sqrt(_f32(2.0) * noise / information) if information > 0 else _f32(np.inf)


@njit(parallel=True, fastmath=FAST_MATH)
def refine(
    image, sources, M, b, q, gu, gv, cost, chosen, sigma, offsets, inverse_colour, noise, best, step, q_min,
    min_response, slope_u, slope_v,
):  # fmt: skip
    """Move q to the minimum of the parabola through the cost at q - step, q and q + step, and find its sigma."""
    height, width = image.shape
    for v in prange(height):
        values = np.empty(_SAMPLES, _f32)
        weights = np.empty(_SAMPLES, _f32)
        costs = np.empty(chosen.shape[2], _f32)
        for u in range(width):
            stats = _reference_window(image, u, v, offsets, inverse_colour, values, weights)
            structure = _structure(slope_u, slope_v, u, v, offsets, weights)
            sigma[v, u] = _depth_sigma(
                q[v, u], gu[v, u], gv[v, u], _f32(u), _f32(v), M, b, structure, stats[0], noise, min_response
            )
            if np.isinf(sigma[v, u]):
                continue
            farther = _cost(
                q[v, u] - step, gu[v, u], gv[v, u], u, v, M, b, values, weights, stats, offsets, sources, height, width,
                noise, best, costs, chosen,
            )  # fmt: skip
            nearer = _cost(
                q[v, u] + step, gu[v, u], gv[v, u], u, v, M, b, values, weights, stats, offsets, sources, height, width,
                noise, best, costs, chosen,
            )  # fmt: skip
            curvature = farther + nearer - _f32(2.0) * cost[v, u]
            if curvature > _LEAST_CURVATURE:
                shift = _f32(0.5) * (farther - nearer) / curvature
                q[v, u] = max(q[v, u] + min(max(shift, -_LARGEST_SHIFT), _LARGEST_SHIFT) * step, q_min)
            else:
                sigma[v, u] = _f32(np.inf)
