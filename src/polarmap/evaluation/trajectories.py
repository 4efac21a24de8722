"""Trajectories against the true one."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np

from polarmap.data.trajectory import Trajectory
from polarmap.evaluation.metrics import TrajectoryMetrics, relative_pose_error, trajectory_metrics
from polarmap.io.formats.rounded_positions import warn_of_rounding

LEAST_POSES = 3
"""True poses that a trajectory needs for its error and its scale to be known."""

_NONE = float("nan")


def compare_trajectories(run: Trajectory, truth: Trajectory) -> TrajectoryMetrics | None:
    """Error of a trajectory's poses at its times, NaN from fewer than `LEAST_POSES`; None where none has a true one.

    Warns where the positions of one of them have been rounded far from the origin.
    """
    for trajectory in (run, truth):
        warn_of_rounding(trajectory)
    pairs = [(pose, truth.at(t)) for t, pose in zip(run.timestamps.tolist(), run.poses, strict=True)]
    known = [(pose, true) for pose, true in pairs if true is not None]
    if not known:
        return None
    if len(known) < LEAST_POSES:
        return TrajectoryMetrics(len(known), _NONE, _NONE, _NONE, _NONE, of=len(run))
    poses, true_poses = np.array(known, float).transpose(1, 0, 2, 3)
    metrics = trajectory_metrics(poses[:, :3, 3], true_poses[:, :3, 3])
    moved = np.isfinite(metrics.scale)
    return replace(
        metrics,
        of=len(run),
        rpe=relative_pose_error(poses, true_poses),
        rpe_similar=relative_pose_error(poses, true_poses, metrics.scale) if moved else None,
    )


def poses_at(trajectory: Trajectory | None, times: Mapping[int, float]) -> dict[int, np.ndarray]:
    """T_world_camera, float64 4×4, by index of the frames at whose times the trajectory has one.

    times: seconds by index of the frame; where one of them is NaN, as in a sequence without times, there are no poses.
    """
    if trajectory is None or any(np.isnan(time) for time in times.values()):
        return {}
    found = {index: trajectory.at(time) for index, time in times.items()}
    return {index: pose for index, pose in found.items() if pose is not None}
