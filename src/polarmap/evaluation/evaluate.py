"""How good a run is: its keyframes and poses against the true depth and poses of the sequence it mapped."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from pathlib import Path

import numpy as np
from pydantic import TypeAdapter, ValidationError

from polarmap.data.codes import Origin
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.metrics import (
    ConfidenceCurve,
    ConfidenceHistogram,
    DepthMetrics,
    NormalMetrics,
    SigmaMetrics,
    TrajectoryMetrics,
    depth_metrics,
    mean_metrics,
    normal_metrics,
    relative_pose_error,
    sigma_metrics,
    trajectory_metrics,
)
from polarmap.evaluation.surface import MapMetrics
from polarmap.evaluation.truth import normal_source, read_truth
from polarmap.evaluation.walls import WallMetrics
from polarmap.io.files import write_bytes
from polarmap.io.formats.json_text import read_json_text
from polarmap.io.formats.rounded_positions import warn_of_rounding
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import Sequence
from polarmap.io.run_folder.folder import TRAJECTORY_NAME, read_keyframes, read_results, segment_file
from polarmap.io.run_folder.keyframe_file import KeyframeResult
from polarmap.io.run_folder.results import RunResults

log = logging.getLogger(__name__)

FINAL = "final"
LEAST_POSES = 3
"""True poses that a trajectory needs for its error and its scale to be known."""

_NONE = float("nan")
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
    sigma: SigmaMetrics | None = None


@dataclass(frozen=True)
class Scale:
    """What depth was multiplied by before it was compared, and why."""

    factor: float
    reason: str


@dataclass(frozen=True)
class SegmentEvaluation:
    """A segment of a run with odometry. scale: its own; None where it has too few true poses, or did not move.

    keyframes: how many it has. trajectory: None where it has no true poses.
    """

    segment: int
    keyframes: int
    scale: Scale | None
    trajectory: TrajectoryMetrics | None


@dataclass(frozen=True)
class Evaluation:
    """A run against the truth. depth, by_origin, stages, normals, sigma: means over the keyframes.

    scale, trajectory: of a run with odometry, those of its first segment that has a scale, which is the largest or,
    where that is too short, the next.
    segments: of a run with odometry, all of them. without_scale: keyframes of segments whose scale is not known, which
    are left out.
    without_truth: keyframes that have no true depth and are left out.
    normal_truth: what the true normals are from.
    trajectory: None where the sequence has no true poses at the run's times.
    format: "polarmap", or that of another program's results (`polarmap.evaluation.imported`), which may lack depth:
        then keyframes is empty. sparse: whether their depth is that of sparse points alone.
    map, walls, sigma: None where they were not measured.
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
    segments: tuple[SegmentEvaluation, ...] = ()
    without_scale: int = 0
    format: str = "polarmap"
    sparse: bool = False
    map: MapMetrics | None = None
    walls: WallMetrics | None = None
    sigma: SigmaMetrics | None = None


def evaluate_run(out: Path | str, sequence: Sequence) -> Evaluation:
    """Compare the run in a folder with the truth of the sequence, one keyframe in memory at a time.

    Raises InputError where the folder is not that of a run, the sequence is not the one that was mapped, has no
    true depth, or lacks the true poses that the scale is to be found by.
    """
    out = Path(out)
    results = read_results(out)
    if results.poses == "given":
        segments, main = (), _given(out, sequence)
    else:
        segments = _segments(out, results, sequence)
        main = _main_segment(segments, sequence)
    factor_of = _factors(results, segments)
    histogram = ConfidenceHistogram()
    rows = [
        _evaluate_keyframe(keyframe, sequence, factor, histogram)
        for keyframe in read_keyframes(out, results.camera.size)
        if (factor := factor_of(keyframe.index)) is not None
    ]
    keyframes = tuple(row for row in rows if row is not None)
    if not keyframes:
        raise InputError(f"{sequence.path}: no true depth (depth/NAME.png) for any of the {len(rows)} keyframes")
    return Evaluation(
        run=str(out),
        sequence=str(sequence.path),
        scale=main.scale,
        depth=mean_metrics([k.depth for k in keyframes]),
        by_origin=_mean_by_name([k.by_origin for k in keyframes]),
        stages=_mean_by_name([k.stages for k in keyframes]),
        normals=mean_metrics([k.normals for k in keyframes]),
        sigma=mean_metrics([k.sigma for k in keyframes]),
        normal_truth=normal_source(sequence),
        trajectory=main.trajectory,
        curve=histogram.curve(),
        without_truth=len(rows) - len(keyframes),
        keyframes=keyframes,
        segments=segments,
        without_scale=sum(segment.keyframes for segment in segments if segment.scale is None),
    )


def write_evaluation(path: Path | str, evaluation: Evaluation) -> None:
    """Write an evaluation as JSON, NaN as null; PolarmapError where that fails."""
    write_bytes(Path(path), _JSON.dump_json(evaluation, indent=1) + b"\n")


def read_evaluation(path: Path | str) -> Evaluation:
    """An evaluation from JSON; InputError where the file is none."""
    try:
        return _JSON.validate_json(read_json_text(Path(path)), strict=True)
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"]) or "its whole"
        raise InputError(
            f"{path}: not an evaluation as 'polarmap eval' writes it ({where}: {problem['msg']})"
        ) from None


def _given(out: Path, sequence: Sequence) -> SegmentEvaluation:
    """A run with given poses: all of it in one world, and its scale is theirs."""
    scale = Scale(1.0, "none: the poses were given, and depth has their unit")
    return SegmentEvaluation(0, 0, scale, _compare_trajectories(out / TRAJECTORY_NAME, sequence))


def _segments(out: Path, results: RunResults, sequence: Sequence) -> tuple[SegmentEvaluation, ...]:
    """The segments of a run with odometry, the one with most keyframes first."""
    counts = Counter(keyframe.segment for keyframe in results.keyframes)
    return tuple(_segment(out, results, sequence, *count) for count in counts.most_common())


def _segment(out: Path, results: RunResults, sequence: Sequence, segment: int, keyframes: int) -> SegmentEvaluation:
    path = out / segment_file(TRAJECTORY_NAME, segment, results.segment)
    trajectory, scale = _compare_trajectories(path, sequence), None
    if trajectory is not None and trajectory.poses >= LEAST_POSES and np.isfinite(trajectory.scale):
        scale = Scale(trajectory.scale, "odometry's trajectory aligned with the true one (Sim(3))")
    return SegmentEvaluation(segment, keyframes, scale, trajectory)


def _main_segment(segments: tuple[SegmentEvaluation, ...], sequence: Sequence) -> SegmentEvaluation:
    main = next((segment for segment in segments if segment.scale is not None), None)
    if main is None:
        raise InputError(
            f"{sequence.path}: true poses (groundtruth.txt) of a moving camera at {LEAST_POSES} of the run's times "
            "are needed to scale a run with odometry"
        )
    return main


def _factors(results: RunResults, segments: tuple[SegmentEvaluation, ...]) -> Callable[[int], float | None]:
    """Gives what to multiply a keyframe's depth by; None where that is not known."""
    if results.poses == "given":
        return lambda index: 1.0
    factors = {segment.segment: segment.scale.factor for segment in segments if segment.scale is not None}
    return {k.index: factors[k.segment] for k in results.keyframes if k.segment in factors}.get


def _compare_trajectories(path: Path, sequence: Sequence) -> TrajectoryMetrics | None:
    """The trajectory in a file against the true one; None where there is no true pose at its times."""
    truth = sequence.truth_trajectory()
    if truth is None:
        return None
    run = read_trajectory(path, "tum")
    metrics = compare_trajectories(run, truth)
    if metrics is None:
        log.warning("%s: no true pose at any time of %s", truth.source, run.source)
    return metrics


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
        sigma=sigma_metrics(depth, keyframe.sigma, truth.depth),
    )


def _mean_by_name(rows: list[dict[str, DepthMetrics]]) -> dict[str, DepthMetrics]:
    """Means of what all keyframes have."""
    names = reduce(lambda known, row: [name for name in known if name in row], rows, list(rows[0]))
    return {name: mean_metrics([row[name] for row in rows]) for name in names}


_JSON = TypeAdapter(Evaluation)
