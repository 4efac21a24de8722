"""Alignment on one level of a pyramid: Levenberg-Marquardt over motion and brightness, compiled as a whole.

A trial step costs the residuals alone; the normal equations are summed up once it is taken. All of it runs on one
thread: a level has some thousands of points, and what several threads would save is less than what starting them costs.
"""

from __future__ import annotations

import numpy as np

from polarmap.geometry.lie import exponential
from polarmap.jit import FAST_MATH, njit
from polarmap.odometry.projection import fill_projection

CUTOFF = 20.0  # grey values; a larger residual counts as one of this size
LEAST_POINTS = 20  # in view; eight variables need some more
VARIABLES = 8  # xi of T_frame_reference, ln(gain), offset
_MARGIN = np.float32(2.0)  # pixels from the border, within which a pixel and its gradient can be sampled
_MAX_LOG_GAIN, _MAX_OFFSET = 3.0, 100.0  # the offset in grey values
_OFFSET_STD = 0.5  # grey values; brightness changes by a factor, hardly by an offset
_MAX_SATURATED = 0.6  # share of residuals above the cutoff, with which it is doubled
_MAX_CUTOFF = 8 * CUTOFF  # at which doubling ends

# Levenberg-Marquardt; set by hand.
_FIRST_DAMPING = 0.01
_LESS_DAMPING, _MORE_DAMPING = 0.5, 4.0  # factors after a step that is taken, and after one that is not
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 100.0
_SMALL_GAIN = 1e-5  # of the cost, as a share of it; no more steps after one that gains less
_REGULARIZATION = 1e-6  # squared grey values, far below any residual's; decides what no residual does

TERMS = 8  # of a residual, see `residuals`
_ROWS = VARIABLES + 1  # of the normal equations, the residual's included
_BATCH = 256  # points whose derivatives stay in the fastest cache
_BLOCK = 3  # rows and columns whose products are summed up at once, as many as registers hold


@njit(error_model="numpy", fastmath=FAST_MATH)
def residuals(level, points, K, T, log_gain, offset, huber, cutoff, terms):
    """Residuals of points N×4 (u, v, inverse depth, intensity) of the reference in a frame, float32 H×W×3.

    terms: float32 8×N at least, whose first columns become, for every residual below the cutoff: the point in the
    frame (x/z, y/z, inverse z), its gradient times the focal lengths, the expected intensity less the offset, the
    residual, and its weight. Returns their number, the energy, and how many points are in view and above the cutoff.
    """
    height, width = np.float32(level.shape[0]), np.float32(level.shape[1])
    one = np.float32(1.0)
    gain, shift = np.float32(np.exp(log_gain)), np.float32(offset)
    fx, fy, cx, cy = np.float32(K[0, 0]), np.float32(K[1, 1]), np.float32(K[0, 2]), np.float32(K[1, 2])
    M, m = projection(K, T)
    m00, m01, m02, m03 = M[0, 0], M[0, 1], M[0, 2], m[0]
    m10, m11, m12, m13 = M[1, 0], M[1, 1], M[1, 2], m[1]
    m20, m21, m22, m23 = M[2, 0], M[2, 1], M[2, 2], m[2]
    cutoff_energy = huber * (np.float32(2.0) * cutoff - huber)
    energy, seen, saturated, n = 0.0, 0, 0, 0
    for p in range(len(points)):
        u, v, d = points[p, 0], points[p, 1], points[p, 2]
        iz = one / (m20 * u + m21 * v + m22 + d * m23)
        pu = (m00 * u + m01 * v + m02 + d * m03) * iz
        pv = (m10 * u + m11 * v + m12 + d * m13) * iz
        if not (iz > 0 and _MARGIN < pu < width - _MARGIN and _MARGIN < pv < height - _MARGIN):
            continue
        seen += 1
        column, row = np.uint32(pu), np.uint32(pv)
        fu, fv = pu - np.float32(column), pv - np.float32(row)
        w11 = fu * fv
        w10, w01 = fv - w11, fu - w11
        w00 = one - fu - w10
        next_column, next_row = column + np.uint32(1), row + np.uint32(1)
        value = w00 * level[row, column, 0] + w01 * level[row, next_column, 0]
        value += w10 * level[next_row, column, 0] + w11 * level[next_row, next_column, 0]
        expected = gain * points[p, 3]
        r = value - expected - shift
        size = abs(r)
        if size > cutoff:
            energy += cutoff_energy
            saturated += 1
            continue
        gx = w00 * level[row, column, 1] + w01 * level[row, next_column, 1]
        gx += w10 * level[next_row, column, 1] + w11 * level[next_row, next_column, 1]
        gy = w00 * level[row, column, 2] + w01 * level[row, next_column, 2]
        gy += w10 * level[next_row, column, 2] + w11 * level[next_row, next_column, 2]
        w = one if size <= huber else huber / size
        energy += w * r * r * (np.float32(2.0) - w)
        terms[0, n], terms[1, n], terms[2, n] = (pu - cx) / fx, (pv - cy) / fy, d * iz
        terms[3, n], terms[4, n] = gx * fx, gy * fy
        terms[5, n], terms[6, n], terms[7, n] = expected, r, w
        n += 1
    return n, energy, seen, saturated


@njit
def projection(K, T):
    """K R K⁻¹ and K t of a motion, float32 3×3 and 3: p' ~ K R K⁻¹ (u, v, 1) + d K t."""
    KRKi, Kt = np.empty((3, 3), np.float32), np.empty(3, np.float32)
    fill_projection(K, T, KRKi, Kt)
    return KRKi, Kt


@njit(fastmath=FAST_MATH)
def normal_equations(terms, count, J, wJ):
    """Sums of w J Jᵀ over the first `count` residuals, float64 9×9: xi, ln(gain), offset, and the residual itself.

    terms: see `residuals`. J, wJ: float32 9×256 each, to work in.
    """
    sums = np.zeros((_ROWS, _ROWS))
    one = np.float32(1.0)
    for begin in range(0, count, _BATCH):
        size = min(_BATCH, count - begin)
        for k in range(size):
            p = begin + k
            x, y, z, gx, gy = terms[0, p], terms[1, p], terms[2, p], terms[3, p], terms[4, p]
            J[0, k] = gx * z
            J[1, k] = gy * z
            J[2, k] = -z * (gx * x + gy * y)
            J[3, k] = -gx * x * y - gy * (one + y * y)
            J[4, k] = gx * (one + x * x) + gy * x * y
            J[5, k] = -gx * y + gy * x
            J[6, k] = -terms[5, p]
            J[7, k] = -one
            J[8, k] = terms[6, p]
        for i in range(_ROWS):
            for k in range(size):
                wJ[i, k] = terms[7, begin + k] * J[i, k]
        for i in range(0, _ROWS, _BLOCK):
            for j in range(i, _ROWS, _BLOCK):
                _add_products(wJ[i], wJ[i + 1], wJ[i + 2], J[j], J[j + 1], J[j + 2], size, sums, i, j)
    for i in range(_ROWS):
        for j in range(i):
            sums[i, j] = sums[j, i]
    return sums


@njit(fastmath=FAST_MATH, inline="always")
def _add_products(a0, a1, a2, b0, b1, b2, size, sums, i, j):
    s00 = s01 = s02 = s10 = s11 = s12 = s20 = s21 = s22 = np.float32(0.0)
    for k in range(size):
        s00 += a0[k] * b0[k]
        s01 += a0[k] * b1[k]
        s02 += a0[k] * b2[k]
        s10 += a1[k] * b0[k]
        s11 += a1[k] * b1[k]
        s12 += a1[k] * b2[k]
        s20 += a2[k] * b0[k]
        s21 += a2[k] * b1[k]
        s22 += a2[k] * b2[k]
    sums[i, j] += s00
    sums[i, j + 1] += s01
    sums[i, j + 2] += s02
    sums[i + 1, j] += s10
    sums[i + 1, j + 1] += s11
    sums[i + 1, j + 2] += s12
    sums[i + 2, j] += s20
    sums[i + 2, j + 1] += s21
    sums[i + 2, j + 2] += s22


@njit(error_model="numpy")
def descend(level, points, K, T, log_gain, offset, huber, iterations, small_step, terms):
    """Align one level from a start, T float64 4×4: T, ln(gain), offset, then as `at` from the cost on, and the cutoff.

    small_step: radians, and lengths where the mean inverse depth is about 1; a smaller one is the last.
    Fewer points in view than 20 at the start end it there. terms: see `residuals`.
    """
    J, wJ = np.empty((_ROWS, _BATCH), np.float32), np.empty((_ROWS, _BATCH), np.float32)
    cutoff = CUTOFF
    n, cost, seen, saturated = _cost(level, points, K, T, log_gain, offset, huber, cutoff, terms)
    while saturated > _MAX_SATURATED and cutoff < _MAX_CUTOFF:
        cutoff *= 2.0
        n, cost, seen, saturated = _cost(level, points, K, T, log_gain, offset, huber, cutoff, terms)
    sums = normal_equations(terms, n, J, wJ)
    _hold_offset(sums, seen, offset)
    if seen < LEAST_POINTS:
        return T, log_gain, offset, cost, seen, saturated, sums, cutoff
    damping = _FIRST_DAMPING
    for _ in range(iterations):
        step = _step(sums, damping)
        T_trial = exponential(step[:6]) @ T
        log_gain_trial = min(max(log_gain + step[6], -_MAX_LOG_GAIN), _MAX_LOG_GAIN)
        offset_trial = min(max(offset + step[7], -_MAX_OFFSET), _MAX_OFFSET)
        small = np.abs(step[:6]).max() < small_step
        n, cost_trial, seen_trial, saturated_trial = _cost(
            level, points, K, T_trial, log_gain_trial, offset_trial, huber, cutoff, terms
        )
        if cost_trial < cost and seen_trial > LEAST_POINTS:
            gained = cost - cost_trial
            T, log_gain, offset = T_trial, log_gain_trial, offset_trial
            cost, seen, saturated = cost_trial, seen_trial, saturated_trial
            sums = normal_equations(terms, n, J, wJ)
            _hold_offset(sums, seen, offset)
            damping = max(_LESS_DAMPING * damping, _LEAST_DAMPING)
            if small or gained < _SMALL_GAIN * cost:
                break
        else:
            damping *= _MORE_DAMPING
            if damping > _LARGEST_DAMPING or small:
                break
    return T, log_gain, offset, cost, seen, saturated, sums, cutoff


@njit(error_model="numpy")
def at(level, points, K, T, log_gain, offset, huber, terms):
    """Cost (mean energy), points in view, share of them above the usual cutoff, and sums 9×9, of a given alignment."""
    J, wJ = np.empty((_ROWS, _BATCH), np.float32), np.empty((_ROWS, _BATCH), np.float32)
    n, cost, seen, saturated = _cost(level, points, K, T, log_gain, offset, huber, CUTOFF, terms)
    sums = normal_equations(terms, n, J, wJ)
    _hold_offset(sums, seen, offset)
    return cost, seen, saturated, sums


@njit(error_model="numpy")
def _cost(level, points, K, T, log_gain, offset, huber, cutoff, terms):
    """Number of rows in `terms`, mean energy with the prior of the offset, points in view, share above the cutoff."""
    n, energy, seen, saturated = residuals(level, points, K, T, log_gain, offset, huber, np.float32(cutoff), terms)
    count = max(seen, 1)
    return n, (energy + seen / _OFFSET_STD**2 * offset**2) / count, seen, saturated / count


@njit
def _hold_offset(sums, seen, offset):
    """Add the prior of the offset, as strong as all residuals together."""
    information = seen / _OFFSET_STD**2
    sums[7, 7] += information
    sums[7, 8] += information * offset
    sums[8, 7] += information * offset


@njit
def _step(sums, damping):
    H = np.ascontiguousarray(sums[:VARIABLES, :VARIABLES])
    for i in range(VARIABLES):
        H[i, i] += damping * H[i, i] + _REGULARIZATION
    return np.linalg.solve(H, -sums[:VARIABLES, VARIABLES])
