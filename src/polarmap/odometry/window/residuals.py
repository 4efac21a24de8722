"""Photometric residuals between keyframes, and the normal equations that they make (DSO, sections 2.2 and 2.3).

A point p of host keyframe h with inverse depth d is compared in target keyframe t over the pattern's pixels:

    r = I_t[p'] - b_t - A (I_h[p] - b_h),     A = (t_t / t_h) exp(a_t - a_h)

Its derivatives are taken with respect to

    relative variables of a pair (h, t):  calibration (fx, fy, cx, cy), xi of T_t_h (6), alpha = a_t - a_h, beta
    absolute variables:                   calibration, then for every keyframe slot xi of T_camera_world (6), a, b

and mapped from the former to the latter by `host_map`; that of the target is the identity. Geometric derivatives are
those of the pattern's centre at the first estimate.

Kernels run on one thread, beside those of whoever maps: they are called by the thread that adjusts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.jit import FAST_MATH, njit
from polarmap.odometry.pattern import PATTERN_RADIUS, PATTERN_SIZE
from polarmap.odometry.window.sampling import project_pattern, sample_pattern

CALIBRATION = 4  # variables
FRAME = 8  # variables of a keyframe
_RELATIVE = CALIBRATION + FRAME
_GEOMETRIC = CALIBRATION + 6  # variables of a pair that move pixels
_PADDED = 16  # numbers in a row of a pair's block of 13, as whole vector registers
_SUMS = 14  # of a residual, see `_compare`
_BATCH = 8  # points whose depths are eliminated at once, see `_eliminate`
_MARGIN = np.float32(PATTERN_RADIUS + 1)

NONE, GOOD, OUTLIER, OUTSIDE = np.uint8(0), np.uint8(1), np.uint8(2), np.uint8(3)  # states of a residual


@dataclass(frozen=True, eq=False)
class Pairs:
    """What projection needs of every pair (host, target) of S keyframe slots.

    KRKi float32 S×S×3×3, Kt float32 S×S×3: p' ~ KRKi (u, v, 1) + d Kt. gain, offset float32 S×S: I_t is expected
    to be gain I_h + offset. All at the present state.
    R0 float32 S×S×3×3, t0 float32 S×S×3: T_t_h at the first estimate. gain0 float32 S×S, b0 float32 S there.
    host_map float64 S×S×8×8: how the pair's relative variables change with the host's absolute ones.
    calibration float32 4: fx, fy, cx, cy.
    """

    KRKi: np.ndarray
    Kt: np.ndarray
    gain: np.ndarray
    offset: np.ndarray
    R0: np.ndarray
    t0: np.ndarray
    gain0: np.ndarray
    b0: np.ndarray
    host_map: np.ndarray
    calibration: np.ndarray


@dataclass(frozen=True, eq=False)
class Residuals:
    """All residuals of N points in S keyframe slots, as the present state gives them.

    energy: the robust cost. state uint8 N×S, energies float32 N×S: of each residual.
    sums float32 N×S×14: weighted products of the pixels' derivatives, see `_compare`; where the state is GOOD.
    """

    energy: float
    state: np.ndarray
    energies: np.ndarray
    sums: np.ndarray


@dataclass(frozen=True, eq=False)
class Linearization:
    """Normal equations H x = -b of N points over D = 4 + 8 S variables, inverse depths eliminated.

    energy, state, energies: those of `Residuals`. H float64 D×D, b float64 D: of the other variables alone.
    H_schur, b_schur: what eliminating the inverse depths subtracts from them.
    coupling float32 N×D, depth_hessian float32 N, depth_gradient float32 N: for the inverse depths' step,
        -(depth_gradient + coupling · x) / depth_hessian.
    """

    energy: float
    H: np.ndarray
    b: np.ndarray
    H_schur: np.ndarray
    b_schur: np.ndarray
    coupling: np.ndarray
    depth_hessian: np.ndarray
    depth_gradient: np.ndarray
    state: np.ndarray
    energies: np.ndarray


def evaluate(images, points, pairs: Pairs, thresholds, huber: float, gradient_constant: float) -> Residuals:
    """All residuals of `points` (see `points.ActivePoints`); those that were OUTSIDE once stay so.

    images: float32 S×H×W×3, intensity and gradients by slot. thresholds: float32 S, energy over which a residual
    that concerns this keyframe is an outlier.
    """
    count, slots = points.state.shape
    state = points.state.copy()
    energies = np.zeros((count, slots), np.float32)
    sums = np.empty((count, slots, _SUMS), np.float32)
    _evaluate(
        images, points.host, points.pixel, points.inverse_depth, points.color, points.weight,
        pairs.KRKi, pairs.Kt, pairs.gain, pairs.offset, pairs.gain0, pairs.b0, thresholds,
        np.float32(huber), np.float32(gradient_constant**2), state, energies, sums,
    )  # fmt: skip
    return Residuals(float(energies.sum(dtype=np.float64)), state, energies, sums)


def assemble(points, pairs: Pairs, residuals: Residuals, calibrated: bool = True) -> Linearization:
    """The normal equations of residuals that `evaluate` gave for these points and pairs.

    calibrated: whether they are wanted by fx, fy, cx and cy too; zero otherwise.
    """
    count, slots = residuals.state.shape
    size = CALIBRATION + FRAME * slots
    blocks = np.zeros((slots, slots, _RELATIVE + 1, _PADDED))
    schur = np.zeros((size + 1, size))
    coupling = np.zeros((count, size), np.float32)
    depth_system = np.zeros((count, 2), np.float32)
    _assemble(
        points.host, points.pixel, points.inverse_depth, pairs.R0, pairs.t0, pairs.host_map, pairs.calibration,
        residuals.state, residuals.sums, 0 if calibrated else CALIBRATION, blocks, schur, coupling, depth_system,
    )  # fmt: skip
    H, b = _stitch(blocks, pairs.host_map)
    return Linearization(
        energy=residuals.energy,
        H=H,
        b=b,
        H_schur=_mirrored(schur[:-1]),
        b_schur=schur[-1],
        coupling=coupling,
        depth_hessian=depth_system[:, 0],
        depth_gradient=depth_system[:, 1],
        state=residuals.state,
        energies=residuals.energies,
    )


def linearize(images, points, pairs: Pairs, thresholds, huber: float, gradient_constant: float) -> Linearization:
    """`evaluate`, then `assemble`."""
    return assemble(points, pairs, evaluate(images, points, pairs, thresholds, huber, gradient_constant))


def depth_information(points, pairs: Pairs, residuals: Residuals) -> np.ndarray:
    """`Linearization.depth_hessian` alone, float32 N."""
    return _depth_information(
        points.host, points.pixel, points.inverse_depth, pairs.R0, pairs.t0, pairs.calibration,
        residuals.state, residuals.sums,
    )  # fmt: skip


def _mirrored(upper: np.ndarray) -> np.ndarray:
    """The symmetric matrix of which the upper triangle is given."""
    return np.triu(upper) + np.triu(upper, 1).T


@njit(error_model="numpy", fastmath=FAST_MATH)
def _evaluate(
    images, host, pixel, inverse_depth, color, weight, KRKi, Kt, gain, offset, gain0, b0, thresholds, huber, c2,
    state, energies, sums,
):  # fmt: skip
    count, slots = state.shape
    height, width = images.shape[1:3]
    flat = images.reshape(-1)
    row = np.uint64(3 * width)
    u, v = np.empty(PATTERN_SIZE, np.float32), np.empty(PATTERN_SIZE, np.float32)
    inverse_z = np.empty(PATTERN_SIZE, np.float32)
    values = np.empty((3, PATTERN_SIZE), np.float32)
    for p in range(count):
        h = np.int64(host[p])
        for t in range(slots):
            if state[p, t] == NONE or state[p, t] == OUTSIDE:
                continue
            if not project_pattern(
                pixel[p], inverse_depth[p], KRKi[h, t], Kt[h, t], height, width, _MARGIN, u, v, inverse_z
            ):
                state[p, t] = OUTSIDE
                continue
            sample_pattern(flat, np.uint64(t) * np.uint64(height) * row, row, u, v, values)
            energy = _compare(
                values, color[p], weight[p], gain[h, t], offset[h, t], gain0[h, t], b0[h], huber, c2, sums[p, t]
            )
            threshold = max(thresholds[h], thresholds[t])
            state[p, t] = OUTLIER if energy > threshold else GOOD
            energies[p, t] = min(energy, threshold)


@njit(error_model="numpy", fastmath=FAST_MATH, inline="always")
def _compare(values, color, weight, gain, offset, gain0, b0, huber, c2, sums):
    """Energy of one residual; `sums` of the weighted products of its derivatives.

    sums: gx gx, gx gy, gy gy, | gx ja, gy ja, gx jb, gy jb, | ja ja, ja jb, jb jb, | gx r, gy r, ja r, jb r
    """
    half, two = np.float32(0.5), np.float32(2.0)
    energy = xx = xy = yy = xa = ya = x1 = y1 = aa = a1 = ww = xr = yr = ar = wr = np.float32(0.0)
    for k in range(PATTERN_SIZE):
        gx, gy = values[1, k], values[2, k]
        r = values[0, k] - gain * color[k] - offset
        w = half * (np.sqrt(c2 / (c2 + gx * gx + gy * gy)) + weight[k])
        robust = huber / max(abs(r), huber)
        w = w * w * robust
        energy += w * r * r * (two - robust)
        ja = -gain0 * (color[k] - b0)
        wx, wy, wa = w * gx, w * gy, w * ja
        xx += wx * gx
        xy += wx * gy
        yy += wy * gy
        xa += wx * ja
        ya += wy * ja
        x1 += wx
        y1 += wy
        aa += wa * ja
        a1 += wa
        ww += w
        xr += wx * r
        yr += wy * r
        ar += wa * r
        wr += w * r
    sums[0], sums[1], sums[2] = xx, xy, yy
    sums[3], sums[4], sums[5], sums[6] = xa, ya, -x1, -y1
    sums[7], sums[8], sums[9] = aa, -a1, ww
    sums[10], sums[11], sums[12], sums[13] = xr, yr, ar, -wr
    return energy


@njit(error_model="numpy", fastmath=FAST_MATH)
def _assemble(
    host, pixel, inverse_depth, R0, t0, host_map, calibration, state, sums, first, blocks, schur, coupling,
    depth_system,
):  # fmt: skip
    count, slots = state.shape
    size = CALIBRATION + FRAME * slots
    J, J_depth = np.zeros((2, _PADDED), np.float32), np.zeros(2, np.float32)
    products = np.zeros((2, _PADDED), np.float32)
    rows, inverse_hessians = np.zeros((_BATCH, size + 1)), np.zeros(_BATCH)
    filled = 0
    for p in range(count):
        h = np.int64(host[p])
        row = rows[filled]
        row[:] = 0.0
        hessian, gradient = 0.0, 0.0
        for t in range(slots):
            if state[p, t] != GOOD:
                continue
            _differentiate(pixel[p], inverse_depth[p], R0[h, t], t0[h, t], calibration, J, J_depth)
            _multiply(J, sums[p, t], products)
            _add_block(blocks[h, t], J, products, sums[p, t], first)
            hessian_part, gradient_part = _couple(J_depth, products, sums[p, t], host_map[h, t], h, t, first, row)
            hessian += hessian_part
            gradient += gradient_part
        depth_system[p, 0] = hessian
        depth_system[p, 1] = gradient
        if hessian > 0.0:
            for i in range(size):
                coupling[p, i] = row[i]
            row[size] = gradient
            inverse_hessians[filled] = 1.0 / hessian
            filled += 1
            if filled == _BATCH:
                _eliminate(schur, rows, inverse_hessians, first)
                filled = 0
    inverse_hessians[filled:] = 0.0
    _eliminate(schur, rows, inverse_hessians, first)


@njit(error_model="numpy", fastmath=FAST_MATH)
def _depth_information(host, pixel, inverse_depth, R0, t0, calibration, state, sums):
    count, slots = state.shape
    found = np.zeros(count, np.float32)
    J, J_depth = np.zeros((2, _PADDED), np.float32), np.zeros(2, np.float32)
    for p in range(count):
        h = np.int64(host[p])
        hessian = 0.0
        for t in range(slots):
            if state[p, t] == GOOD:
                _differentiate(pixel[p], inverse_depth[p], R0[h, t], t0[h, t], calibration, J, J_depth)
                hessian += _depth_hessian(J_depth, sums[p, t])
        found[p] = hessian
    return found


@njit(error_model="numpy", fastmath=FAST_MATH)
def _differentiate(pixel, d, R0, t0, calibration, J, J_depth):
    """Derivatives of the projected pixel: J, 2×10, by calibration and xi; J_depth, 2, by inverse depth."""
    fx, fy, cx, cy = calibration[0], calibration[1], calibration[2], calibration[3]
    one = np.float32(1.0)
    xh, yh = (pixel[0] - cx) / fx, (pixel[1] - cy) / fy
    iz = one / (R0[2, 0] * xh + R0[2, 1] * yh + R0[2, 2] + d * t0[2])
    x = (R0[0, 0] * xh + R0[0, 1] * yh + R0[0, 2] + d * t0[0]) * iz
    y = (R0[1, 0] * xh + R0[1, 1] * yh + R0[1, 2] + d * t0[1]) * iz
    dt = d * iz
    J_depth[0] = fx * iz * (t0[0] - t0[2] * x)
    J_depth[1] = fy * iz * (t0[1] - t0[2] * y)
    xx, xy = iz * (R0[0, 0] - R0[2, 0] * x), iz * (R0[0, 1] - R0[2, 1] * x)
    yx, yy = iz * (R0[1, 0] - R0[2, 0] * y), iz * (R0[1, 1] - R0[2, 1] * y)
    J[0, 0] = x - xx * xh
    J[0, 1] = -fx / fy * xy * yh
    J[0, 2] = one - xx
    J[0, 3] = -fx / fy * xy
    J[1, 0] = -fy / fx * yx * xh
    J[1, 1] = y - yy * yh
    J[1, 2] = -fy / fx * yx
    J[1, 3] = one - yy
    J[0, 4] = fx * dt
    J[0, 5] = 0.0
    J[0, 6] = -fx * x * dt
    J[0, 7] = -fx * x * y
    J[0, 8] = fx * (one + x * x)
    J[0, 9] = -fx * y
    J[1, 4] = 0.0
    J[1, 5] = fy * dt
    J[1, 6] = -fy * y * dt
    J[1, 7] = -fy * (one + y * y)
    J[1, 8] = fy * x * y
    J[1, 9] = fy * x


@njit(error_model="numpy", fastmath=FAST_MATH)
def _multiply(J, s, products):
    """What the two rows of the projected pixel's derivatives are multiplied with: all columns of the pair's block."""
    for k in range(_GEOMETRIC):
        products[0, k] = s[0] * J[0, k] + s[1] * J[1, k]
        products[1, k] = s[1] * J[0, k] + s[2] * J[1, k]
    products[0, _GEOMETRIC], products[1, _GEOMETRIC] = s[3], s[4]
    products[0, _GEOMETRIC + 1], products[1, _GEOMETRIC + 1] = s[5], s[6]
    products[0, _RELATIVE], products[1, _RELATIVE] = s[10], s[11]


@njit(error_model="numpy", fastmath=FAST_MATH)
def _add_block(block, J, products, s, first):
    """The pair's 13×13 block: calibration, xi, alpha, beta, residual; its upper triangle at least, from a row on."""
    for i in range(first, _GEOMETRIC):
        x, y = J[0, i], J[1, i]
        for k in range(_PADDED):
            block[i, k] += x * products[0, k] + y * products[1, k]
    block[_GEOMETRIC, _GEOMETRIC] += s[7]
    block[_GEOMETRIC, _GEOMETRIC + 1] += s[8]
    block[_GEOMETRIC + 1, _GEOMETRIC + 1] += s[9]
    block[_GEOMETRIC, _RELATIVE] += s[12]
    block[_GEOMETRIC + 1, _RELATIVE] += s[13]


@njit(error_model="numpy", fastmath=FAST_MATH)
def _couple(J_depth, products, s, host_map, h, t, first, row):
    """Adds to `row` the second derivatives by inverse depth and all others; returns that by depth alone, and the first.

    Those by the relative variables go to the target's as they are, to the host's through `host_map`.
    """
    target, host = CALIBRATION + FRAME * t, CALIBRATION + FRAME * h
    x, y = J_depth[0], J_depth[1]
    for i in range(first, CALIBRATION):
        row[i] += x * products[0, i] + y * products[1, i]
    for k in range(FRAME):
        relative = x * products[0, CALIBRATION + k] + y * products[1, CALIBRATION + k]
        row[target + k] += relative
        for i in range(FRAME):
            row[host + i] += relative * host_map[k, i]
    return _depth_hessian(J_depth, s), s[10] * x + s[11] * y


@njit(error_model="numpy", fastmath=FAST_MATH)
def _depth_hessian(J_depth, s):
    x, y = J_depth[0], J_depth[1]
    return x * (s[0] * x + s[1] * y) + y * (s[1] * x + s[2] * y)


@njit(error_model="numpy", fastmath=FAST_MATH)
def _eliminate(schur, rows, factors, first):
    """Adds factor · row rowᵀ of eight points at once to the upper triangle; the last of a row is the gradient.

    Eight, since each sum then is loaded and stored once for as many products.
    """
    size = schur.shape[1]
    r0, r1, r2, r3, r4, r5, r6, r7 = rows[0], rows[1], rows[2], rows[3], rows[4], rows[5], rows[6], rows[7]
    for i in range(first, size + 1):
        f0, f1, f2, f3 = factors[0] * r0[i], factors[1] * r1[i], factors[2] * r2[i], factors[3] * r3[i]
        f4, f5, f6, f7 = factors[4] * r4[i], factors[5] * r5[i], factors[6] * r6[i], factors[7] * r7[i]
        for k in range(i if i < size else first, size):
            first_half = f0 * r0[k] + f1 * r1[k] + f2 * r2[k] + f3 * r3[k]
            schur[i, k] += first_half + f4 * r4[k] + f5 * r5[k] + f6 * r6[k] + f7 * r7[k]


@njit
def _stitch(blocks, host_map):
    """H and b over the absolute variables from the pairs' blocks over the relative ones."""
    slots = blocks.shape[0]
    size = CALIBRATION + FRAME * slots
    H, b = np.zeros((size, size)), np.zeros(size)
    C, E = CALIBRATION, CALIBRATION + FRAME
    for h in range(slots):
        for t in range(slots):
            block = blocks[h, t]
            if block[E - 1, E - 1] == 0.0:  # the sum of the weights: no residual
                continue
            D = host_map[h, t]
            for i in range(E):
                for k in range(i):
                    block[i, k] = block[k, i]
            Q = np.ascontiguousarray(block[C:E, C:E])
            mixed = np.ascontiguousarray(block[:C, C:E])
            r = np.ascontiguousarray(block[C:E, E])
            th, tt = C + FRAME * h, C + FRAME * t
            DQ = D.T @ Q
            H[th : th + FRAME, th : th + FRAME] += DQ @ D
            H[tt : tt + FRAME, tt : tt + FRAME] += Q
            H[th : th + FRAME, tt : tt + FRAME] += DQ
            H[tt : tt + FRAME, th : th + FRAME] += DQ.T
            H[:C, :C] += block[:C, :C]
            H[:C, tt : tt + FRAME] += mixed
            H[tt : tt + FRAME, :C] += mixed.T
            host_part = mixed @ D
            H[:C, th : th + FRAME] += host_part
            H[th : th + FRAME, :C] += host_part.T
            b[:C] += block[:C, E]
            b[tt : tt + FRAME] += r
            b[th : th + FRAME] += D.T @ r
    return H, b
