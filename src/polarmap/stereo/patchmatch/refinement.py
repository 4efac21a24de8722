"""From the search's planes to depth with its noise: what the image can tell, sub-pixel steps, and the pixels between.

Arguments as in `matching` and `search`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import FAST_MATH, FINITE_MATH, njit
from polarmap.stereo.patchmatch.matching import LEAST_Z, SAMPLES, plane_cost, reference_window

_LEAST_CURVATURE = np.float32(1e-4)  # of the cost, per step of q squared; below it rounding makes the minimum
_LARGEST_SHIFT = np.float32(0.5)  # steps of q, from the best of three to the parabola's minimum
_NO_LIMIT = np.float32(1e9)
_f32 = np.float32


@njit(fastmath=FINITE_MATH)
def _structure(slope_u, slope_v, u, v, offsets, weights):
    """Weighted sums of the squared image gradient over the window: uu, uv, vv."""
    height, width = slope_u.shape
    uu = _f32(0.0)
    uv = _f32(0.0)
    vv = _f32(0.0)
    for i in range(SAMPLES):
        y = min(max(v + np.int64(offsets[1, i]), 0), height - 1)
        x = min(max(u + np.int64(offsets[0, i]), 0), width - 1)
        uu += weights[i] * slope_u[y, x] * slope_u[y, x]
        uv += weights[i] * slope_u[y, x] * slope_v[y, x]
        vv += weights[i] * slope_v[y, x] * slope_v[y, x]
    return uu, uv, vv


@njit(parallel=True, fastmath=FINITE_MATH)
def responsive(image, slope_u, slope_v, active, stride, offsets, inverse_colour, noise, min_response):
    """Find the pixels whose window changes by more than noise along some line, so that it can tell a depth at all.

    slope_u, slope_v: the image's central differences. active is filled. The mean square of the gradient along
    a line is at most the larger eigenvalue of the structure tensor.
    """
    for j in prange(active.shape[0]):
        values = np.empty(SAMPLES, _f32)
        weights = np.empty(SAMPLES, _f32)
        for i in range(active.shape[1]):
            u, v = i * stride, j * stride
            total, _, _ = reference_window(image, u, v, offsets, inverse_colour, values, weights)
            uu, uv, vv = _structure(slope_u, slope_v, u, v, offsets, weights)
            half = _f32(0.5) * (uu - vv)
            largest = _f32(0.5) * (uu + vv) + np.sqrt(half * half + uv * uv)
            active[j, i] = largest > min_response * noise * total


@njit(fastmath=FINITE_MATH)
def _shift_by_depth(s, q, gu, gv, u, v, M, b):
    """How far in the reference image the match in source `s` moves per unit of q: (du, dv), (0, 0) behind it.

    The source point moves by (b_xy - x b_z)/h_z; the inverse of the homography's derivative carries that back.
    """
    hz = M[s, 2, 0] * u + M[s, 2, 1] * v + M[s, 2, 2] + b[s, 2] * q
    if hz < LEAST_Z:
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
    image, sources, M, b, q, gu, gv, cost, chosen, active, stride, offsets, inverse_colour, unit, noise, best, sigma,
    steps, q_min, min_response, slope_u, slope_v,
):  # fmt: skip
    """Move q to the minimum of the parabola through the cost at q - step, q and q + step, and find its sigma.

    cost: without polarization; it becomes that of the last q but one. steps: of q, one after the other. sigma is
    filled, with infinity where the cost has no minimum or the image does not respond to depth.
    """
    height, width = image.shape
    for j in prange(q.shape[0]):
        values = np.empty(SAMPLES, _f32)
        weights = np.empty(SAMPLES, _f32)
        costs = np.empty(chosen.shape[2], _f32)
        v = j * stride
        for i in range(q.shape[1]):
            sigma[j, i] = _f32(np.inf)
            if not active[j, i]:
                continue
            u = i * stride
            stats = reference_window(image, u, v, offsets, inverse_colour, values, weights)
            structure = _structure(slope_u, slope_v, u, v, offsets, weights)
            here, slope_x, slope_y = q[j, i], gu[j, i], gv[j, i]
            found = _depth_sigma(
                here, slope_x, slope_y, _f32(u), _f32(v), M, b, structure, stats[0], noise, min_response
            )
            if np.isinf(found):
                continue
            for k in range(len(steps)):
                step = steps[k]
                if k > 0:
                    cost[j, i] = plane_cost(
                        here, slope_x, slope_y, u, v, M, b, values, weights, stats, offsets, sources, height, width,
                        unit, noise, best, costs, chosen, j, i, _NO_LIMIT,
                    )  # fmt: skip
                farther = plane_cost(
                    here - step, slope_x, slope_y, u, v, M, b, values, weights, stats, offsets, sources, height, width,
                    unit, noise, best, costs, chosen, j, i, _NO_LIMIT,
                )  # fmt: skip
                nearer = plane_cost(
                    here + step, slope_x, slope_y, u, v, M, b, values, weights, stats, offsets, sources, height, width,
                    unit, noise, best, costs, chosen, j, i, _NO_LIMIT,
                )  # fmt: skip
                curvature = farther + nearer - _f32(2.0) * cost[j, i]
                if not curvature > _LEAST_CURVATURE:
                    found = _f32(np.inf)
                    break
                shift = _f32(0.5) * (farther - nearer) / curvature
                here = max(here + min(max(shift, -_LARGEST_SHIFT), _LARGEST_SHIFT) * step, q_min)
            q[j, i] = here
            sigma[j, i] = found


@njit(parallel=True, fastmath=FAST_MATH)
def fill(
    image, sources, M, b, q, gu, gv, cost, chosen, sigma, stride, offsets, inverse_colour, unit, noise, best,
    min_response, slope_u, slope_v, dense_q, dense_gu, dense_gv, dense_cost, dense_sigma,
):  # fmt: skip
    """Planes of all pixels: those between searched ones take the plane of the one around that matches best.

    q, gu, gv, cost, sigma: of every `stride`-th pixel, as `refine` leaves them. dense_…: float32 H×W each, are filled.
    """
    height, width = image.shape
    rows, columns = q.shape
    for v in prange(height):
        values = np.empty(SAMPLES, _f32)
        weights = np.empty(SAMPLES, _f32)
        costs = np.empty(chosen.shape[2], _f32)
        top = v // stride
        bottom = min(top + 1, rows - 1) if v % stride else top
        for u in range(width):
            left = u // stride
            right = min(left + 1, columns - 1) if u % stride else left
            if v % stride == 0 and u % stride == 0:
                dense_q[v, u], dense_gu[v, u], dense_gv[v, u] = q[top, left], gu[top, left], gv[top, left]
                dense_cost[v, u], dense_sigma[v, u] = cost[top, left], sigma[top, left]
                continue
            least = _NO_LIMIT
            best_j, best_i = top, left
            stats = _f32(0.0), _f32(0.0), _f32(0.0)
            for j in range(top, bottom + 1):
                for i in range(left, right + 1):
                    if np.isinf(sigma[j, i]):
                        continue
                    if least == _NO_LIMIT:
                        stats = reference_window(image, u, v, offsets, inverse_colour, values, weights)
                    slope_x, slope_y = gu[j, i], gv[j, i]
                    at_pixel = q[j, i] + slope_x * _f32(u - i * stride) + slope_y * _f32(v - j * stride)
                    found = plane_cost(
                        at_pixel, slope_x, slope_y, u, v, M, b, values, weights, stats, offsets, sources, height,
                        width, unit, noise, best, costs, chosen, j, i, least,
                    )  # fmt: skip
                    if found < least:
                        least, best_j, best_i = found, j, i
            slope_x, slope_y = gu[best_j, best_i], gv[best_j, best_i]
            at_pixel = q[best_j, best_i] + slope_x * _f32(u - best_i * stride) + slope_y * _f32(v - best_j * stride)
            dense_q[v, u], dense_gu[v, u], dense_gv[v, u] = at_pixel, slope_x, slope_y
            dense_cost[v, u] = least
            if least == _NO_LIMIT:
                dense_sigma[v, u] = _f32(np.inf)
                continue
            structure = _structure(slope_u, slope_v, u, v, offsets, weights)
            dense_sigma[v, u] = _depth_sigma(
                at_pixel, slope_x, slope_y, _f32(u), _f32(v), M, b, structure, stats[0], noise, min_response
            )
