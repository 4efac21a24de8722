"""How good a run is: its keyframes and poses against the true depth and poses of the sequence it mapped."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from functools import reduce
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from polarmap.densify.densify import Origin
from polarmap.errors import InputError
from polarmap.evaluation.metrics import (
    ConfidenceCurve,
    ConfidenceHistogram,
    DepthMetrics,
    NormalMetrics,
    TrajectoryMetrics,
    depth_metrics,
    mean_metrics,
    normal_metrics,
    trajectory_metrics,
)
from polarmap.evaluation.truth import normal_source, read_truth
from polarmap.io.files import read_text, write_bytes
from polarmap.io.keyframe_file import KeyframeResult
from polarmap.io.results import TRAJECTORY_NAME, RunResults, read_keyframes, read_results
from polarmap.io.sequence import Sequence
from polarmap.io.trajectory import Trajectory, read_trajectory

log = logging.getLogger(__name__)

FINAL = "final"

_ORIGINS = (Origin.STEREO, Origin.PROPAGATED, Origin.ESTIMATED)


@dataclass(frozen=True)
class KeyframeEvaluation:
    """One keyframe; index is its frame's. by_origin: stereo, propagated, estimated. stages: those that the run kept
    (stereo, inliers, first) and "final", which is `depth`."""

    index: int
    depth: DepthMetrics
    by_origin: dict[str, DepthMetrics]
    stages: dict[str, DepthMetrics]
    normals: NormalMetrics


@dataclass(frozen=True)
class Scale:
    """What depth was multiplied by before it was compared, and why."""

    factor: float
    reason: str


@dataclass(frozen=True)
class Evaluation:
    """A run against the truth. depth, by_origin, stages, normals: means over the keyframes.

    without_truth: keyframes that have no true depth and are left out.
    normal_truth: what the true normals are from.
    trajectory: None where the sequence has no true poses at the run's times.
    """

    run: str
    sequence: str
    scale: Scale
    depth: DepthMetrics
    by_origin: dict[str, DepthMetrics]
    stages: dict[str, DepthMetrics]
    normals: NormalMetrics
    normal_truth: str
    trajectory: TrajectoryMetrics | None
    curve: ConfidenceCurve
    without_truth: int
    keyframes: tuple[KeyframeEvaluation, ...]


def evaluate_run(out: Path | str, sequence: Sequence) -> Evaluation:
    """Compare the run in a folder with the truth of the sequence, one keyframe in memory at a time.

    Raises InputError where the folder is not that of a run, the sequence is not the one that was mapped, has no
    true depth, or lacks the true poses that the scale is to be found by.
    """
    out = Path(out)
    trajectory = _compare_trajectories(out, sequence)
    scale = _scale(read_results(out), trajectory, sequence)
    histogram = ConfidenceHistogram()
    rows = [_evaluate_keyframe(keyframe, sequence, scale.factor, histogram) for keyframe in read_keyframes(out)]
    keyframes = tuple(row for row in rows if row is not None)
    if not keyframes:
        raise InputError(f"{sequence.path}: no true depth (depth/NAME.png) for any of the {len(rows)} keyframes")
    return Evaluation(
        run=str(out),
        sequence=str(sequence.path),
        scale=scale,
        depth=mean_metrics([k.depth for k in keyframes]),
        by_origin=_mean_by_name([k.by_origin for k in keyframes]),
        stages=_mean_by_name([k.stages for k in keyframes]),
        normals=mean_metrics([k.normals for k in keyframes]),
        normal_truth=normal_source(sequence),
        trajectory=trajectory,
        curve=histogram.curve(),
        without_truth=len(rows) - len(keyframes),
        keyframes=keyframes,
    )


def write_evaluation(path: Path | str, evaluation: Evaluation) -> None:
    """Write an evaluation as JSON, NaN as null; PolarmapError where that fails."""
    write_bytes(Path(path), _JSON.dump_json(evaluation, indent=1) + b"\n")


def read_evaluation(path: Path | str) -> Evaluation:
    """An evaluation from JSON; InputError where the file is none."""
    try:
        return _JSON.validate_json(read_text(Path(path)))
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"]) or "JSON"
        raise InputError(
            f"{path}: not an evaluation as 'polarmap eval' writes it ({where}: {problem['msg']})"
        ) from None


def _compare_trajectories(out: Path, sequence: Sequence) -> TrajectoryMetrics | None:
    truth = sequence.truth_trajectory()
    if truth is None:
        return None
    run = read_trajectory(out / TRAJECTORY_NAME, "tum")
    positions, true_positions = _at_same_times(run, truth)
    if len(positions) == 0:
        log.warning("%s: no true pose at any time of %s", truth.source, run.source)
        return None
    return trajectory_metrics(positions, true_positions)


def _at_same_times(run: Trajectory, truth: Trajectory) -> tuple[np.ndarray, np.ndarray]:
    """Camera positions of the run, and the true ones at their times, N×3."""
    pairs = [(pose, truth.at(t)) for t, pose in zip(run.timestamps.tolist(), run.poses, strict=True)]
    known = [(pose[:3, 3], true[:3, 3]) for pose, true in pairs if true is not None]
    run_positions, true_positions = np.array(known, float).reshape(-1, 2, 3).transpose(1, 0, 2)
    return run_positions, true_positions


def _scale(results: RunResults, trajectory: TrajectoryMetrics | None, sequence: Sequence) -> Scale:
    if results.poses == "given":
        return Scale(1.0, "none: the poses were given, and depth has their unit")
    if trajectory is None or not np.isfinite(trajectory.scale):
        raise InputError(
            f"{sequence.path}: true poses (groundtruth.txt) of a moving camera at the run's times are needed "
            "to scale a run with odometry"
        )
    return Scale(trajectory.scale, "one factor for the run: odometry's trajectory aligned with the true one (Sim(3))")


def _evaluate_keyframe(
    keyframe: KeyframeResult, sequence: Sequence, scale: float, histogram: ConfidenceHistogram
) -> KeyframeEvaluation | None:
    """The keyframe's figures, its pixels added to the histogram; None without true depth."""
    truth = read_truth(sequence, keyframe)
    if truth is None:
        return None
    depth = np.float32(scale) * keyframe.depth
    histogram.add(depth, keyframe.confidence, truth.depth)
    final = depth_metrics(depth, truth.depth)
    by_origin = {
        origin.name.lower(): depth_metrics(np.where(keyframe.origin == origin, depth, np.nan), truth.depth)
        for origin in _ORIGINS
    }
    stages = {name: depth_metrics(np.float32(scale) * z, truth.depth) for name, z in keyframe.stages.items()}
    return KeyframeEvaluation(
        index=keyframe.index,
        depth=final,
        by_origin=by_origin,
        stages={**stages, FINAL: final},
        normals=normal_metrics(keyframe.normal, truth.normal),
    )


def _mean_by_name(rows: list[dict[str, DepthMetrics]]) -> dict[str, DepthMetrics]:
    """Means of what all keyframes have."""
    names = reduce(lambda known, row: [name for name in known if name in row], rows, list(rows[0]))
    return {name: mean_metrics([row[name] for row in rows]) for name in names}


_JSON = TypeAdapter(Evaluation)
