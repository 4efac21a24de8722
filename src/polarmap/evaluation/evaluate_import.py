"""How good another program's results are: the figures of `evaluate_run`, by the same code."""

from __future__ import annotations

from collections.abc import Collection
from typing import Literal

import numpy as np

from polarmap.errors import InputError
from polarmap.evaluation.imported import ImportedDepth, ImportedFrame, ImportedRun
from polarmap.evaluation.metrics import (
    ConfidenceHistogram,
    DepthMetrics,
    TrajectoryMetrics,
    depth_metrics,
    mean_metrics,
    mean_of_known,
    normal_metrics,
)
from polarmap.evaluation.records import FINAL, Evaluation, KeyframeEvaluation, Scale
from polarmap.evaluation.regions import region_metrics
from polarmap.evaluation.trajectories import LEAST_POSES, compare_trajectories
from polarmap.evaluation.truth import Truth

ScaleRule = Literal["auto", "as-is", "trajectory", "median"]

_SAMPLES_PER_FRAME = 20_000
_NONE = float("nan")
_NOTHING = DepthMetrics(0, _NONE, 0, _NONE, _NONE, _NONE, _NONE)


def evaluate_import(
    run: ImportedRun, truth: Truth, scale: ScaleRule = "auto", indices: Collection[int] | None = None
) -> Evaluation:
    """Compare an imported run with the truth of its sequence, one frame in memory at a time.

    scale: what its depth is multiplied by. "as-is": 1. "trajectory": the scale of the Sim(3) that takes its trajectory
    to the true one. "median": the median of true depth / depth over all frames together, which uses the very truth
    that is then compared with. "auto": by trajectory where that is possible, else as it is.
    indices: frames to evaluate, by default all that the run has.
    Results without depth (a point cloud, a trajectory) give an Evaluation without keyframes.
    Raises InputError where a file is malformed or of another camera, the scale cannot be found, or no frame of the run
    has a true depth.
    """
    frames = [frame for frame in run.frames if indices is None or frame.index in indices]
    if run.frames and not frames:
        raise InputError(f"{run.path}: has none of the frames that are to be compared")
    trajectory = _trajectory(run, truth)
    factor = find_scale(run, truth, scale, trajectory)
    histogram = ConfidenceHistogram()
    rows = [_evaluate_frame(frame, truth, factor.factor, histogram) for frame in frames]
    keyframes = tuple(row for row in rows if row is not None)
    if frames and not keyframes:
        raise InputError(f"{truth.source}: no true depth (depth/NAME.png) for any of the {len(rows)} frames")
    if not frames and run.surface is None and trajectory is None:
        raise InputError(f"{truth.source}: no true pose (groundtruth.txt) at any time of {run.path}")
    depth = mean_metrics([k.depth for k in keyframes]) if keyframes else _NOTHING
    no_normals = normal_metrics(np.empty((0, 0, 3)), np.empty((0, 0, 3)))
    return Evaluation(
        run=str(run.path),
        sequence=truth.source,
        scale=factor,
        depth=depth,
        by_origin={},
        stages={FINAL: depth},
        normals=mean_metrics([k.normals for k in keyframes]) if keyframes else no_normals,
        normal_truth=truth.normal_source,
        trajectory=trajectory,
        curve=histogram.curve(),
        without_truth=len(rows) - len(keyframes),
        keyframes=keyframes,
        regions=mean_of_known([k.regions for k in keyframes]),
        format=run.format,
        sparse=run.sparse,
    )


def find_scale(run: ImportedRun, truth: Truth, rule: ScaleRule, trajectory: TrajectoryMetrics | None = None) -> Scale:
    """What to multiply a run's depth by, under a rule of `evaluate_import`; trajectory: its comparison, if known."""
    if rule not in ("auto", "as-is", "trajectory", "median"):
        raise InputError(f"scale {rule!r} is not one of auto, as-is, trajectory, median")
    if rule == "median":
        return Scale(_median_ratio(run, truth), "median of true depth / depth, one factor for all frames")
    trajectory = trajectory or _trajectory(run, truth)
    known = trajectory is not None and trajectory.poses >= LEAST_POSES and np.isfinite(trajectory.scale)
    if rule != "as-is" and known:
        return Scale(trajectory.scale, "its trajectory aligned with the true one (Sim(3))")
    if rule == "trajectory":
        raise InputError(
            f"{run.path}: no scale by trajectory: it needs {LEAST_POSES} poses of a moving camera at times that "
            f"{truth.source} has true poses of (groundtruth.txt)"
        )
    return Scale(1.0, "none: depth is taken as it is")


def _trajectory(run: ImportedRun, truth: Truth) -> TrajectoryMetrics | None:
    if truth.trajectory is None or run.trajectory is None:
        return None
    return compare_trajectories(run.trajectory, truth.trajectory)


def _median_ratio(run: ImportedRun, truth: Truth) -> float:
    ratios = [np.empty(0)]
    for frame in run.frames:
        depth = truth.depth(frame.index)
        if depth is not None:
            ratio = (depth / frame.read().depth).ravel()
            ratio = ratio[np.isfinite(ratio) & (ratio > 0)]
            ratios.append(ratio[:: max(1, len(ratio) // _SAMPLES_PER_FRAME)])
    together = np.concatenate(ratios)
    if not together.size:
        raise InputError(f"{run.path}: no scale by median: no pixel has depth and a true depth")
    return float(np.median(together))


def _evaluate_frame(
    frame: ImportedFrame, truth: Truth, scale: float, histogram: ConfidenceHistogram
) -> KeyframeEvaluation | None:
    """The frame's figures, its pixels added to the histogram as all of one confidence; None without true depth."""
    true = truth.image(frame.index)
    if true is None:
        return None
    found: ImportedDepth = frame.read()
    depth = np.float32(scale) * found.depth
    histogram.add(depth, np.ones(depth.shape, np.float32), true.depth)
    final = depth_metrics(depth, true.depth)
    normal = np.full_like(true.normal, np.nan) if found.normal is None else found.normal
    return KeyframeEvaluation(
        frame.index,
        final,
        {},
        {FINAL: final},
        normal_metrics(normal, true.normal),
        regions=region_metrics(depth, normal, true.depth, true.normal),
    )
