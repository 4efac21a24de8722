"""Photometric residuals between keyframes, and the normal equations that they make (DSO, sections 2.2 and 2.3).

A point p of host keyframe h with inverse depth d is compared in target keyframe t over the pattern's pixels:

    r = I_t[p'] - b_t - A (I_h[p] - b_h),     A = (t_t / t_h) exp(a_t - a_h)

Its derivatives are taken with respect to

    relative variables of a pair (h, t):  calibration (fx, fy, cx, cy), xi of T_t_h (6), alpha = a_t - a_h, beta
    absolute variables:                   calibration, then for every keyframe slot xi of T_camera_world (6), a, b

and mapped from the former to the latter by `host_map`; that of the target is the identity. Geometric derivatives are
those of the pattern's centre at the first estimate.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.jit import njit
from polarmap.odometry.pattern import PATTERN, PATTERN_RADIUS, PATTERN_SIZE
from polarmap.odometry.pyramid import sample

CALIBRATION = 4  # variables
FRAME = 8  # variables of a keyframe
_RELATIVE = CALIBRATION + FRAME
_CHUNKS = 8  # of the points; fixed, so that sums do not depend on the number of threads
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
class Linearization:
    """Normal equations H x = -b of N points over D = 4 + 8 S variables, inverse depths eliminated.

    energy: the robust cost. H float64 D×D, b float64 D: of the other variables alone.
    H_schur, b_schur: what eliminating the inverse depths subtracts from them.
    coupling float32 N×D, depth_hessian float32 N, depth_gradient float32 N: for the inverse depths' step,
        -(depth_gradient + coupling · x) / depth_hessian.
    state uint8 N×S, energies float32 N×S: of each residual.
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


def linearize(images, points, pairs: Pairs, thresholds, huber: float, gradient_constant: float) -> Linearization:
    """Evaluate all residuals of `points` (see `points.ActivePoints`) and sum up their normal equations.

    images: float32 S×H×W×3, intensity and gradients by slot. thresholds: float32 S, energy over which a residual
    that concerns this keyframe is an outlier.
    """
    count, slots = points.state.shape
    size = CALIBRATION + FRAME * slots
    blocks = np.zeros((_CHUNKS, slots, slots, _RELATIVE + 1, _RELATIVE + 1))
    schur = np.zeros((_CHUNKS, size + 1, size))
    coupling = np.zeros((count, size), np.float32)
    depth_system = np.zeros((count, 2), np.float32)
    state = points.state.copy()
    energies = np.zeros((count, slots), np.float32)
    _linearize(
        images, points.host, points.pixel, points.inverse_depth, points.color, points.weight,
        pairs.KRKi, pairs.Kt, pairs.gain, pairs.offset, pairs.R0, pairs.t0, pairs.gain0, pairs.b0,
        pairs.host_map, pairs.calibration, thresholds, np.float32(huber), np.float32(gradient_constant**2),
        state, energies, blocks, schur, coupling, depth_system,
    )  # fmt: skip
    H, b = _stitch(blocks.sum(axis=0), pairs.host_map)
    total = schur.sum(axis=0)
    return Linearization(
        energy=float(energies.sum(dtype=np.float64)),
        H=H,
        b=b,
        H_schur=_mirrored(total[:-1]),
        b_schur=total[-1],
        coupling=coupling,
        depth_hessian=depth_system[:, 0],
        depth_gradient=depth_system[:, 1],
        state=state,
        energies=energies,
    )


def _mirrored(upper: np.ndarray) -> np.ndarray:
    """The symmetric matrix of which the upper triangle is given."""
    return np.triu(upper) + np.triu(upper, 1).T


@njit(parallel=True, error_model="numpy")
def _linearize(
    images, host, pixel, inverse_depth, color, weight, KRKi, Kt, gain, offset, R0, t0, gain0, b0, host_map,
    calibration, thresholds, huber, c2, state, energies, blocks, schur, coupling, depth_system,
):  # fmt: skip
    count, slots = state.shape
    for chunk_index in prange(_CHUNKS):
        chunk = np.int64(chunk_index)
        J = np.zeros((2, CALIBRATION + 6), np.float32)
        J_depth = np.zeros(2, np.float32)
        sums = np.zeros(16, np.float32)
        relative = np.zeros(_RELATIVE)
        row = np.zeros(CALIBRATION + FRAME * slots)
        for p in range(chunk * count // _CHUNKS, (chunk + 1) * count // _CHUNKS):
            h = np.int64(host[p])
            row[:] = 0.0
            hessian, gradient = 0.0, 0.0
            for t in range(slots):
                if state[p, t] == NONE or state[p, t] == OUTSIDE:
                    continue
                threshold = max(thresholds[h], thresholds[t])
                state[p, t], energies[p, t] = _compare(
                    images, t, pixel, inverse_depth[p], color, weight, p, KRKi, Kt, gain[h, t], offset[h, t], h,
                    gain0[h, t], b0[h], huber, c2, threshold, sums,
                )  # fmt: skip
                if state[p, t] != GOOD:
                    continue
                _differentiate(pixel, p, inverse_depth[p], R0, t0, h, t, calibration, J, J_depth)
                _add_block(blocks, chunk, h, t, J, sums)
                hessian_part, gradient_part = _couple(J, J_depth, sums, relative)
                hessian += hessian_part
                gradient += gradient_part
                for i in range(CALIBRATION):
                    row[i] += relative[i]
                at_target, at_host = CALIBRATION + FRAME * t, CALIBRATION + FRAME * h
                for i in range(FRAME):
                    row[at_target + i] += relative[CALIBRATION + i]
                    value = 0.0
                    for k in range(FRAME):
                        value += host_map[h, t, k, i] * relative[CALIBRATION + k]
                    row[at_host + i] += value
            depth_system[p, 0] = hessian
            depth_system[p, 1] = gradient
            if hessian > 0.0:
                coupling[p] = row
                _eliminate(schur, chunk, row, gradient, 1.0 / hessian)


@njit(error_model="numpy")
def _compare(
    images, t, pixel, d, color, weight, p, KRKi, Kt, gain, offset, h, gain0, b0, huber, c2, threshold, sums
):  # fmt: skip
    """State and energy of one residual; `sums` of the weighted products of its derivatives.

    sums: gx gx, gx gy, gy gy, | gx ja, gy ja, gx jb, gy jb, | ja ja, ja jb, jb jb, | gx r, gy r, ja r, jb r
    """
    one = np.float32(1.0)
    height, width = images.shape[1:3]
    sums[:] = 0.0
    energy = np.float32(0.0)
    for k in range(PATTERN_SIZE):
        u, v = pixel[p, 0] + PATTERN[k, 0], pixel[p, 1] + PATTERN[k, 1]
        z = KRKi[h, t, 2, 0] * u + KRKi[h, t, 2, 1] * v + KRKi[h, t, 2, 2] + d * Kt[h, t, 2]
        iz = one / z
        pu = (KRKi[h, t, 0, 0] * u + KRKi[h, t, 0, 1] * v + KRKi[h, t, 0, 2] + d * Kt[h, t, 0]) * iz
        pv = (KRKi[h, t, 1, 0] * u + KRKi[h, t, 1, 1] * v + KRKi[h, t, 1, 2] + d * Kt[h, t, 1]) * iz
        if not (z > 0 and _MARGIN <= pu < width - _MARGIN and _MARGIN <= pv < height - _MARGIN):
            return OUTSIDE, np.float32(0.0)
        value, gx, gy = sample(images, t, pu, pv)
        r = value - gain * color[p, k] - offset
        w = np.float32(0.5) * (np.sqrt(c2 / (c2 + gx * gx + gy * gy)) + weight[p, k])
        size = abs(r)
        robust = one if size <= huber else huber / size
        w = w * w * robust
        energy += w * r * r * (np.float32(2.0) - robust)
        ja = -gain0 * (color[p, k] - b0)
        wx, wy, wa = w * gx, w * gy, w * ja
        sums[0] += wx * gx
        sums[1] += wx * gy
        sums[2] += wy * gy
        sums[3] += wx * ja
        sums[4] += wy * ja
        sums[5] -= wx
        sums[6] -= wy
        sums[7] += wa * ja
        sums[8] -= wa
        sums[9] += w
        sums[10] += wx * r
        sums[11] += wy * r
        sums[12] += wa * r
        sums[13] -= w * r
    if energy > threshold:
        return OUTLIER, threshold
    return GOOD, energy


@njit(error_model="numpy")
def _differentiate(pixel, p, d, R0, t0, h, t, calibration, J, J_depth):
    """Derivatives of the projected pixel: J, 2×10, by calibration and xi; J_depth, 2, by inverse depth."""
    fx, fy, cx, cy = calibration[0], calibration[1], calibration[2], calibration[3]
    one = np.float32(1.0)
    xh, yh = (pixel[p, 0] - cx) / fx, (pixel[p, 1] - cy) / fy
    iz = one / (R0[h, t, 2, 0] * xh + R0[h, t, 2, 1] * yh + R0[h, t, 2, 2] + d * t0[h, t, 2])
    x = (R0[h, t, 0, 0] * xh + R0[h, t, 0, 1] * yh + R0[h, t, 0, 2] + d * t0[h, t, 0]) * iz
    y = (R0[h, t, 1, 0] * xh + R0[h, t, 1, 1] * yh + R0[h, t, 1, 2] + d * t0[h, t, 1]) * iz
    dt = d * iz
    J_depth[0] = fx * iz * (t0[h, t, 0] - t0[h, t, 2] * x)
    J_depth[1] = fy * iz * (t0[h, t, 1] - t0[h, t, 2] * y)
    xx, xy = iz * (R0[h, t, 0, 0] - R0[h, t, 2, 0] * x), iz * (R0[h, t, 0, 1] - R0[h, t, 2, 1] * x)
    yx, yy = iz * (R0[h, t, 1, 0] - R0[h, t, 2, 0] * y), iz * (R0[h, t, 1, 1] - R0[h, t, 2, 1] * y)
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


@njit(error_model="numpy")
def _add_block(blocks, chunk, h, t, J, s):
    """Upper triangle of the pair's 13×13 block: calibration, xi, alpha, beta, residual."""
    geometric = CALIBRATION + 6
    for i in range(geometric):
        u = s[0] * J[0, i] + s[1] * J[1, i]
        v = s[1] * J[0, i] + s[2] * J[1, i]
        for k in range(i, geometric):
            blocks[chunk, h, t, i, k] += u * J[0, k] + v * J[1, k]
        blocks[chunk, h, t, i, geometric] += s[3] * J[0, i] + s[4] * J[1, i]
        blocks[chunk, h, t, i, geometric + 1] += s[5] * J[0, i] + s[6] * J[1, i]
        blocks[chunk, h, t, i, geometric + 2] += s[10] * J[0, i] + s[11] * J[1, i]
    blocks[chunk, h, t, geometric, geometric] += s[7]
    blocks[chunk, h, t, geometric, geometric + 1] += s[8]
    blocks[chunk, h, t, geometric + 1, geometric + 1] += s[9]
    blocks[chunk, h, t, geometric, geometric + 2] += s[12]
    blocks[chunk, h, t, geometric + 1, geometric + 2] += s[13]


@njit(error_model="numpy")
def _couple(J, J_depth, s, relative):
    """Second derivatives by inverse depth and the relative variables; returns that by depth alone, and the gradient."""
    u = s[0] * J_depth[0] + s[1] * J_depth[1]
    v = s[1] * J_depth[0] + s[2] * J_depth[1]
    geometric = CALIBRATION + 6
    for i in range(geometric):
        relative[i] = u * J[0, i] + v * J[1, i]
    relative[geometric] = s[3] * J_depth[0] + s[4] * J_depth[1]
    relative[geometric + 1] = s[5] * J_depth[0] + s[6] * J_depth[1]
    return u * J_depth[0] + v * J_depth[1], s[10] * J_depth[0] + s[11] * J_depth[1]


@njit(error_model="numpy")
def _eliminate(schur, chunk, row, gradient, inverse_hessian):
    size = row.shape[0]
    for i in range(size):
        if row[i] != 0.0:
            factor = row[i] * inverse_hessian
            for k in range(i, size):
                schur[chunk, i, k] += factor * row[k]
    factor = gradient * inverse_hessian
    for k in range(size):
        schur[chunk, size, k] += factor * row[k]


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
