"""Odometry's sparse points as depth: what the map would be without stereo and densification.

The first column of the paper's ablation. At a keyframe direct sparse odometry knows the points of its window: its own
and those of the keyframes before it, projected into it.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np

from polarmap.data.odometry import OdometryResult
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.metrics import DepthMetrics, depth_metrics, mean_metrics
from polarmap.evaluation.resampling import project_points
from polarmap.evaluation.trajectories import LEAST_POSES, compare_trajectories
from polarmap.evaluation.truth import Truth
from polarmap.io.run_folder.odometry_files import segment_trajectory

WINDOW = 7
"""Keyframes whose points are projected, as many as odometry adjusts together by default."""

_MOST_UNCERTAIN = 0.1


@dataclass(frozen=True)
class SparseEvaluation:
    """depth: mean over the keyframes; its `points` are the points per image. keyframes: by index of the frame.

    left_out: keyframes without a true depth, or of segments whose scale is not known.
    """

    depth: DepthMetrics
    keyframes: dict[int, DepthMetrics]
    left_out: int


def evaluate_sparse(
    result: OdometryResult,
    truth: Truth,
    window: int = WINDOW,
    indices: Collection[int] | None = None,
) -> SparseEvaluation:
    """Compare the depth of odometry's points with the true depth at its keyframes.

    window: how many keyframes, the one itself included, whose points are projected into it; the nearest point of a
    pixel counts. Points whose inverse depth has a standard deviation of more than a tenth of it are left out: they may
    as well be at infinity. indices: keyframes to look at, by default all.
    Scale is by Sim(3) of each segment's trajectory to the true one.
    Raises InputError where no keyframe has both a true depth and a scale.
    """
    if window < 1:
        raise InputError(f"sparse points: needs a window of at least one keyframe, not {window}")
    scales = _scales(result, truth.trajectory)
    points = result.points
    known = np.flatnonzero(points.inverse_depth_std <= _MOST_UNCERTAIN * points.inverse_depth)
    order = known[np.argsort(points.host[known], kind="stable")]
    hosts = points.host[order]
    found: dict[int, DepthMetrics] = {}
    keyframes = [frame for frame in result.frames if frame.is_keyframe]
    for place, keyframe in enumerate(keyframes):
        if (indices is not None and keyframe.index not in indices) or keyframe.segment not in scales:
            continue
        true_depth = truth.depth(keyframe.index)
        if true_depth is None:
            continue
        before = [k for k in keyframes[: place + 1] if k.segment == keyframe.segment][-window:]
        own = np.concatenate([order[slice(*np.searchsorted(hosts, [k.index, k.index + 1]))] for k in before])
        depth = project_points(points.position[own], truth.camera, keyframe.T_world_camera)
        found[keyframe.index] = depth_metrics(np.float32(scales[keyframe.segment]) * depth, true_depth)
    if not found:
        raise InputError(
            f"{truth.source}: no keyframe of odometry has a true depth (depth/NAME.png) and true poses to scale it by"
        )
    wanted = len(keyframes) if indices is None else sum(k.index in indices for k in keyframes)
    return SparseEvaluation(mean_metrics(list(found.values())), found, wanted - len(found))


def _scales(result: OdometryResult, truth: Trajectory | None) -> dict[int, float]:
    """True units per unit of each segment that has enough true poses."""
    scales = {}
    for segment in result.segments if truth is not None else ():
        metrics = compare_trajectories(segment_trajectory(result, segment), truth)
        if metrics is not None and metrics.poses >= LEAST_POSES and np.isfinite(metrics.scale):
            scales[segment] = metrics.scale
    return scales
