"""The start of odometry from two frames, whatever the motion between them: pose, and inverse depth of corners.

Corners of the first frame are followed (`corner_tracks`) until two views determine the geometry. The motion comes from
many starts of the same minimization (`epipolar`): directions spread over the sphere about the best rotation, essential
matrices from sampled subsets, and the decompositions of a homography. Starting from all of them finds every explanation
of the matches; the second best tells whether the best is to be believed. Where a plane explains the matches as
well (Torr's GRIC, IJCV 2002), the free depths give way to that plane, and its two-fold ambiguity (Longuet-Higgins,
1986) is settled by points that would be behind a camera or are off the plane, or else the start is refused.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.start.corner_tracks import CornerOptions, CornerTracks
from polarmap.odometry.start.epipolar import (
    Matches,
    Triangulation,
    direction_std,
    fit_rotation,
    plane_residual,
    refine_motion,
    refine_plane,
    rotation_flow,
    triangulate,
)
from polarmap.options import Options, parameter

_FINEST = 1.0  # pixels: c of the robust error while the noise is unknown
_STARTS = 12  # directions of the translation
_FEW = 250  # matches that are enough to follow all starts
_KEPT = 4  # minima that are followed to the end
_DISTINCT = np.radians(15.0)  # between directions of translation of two explanations
_LEAST_NOISE = 0.1  # pixels, one axis; matches are not better than this
_INLIER = 3  # standard deviations from the epipolar line: 99.7 % of normal errors; c once the noise is known
_PLANE_INLIER = 4  # standard deviations from where a plane sees a point, along u and v: 99.97 % of normal errors
_BEFORE = 0.98  # share of a plane's points that must be before the camera, the rest being noise
_CLEARLY = 5  # times the least flow: a camera that moves the image so far, and by a rotation alone, has turned only
_CELLS = 4  # along each side of the image, to judge how points are spread
_RANSAC_STEPS = 200
_PLANAR_SHARE = 0.6  # of the matches on a plane, below which it is not the whole scene


class TwoViewOptions(Options):
    """When two views are enough to start from."""

    corners: CornerOptions = parameter(CornerOptions(), "which corners are followed")
    min_points: int = parameter(60, "with a depth", ge=8, le=5000)
    min_cells: int = parameter(6, "of 4×4 over the image with 3 points or more", ge=1, le=16)
    min_inliers: float = parameter(0.5, "share of the matches that the motion explains", ge=0, le=1)
    min_rotation_residual: float = parameter(1.0, "median flow that no rotation explains", "pixels", ge=0.01, le=1000)
    min_parallax: float = parameter(4.0, "median, rotation removed", "pixels", ge=0.01, le=1000)
    min_angle: float = parameter(np.radians(0.75), "median between the two rays of a point", "radians", ge=1e-4, le=1.5)
    max_noise: float = parameter(
        0.8, "standard deviation of the distance from the epipolar lines", "pixels", ge=0.01, le=100
    )
    max_direction_std: float = parameter(np.radians(1.5), "of the translation's direction", "radians", ge=1e-4, le=1.5)
    min_margin: float = parameter(
        0.2,
        "by which the next best motion must explain less, per match, squared errors over noise squared",
        ge=0,
        le=1000,
    )


@dataclass(frozen=True, eq=False)
class TwoViewGeometry:
    """Two frames and points in them, in the unit of length in which the points' mean inverse depth is 1.

    T_second_first: float64 4×4, first camera to second.
    pixels: float32 N×2, (u, v) in the first frame, whole numbers. second_pixels: float32 N×2, in the second frame.
    inverse_depth, inverse_depth_std: float32 N, 1/z in the first camera, and its standard deviation from the matches'
        noise alone (that of the pose moves all points together).
    parallax: median distance in pixels from where a point at infinity would be. angle: median angle between a
        point's two rays, radians.
    noise: standard deviation of a match along one axis, pixels.
    direction_std: standard deviation of the translation's direction along its least certain axis, radians.
    planar: a plane explains the matches, and the geometry comes from its homography.
    """

    T_second_first: np.ndarray
    pixels: np.ndarray
    second_pixels: np.ndarray
    inverse_depth: np.ndarray
    inverse_depth_std: np.ndarray
    parallax: float
    angle: float
    noise: float
    direction_std: float
    planar: bool


@dataclass(frozen=True, eq=False)
class _Motion:
    """One explanation: x2 ∥ R x1 + q t; cost in pixels² over all matches, those behind a camera counted as wrong."""

    R: np.ndarray
    t: np.ndarray
    cost: float
    plane: np.ndarray | None = None
    direction_std: float = np.inf


class _Refusal(Exception):
    """Why the two frames are not enough."""


class TwoViewStarter:
    """Follows a first frame's corners until two views determine motion and depth.

    reason: after an `add` (or `begin`) that gave nothing, one line that says why; empty otherwise.
    exhausted: too few corners are left for this first frame ever to do; `begin` anew.
    """

    def __init__(self, camera: PinholeCamera, options: TwoViewOptions | None = None, seed: int = 0) -> None:
        self._camera = camera
        self._options = options or TwoViewOptions()
        self._seed = seed
        self._tracks: CornerTracks | None = None
        self.reason = ""
        self.exhausted = True

    @property
    def count(self) -> int:
        """Corners that are followed now."""
        return 0 if self._tracks is None else len(self._tracks)

    def begin(self, image: np.ndarray) -> None:
        """The first frame, H×W in [0, 1]. Raises InputError where its shape is not the camera's."""
        self._tracks = CornerTracks(self._checked(image), self._options.corners)
        self._judge_count("too few corners (blank or blurred)")

    def add(self, image: np.ndarray) -> TwoViewGeometry | None:
        """The next frame, H×W in [0, 1]; None where it does not make a start, with `reason` set.

        Raises InputError where its shape is not the camera's, or before `begin`.
        """
        if self._tracks is None:
            raise InputError("two-view start: begin() with a first frame comes before add()")
        if self.exhausted:
            return None
        self._tracks.advance(self._checked(image))
        self._judge_count("too few tracked corners")
        if self.exhausted:
            return None
        matches = Matches.of(self._camera, self._tracks.first, self._tracks.current)
        try:
            return self._solve(matches)
        except _Refusal as refusal:
            self.reason = str(refusal)
            return None

    def _checked(self, image: np.ndarray) -> np.ndarray:
        if np.shape(image) != self._camera.shape:
            raise InputError(
                f"two-view start: an image of shape {np.shape(image)} for a camera of {self._camera.shape}"
            )
        return np.asarray(image, np.float32)

    def _judge_count(self, problem: str) -> None:
        count, needed = len(self._tracks), self._options.min_points
        self.exhausted = count < needed
        self.reason = f"{problem}: {count}; needs {needed}" if self.exhausted else ""

    def _solve(self, matches: Matches) -> TwoViewGeometry:
        R, flow = self._rotation(matches)
        homography = _homography(matches, self._seed)
        motions = _explanations(matches, R, flow, homography, self._seed)
        noise = self._noise(matches, motions[0])
        self._require_parallax(matches, motions[0], noise)
        planes = _plane_explanations(matches, homography, noise)
        planar = bool(planes) and _plane_suffices(matches, motions[0], planes[0], noise)
        motions = planes if planar else _sharpened(matches, motions, noise)
        self._require_one(motions, noise, len(matches), planar)
        return self._geometry(matches, motions[0], noise)

    def _rotation(self, matches: Matches) -> tuple[np.ndarray, float]:
        """The rotation that explains most, and the median flow that remains; refuses where that is next to none."""
        moved = float(np.median(np.linalg.norm(matches.second - matches.first, axis=1)))
        R = fit_rotation(matches, np.geomspace(max(2 * moved, 4.0), 2.0, 8))
        remaining = float(np.median(np.linalg.norm(rotation_flow(matches, R), axis=1)))
        needed = self._options.min_rotation_residual
        if remaining < needed:
            kind = "rotation only" if moved > _CLEARLY * needed else "too little parallax"
            raise _Refusal(f"{kind} ({remaining:.1f} px after rotation is removed; needs {needed:.1f})")
        return R, remaining

    def _noise(self, matches: Matches, motion: _Motion) -> float:
        """Standard deviation of the matches; refuses where no rigid motion explains them."""
        noise = _spread_of_inliers(triangulate(matches, motion.R, motion.t).error)
        if noise > self._options.max_noise:
            raise _Refusal(f"no rigid motion explains the matches (noise {noise:.1f} px)")
        return max(noise, _LEAST_NOISE)

    def _require_one(self, motions: list[_Motion], noise: float, count: int, planar: bool) -> None:
        """Refuses where another motion is about as good."""
        for other in motions[1:]:
            margin = (other.cost - motions[0].cost) / (noise**2 * count)
            if margin < self._options.min_margin and _apart(motions[0], other):
                raise _Refusal("two-fold ambiguity of a plane" if planar else "two motions explain the matches")

    def _geometry(self, matches: Matches, motion: _Motion, noise: float) -> TwoViewGeometry:
        seen = triangulate(matches, motion.R, motion.t)
        good = _explained(matches, motion, seen, noise)
        far = good & (seen.disparity < 2 * noise)
        self._require_spread(matches, good & ~far)
        parallax, angle = self._require_parallax(matches, motion, noise)
        std = _uncertainty(matches.subset(good), motion, noise)
        if std > self._options.max_direction_std:
            limit = np.degrees(self._options.max_direction_std)
            raise _Refusal(f"uncertain motion (direction known to {np.degrees(std):.1f}°; needs {limit:.1f}°)")
        return _scaled(matches.subset(good & ~far), motion, noise, std, parallax, angle)

    def _require_spread(self, matches: Matches, near: np.ndarray) -> None:
        if near.sum() < self._options.min_points:
            raise _Refusal(f"too few points with a depth: {near.sum()}; needs {self._options.min_points}")
        used = int((np.bincount(_cells(matches)[near]) >= 3).sum())
        if used < self._options.min_cells:
            raise _Refusal(f"points in too small a part of the image ({used} of 16 cells)")

    def _require_parallax(self, matches: Matches, motion: _Motion, noise: float) -> tuple[float, float]:
        """Median parallax in pixels and in radians; refuses where it is too little."""
        seen = triangulate(matches, motion.R, motion.t)
        good = _explained(matches, motion, seen, noise)
        if good.mean() < self._options.min_inliers:
            raise _Refusal(f"no rigid motion explains enough matches ({100 * good.mean():.0f} %)")
        parallax = float(np.median(seen.disparity[good]))
        angle = float(np.median(_ray_angles(matches.subset(good), motion.R)))
        if parallax < self._options.min_parallax or angle < self._options.min_angle:
            raise _Refusal(
                f"too little parallax ({parallax:.1f} px, {np.degrees(angle):.2f}° after rotation is removed; needs "
                f"{self._options.min_parallax:.1f} px, {np.degrees(self._options.min_angle):.2f}°)"
            )
        return parallax, angle


def _explanations(matches: Matches, R: np.ndarray, flow: float, homography, seed: int) -> list[_Motion]:
    """The minima that are reached from many starts, best first."""
    coarse = np.concatenate([np.geomspace(max(2 * flow, 3.0), _FINEST, 8), np.full(4, _FINEST)])
    few = matches.subset(slice(None, None, -(-len(matches) // _FEW)))
    found = [refine_motion(few, R, t, coarse) for t in _directions(_STARTS)]
    starts = _sampled_motions(matches, seed) + [(R_, t) for R_, t, _ in _decomposed(homography)]
    starts = [(R_, t) for R_, t in starts if np.trace(R.T @ R_) > 1]  # not the twin that is turned by 180° about t
    found += [refine_motion(few, R_, t, np.full(6, _FINEST)) for R_, t in starts]
    distinct: list[tuple] = []
    for R_, t, cost in sorted(found, key=lambda motion: motion[2]):
        if all(abs(t @ other) < np.cos(_DISTINCT / 3) for _, other, _ in distinct):
            distinct.append((R_, t, cost))
    motions = [
        _judged(matches, *refine_motion(matches, R_, t, np.full(6, _FINEST))[:2], _FINEST)
        for R_, t, _ in distinct[:_KEPT]
    ]
    return sorted(motions, key=lambda motion: motion.cost)


def _sharpened(matches: Matches, motions: list[_Motion], noise: float) -> list[_Motion]:
    """The same minima for errors of the size of the noise, best first."""
    scale = np.full(8, _INLIER * noise)
    refined = [_judged(matches, *refine_motion(matches, m.R, m.t, scale)[:2], _INLIER * noise) for m in motions]
    return sorted(refined, key=lambda motion: motion.cost)


def _judged(matches: Matches, R: np.ndarray, t: np.ndarray, scale: float) -> _Motion:
    """The motion with the sign of t that has more points before the cameras, and its cost."""
    seen = triangulate(matches, R, t)
    inlier = np.abs(seen.error) < 2 * scale
    if np.sum(seen.disparity[inlier] > 0) < 0.5 * inlier.sum():
        t, seen = -t, triangulate(matches, R, -t)
    return _Motion(R, t, _cost(seen, scale))


def _cost(seen: Triangulation, scale: float) -> float:
    behind = np.minimum(seen.disparity, 0.0)  # a distant point may be a little behind the plane at infinity
    square = seen.error**2 + behind**2
    return float((square / (1 + square / scale**2)).sum())


def _explained(matches: Matches, motion: _Motion, seen: Triangulation, noise: float) -> np.ndarray:
    good = (np.abs(seen.error) < _INLIER * noise) & (seen.disparity > -_INLIER * noise)
    if motion.plane is None:
        return good
    residual = plane_residual(matches, motion.R, motion.t, motion.plane)
    return good & (np.linalg.norm(residual, axis=1) < _PLANE_INLIER * noise)


def _spread_of_inliers(error: np.ndarray) -> float:
    """Standard deviation of normal errors of which up to half are replaced by larger ones."""
    error = np.abs(error)
    noise = float(np.quantile(error, 0.35)) / 0.454  # the quantile of |N(0, 1)|
    for _ in range(4):
        noise = 1.4826 * float(np.median(error[error <= _INLIER * noise]))
    return noise


def _cells(matches: Matches) -> np.ndarray:
    """Number of the image's cell in which each first pixel is, int64 N."""
    cell = np.floor(matches.first * _CELLS / (matches.camera.width, matches.camera.height)).astype(np.int64)
    return cell[:, 1] * _CELLS + cell[:, 0]


def _uncertainty(matches: Matches, motion: _Motion, noise: float) -> float:
    """Standard deviation of t's direction, radians: the larger of the formal one and the jackknife's over image cells.

    Errors of neighbouring matches go together, which the formal one ignores; leaving out whole cells does not.
    """
    if motion.plane is not None:
        return motion.direction_std
    cell = _cells(matches)
    scale = np.full(4, _INLIER * noise)
    without = [matches.subset(cell != k) for k in np.unique(cell) if np.mean(cell == k) < 0.5]
    ts = np.array([refine_motion(m, motion.R, motion.t, scale)[1] for m in without])
    spread = np.linalg.norm(ts - ts.mean(axis=0), ord=2) * np.sqrt((len(ts) - 1) / len(ts))
    return max(float(spread), direction_std(matches, motion.R, motion.t, _INLIER * noise, noise))


def _apart(one: _Motion, other: _Motion) -> bool:
    return float(one.t @ other.t) < np.cos(_DISTINCT)


def _directions(count: int) -> np.ndarray:
    """Unit vectors spread evenly over half the sphere (a Fibonacci lattice), float64 N×3."""
    k = np.arange(count)
    z, angle = (k + 0.5) / count, np.pi * (3 - np.sqrt(5)) * k
    return np.stack([np.sqrt(1 - z**2) * np.cos(angle), np.sqrt(1 - z**2) * np.sin(angle), z], axis=1)


def _sampling(seed: int, threshold: float) -> cv2.UsacParams:
    params = cv2.UsacParams()
    params.randomGeneratorState = seed
    params.threshold = threshold
    params.maxIterations = _RANSAC_STEPS
    params.score = cv2.SCORE_METHOD_MAGSAC
    params.loMethod = cv2.LOCAL_OPTIM_SIGMA
    return params


def _sampled_motions(matches: Matches, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(R, t) of the essential matrix that explains most, by both of its rotations."""
    K = matches.camera.matrix
    E, _ = cv2.findEssentialMat(matches.first, matches.second, K, K, None, None, _sampling(seed, _FINEST))
    if E is None or E.shape != (3, 3) or not np.isfinite(E).all():
        return []
    R1, R2, t = cv2.decomposeEssentialMat(E)
    return [(R, t[:, 0]) for R in (R1, R2)]


def _homography(matches: Matches, seed: int) -> np.ndarray | None:
    """The homography between normalized coordinates that explains most, float64 3×3."""
    H, _ = cv2.findHomography(matches.first, matches.second, _sampling(seed, 2 * _FINEST))
    if H is None or not np.isfinite(H).all():
        return None
    K = matches.camera.matrix
    return np.linalg.inv(K) @ H @ K


def _decomposed(homography: np.ndarray | None) -> list[tuple[np.ndarray, np.ndarray, np.ndarray]]:
    """(R, t, plane) with H ∝ R + t planeᵀ, up to four (Malis and Vargas, 2007)."""
    if homography is None or abs(np.linalg.det(homography)) < 1e-9:
        return []
    _, rotations, translations, normals = cv2.decomposeHomographyMat(homography, np.eye(3))
    parts = [(R, t[:, 0], n[:, 0]) for R, t, n in zip(rotations, translations, normals, strict=True)]
    return [
        part
        for part in parts
        if np.isfinite(np.concatenate([*part[0], *part[1:]])).all() and np.linalg.norm(part[1]) > 1e-6
    ]


def _plane_explanations(matches: Matches, homography: np.ndarray | None, noise: float) -> list[_Motion]:
    """The motions by which the homography's plane is before both cameras, best first."""
    motions: list[_Motion] = []
    if homography is None or _share_on_plane(matches, homography) < _PLANAR_SHARE:
        return motions
    scales = np.geomspace(2 * _INLIER * noise, _INLIER * noise, 6)
    for R, t, plane in _decomposed(homography):
        R, t, plane, std = refine_plane(matches, R, t, plane, scales, noise)
        on_plane = np.linalg.norm(plane_residual(matches, R, t, plane), axis=1) < _PLANE_INLIER * noise
        depth = matches.x1[on_plane] @ plane
        if len(depth) and np.mean(depth > 0) > _BEFORE:
            motions.append(_Motion(R, t, _cost(triangulate(matches, R, t), _INLIER * noise), plane, std))
    return sorted(motions, key=lambda motion: motion.cost)


def _share_on_plane(matches: Matches, homography: np.ndarray) -> float:
    p = matches.x1 @ homography.T
    error = np.linalg.norm(matches.focal * (p[:, :2] / p[:, 2:] - matches.x2[:, :2]), axis=1)
    return float(np.mean(error < 2 * _FINEST))


def _plane_suffices(matches: Matches, motion: _Motion, plane: _Motion, noise: float) -> bool:
    """Whether GRIC prefers the plane (2 dimensions, 8 parameters) to free depths (3 dimensions, 5 parameters)."""
    count = len(matches)
    free = (triangulate(matches, motion.R, motion.t).error / noise) ** 2
    flat = (plane_residual(matches, plane.R, plane.t, plane.plane) ** 2).sum(axis=1) / noise**2
    penalty = np.log(4.0) * count
    gric_free = np.minimum(free, 2.0).sum() + 3 * penalty + 5 * np.log(4.0 * count)
    gric_flat = np.minimum(flat, 4.0).sum() + 2 * penalty + 8 * np.log(4.0 * count)
    return bool(gric_flat < gric_free)


def _ray_angles(matches: Matches, R: np.ndarray) -> np.ndarray:
    a, b = matches.x1 @ R.T, matches.x2
    return np.arctan2(np.linalg.norm(np.cross(a, b), axis=1), (a * b).sum(axis=1))


def _scaled(
    matches: Matches, motion: _Motion, noise: float, std: float, parallax: float, angle: float
) -> TwoViewGeometry:
    """The result in the unit in which the mean inverse depth is 1."""
    seen = triangulate(matches, motion.R, motion.t)
    scale = float(seen.inverse_depth.mean())
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = motion.R, motion.t * scale
    return TwoViewGeometry(
        T_second_first=T,
        pixels=matches.first.astype(np.float32),
        second_pixels=matches.second.astype(np.float32),
        inverse_depth=(seen.inverse_depth / scale).astype(np.float32),
        inverse_depth_std=(noise / (seen.slope * scale)).astype(np.float32),
        parallax=parallax,
        angle=angle,
        noise=noise,
        direction_std=std,
        planar=motion.plane is not None,
    )
