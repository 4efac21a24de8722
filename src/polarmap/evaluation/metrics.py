"""Figures of merit of depth, normals and trajectories against the truth, from arrays.

A depth counts as known where it is finite, a true depth where it is finite and positive.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, TypeVar

import numpy as np
from pydantic import BeforeValidator

from polarmap.evaluation.alignment import umeyama

# A figure that is NaN where nothing could be measured; JSON has null for it.
Figure = Annotated[float, BeforeValidator(lambda value: float("nan") if value is None else value)]

_NONE = float("nan")
_CURVE_BINS = 100


@dataclass(frozen=True)
class DepthMetrics:
    """Depth z against true depth, all shares in [0, 1].

    points: pixels that have depth; density: their share of all pixels of the image.
    compared: points that have a true depth too; the next three are over them, NaN where there are none.
    abs_rel: mean |z - z_gt| / z_gt (the paper's AbsRel, Section IV). rmse: root mean square of z - z_gt, metres.
    delta1, delta2, delta3: share with max(z/z_gt, z_gt/z) < 1.25, 1.25², 1.25³.
    within: share of *all* pixels of the image that have depth within 2 % of the truth; within_1, within_5: 1 and 5 %.
    Pixels without a true depth count as all others there, and cannot be right.
    """

    points: float
    density: Figure
    compared: float
    abs_rel: Figure
    rmse: Figure
    delta1: Figure
    within: Figure
    delta2: Figure = _NONE
    delta3: Figure = _NONE
    within_1: Figure = _NONE
    within_5: Figure = _NONE


@dataclass(frozen=True)
class NormalMetrics:
    """Angle between normals and true normals in degrees: its median, and shares of the `compared` pixels below
    11.25°, 22.5° and 30°; NaN where there are none."""

    compared: float
    median: Figure
    below_11: Figure
    below_22: Figure
    below_30: Figure


@dataclass(frozen=True)
class SigmaMetrics:
    """How honest the standard deviation σ of depth is.

    Shares of the `compared` pixels whose |log z - log z_gt| is below one σ (of normal errors 68 %) and two (95 %),
    NaN where there are none.
    """

    compared: float
    within_one: Figure
    within_two: Figure


@dataclass(frozen=True)
class RegionMetrics:
    """curved: pixels whose true normals turn by 2 to 30 degrees over 8 pixels, with no step of depth near.

    curved_within: share of them whose depth is right to 2 %. curved_normals: median error of their normals, degrees.
    edges: pixels within 8 pixels of a step of true depth; edges_within: share of them right to 2 %. NaN without pixels.
    """

    curved: float
    curved_within: Figure
    curved_normals: Figure
    edges: float
    edges_within: Figure


@dataclass(frozen=True)
class ErrorStatistics:
    """Root mean square, mean, median and largest of errors; NaN where there are none."""

    rmse: Figure
    mean: Figure
    median: Figure
    max: Figure


@dataclass(frozen=True)
class RelativePoseError:
    """Error of the motion between poses that are `step` poses apart, over `pairs` pairs.

    translation: of its length, metres. rotation: of its angle, degrees.
    """

    step: int
    pairs: int
    translation: ErrorStatistics
    rotation: ErrorStatistics


@dataclass(frozen=True)
class TrajectoryMetrics:
    """Absolute trajectory error, rms distance of the camera's positions in metres, over `poses` of `of` poses.

    of: poses of the run; those without a true pose at their time are not compared. Figures are NaN where too few are.

    unaligned: as they are. rigid: after the best rotation and translation. similar: after the best scale too,
    which is `scale`, true units per unit of the run.
    ate_rigid, ate_similar: the distances behind `rigid` and `similar` in further figures. rpe, rpe_similar: errors of
    the motion from pose to pose, as it is and with its length multiplied by `scale`. None where not computed.
    """

    poses: int
    unaligned: Figure
    rigid: Figure
    similar: Figure
    scale: Figure
    ate_rigid: ErrorStatistics | None = None
    ate_similar: ErrorStatistics | None = None
    rpe: RelativePoseError | None = None
    rpe_similar: RelativePoseError | None = None
    of: int = 0


@dataclass(frozen=True)
class ConfidenceCurve:
    """Accuracy of the most confident pixels, all keyframes together, from few to all of them.

    confidence: the least that is included. density: share of all pixels that is. abs_rel: theirs, NaN where none
    has a true depth. All of the same length, empty steps left out.
    """

    confidence: tuple[float, ...]
    density: tuple[float, ...]
    abs_rel: tuple[Figure, ...]

    def __post_init__(self) -> None:
        if not len(self.confidence) == len(self.density) == len(self.abs_rel):
            raise ValueError("confidence, density and abs_rel must have the same length")
        if not all(0 <= share <= 1 for share in self.density):
            raise ValueError("density must be shares in [0, 1]")


Metrics = TypeVar("Metrics", DepthMetrics, NormalMetrics, SigmaMetrics, RegionMetrics)


def depth_metrics(depth: np.ndarray, truth: np.ndarray, tolerance: float = 0.02) -> DepthMetrics:
    """Compare depth with true depth, both H×W z in metres with NaN where none. tolerance: that of `within`."""
    compared, z, z_gt = _pairs(depth, truth)
    error = z - z_gt
    relative = np.abs(error) / z_gt
    nearer, farther = np.minimum(z, z_gt), np.maximum(z, z_gt)
    points = int(np.count_nonzero(np.isfinite(depth)))
    within = [int(np.count_nonzero(relative <= limit)) / depth.size for limit in (tolerance, 0.01, 0.05)]
    return DepthMetrics(
        points=points,
        density=points / depth.size,
        compared=int(np.count_nonzero(compared)),
        abs_rel=_mean(relative),
        rmse=float(np.sqrt(_mean(error**2))),
        delta1=_mean(farther < 1.25 * nearer),
        within=within[0],
        delta2=_mean(farther < 1.25**2 * nearer),
        delta3=_mean(farther < 1.25**3 * nearer),
        within_1=within[1],
        within_5=within[2],
    )


def normal_metrics(normal: np.ndarray, truth: np.ndarray) -> NormalMetrics:
    """Compare unit normals with true ones, both H×W×3 with NaN where none."""
    cosine = np.einsum("hwc,hwc->hw", normal, truth)
    degrees = np.degrees(np.arccos(np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0)))
    median = float(np.median(degrees)) if degrees.size else _NONE
    return NormalMetrics(degrees.size, median, *(_mean(degrees < limit) for limit in (11.25, 22.5, 30.0)))


def sigma_metrics(depth: np.ndarray, sigma: np.ndarray, truth: np.ndarray) -> SigmaMetrics:
    """Compare errors of depth with their standard deviation `sigma`, a share of depth; H×W each, NaN where unknown."""
    compared, z, z_gt = _pairs(np.where(np.isfinite(sigma), depth, np.nan), truth)
    error = np.abs(np.log(z / z_gt))
    return SigmaMetrics(error.size, *(_mean(error < n * sigma[compared]) for n in (1.0, 2.0)))


def trajectory_metrics(positions: np.ndarray, truth: np.ndarray) -> TrajectoryMetrics:
    """Compare camera positions with the true ones at the same times, both float N×3 in metres, N at least 1.

    The similarity is NaN where the camera did not move, by one of them.
    """
    moved = bool(np.ptp(positions, axis=0).max() > 0 and np.ptp(truth, axis=0).max() > 0)
    rigid = error_statistics(_distances(umeyama(positions, truth, with_scale=False).apply(positions), truth))
    similarity = umeyama(positions, truth) if moved else None
    similar = error_statistics(_distances(similarity.apply(positions), truth) if similarity else np.empty(0))
    return TrajectoryMetrics(
        poses=len(positions),
        unaligned=error_statistics(_distances(positions, truth)).rmse,
        rigid=rigid.rmse,
        similar=similar.rmse,
        scale=similarity.scale if similarity else _NONE,
        ate_rigid=rigid,
        ate_similar=similar,
        of=len(positions),
    )


def relative_pose_error(
    poses: np.ndarray, truth: np.ndarray, scale: float = 1.0, step: int = 1
) -> RelativePoseError | None:
    """Error of the motion between poses `step` apart, all pairs of them (Sturm et al., IROS 2012, equation 2).

    With P the poses, their translations multiplied by `scale`, and Q the true ones, T_world_camera N×4×4 both:
    E = (Q_i⁻¹ Q_j)⁻¹ (P_i⁻¹ P_j), j = i + step. A rigid motion of the whole does not change it. None without a pair.
    """
    if len(poses) <= step:
        return None
    scaled = poses.astype(np.float64)
    scaled[:, :3, 3] *= scale
    errors = np.linalg.solve(_motions(truth.astype(np.float64), step), _motions(scaled, step))
    sine = 0.5 * np.linalg.norm(_axial(errors[:, :3, :3]), axis=1)
    cosine = 0.5 * (np.trace(errors[:, :3, :3], axis1=1, axis2=2) - 1.0)
    return RelativePoseError(
        step,
        len(errors),
        error_statistics(np.linalg.norm(errors[:, :3, 3], axis=1)),
        error_statistics(np.degrees(np.arctan2(sine, cosine))),
    )


def error_statistics(errors: np.ndarray) -> ErrorStatistics:
    """Figures of errors, float N; all NaN without any."""
    if not errors.size:
        return ErrorStatistics(*(_NONE,) * 4)
    figures = np.sqrt(np.mean(errors**2)), np.mean(errors), np.median(errors), np.max(errors)
    return ErrorStatistics(*map(float, figures))


def mean_metrics(metrics: Sequence[Metrics]) -> Metrics:
    """The mean of each figure; those that are NaN are left out of theirs. At least one is needed."""
    kind = type(metrics[0])
    columns = {field.name: [getattr(m, field.name) for m in metrics] for field in fields(kind)}
    return kind(**{name: _mean(np.array([v for v in column if v == v], float)) for name, column in columns.items()})


def mean_of_known(metrics: Sequence[Metrics | None]) -> Metrics | None:
    """As `mean_metrics` of those that were measured; None where none was."""
    known = [m for m in metrics if m is not None]
    return mean_metrics(known) if known else None


class ConfidenceHistogram:
    """Collects pixels by confidence, keyframe by keyframe, for a `ConfidenceCurve`; memory does not grow."""

    def __init__(self) -> None:
        self._pixels = 0
        self._points, self._compared, self._error = np.zeros((3, _CURVE_BINS))

    def add(self, depth: np.ndarray, confidence: np.ndarray, truth: np.ndarray) -> None:
        """Add the pixels of a keyframe: depth and truth as in `depth_metrics`, confidence float H×W in [0, 1]."""
        compared, z, z_gt = _pairs(depth, truth)
        step = np.minimum((confidence * _CURVE_BINS).astype(np.int64), _CURVE_BINS - 1)
        relative = np.abs(z - z_gt) / z_gt
        self._pixels += depth.size
        self._points += np.bincount(step[np.isfinite(depth)], minlength=_CURVE_BINS)
        self._compared += np.bincount(step[compared], minlength=_CURVE_BINS)
        self._error += np.bincount(step[compared], relative, minlength=_CURVE_BINS)

    def curve(self) -> ConfidenceCurve:
        """The curve of what was added."""
        filled = np.flatnonzero(self._points)[::-1]
        points, compared, error = (np.cumsum(h[filled]) for h in (self._points, self._compared, self._error))
        with np.errstate(invalid="ignore"):
            abs_rel = error / compared
        return ConfidenceCurve(
            confidence=tuple((filled / _CURVE_BINS).tolist()),
            density=tuple((points / max(self._pixels, 1)).tolist()),
            abs_rel=tuple(abs_rel.tolist()),
        )


def _pairs(depth: np.ndarray, truth: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Where both are known, and their values there, float64."""
    compared = np.isfinite(depth) & np.isfinite(truth) & (truth > 0)
    return compared, depth[compared].astype(np.float64), truth[compared].astype(np.float64)


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if values.size else _NONE


def _distances(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.linalg.norm(a - b, axis=1)


def _motions(poses: np.ndarray, step: int) -> np.ndarray:
    """From each pose to the one `step` later, seen from it."""
    return np.linalg.solve(poses[:-step], poses[step:])


def _axial(R: np.ndarray) -> np.ndarray:
    """2 sin θ times the axis of each rotation, N×3."""
    return np.stack([R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]], axis=1)
