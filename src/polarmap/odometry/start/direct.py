"""The slow start: two frames aligned directly while the inverse depths of the first are found along with the motion.

All points start at inverse depth 1. Every new frame is aligned to the first, coarse to fine, with each point's inverse
depth as a variable that is drawn to the median of its neighbours; where the images say something, they outweigh it.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import se3_exp
from polarmap.jit import njit
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pattern import OUTLIER_ENERGY, PATTERN, PATTERN_SIZE
from polarmap.odometry.points import describe
from polarmap.odometry.pyramid import Pyramid, sample
from polarmap.odometry.selection import PointSelector

_MAX_AFFINE = np.array([3.0, 100.0])  # of ln(gain), and of the offset in grey values
_NEIGHBOURS = 8  # whose median a point's depth is drawn to
_MARGIN = np.float32(2.0)  # pixels from the border, within which a pixel and its gradient can be sampled
_SMOOTHNESS = np.float32(1.0)  # energy of a relative inverse depth that differs by 1 from its neighbours' median
_FLATNESS = 10.0  # energy of an inverse depth that differs by 1 from the flat start
_PARENT_SHARE = 2.0  # how much more the coarser level's depth counts where both know it equally well
_RIVAL_MARGIN = 1.1  # by which the energy of other motions must be larger
_AGREEING = 3  # starts that must end in the same motion; the flat one counts twice
_DISTINCT = np.radians(20.0)  # between the translations of different motions
_MIN_POINTS = 150  # of level 0
_MIN_INLIERS = 0.6  # share of the points
_MAX_RMS = 12.0  # grey values; as of OUTLIER_ENERGY

# Points of the levels; set by hand.
_LEAST_CHOSEN = 300  # pixels that are chosen on each level at least, since coarse levels have few that stand out
_COARSER_THRESHOLD = 0.75  # of the gradient threshold, from level to level: halving smooths
_NEAREST_KNOWN = 4  # points of known depth that a point takes its first depth from, where some are known
_NEAR = 4.0  # pixels, within which their distance makes little difference

# Levenberg-Marquardt over motion and all depths; set by hand, with more damping than for a window, which starts nearer.
_ITERATIONS, _COARSER_ITERATIONS = 20, 30  # at most: on level 0, and on each coarser one, whose steps cost less
_FIRST_DAMPING = 0.1
_LESS_DAMPING, _MORE_DAMPING = 0.3, 4.0  # factors after a step that is taken, and after one that is not
_LEAST_DAMPING, _LARGEST_DAMPING = 1e-4, 1e3
_SMALL_GAIN = 1e-3  # of the energy, as a share of it; no more steps after one that gains less
_REGULARIZATION = 1e-3  # squared grey values, far below any residual's; decides what no residual does
_PARENT_INFORMATION = 1e-3  # squared grey values; of a coarser level's depth even where that level knows nothing
_LARGEST_CHANGE, _SMALLEST_LIMIT = 0.3, 0.02  # of an inverse depth in one step: a share of it, and at least this
_LEAST_DEPTH, _LARGEST_DEPTH = 1e-3, 50.0  # inverse depths, of a median of about 1
_LARGEST_UNIT = 1e3  # by which the unit of length changes at most, so that a wrong solution overflows nowhere

# What is kept of a solution for the map's first window; set by hand.
_LEAST_KEPT_DEPTH = 0.02  # inverse depth, of a median of 1; the cut at _LEAST_DEPTH is not far below
_LEAST_CERTAIN = 0.1  # share of the points that are left out, those whose depth is known least


@dataclass(eq=False)
class _Level:
    """Points of a level, N: pixel N×2, color N×8, inverse depth and its smoothed version, information, neighbours."""

    pixel: np.ndarray
    color: np.ndarray
    weight: np.ndarray
    depth: np.ndarray
    smooth: np.ndarray
    information: np.ndarray
    good: np.ndarray
    neighbours: np.ndarray
    parents: np.ndarray | None  # index of the nearest point of the next coarser level

    def forget(self) -> None:
        """Back to inverse depth 1 everywhere."""
        self.depth, self.smooth = np.ones_like(self.depth), np.ones_like(self.depth)
        self.information = np.zeros_like(self.depth)


@dataclass(frozen=True, eq=False)
class Start:
    """A map to begin with, the mean of its inverse depths about 1.

    T_second_first: float64 4×4. gain, offset: a first-frame intensity I is expected as gain I + offset.
    pixels float32 N×2, inverse_depth float32 N: points of the first frame.
    """

    T_second_first: np.ndarray
    gain: float
    offset: float
    pixels: np.ndarray
    inverse_depth: np.ndarray


@dataclass(frozen=True, eq=False)
class _Solution:
    """A motion T_second_first with what level 0 then has; the median of the good points' inverse depths is 1."""

    T: np.ndarray
    affine: np.ndarray
    depth: np.ndarray
    good: np.ndarray
    information: np.ndarray
    energy: float


class DirectStarter:
    """Finds motion and depth from a first frame and the slowly moving ones that follow it.

    reason: why the last frame made no start. unfit: it does not show what the first one does any more.
    """

    def __init__(
        self,
        cameras: tuple[PinholeCamera, ...],
        options: OdometryOptions,
        seed: int = 0,
        valid: np.ndarray | None = None,
    ) -> None:
        self._cameras = cameras
        self._options = options
        self._seed = seed
        self._valid = valid
        self._levels: list[_Level] = []
        self.reason = ""
        self.unfit = False

    def begin(self, pyramid: Pyramid) -> bool:
        """Take the first frame; False, with `reason`, where it has too few points."""
        counts = [2 * self._options.points // (1 if n == 0 else 2 ** (n - 1)) for n in range(len(self._cameras))]
        self._levels = []
        for number, (level, count) in enumerate(zip(pyramid.levels, counts, strict=True)):
            single = Pyramid((level,))
            threshold = self._options.gradient_threshold * _COARSER_THRESHOLD**number
            selector = PointSelector(threshold, self._seed, _halved(self._valid, number))
            pixels = selector.select(single, max(count, _LEAST_CHOSEN))
            if len(pixels) < _NEIGHBOURS + 1 or (number == 0 and len(pixels) < _MIN_POINTS):
                self.reason = f"too little contrast: {len(pixels)} points stand out"
                return False
            self._levels.append(_new_level(level, pixels, self._options.gradient_constant))
        for fine, coarse in zip(self._levels, self._levels[1:], strict=False):
            _, fine.parents = cKDTree(coarse.pixel).query(fine.pixel * 0.5 - 0.25)
        self._T = np.eye(4)
        self._affine = np.zeros(2)
        self.unfit = False
        return True

    def add(self, pyramid: Pyramid, min_parallax: float) -> Start | None:
        """Align a later frame; the start, if its points moved by `min_parallax` pixels that no rotation explains.

        Depths begin at 1 each time, since those that little motion gave lead astray. None, with `reason`, where the
        parallax is too small or the frame does not fit.
        """
        found = self._solve(pyramid, self._T, self._affine, _FLATNESS)
        if found is None:
            return None
        self._T, self._affine = found.T, found.affine
        parallax = self._parallax(found.T)
        if parallax < min_parallax:
            self.reason = f"too little parallax ({parallax:.1f} px after rotation is removed; needs {min_parallax:.1f})"
            return None
        best = self._best_of_many(pyramid, found, parallax)
        self.unfit = False
        if best is None:
            self.reason = "rotation, translation and relief cannot be told apart yet"
            return None
        return self._start(best)

    def refine(self, pyramid: Pyramid, T_second_first, pixels: np.ndarray, inverse_depth: np.ndarray) -> Start | None:
        """The start from a motion and a few inverse depths (pixels N×2, float32 N) that are about right."""
        for level, camera in zip(self._levels, self._cameras, strict=True):
            scale = self._cameras[0].width / camera.width
            distance, near = cKDTree(pixels).query(level.pixel * scale, _NEAREST_KNOWN)
            share = 1.0 / (distance + _NEAR)
            level.forget()
            level.depth = (np.sum(share * inverse_depth[near], 1) / share.sum(1)).astype(np.float32)
            level.smooth = level.depth.copy()
        found = self._solve(pyramid, T_second_first, np.zeros(2), 0.0, fresh=False)
        return None if found is None else self._start(found)

    def _best_of_many(self, pyramid: Pyramid, flat: _Solution, parallax: float) -> _Solution | None:
        """The best of the solutions from translations along all axes; None where few starts end there, or another one
        is about as good.

        A flat start may end in a wrong minimum: rotation, translation and relief make up for each other.
        """
        average = _exchanged(flat.T[:3, 3]) @ flat.T  # the rotation that moves the image as the motion does on average
        length = parallax / (0.5 * (self._cameras[0].fx + self._cameras[0].fy))
        solutions = [flat]
        for direction in (*np.eye(3), *-np.eye(3)):
            T = _exchanged(-length * direction) @ average
            T[:3, 3] = length * direction
            solutions.append(self._solve(pyramid, T, flat.affine, 0.0))
        solutions = sorted((found for found in solutions if found is not None), key=lambda found: found.energy)
        best = solutions[0]
        rivals = [other for other in solutions[1:] if _angle(best.T[:3, 3], other.T[:3, 3]) > _DISTINCT]
        agreeing = len(solutions) - len(rivals) + (flat not in rivals)
        if agreeing < _AGREEING or (rivals and rivals[0].energy < _RIVAL_MARGIN * best.energy):
            return None
        return best

    def _solve(self, pyramid: Pyramid, T, affine, flatness: float, fresh: bool = True) -> _Solution | None:
        """Motion, brightness and depths from all levels, coarse to fine; None, with `reason`, where they do not fit.

        fresh: start from inverse depth 1, else from what the levels hold.
        """
        self.unfit = False
        for level in self._levels if fresh else ():
            level.forget()
        for number in range(len(self._levels) - 1, -1, -1):
            T, affine, system = self._align(pyramid, number, T, affine, flatness)
            if number > 0:
                self._pass_down(number - 1)
        if system.inliers < _MIN_INLIERS or system.rms > _MAX_RMS:
            self.unfit = True
            share = 100 * system.inliers
            self.reason = f"the frames do not fit ({share:.0f} % of the points match, residual {system.rms:.1f} of 255)"
            return None
        first = self._levels[0]
        scale = float(np.clip(np.median(first.depth[first.good]), 1 / _LARGEST_UNIT, _LARGEST_UNIT))
        T = T.copy()
        T[:3, 3] *= scale
        return _Solution(T, affine, first.depth / np.float32(scale), first.good, first.information, system.energy)

    def _start(self, found: _Solution) -> Start | None:
        pixel = self._levels[0].pixel
        keep = found.good & (found.depth > _LEAST_KEPT_DEPTH)
        keep &= found.information > np.quantile(found.information, _LEAST_CERTAIN)
        if np.count_nonzero(keep) < _MIN_POINTS:
            self.reason = f"too few points have a depth: {np.count_nonzero(keep)}"
            return None
        gain, offset = float(np.exp(found.affine[0])), float(found.affine[1])
        return Start(found.T, gain, offset, pixel[keep], found.depth[keep])

    def _align(self, pyramid: Pyramid, number: int, T: np.ndarray, affine: np.ndarray, flatness: float):
        level = self._levels[number]
        damping = _FIRST_DAMPING
        system = self._evaluate(pyramid, number, T, affine, level.depth, flatness)
        for _ in range(_COARSER_ITERATIONS if number else _ITERATIONS):
            step, depth = system.step(level.depth, damping)
            T_trial, affine_trial = se3_exp(step[:6]) @ T, np.clip(affine + step[6:], -_MAX_AFFINE, _MAX_AFFINE)
            trial = self._evaluate(pyramid, number, T_trial, affine_trial, depth, flatness)
            if trial.energy < system.energy:
                gained = 1.0 - trial.energy / system.energy
                T, affine, level.depth, system = T_trial, affine_trial, depth, trial
                level.smooth = _neighbour_median(level.depth, system.good, level.neighbours)
                damping = max(_LESS_DAMPING * damping, _LEAST_DAMPING)
                if gained < _SMALL_GAIN:
                    break
            else:
                damping *= _MORE_DAMPING
                if damping > _LARGEST_DAMPING:
                    break
        level.good, level.information = system.good, system.depth_hessian
        return T, affine, system

    def _evaluate(self, pyramid, number, T, affine, depth, flatness) -> _System:
        level, K = self._levels[number], self._cameras[number].matrix
        K_inverse = np.linalg.inv(K)
        image = pyramid.levels[number]
        count = len(depth)
        rows = np.zeros((count, 10), np.float32)
        good = np.zeros(count, np.bool_)
        sums = _evaluate_start(
            image.reshape(1, *image.shape), level.pixel, level.color, level.weight, depth, level.smooth,
            (K @ T[:3, :3] @ K_inverse).astype(np.float32), (K @ T[:3, 3]).astype(np.float32),
            K.astype(np.float32), np.float32(np.exp(affine[0])), np.float32(affine[1]),
            np.float32(self._options.huber), np.float32(flatness), rows, good,
        )  # fmt: skip
        return _System(sums, rows, good)

    def _pass_down(self, number: int) -> None:
        """Depths of a level improved by what the coarser one has found."""
        fine, coarse = self._levels[number], self._levels[number + 1]
        parent = np.where(coarse.good, coarse.depth, coarse.smooth)[fine.parents]
        known = _PARENT_SHARE * coarse.information[fine.parents] + _PARENT_INFORMATION
        own = fine.information * fine.good
        fine.depth = ((own * fine.depth + known * parent) / (own + known)).astype(np.float32)
        fine.smooth = _neighbour_median(fine.depth, np.ones(len(fine.depth), bool), fine.neighbours)

    def _parallax(self, T: np.ndarray) -> float:
        """Median motion of level 0's good points in pixels that no rotation explains."""
        first, camera = self._levels[0], self._cameras[0]
        rays = camera.unproject(first.pixel[first.good])
        x = rays[:, :2]
        moved = rays @ T[:3, :3].T + first.depth[first.good, None] * T[:3, 3]
        flow = moved[:, :2] / moved[:, 2:] - x
        turn = np.stack(
            [
                np.stack([-x[:, 0] * x[:, 1], 1 + x[:, 0] ** 2, -x[:, 1]], axis=1),
                np.stack([-1 - x[:, 1] ** 2, x[:, 0] * x[:, 1], x[:, 0]], axis=1),
            ],
            axis=1,
        )  # how the pixels move with a small rotation, N×2×3
        rotation = np.linalg.lstsq(turn.reshape(-1, 3), flow.reshape(-1), rcond=None)[0]
        remaining = (flow - turn @ rotation) * [camera.fx, camera.fy]
        return float(np.median(np.linalg.norm(remaining, axis=1)))


class _System:
    def __init__(self, total: np.ndarray, rows: np.ndarray, good: np.ndarray) -> None:
        self.energy, residual_energy = total[18, :2]
        self.good = good
        found = max(np.count_nonzero(good), 1)
        self.rms = float(np.sqrt(residual_energy / (found * PATTERN_SIZE)))
        self.inliers = found / max(len(good), 1)
        H, schur = total[:9], total[9:18]
        self._full = np.triu(H) + np.triu(H, 1).T
        self._schur = np.triu(schur) + np.triu(schur, 1).T
        self._rows = rows
        self.depth_hessian = rows[:, 9]

    def step(self, depth: np.ndarray, damping: float) -> tuple[np.ndarray, np.ndarray]:
        """The step of motion and brightness, float64 8, and the new inverse depths."""
        full = self._full - self._schur / (1.0 + damping)
        H = full[:8, :8] + damping * np.diag(np.diag(self._full)[:8]) + _REGULARIZATION * np.eye(8)
        step = np.linalg.solve(H, -full[:8, 8])
        rows = self._rows
        change = -(rows[:, 8] + rows[:, :8] @ step.astype(np.float32)) / (rows[:, 9] * np.float32(1.0 + damping))
        limit = np.maximum(_LARGEST_CHANGE * depth, _SMALLEST_LIMIT)
        return step, np.clip(depth + np.clip(change, -limit, limit), _LEAST_DEPTH, _LARGEST_DEPTH).astype(np.float32)


def _new_level(level: np.ndarray, pixels: np.ndarray, gradient_constant: float) -> _Level:
    color, weight, _ = describe(level, pixels, gradient_constant)
    pixel = pixels.astype(np.float32)
    count = len(pixel)
    _, neighbours = cKDTree(pixel).query(pixel, _NEIGHBOURS + 1)
    ones = np.ones(count, np.float32)
    return _Level(
        pixel, color, weight, ones, ones.copy(), np.zeros(count, np.float32), np.ones(count, bool),
        np.ascontiguousarray(neighbours[:, 1:]), None,
    )  # fmt: skip


def _halved(valid: np.ndarray | None, times: int) -> np.ndarray | None:
    """A mask at a coarser level: where all of its pixels are valid."""
    for _ in range(times if valid is not None else 0):
        height, width = valid.shape[0] // 2, valid.shape[1] // 2
        valid = valid[: 2 * height, : 2 * width].reshape(height, 2, width, 2).all(axis=(1, 3))
    return valid


def _exchanged(translation: np.ndarray) -> np.ndarray:
    """The rotation that moves the image as this translation does at inverse depth 1, 4×4."""
    x, y, _ = translation
    return se3_exp(np.array([0.0, 0.0, 0.0, -y, x, 0.0]))


def _angle(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.arccos(np.clip(a @ b / (np.linalg.norm(a) * np.linalg.norm(b) + 1e-12), -1.0, 1.0)))


@njit
def _neighbour_median(depth, good, neighbours):
    """Median over a point and its good neighbours."""
    smooth = depth.copy()
    values = np.empty(neighbours.shape[1] + 1, np.float32)
    for p in range(len(depth)):
        count = 0
        if good[p]:
            values[0] = depth[p]
            count = 1
        for k in range(neighbours.shape[1]):
            n = neighbours[p, k]
            if good[n]:
                values[count] = depth[n]
                count += 1
        if count > 2:
            smooth[p] = np.median(values[:count])
    return smooth


@njit(error_model="numpy")
def _evaluate_start(
    images, pixel, color, weight, depth, smooth, KRKi, Kt, K, gain, offset, huber, flatness, rows, good
):
    """Sums, float64 19×9: normal equations 9×9, what the depths take from them 9×9, energies.

    rows: float32 N×10, of each point: derivative by depth and motion (8), by depth, by depth twice.
    """
    out = np.zeros((19, 9))
    height, width = np.float32(images.shape[1]), np.float32(images.shape[2])
    one, zero = np.float32(1.0), np.int64(0)
    count = len(depth)
    J = np.zeros(9, np.float32)
    own = np.zeros((9, 9), np.float64)
    row = np.zeros(10, np.float64)
    for p in range(count):
        d = depth[p]
        own[:] = 0.0
        row[:] = 0.0
        energy = np.float32(0.0)
        inside = True
        for k in range(PATTERN_SIZE):
            u, v = pixel[p, 0] + PATTERN[k, 0], pixel[p, 1] + PATTERN[k, 1]
            iz = one / (KRKi[2, 0] * u + KRKi[2, 1] * v + KRKi[2, 2] + d * Kt[2])
            pu = (KRKi[0, 0] * u + KRKi[0, 1] * v + KRKi[0, 2] + d * Kt[0]) * iz
            pv = (KRKi[1, 0] * u + KRKi[1, 1] * v + KRKi[1, 2] + d * Kt[1]) * iz
            if not (iz > 0 and _MARGIN < pu < width - _MARGIN and _MARGIN < pv < height - _MARGIN):
                inside = False
                break
            value, gx, gy = sample(images, zero, pu, pv)
            r = value - gain * color[p, k] - offset
            size = abs(r)
            robust = one if size <= huber else huber / size
            w = robust * weight[p, k] * weight[p, k]
            energy += w * r * r * (np.float32(2.0) - robust)
            J_depth = iz * (gx * (Kt[0] - Kt[2] * pu) + gy * (Kt[1] - Kt[2] * pv))
            x, y, z = (pu - K[0, 2]) / K[0, 0], (pv - K[1, 2]) / K[1, 1], d * iz
            gx, gy = gx * K[0, 0], gy * K[1, 1]
            J[0] = gx * z
            J[1] = gy * z
            J[2] = -z * (gx * x + gy * y)
            J[3] = -gx * x * y - gy * (one + y * y)
            J[4] = gx * (one + x * x) + gy * x * y
            J[5] = -gx * y + gy * x
            J[6] = -gain * color[p, k]
            J[7] = -one
            J[8] = r
            for i in range(9):
                wJ = w * J[i]
                row[i] += wJ * J_depth
                for n in range(i, 9):
                    own[i, n] += wJ * J[n]
            row[9] += w * J_depth * J_depth
        difference = d - smooth[p]
        out[18, 0] += _SMOOTHNESS * difference * difference + flatness * (d - one) * (d - one)
        good[p] = inside and energy <= OUTLIER_ENERGY
        if good[p]:
            out[18, 0] += energy
            out[18, 1] += energy
            out[18, 2] += 1.0
        else:
            out[18, 0] += OUTLIER_ENERGY
            row[:] = 0.0
        row[8] += _SMOOTHNESS * difference + flatness * (d - one)
        row[9] += _SMOOTHNESS + flatness
        for i in range(10):
            rows[p, i] = row[i]
        if good[p]:
            for i in range(9):
                factor = row[i] / row[9]
                for n in range(i, 9):
                    out[i, n] += own[i, n]
                    out[9 + i, n] += factor * row[n]
    return out
