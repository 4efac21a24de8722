"""How good a run is: its keyframes and poses against the true depth and poses of the sequence it mapped."""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from functools import reduce
from pathlib import Path

import numpy as np

from polarmap.data.codes import Origin
from polarmap.errors import InputError
from polarmap.evaluation.metrics import (
    ConfidenceHistogram,
    DepthMetrics,
    TrajectoryMetrics,
    depth_metrics,
    mean_metrics,
    mean_of_known,
    normal_metrics,
    sigma_metrics,
)
from polarmap.evaluation.records import FINAL, Evaluation, KeyframeEvaluation, Scale, SegmentEvaluation
from polarmap.evaluation.regions import region_metrics
from polarmap.evaluation.trajectories import LEAST_POSES, compare_trajectories
from polarmap.evaluation.truth import Truth
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.run_folder.folder import TRAJECTORY_NAME, read_keyframes, read_results, segment_file
from polarmap.io.run_folder.keyframe_file import KeyframeResult
from polarmap.io.run_folder.results import RunResults

log = logging.getLogger(__name__)

_ORIGINS = (Origin.STEREO, Origin.PROPAGATED, Origin.ESTIMATED)
_TIME_TOLERANCE = 1e-3  # seconds
_INTRINSICS_TOLERANCE = 0.01  # pixels


def evaluate_run(out: Path | str, truth: Truth) -> Evaluation:
    """Compare the run in a folder with the truth of its sequence, one keyframe in memory at a time.

    Raises InputError where the folder is not that of a run, the sequence is not the one that was mapped, has no
    true depth, or lacks the true poses that the scale is to be found by.
    """
    out = Path(out)
    results = read_results(out)
    if results.poses == "given":
        segments, main = (), _given(out, truth)
    else:
        segments = _segments(out, results, truth)
        main = _main_segment(segments, truth)
    factor_of = _factors(results, segments)
    histogram = ConfidenceHistogram()
    rows = [*evaluate_keyframes(read_keyframes(out, results.camera.size), truth, factor_of, histogram)]
    keyframes = tuple(row for row in rows if row is not None)
    if not keyframes:
        raise InputError(f"{truth.source}: no true depth (depth/NAME.png) for any of the {len(rows)} keyframes")
    return Evaluation(
        run=str(out),
        sequence=truth.source,
        scale=main.scale,
        depth=mean_metrics([k.depth for k in keyframes]),
        by_origin=_mean_by_name([k.by_origin for k in keyframes]),
        stages=_mean_by_name([k.stages for k in keyframes]),
        normals=mean_metrics([k.normals for k in keyframes]),
        sigma=mean_of_known([k.sigma for k in keyframes]),
        regions=mean_of_known([k.regions for k in keyframes]),
        normal_truth=truth.normal_source,
        trajectory=main.trajectory,
        curve=histogram.curve(),
        without_truth=len(rows) - len(keyframes),
        keyframes=keyframes,
        segments=segments,
        without_scale=sum(segment.keyframes for segment in segments if segment.scale is None),
    )


def evaluate_keyframes(
    keyframes: Iterable[KeyframeResult],
    truth: Truth,
    factor_of: Callable[[int], float | None],
    histogram: ConfidenceHistogram,
) -> Iterator[KeyframeEvaluation | None]:
    """The figures of each keyframe whose scale is known, None without true depth; their pixels go into the histogram.

    factor_of: gives what to multiply the depth of the keyframe with an index by, None where that is not known.
    Raises InputError where a keyframe is not of this sequence.
    """
    for keyframe in keyframes:
        factor = factor_of(keyframe.index)
        if factor is not None:
            yield _evaluate_keyframe(keyframe, truth, factor, histogram)


def _given(out: Path, truth: Truth) -> SegmentEvaluation:
    """A run with given poses: all of it in one world, and its scale is theirs."""
    scale = Scale(1.0, "none: the poses were given, and depth has their unit")
    return SegmentEvaluation(0, 0, scale, _compare_trajectories(out / TRAJECTORY_NAME, truth))


def _segments(out: Path, results: RunResults, truth: Truth) -> tuple[SegmentEvaluation, ...]:
    """The segments of a run with odometry, the one with most keyframes first."""
    counts = Counter(keyframe.segment for keyframe in results.keyframes)
    return tuple(_segment(out, results, truth, *count) for count in counts.most_common())


def _segment(out: Path, results: RunResults, truth: Truth, segment: int, keyframes: int) -> SegmentEvaluation:
    path = out / segment_file(TRAJECTORY_NAME, segment, results.segment)
    trajectory, scale = _compare_trajectories(path, truth), None
    if trajectory is not None and trajectory.poses >= LEAST_POSES and np.isfinite(trajectory.scale):
        scale = Scale(trajectory.scale, "odometry's trajectory aligned with the true one (Sim(3))")
    return SegmentEvaluation(segment, keyframes, scale, trajectory)


def _main_segment(segments: tuple[SegmentEvaluation, ...], truth: Truth) -> SegmentEvaluation:
    main = next((segment for segment in segments if segment.scale is not None), None)
    if main is None:
        raise InputError(
            f"{truth.source}: true poses (groundtruth.txt) of a moving camera at {LEAST_POSES} of the run's times "
            "are needed to scale a run with odometry"
        )
    return main


def _factors(results: RunResults, segments: tuple[SegmentEvaluation, ...]) -> Callable[[int], float | None]:
    """Gives what to multiply a keyframe's depth by; None where that is not known."""
    if results.poses == "given":
        return lambda index: 1.0
    factors = {segment.segment: segment.scale.factor for segment in segments if segment.scale is not None}
    return {k.index: factors[k.segment] for k in results.keyframes if k.segment in factors}.get


def _compare_trajectories(path: Path, truth: Truth) -> TrajectoryMetrics | None:
    """The trajectory in a file against the true one; None where there is no true pose at its times."""
    if truth.trajectory is None:
        return None
    run = read_trajectory(path, "tum")
    metrics = compare_trajectories(run, truth.trajectory)
    if metrics is None:
        log.warning("%s: no true pose at any time of %s", truth.trajectory.source, run.source)
    return metrics


def _evaluate_keyframe(
    keyframe: KeyframeResult, truth: Truth, scale: float, histogram: ConfidenceHistogram
) -> KeyframeEvaluation | None:
    """The keyframe's figures, its pixels added to the histogram; None without true depth."""
    _require_same_frame(keyframe, truth)
    true = truth.image(keyframe.index)
    if true is None:
        return None
    depth = np.float32(scale) * keyframe.depth
    histogram.add(depth, keyframe.confidence, true.depth)
    final = depth_metrics(depth, true.depth)
    by_origin = {
        origin.name.lower(): depth_metrics(np.where(keyframe.origin == origin, depth, np.nan), true.depth)
        for origin in _ORIGINS
    }
    stages = {name: depth_metrics(np.float32(scale) * z, true.depth) for name, z in keyframe.stages.items()}
    return KeyframeEvaluation(
        index=keyframe.index,
        depth=final,
        by_origin=by_origin,
        stages={**stages, FINAL: final},
        normals=normal_metrics(keyframe.normal, true.normal),
        sigma=sigma_metrics(depth, keyframe.sigma, true.depth),
        regions=region_metrics(depth, keyframe.normal, true.depth, true.normal),
    )


def _mean_by_name(rows: list[dict[str, DepthMetrics]]) -> dict[str, DepthMetrics]:
    """Means of what all keyframes have."""
    names = reduce(lambda known, row: [name for name in known if name in row], rows, list(rows[0]))
    return {name: mean_metrics([row[name] for row in rows]) for name in names}


def _require_same_frame(keyframe: KeyframeResult, truth: Truth) -> None:
    """InputError where the sequence has no such frame, or has it of another time or camera."""
    wrong, index = f"{truth.source}: is not the sequence of this run", keyframe.index
    frame = truth.by_index.get(index)
    if frame is None:
        raise InputError(f"{wrong}: it has no frame {index}")
    if abs(frame.timestamp - keyframe.timestamp) > _TIME_TOLERANCE:
        raise InputError(f"{wrong}: its frame {index} is of {frame.timestamp} s, not of {keyframe.timestamp} s")
    if not _same_camera(truth.camera, keyframe.camera):
        raise InputError(f"{wrong}: its camera file has another size, fx, fy, cx or cy than keyframe {index}")


def _same_camera(a: PinholeCamera, b: PinholeCamera) -> bool:
    return a.shape == b.shape and bool(np.allclose(a.matrix, b.matrix, rtol=0.0, atol=_INTRINSICS_TOLERANCE))
