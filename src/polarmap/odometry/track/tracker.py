"""Frame tracking: direct alignment of a frame to the newest keyframe, coarse to fine (DSO, section 3.1)."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import orthonormalized
from polarmap.jit import njit
from polarmap.odometry.pyramid import Pyramid
from polarmap.odometry.track.descent import CUTOFF, LEAST_POINTS, TERMS, VARIABLES, at, descend, projection

_ITERATIONS = (10, 20, 50, 50, 50, 50)  # by level, the finest first
_SMALL_STEPS = (2e-5, 1e-4)  # radians, on the finest level and on others: about 0.01 and 0.05 of its pixels
_REPEAT_RATIO = 1.5  # a hypothesis this much worse than usual is not taken at once
_HOPELESS_RATIO, _HOPELESS_RMS = 3.0, 5.0  # of the best's residual and grey values above it, on the coarsest level
_SAMPLED = 50  # points for which the uncertainty is computed, about

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
        self._terms = np.empty((TERMS, 0), np.float32)

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
        self._terms = np.empty((TERMS, max(map(len, self._points))), np.float32)

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

    def realign(self, pyramid: Pyramid, T: np.ndarray, gain: float, offset: float) -> tuple[np.ndarray, float] | None:
        """T_frame_reference from a guess that is nearly right, and the share of inliers; None with too few in view."""
        found = self._descend(pyramid, orthonormalized(T), gain, offset, None)
        return None if found is None else (found.T, 1.0 - found.saturated)

    def _align_from(self, pyramid, T, gain, offset, best: Alignment | None) -> Alignment | None:
        found = self._descend(pyramid, T, gain, offset, best)
        if found is None:
            return None
        points, K = self._points[0], self._matrices[0]
        flow, translation_flow = _flow(points, *projection(K, found.T), K)
        return Alignment(
            found.T, float(np.exp(found.log_gain)), float(found.offset), found.rms, 1.0 - found.saturated,
            float(flow), float(translation_flow), found.seen / max(len(points), 1), int(found.seen),
            found.uncertainty(points, K),
        )  # fmt: skip

    def _descend(self, pyramid, T, gain, offset, best: Alignment | None) -> _Descended | None:
        """From the coarsest level to the finest; None where too few points are in view, or `best` is far better."""
        log_gain, cutoff = float(np.log(gain)), CUTOFF
        coarsest = len(self._points) - 1
        for level in range(coarsest, -1, -1):
            T, log_gain, offset, cost, seen, saturated, sums, cutoff = descend(
                pyramid.levels[level], self._points[level], self._matrices[level], T, log_gain, float(offset),
                self._huber, _ITERATIONS[min(level, len(_ITERATIONS) - 1)], _SMALL_STEPS[min(level, 1)], self._terms,
            )  # fmt: skip
            if seen < LEAST_POINTS:
                return None
            if level == coarsest and best is not None and np.sqrt(cost) > _HOPELESS_RATIO * best.rms + _HOPELESS_RMS:
                return None
        if cutoff > CUTOFF:
            cost, seen, saturated, sums = at(
                pyramid.levels[0], self._points[0], self._matrices[0], T, log_gain, offset, self._huber, self._terms
            )
        return _Descended(T, log_gain, offset, float(np.sqrt(cost)), seen, saturated, sums[:VARIABLES, :VARIABLES])


@dataclass(frozen=True, eq=False)
class _Descended:
    """What descent through the levels came to; H float64 8×8: second derivatives by xi, ln(gain) and offset."""

    T: np.ndarray
    log_gain: float
    offset: float
    rms: float
    seen: int
    saturated: float
    H: np.ndarray

    def uncertainty(self, points: np.ndarray, K: np.ndarray) -> float:
        """Typical standard deviation in pixels of where the motion puts the points (N×4), by the residuals' noise."""
        values, vectors = np.linalg.eigh(self.H)
        if np.abs(values).min() <= VARIABLES * np.finfo(float).eps * np.abs(values).max():
            return np.inf
        covariance = self.rms**2 * (vectors / values @ vectors.T)[:6, :6]
        some = points[:: max(1, len(points) // _SAMPLED)].astype(np.float64)
        x, y, d = (some[:, 0] - K[0, 2]) / K[0, 0], (some[:, 1] - K[1, 2]) / K[1, 1], some[:, 2]
        zero = np.zeros_like(d)
        along_u = K[0, 0] * np.stack([d, zero, -x * d, -x * y, 1 + x * x, -y])
        along_v = K[1, 1] * np.stack([zero, d, -y * d, -1 - y * y, x * y, x])
        variance = (along_u * (covariance @ along_u) + along_v * (covariance @ along_v)).sum(axis=0)
        return float(np.sqrt(np.median(variance)))


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
