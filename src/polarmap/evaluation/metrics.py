"""Figures of merit of depth, normals and trajectories against the truth, from arrays."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, fields
from typing import Annotated, TypeVar

import numpy as np
from pydantic import BeforeValidator

from polarmap.evaluation.alignment import umeyama

# A figure that is NaN where nothing could be measured; JSON has null for it.
Figure = Annotated[float, BeforeValidator(lambda value: float("nan") if value is None else value)]

_CURVE_BINS = 100


@dataclass(frozen=True)
class DepthMetrics:
    """Depth z against true depth, all shares in [0, 1].

    points: pixels that have depth; density: their share of all pixels of the image.
    compared: points that have a true depth too; the next three are over them, NaN where there are none.
    abs_rel: mean |z - z_gt| / z_gt (the paper's AbsRel, Section IV). rmse: root mean square of z - z_gt, metres.
    delta1: share with max(z/z_gt, z_gt/z) < 1.25.
    within: share of *all* pixels of the image that have depth within 2 % of the truth.
    """

    points: float
    density: float
    compared: float
    abs_rel: Figure
    rmse: Figure
    delta1: Figure
    within: float


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
class TrajectoryMetrics:
    """Absolute trajectory error, rms distance of the camera's positions in metres, over `poses` poses.

    unaligned: as they are. rigid: after the best rotation and translation. similar: after the best scale too,
    which is `scale`, true units per unit of the run.
    """

    poses: int
    unaligned: float
    rigid: float
    similar: Figure
    scale: Figure


@dataclass(frozen=True)
class ConfidenceCurve:
    """Accuracy of the most confident pixels, all keyframes together, from few to all of them.

    confidence: the least that is included. density: share of all pixels that is. abs_rel: theirs, NaN where none
    has a true depth. All of the same length, empty steps left out.
    """

    confidence: tuple[float, ...]
    density: tuple[float, ...]
    abs_rel: tuple[Figure, ...]


Metrics = TypeVar("Metrics", DepthMetrics, NormalMetrics)


def depth_metrics(depth: np.ndarray, truth: np.ndarray, tolerance: float = 0.02) -> DepthMetrics:
    """Compare depth with true depth, both H×W z in metres with NaN where none."""
    compared, z, z_gt = _pairs(depth, truth)
    error = z - z_gt
    relative = np.abs(error) / z_gt
    points = int(np.count_nonzero(np.isfinite(depth)))
    return DepthMetrics(
        points=points,
        density=points / depth.size,
        compared=int(np.count_nonzero(compared)),
        abs_rel=_mean(relative),
        rmse=float(np.sqrt(_mean(error**2))),
        delta1=_mean(np.maximum(z, z_gt) < 1.25 * np.minimum(z, z_gt)),
        within=int(np.count_nonzero(relative <= tolerance)) / depth.size,
    )


def normal_metrics(normal: np.ndarray, truth: np.ndarray) -> NormalMetrics:
    """Compare unit normals with true ones, both H×W×3 with NaN where none."""
    cosine = np.einsum("hwc,hwc->hw", normal, truth)
    degrees = np.degrees(np.arccos(np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0)))
    median = float(np.median(degrees)) if degrees.size else float("nan")
    return NormalMetrics(degrees.size, median, *(_mean(degrees < limit) for limit in (11.25, 22.5, 30.0)))


def trajectory_metrics(positions: np.ndarray, truth: np.ndarray) -> TrajectoryMetrics:
    """Compare camera positions with the true ones at the same times, both float N×3 in metres, N at least 1.

    The similarity is NaN where the camera did not move.
    """
    moved = bool(np.ptp(positions, axis=0).max() > 0)
    rigid = umeyama(positions, truth, with_scale=False)
    similar = umeyama(positions, truth) if moved else None
    return TrajectoryMetrics(
        poses=len(positions),
        unaligned=_rms_distance(positions, truth),
        rigid=_rms_distance(rigid.apply(positions), truth),
        similar=_rms_distance(similar.apply(positions), truth) if similar else float("nan"),
        scale=similar.scale if similar else float("nan"),
    )


def mean_metrics(metrics: Sequence[Metrics]) -> Metrics:
    """The mean of each figure; those that are NaN are left out of theirs. At least one is needed."""
    kind = type(metrics[0])
    columns = {field.name: [getattr(m, field.name) for m in metrics] for field in fields(kind)}
    return kind(**{name: _mean(np.array([v for v in column if v == v], float)) for name, column in columns.items()})


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
    compared = np.isfinite(depth) & np.isfinite(truth)
    return compared, depth[compared].astype(np.float64), truth[compared].astype(np.float64)


def _mean(values: np.ndarray) -> float:
    return float(np.mean(values)) if values.size else float("nan")


def _rms_distance(a: np.ndarray, b: np.ndarray) -> float:
    return float(np.sqrt(np.mean(np.sum((a - b) ** 2, axis=1))))
