"""Immature points: their inverse depth, searched along epipolar lines frame by frame (DSO, section 3.2).

DSO's paper names no numbers for the search. Those below are set by hand, for the reasons beside them.
"""

from __future__ import annotations

import numpy as np

from polarmap.jit import FAST_MATH, njit
from polarmap.odometry.pattern import OUTLIER_ENERGY, PATTERN, PATTERN_RADIUS, PATTERN_SIZE
from polarmap.odometry.points import ImmaturePoints
from polarmap.odometry.window.residuals import GOOD, NONE
from polarmap.odometry.window.sampling import pattern_intensity, project_pattern, sample_pattern
from polarmap.odometry.window.window import Projection

UNSEEN, FOUND, SETTLED, UNCLEAR, MISMATCH, GONE = (np.uint8(i) for i in range(6))  # status of a point
_MARGIN = np.float32(PATTERN_RADIUS + 2)

# Where the line is, and whether to search it. z is that in the frame over that in the host.
_LEAST_Z = np.float32(0.05)  # nearer points are beside the camera, where their pixel means little
_LEAST_SCALE, _LARGEST_SCALE = np.float32(0.7), np.float32(1.45)  # of z, where the pattern keeps about its size
_DIRECTION_STEP = np.float32(0.01)  # of inverse depth, to a second point of an open line; small, so that z is positive
_LEAST_LINE = np.float32(1e-6)  # pixels; a shorter line has no direction: the camera has only turned
_NARROW = np.float32(1.5)  # pixels; an interval this short is not searched
_STEPS = 100  # pixels that are searched at most, which bounds the memory

# How far a match may be off along the line, pixels: at least the first, and the second times |∇I|² / |∇I along it|², by
# which an error across the line moves it (the geometric error of Engel, Sturm and Cremers, ICCV 2013).
_MATCH_ERROR = np.float32(0.2)
_LINE_ERROR = np.float32(0.2)
_LARGEST_ERROR = np.float32(10.0)  # an interval of twice this is most of the longest search already
_LEAST_STRUCTURE = np.float32(1e-6)  # squared grey values; far below any image's noise, against division by zero

# Whether the best match is distinct.
_NO_MATCH = np.float32(1e10)  # squared grey values, above any pattern's energy
_LEAST_ENERGY = np.float32(1e-3)  # squared grey values; far below any image's noise, against division by zero
_RIVAL_DISTANCE = 2  # pixels; a second minimum nearer than this is the same one
_LONG = 10  # pixels; a longer search judges anew how distinct a point is, a shorter one sees fewer rivals

# Its place to a fraction of a pixel.
_REFINEMENTS = 3
_LEAST_CURVATURE = np.float32(1e-3)  # squared grey values per pixel², below which the energy is flat
_SMALL_STEP = np.float32(0.02)  # pixels; a tenth of _MATCH_ERROR

# Levenberg-Marquardt over an inverse depth, before a point becomes active.
_DEPTH_STEPS = 4
_FIRST_DAMPING = np.float32(0.1)
_LESS_DAMPING, _MORE_DAMPING = np.float32(0.5), np.float32(5.0)  # factors after a step that is taken, and is not
_SMALL_CHANGE = np.float32(1e-4)  # of the inverse depth, as a share of it
_LEAST_INFORMATION = np.float32(100.0)  # squared grey values: with noise of 10, an inverse depth known to 1, its mean


def trace(immature: ImmaturePoints, level: np.ndarray, projection: Projection, huber: float, max_length: float) -> None:
    """Search every point in a frame and narrow its interval, in place.

    level: float32 H×W×3, the frame's level 0. projection: from all keyframes into it. max_length: pixels.
    """
    _trace(
        level.reshape(1, *level.shape), immature.host, immature.pixel, immature.color, immature.structure,
        immature.lowest, immature.highest, immature.quality, immature.length, immature.status,
        projection.KRKi, projection.Kt, projection.gain, projection.offset, np.float32(huber), np.float32(max_length),
    )  # fmt: skip


@njit(error_model="numpy")
def _trace(
    images, host, pixel, color, structure, lowest, highest, quality, length, status, KRKi, Kt, gain, offset, huber,
    max_length,
):  # fmt: skip
    du, dv = np.zeros(PATTERN_SIZE, np.float32), np.zeros(PATTERN_SIZE, np.float32)
    energies = np.zeros(_STEPS, np.float32)
    u8, v8 = np.zeros(PATTERN_SIZE, np.float32), np.zeros(PATTERN_SIZE, np.float32)
    values = np.zeros((3, PATTERN_SIZE), np.float32)
    for p in range(len(host)):
        if status[p] != GONE:
            _search(
                images, np.int64(host[p]), p, pixel, color, structure, lowest, highest, quality, length, status,
                KRKi, Kt, gain, offset, huber, max_length, du, dv, energies, u8, v8, values,
            )  # fmt: skip


@njit(error_model="numpy")
def _search(
    images, h, p, pixel, color, structure, lowest, highest, quality, length, status, KRKi, Kt, gain, offset, huber,
    max_length, du, dv, energies, u8, v8, values,
):  # fmt: skip
    flat, row = images.reshape(-1), np.uint64(3 * images.shape[2])
    height, width = np.float32(images.shape[1]), np.float32(images.shape[2])
    u, v = pixel[p, 0], pixel[p, 1]
    rx = KRKi[h, 0, 0] * u + KRKi[h, 0, 1] * v + KRKi[h, 0, 2]
    ry = KRKi[h, 1, 0] * u + KRKi[h, 1, 1] * v + KRKi[h, 1, 2]
    rz = KRKi[h, 2, 0] * u + KRKi[h, 2, 1] * v + KRKi[h, 2, 2]
    tx, ty, tz = Kt[h, 0], Kt[h, 1], Kt[h, 2]

    low = lowest[p]
    z0 = rz + low * tz
    if z0 < _LEAST_Z:
        status[p] = GONE
        return
    u0, v0 = (rx + low * tx) / z0, (ry + low * ty) / z0
    if not (_MARGIN < u0 < width - _MARGIN and _MARGIN < v0 < height - _MARGIN):
        status[p] = GONE
        return
    open_end = np.isnan(highest[p])
    far = highest[p] if not open_end else low + _DIRECTION_STEP
    z1 = rz + far * tz
    if z1 < _LEAST_Z:
        status[p] = GONE
        return
    u1, v1 = (rx + far * tx) / z1, (ry + far * ty) / z1
    line_u, line_v = u1 - u0, v1 - v0
    distance = np.sqrt(line_u * line_u + line_v * line_v)
    if distance < _LEAST_LINE:
        return
    if open_end:
        span = max_length
    else:
        if distance < _NARROW:
            length[p] = distance
            status[p] = SETTLED
            return
        span = min(distance, max_length)
    dx, dy = line_u / distance, line_v / distance
    if not open_end and not (_MARGIN < u1 < width - _MARGIN and _MARGIN < v1 < height - _MARGIN):
        status[p] = GONE
        return
    if not (_LEAST_SCALE < z0 < _LARGEST_SCALE):  # the pattern would be of another size
        status[p] = GONE
        return

    # How far a match may be off, by how the gradients lie to the line.
    along = dx * dx * structure[p, 0] + np.float32(2.0) * dx * dy * structure[p, 1] + dy * dy * structure[p, 2]
    across = dy * dy * structure[p, 0] - np.float32(2.0) * dx * dy * structure[p, 1] + dx * dx * structure[p, 2]
    uncertainty = _MATCH_ERROR + _LINE_ERROR * (along + across) / max(along, _LEAST_STRUCTURE)
    if not open_end and np.float32(2.0) * uncertainty > span:
        status[p] = UNCLEAR
        length[p] = span
        return
    uncertainty = min(uncertainty, _LARGEST_ERROR)

    # The pattern's pixels move with the rotation and the scale along the line.
    for k in range(PATTERN_SIZE):
        pu, pv = PATTERN[k, 0], PATTERN[k, 1]
        gz = KRKi[h, 2, 0] * pu + KRKi[h, 2, 1] * pv
        du[k] = (KRKi[h, 0, 0] * pu + KRKi[h, 0, 1] * pv - u0 * gz) / z0
        dv[k] = (KRKi[h, 1, 0] * pu + KRKi[h, 1, 1] * pv - v0 * gz) / z0

    steps = min(np.int64(span) + 2, _STEPS)
    best, best_energy = -1, _NO_MATCH
    for i in range(steps):
        cu, cv = u0 + np.float32(i) * dx, v0 + np.float32(i) * dy
        energies[i] = _NO_MATCH
        if _MARGIN < cu < width - _MARGIN and _MARGIN < cv < height - _MARGIN:
            energies[i] = _energy_at(flat, row, cu, cv, du, dv, color[p], gain[h], offset[h], huber, u8, v8, values[0])
            if energies[i] < best_energy:
                best, best_energy = i, energies[i]
    if best < 0:
        status[p] = GONE
        return
    rival = _NO_MATCH
    for i in range(steps):
        if abs(i - best) > _RIVAL_DISTANCE and energies[i] < rival:
            rival = energies[i]
    ratio = rival / max(best_energy, _LEAST_ENERGY)
    if ratio < quality[p] or steps > _LONG:
        quality[p] = ratio

    position, energy = _refine(
        flat, row, height, width, u0, v0, dx, dy, np.float32(best), best_energy, du, dv, color[p], gain[h], offset[h],
        huber, u8, v8, values,
    )  # fmt: skip
    if energy > OUTLIER_ENERGY:
        status[p] = GONE if status[p] == MISMATCH else MISMATCH
        return

    # The interval is where the match may lie, as inverse depths: solved for the larger part of the direction.
    bu, bv = u0 + position * dx, v0 + position * dy
    if dx * dx > dy * dy:
        a, b = bu - uncertainty * dx, bu + uncertainty * dx
        first = (rz * a - rx) / (tx - tz * a)
        second = (rz * b - rx) / (tx - tz * b)
    else:
        a, b = bv - uncertainty * dy, bv + uncertainty * dy
        first = (rz * a - ry) / (ty - tz * a)
        second = (rz * b - ry) / (ty - tz * b)
    if first > second:
        first, second = second, first
    if not (np.isfinite(first) and np.isfinite(second)) or second < 0:
        status[p] = MISMATCH
        return
    lowest[p] = max(first, np.float32(0.0))
    highest[p] = second
    length[p] = np.float32(2.0) * uncertainty
    status[p] = FOUND


@njit(error_model="numpy", fastmath=FAST_MATH)
def _energy_at(flat, row, u, v, du, dv, color, gain, offset, huber, u8, v8, values):
    for k in range(PATTERN_SIZE):
        u8[k], v8[k] = u + du[k], v + dv[k]
    pattern_intensity(flat, row, u8, v8, values)
    energy = np.float32(0.0)
    for k in range(PATTERN_SIZE):
        r = abs(values[k] - gain * color[k] - offset)
        squared = min(r, huber)
        energy += squared * (np.float32(2.0) * r - squared)
    return energy


@njit(error_model="numpy", fastmath=FAST_MATH)
def _refine(
    flat, row, height, width, u0, v0, dx, dy, position, energy, du, dv, color, gain, offset, huber, u8, v8, values
):  # fmt: skip
    """Gauss-Newton along the line; steps of at most a pixel, the best position seen is kept."""
    best, best_energy = position, energy
    one = np.float32(1.0)
    for _ in range(_REFINEMENTS):
        H, b, energy = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        u, v = u0 + position * dx, v0 + position * dy
        if not (_MARGIN < u < width - _MARGIN and _MARGIN < v < height - _MARGIN):
            break
        for k in range(PATTERN_SIZE):
            u8[k], v8[k] = u + du[k], v + dv[k]
        sample_pattern(flat, np.uint64(0), row, u8, v8, values)
        for k in range(PATTERN_SIZE):
            r = values[0, k] - gain * color[k] - offset
            g = values[1, k] * dx + values[2, k] * dy
            w = huber / max(abs(r), huber)
            H += w * g * g
            b += w * g * r
            energy += w * r * r * (np.float32(2.0) - w)
        if energy < best_energy:
            best, best_energy = position, energy
        if _LEAST_CURVATURE > H:
            break
        step = -b / H
        step = min(max(step, -one), one)
        position += step
        if abs(step) < _SMALL_STEP:
            break
    return best, best_energy


@njit(error_model="numpy")
def refine_depths(images, targets, host, pixel, color, weight, start, KRKi, Kt, gain, offset, huber, c2, threshold):
    """Inverse depths of immature points, refined over all keyframes (DSO, section 3.2, activation).

    targets: int64, slots compared with. start: float32 N. threshold: energy over which a residual does not count.
    Returns inverse depth float32 N (NaN where it does not settle), information float32 N, and the residuals' states,
    uint8 N×S.
    """
    count, slots = len(host), images.shape[0]
    found, information = np.empty(count, np.float32), np.zeros(count, np.float32)
    state = np.zeros((count, slots), np.uint8)
    work = np.zeros((6, PATTERN_SIZE), np.float32)
    for p in range(count):
        found[p], information[p] = _refine_depth(
            images, targets, np.int64(host[p]), pixel[p], color[p], weight[p], start[p], KRKi, Kt, gain, offset, huber,
            c2, threshold, state[p], work,
        )  # fmt: skip
    return found, information, state


@njit(error_model="numpy")
def _refine_depth(
    images, targets, h, pixel, color, weight, d, KRKi, Kt, gain, offset, huber, c2, threshold, state, work
):  # fmt: skip
    H, b, energy, _ = _depth_system(
        images, targets, h, pixel, color, weight, d, KRKi, Kt, gain, offset, huber, c2, threshold, state, work
    )
    damping = _FIRST_DAMPING
    for _ in range(_DEPTH_STEPS):
        if H <= 0:
            break
        trial = d - b / (H * (np.float32(1.0) + damping))
        if not trial > 0:
            break
        H2, b2, energy2, _ = _depth_system(
            images, targets, h, pixel, color, weight, trial, KRKi, Kt, gain, offset, huber, c2, threshold, state, work
        )
        if energy2 < energy:
            small = abs(trial - d) < _SMALL_CHANGE * d
            d, H, b, energy = trial, H2, b2, energy2
            damping *= _LESS_DAMPING
            if small:
                break
        else:
            damping *= _MORE_DAMPING
    H, b, energy, good = _depth_system(
        images, targets, h, pixel, color, weight, d, KRKi, Kt, gain, offset, huber, c2, threshold, state, work
    )
    if good == 0 or not np.isfinite(d) or _LEAST_INFORMATION > H:
        return np.float32(np.nan), H
    return d, H


@njit(error_model="numpy", fastmath=FAST_MATH)
def _depth_system(
    images, targets, h, pixel, color, weight, d, KRKi, Kt, gain, offset, huber, c2, threshold, state, work
):  # fmt: skip
    """Second and first derivative of the energy by inverse depth, the energy, and how many residuals are good.

    state: uint8 S, set. work: float32 6×8, to work in.
    """
    height, width = images.shape[1:3]
    flat, row = images.reshape(-1), np.uint64(3 * width)
    u, v, inverse_z, values = work[0], work[1], work[2], work[3:]
    half, two = np.float32(0.5), np.float32(2.0)
    H, b, total = np.float32(0.0), np.float32(0.0), np.float32(0.0)
    good = 0
    for n in range(len(targets)):
        t = targets[n]
        if t == h:
            continue
        if not project_pattern(pixel, d, KRKi[h, t], Kt[h, t], height, width, _MARGIN, u, v, inverse_z):
            state[t] = NONE
            continue
        sample_pattern(flat, np.uint64(t) * np.uint64(height) * row, row, u, v, values)
        tx, ty, tz = Kt[h, t, 0], Kt[h, t, 1], Kt[h, t, 2]
        A, B = gain[h, t], offset[h, t]
        energy, Hr, br = np.float32(0.0), np.float32(0.0), np.float32(0.0)
        for k in range(PATTERN_SIZE):
            gx, gy = values[1, k], values[2, k]
            r = values[0, k] - A * color[k] - B
            J = inverse_z[k] * (gx * (tx - tz * u[k]) + gy * (ty - tz * v[k]))
            w = half * (np.sqrt(c2 / (c2 + gx * gx + gy * gy)) + weight[k])
            robust = huber / max(abs(r), huber)
            w = w * w * robust
            energy += w * r * r * (two - robust)
            Hr += w * J * J
            br += w * J * r
        if energy > threshold:
            state[t] = NONE
            total += threshold
            continue
        state[t] = GOOD
        good += 1
        H += Hr
        b += br
        total += energy
    return H, b, total, good
