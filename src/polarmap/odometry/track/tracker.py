"""Frame tracking: direct alignment of a frame to the newest keyframe, coarse to fine (DSO, section 3.1)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import se3_exp
from polarmap.geometry.pose import orthonormalized
from polarmap.jit import njit
from polarmap.odometry.pyramid import Pyramid, sample

_CHUNKS = 8  # of the points; fixed, so that sums do not depend on the number of threads
_MARGIN = np.float32(2.0)  # pixels from the border, within which a pixel and its gradient can be sampled
_CUTOFF = 20.0  # grey values; a larger residual counts as one of this size
_MAX_AFFINE = np.array([3.0, 100.0])  # of ln(gain), and of the offset in grey values
_ITERATIONS = (10, 20, 50, 50, 50, 50)  # by level, the finest first
_OFFSET_STD = 0.5  # grey values; brightness changes by a factor, hardly by an offset
_REPEAT_RATIO = 1.5  # a hypothesis this much worse than usual is not taken at once
_MAX_SATURATED = 0.6  # share of residuals above the cutoff, with which it is doubled
_MAX_CUTOFF = 8 * _CUTOFF  # at which doubling ends
_LEAST_POINTS = 20  # in view; eight variables need some more
_HOPELESS_RATIO, _HOPELESS_RMS = 3.0, 5.0  # of the best's residual and grey values above it, on the coarsest level
_SAMPLED = 50  # points for which the uncertainty is computed, about

# Levenberg-Marquardt; set by hand.
_FIRST_DAMPING = 0.01
_LESS_DAMPING, _MORE_DAMPING = 0.5, 4.0  # factors after a step that is taken, and after one that is not
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-6, 100.0
_SMALL_STEP = 1e-5  # radians, and lengths where the mean inverse depth is about 1: below a hundredth of a pixel
_SMALL_GAIN = 1e-5  # of the cost, as a share of it; no more steps after one that gains less
_REGULARIZATION = 1e-6  # squared grey values, far below any residual's; decides what no residual does

_SPARSE_LEVELS = 2  # finest levels, whose points are spread to diagonal neighbours alone


@dataclass(frozen=True, eq=False)
class Alignment:
    """A frame aligned to the reference keyframe.

    T_frame_reference: float64 4×4. gain, offset: a reference intensity I is expected as gain I + offset.
    rms: of the residuals at full resolution, in grey values. inliers: share of the points whose residual is below
    the cutoff. flow, translation_flow: root mean square motion of the points, in pixels; the latter without rotation.
    seen: share of the reference's points that fall into the frame, and how many those are.
    uncertainty: standard deviation of the points' position that the motion leaves, in pixels.
    """

    T_frame_reference: np.ndarray
    gain: float
    offset: float
    rms: float
    inliers: float
    flow: float
    translation_flow: float
    seen: float
    count: int
    uncertainty: float


class Tracker:
    """Aligns frames to a reference keyframe whose points have depth, on the pyramid levels that have a camera."""

    def __init__(self, cameras: tuple[PinholeCamera, ...], huber: float) -> None:
        self._matrices = [camera.matrix for camera in cameras]
        self._shapes = [camera.shape for camera in cameras]
        self._huber = np.float32(huber)
        self._points: list[np.ndarray] = []

    def set_reference(
        self, pyramid: Pyramid, pixels: np.ndarray, inverse_depth: np.ndarray, weights: np.ndarray
    ) -> None:
        """Take a keyframe: pixels (u, v) float32 N×2 in it, whose inverse depths (float32 N) have these weights."""
        depth, weight = _splat(pixels, inverse_depth, weights, self._shapes[0])
        self._points = []
        for number, (level, shape) in enumerate(zip(pyramid.levels, self._shapes, strict=False)):
            if number > 0:
                depth, weight = _halve(depth, shape), _halve(weight, shape)
            self._points.append(_gather(depth, weight, level, number < _SPARSE_LEVELS))

    def align(
        self,
        pyramid: Pyramid,
        hypotheses: Iterable[np.ndarray],
        gain: float,
        offset: float,
        usual_rms: float,
    ) -> Alignment | None:
        """Align a frame, from the first of the hypotheses for T_frame_reference that fits as well as usual, else
        from the best of all. None where no hypothesis has enough points in view.
        """
        best = None
        for T in hypotheses:
            found = self._align_from(pyramid, orthonormalized(T), gain, offset, best)
            if found is None or (best is not None and found.rms >= best.rms):
                continue
            best = found
            if best.rms < _REPEAT_RATIO * usual_rms:
                break
        return best

    def _align_from(self, pyramid, T, gain, offset, best: Alignment | None) -> Alignment | None:
        affine = np.array([np.log(gain), offset])
        coarsest = len(self._points) - 1
        for level in range(coarsest, -1, -1):
            cutoff = _CUTOFF
            system = self._evaluate(pyramid, level, T, affine, cutoff)
            while system.saturated > _MAX_SATURATED and cutoff < _MAX_CUTOFF:
                cutoff *= 2.0
                system = self._evaluate(pyramid, level, T, affine, cutoff)
            if system.count < _LEAST_POINTS:
                return None
            damping = _FIRST_DAMPING
            for _ in range(_ITERATIONS[min(level, len(_ITERATIONS) - 1)]):
                step = system.step(damping)
                T_trial, affine_trial = se3_exp(step[:6]) @ T, np.clip(affine + step[6:], -_MAX_AFFINE, _MAX_AFFINE)
                trial = self._evaluate(pyramid, level, T_trial, affine_trial, cutoff)
                if trial.cost < system.cost and trial.count > _LEAST_POINTS:
                    gained = system.cost - trial.cost
                    T, affine, system = T_trial, affine_trial, trial
                    damping = max(_LESS_DAMPING * damping, _LEAST_DAMPING)
                    if np.abs(step[:6]).max() < _SMALL_STEP or gained < _SMALL_GAIN * trial.cost:
                        break
                else:
                    damping *= _MORE_DAMPING
                    if damping > _LARGEST_DAMPING or np.abs(step[:6]).max() < _SMALL_STEP:
                        break
            if level == coarsest and best is not None and system.rms > _HOPELESS_RATIO * best.rms + _HOPELESS_RMS:
                return None
        if cutoff > _CUTOFF:
            system = self._evaluate(pyramid, 0, T, affine, _CUTOFF)
        flow, translation_flow = _flow(self._points[0], *self._projection(0, T), self._matrices[0])
        count = max(len(self._points[0]), 1)
        return Alignment(
            T, float(np.exp(affine[0])), float(affine[1]), system.rms, 1.0 - system.saturated,
            float(flow), float(translation_flow), system.count / count, int(system.count),
            system.uncertainty(self._points[0], self._matrices[0]),
        )  # fmt: skip

    def _projection(self, level: int, T: np.ndarray):
        K = self._matrices[level]
        return (K @ T[:3, :3] @ np.linalg.inv(K)).astype(np.float32), (K @ T[:3, 3]).astype(np.float32)

    def _evaluate(self, pyramid, level, T, affine, cutoff) -> _System:
        K = self._matrices[level]
        KRKi, Kt = self._projection(level, T)
        sums = _align_system(
            pyramid.levels[level].reshape(1, *pyramid.levels[level].shape), self._points[level], KRKi, Kt,
            np.float32(K[0, 0]), np.float32(K[1, 1]), np.float32(K[0, 2]), np.float32(K[1, 2]),
            np.float32(np.exp(affine[0])), np.float32(affine[1]), self._huber, np.float32(cutoff),
        )  # fmt: skip
        return _System(sums, affine[1])


class _System:
    """Normal equations of an alignment: 8 variables (xi, a, b), the residual as the ninth."""

    def __init__(self, sums: np.ndarray, offset: float) -> None:
        total = sums.sum(axis=0)
        energy, self.count, saturated = total[9, :3]
        information = self.count / _OFFSET_STD**2
        total[7, 7] += information
        total[7, 8] += information * offset
        energy += information * offset**2
        self.cost = energy / max(self.count, 1.0)
        self.rms = float(np.sqrt(self.cost))
        self.saturated = saturated / max(self.count, 1.0)
        upper = np.triu(total[:9, :9])
        full = upper + np.triu(upper, 1).T
        self._H, self._b = full[:8, :8], full[:8, 8]

    def uncertainty(self, points: np.ndarray, K: np.ndarray) -> float:
        """Typical standard deviation in pixels of where the motion puts the points (N×4), by the residuals' noise."""
        covariance = self.rms**2 * np.linalg.pinv(self._H, hermitian=True)[:6, :6]
        if np.linalg.matrix_rank(self._H, hermitian=True) < 8:
            return np.inf
        some = points[:: max(1, len(points) // _SAMPLED)]
        x, y, d = (some[:, 0] - K[0, 2]) / K[0, 0], (some[:, 1] - K[1, 2]) / K[1, 1], some[:, 2]
        zero = np.zeros_like(d)
        along_u = K[0, 0] * np.stack([d, zero, -x * d, -x * y, 1 + x * x, -y])
        along_v = K[1, 1] * np.stack([zero, d, -y * d, -1 - y * y, x * y, x])
        variance = np.einsum("in,ij,jn->n", along_u, covariance, along_u)
        variance += np.einsum("in,ij,jn->n", along_v, covariance, along_v)
        return float(np.sqrt(np.median(variance)))

    def step(self, damping: float) -> np.ndarray:
        H = self._H + damping * np.diag(np.diag(self._H)) + _REGULARIZATION * np.eye(8)
        return np.linalg.solve(H, -self._b)


@njit(parallel=True, error_model="numpy")
def _align_system(images, points, KRKi, Kt, fx, fy, cx, cy, gain, offset, huber, cutoff):
    """Sums of the normal equations by chunk, float64 8×10×9; the last row: energy, points in view, saturated."""
    out = np.zeros((_CHUNKS, 10, 9))
    height, width = np.float32(images.shape[1]), np.float32(images.shape[2])
    one, zero = np.float32(1.0), np.int64(0)
    count = len(points)
    cutoff_energy = huber * (np.float32(2.0) * cutoff - huber)
    for chunk_index in prange(_CHUNKS):
        chunk = np.int64(chunk_index)
        sums = np.zeros((9, 9), np.float64)
        J = np.zeros(9, np.float32)
        energy, seen, saturated = 0.0, 0.0, 0.0
        for p in range(chunk * count // _CHUNKS, (chunk + 1) * count // _CHUNKS):
            u, v, d = points[p, 0], points[p, 1], points[p, 2]
            iz = one / (KRKi[2, 0] * u + KRKi[2, 1] * v + KRKi[2, 2] + d * Kt[2])
            pu = (KRKi[0, 0] * u + KRKi[0, 1] * v + KRKi[0, 2] + d * Kt[0]) * iz
            pv = (KRKi[1, 0] * u + KRKi[1, 1] * v + KRKi[1, 2] + d * Kt[1]) * iz
            if not (iz > 0 and _MARGIN < pu < width - _MARGIN and _MARGIN < pv < height - _MARGIN):
                continue
            seen += 1.0
            value, gx, gy = sample(images, zero, pu, pv)
            r = value - gain * points[p, 3] - offset
            size = abs(r)
            if size > cutoff:
                energy += cutoff_energy
                saturated += 1.0
                continue
            w = one if size <= huber else huber / size
            energy += w * r * r * (np.float32(2.0) - w)
            x, y, z = (pu - cx) / fx, (pv - cy) / fy, d * iz
            gx, gy = gx * fx, gy * fy
            J[0] = gx * z
            J[1] = gy * z
            J[2] = -z * (gx * x + gy * y)
            J[3] = -gx * x * y - gy * (one + y * y)
            J[4] = gx * (one + x * x) + gy * x * y
            J[5] = -gx * y + gy * x
            J[6] = -gain * points[p, 3]
            J[7] = -one
            J[8] = r
            for i in range(9):
                wJ = w * J[i]
                for k in range(i, 9):
                    sums[i, k] += wJ * J[k]
        out[chunk, :9] = sums
        out[chunk, 9, 0] = energy
        out[chunk, 9, 1] = seen
        out[chunk, 9, 2] = saturated
    return out


@njit(error_model="numpy")
def _flow(points, KRKi, Kt, K):
    """Root mean square motion of the points in pixels, with the whole motion and with its translation alone."""
    full, translated, count = 0.0, 0.0, 0
    for p in range(len(points)):
        u, v, d = points[p, 0], points[p, 1], points[p, 2]
        z = KRKi[2, 0] * u + KRKi[2, 1] * v + KRKi[2, 2] + d * Kt[2]
        z_still = 1.0 + d * Kt[2]
        if z <= 0 or z_still <= 0:
            continue
        pu = (KRKi[0, 0] * u + KRKi[0, 1] * v + KRKi[0, 2] + d * Kt[0]) / z
        pv = (KRKi[1, 0] * u + KRKi[1, 1] * v + KRKi[1, 2] + d * Kt[1]) / z
        full += (pu - u) ** 2 + (pv - v) ** 2
        su, sv = (u + d * Kt[0]) / z_still, (v + d * Kt[1]) / z_still
        translated += (su - u) ** 2 + (sv - v) ** 2
        count += 1
    count = max(count, 1)
    return np.sqrt(full / count), np.sqrt(translated / count)


@njit
def _splat(pixels, inverse_depth, weights, shape):
    """Weighted sum of inverse depths, and of weights, at the nearest pixel."""
    height, width = shape
    depth, weight = np.zeros((height, width), np.float32), np.zeros((height, width), np.float32)
    for p in range(len(pixels)):
        x, y = np.int64(pixels[p, 0] + 0.5), np.int64(pixels[p, 1] + 0.5)
        if 0 <= x < width and 0 <= y < height:
            depth[y, x] += weights[p] * inverse_depth[p]
            weight[y, x] += weights[p]
    return depth, weight


@njit
def _halve(fine, shape):
    coarse = np.empty(shape, np.float32)
    for y in range(shape[0]):
        for x in range(shape[1]):
            above = fine[2 * y, 2 * x] + fine[2 * y, 2 * x + 1]
            coarse[y, x] = above + fine[2 * y + 1, 2 * x] + fine[2 * y + 1, 2 * x + 1]
    return coarse


@njit(error_model="numpy")
def _gather(depth, weight, level, diagonal):
    """(u, v, inverse depth, intensity) where there is depth, and at its neighbours: diagonal ones, or straight ones."""
    height, width = depth.shape
    points = np.empty((height * width, 4), np.float32)
    count = 0
    for y in range(2, height - 2):
        for x in range(2, width - 2):
            d, w = depth[y, x], weight[y, x]
            if w <= 0.0:
                if diagonal:
                    d = depth[y - 1, x - 1] + depth[y - 1, x + 1] + depth[y + 1, x - 1] + depth[y + 1, x + 1]
                    w = weight[y - 1, x - 1] + weight[y - 1, x + 1] + weight[y + 1, x - 1] + weight[y + 1, x + 1]
                else:
                    d = depth[y, x - 1] + depth[y, x + 1] + depth[y + 1, x] + depth[y - 1, x]
                    w = weight[y, x - 1] + weight[y, x + 1] + weight[y + 1, x] + weight[y - 1, x]
            if w > 0.0:
                points[count, 0] = x
                points[count, 1] = y
                points[count, 2] = d / w
                points[count, 3] = level[y, x, 0]
                count += 1
    return points[:count].copy()
