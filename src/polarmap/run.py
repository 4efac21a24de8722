"""A whole run: a sequence mapped into an output folder, or tracked by odometry alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext, suppress
from time import perf_counter

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.frame import FrameSource, LiveSource
from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map
from polarmap.data.odometry import OdometryUpdate
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError, NothingMapped, PolarmapError
from polarmap.geometry.sim3 import Sim3
from polarmap.interrupts import StopRequests
from polarmap.io.formats.rounded_positions import warn_of_rounding
from polarmap.io.recording.sequence import Sequence
from polarmap.pipeline.config import Config
from polarmap.pipeline.live_log import LiveLog
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.fit import PoseFit, fit_of_poses
from polarmap.pipeline.poses.found import VisualOdometry
from polarmap.pipeline.poses.given import GivenPoses
from polarmap.pipeline.poses.source import PoseSource
from polarmap.pipeline.segment import Fused
from polarmap.pipeline.workers import Workers
from polarmap.prior.priors import Prior
from polarmap.report.run_writer import RunWriter
from polarmap.report.summary import Evidence
from polarmap.sensing.front_end import FrontEnd
from polarmap.sensing.mosaic_check import check_mosaic
from polarmap.viewer.watcher import Tracking, Watcher

_LOOKED_AT = 3  # raw pictures, for what contradicts the camera file
_MOST_WAITING = 1  # keyframes that could be mapped, while frames come at their times


def run_sequence(
    frames: FrameSource,
    poses: Trajectory | PoseSource,
    writer: RunWriter,
    prior: Prior | None = None,
    config: Config | None = None,
    on_frame: Callable[[int, Status], None] | None = None,
    stop: StopRequests | None = None,
    watcher: Watcher | None = None,
) -> Map:
    """Map frames and write all that comes out through `writer`, keyframe by keyframe.

    frames: a recorded sequence, or anything else that gives frames, such as a camera.
    poses: a trajectory, or a source such as `odometry_poses(sequence.camera_file, config)`.
    on_frame: called after each frame with the number of keyframes so far, and whether the frame has a pose. If this
    fails or is interrupted, the keyframes and the map until then are written first. stop: requests to stop that the
    caller notes already; they end the run between two frames. watcher: is told of all that happens, such as a `Feed`
    of the page in the browser. Raises InputError for bad frames or poses, PolarmapError if the output cannot be
    written, NothingMapped if no frame had a pose.
    """
    recorded = frames if isinstance(frames, Sequence) else None
    if isinstance(poses, Trajectory):
        if recorded is not None:
            poses.require_overlap(recorded.timestamps)
        warn_of_rounding(poses)
    mapper = Mapper(frames.camera_file, _source(poses), prior, config, *_told(writer, watcher))
    with nullcontext(stop) if stop else StopRequests() as requests, writer:
        result, reasons = _map_frames(frames, mapper, writer, requests, on_frame, mapper.finish, watcher)
        if recorded is not None:
            requests.check()
            writer.add_evidence(Evidence(_fit(recorded, poses), _mosaic(recorded)))
            requests.check()
        if result.posed == 0:
            raise nothing_tracked("the frames" if recorded is None else str(recorded.path), reasons)
    return result


def run_live(
    source: LiveSource,
    poses: Trajectory | PoseSource,
    writer: RunWriter,
    prior: Prior | None = None,
    config: Config | None = None,
    on_frame: Callable[[int, Status], None] | None = None,
    stop: StopRequests | None = None,
    watcher: Watcher | None = None,
) -> Map:
    """As `run_sequence`, for frames that come at their times, from a camera (`LiveCamera`) or as from one (`Replay`).

    Keyframes are mapped, and the surface is changed, beside the frames that are followed. Where mapping is behind,
    keyframes are skipped; what was, and how late poses and surface came, is told to `writer`. Poses by odometry should
    be found side by side, too (see `odometry_poses`). Results depend on what was in time, so that no two runs are the
    same. Raises the errors of `run_sequence`.
    """
    if isinstance(poses, Trajectory):
        warn_of_rounding(poses)
    pose_source, log = _source(poses), LiveLog()
    with nullcontext(stop) if stop else StopRequests() as requests, writer, Workers() as workers:

        def since(time: float) -> float:
            return time - source.begun

        def posed() -> float:
            exposed, now = since(source.exposed), since(perf_counter())
            log.frame(exposed, now, mapper.backlog, source.missed, mapper.skipped)
            return 1000 * (now - exposed)

        def fused(change: Fused) -> None:
            log.surface(since(source.when(change.timestamp)), since(change.finished))

        def finish() -> Map:
            workers.no_more_frames()
            result = mapper.finish()
            untraced = getattr(getattr(pose_source, "odometry", None), "untraced", 0)
            writer.add_live(log.figures(since(perf_counter()), mapper.hurried, untraced))
            return result

        mapper = Mapper(
            source.camera_file, pose_source, prior, config, *_told(writer, watcher), executor=workers.mapping,
            fusing=workers.fusing, most_waiting=_MOST_WAITING, on_fused=fused,
        )  # fmt: skip
        result, reasons = _map_frames(source, mapper, writer, requests, on_frame, finish, watcher, posed)
        if result.posed == 0:
            raise nothing_tracked("the frames", reasons)
    return result


def _source(poses: Trajectory | PoseSource) -> PoseSource:
    return GivenPoses.of(poses) if isinstance(poses, Trajectory) else poses


def _map_frames(
    frames: FrameSource,
    mapper: Mapper,
    writer: RunWriter,
    requests: StopRequests,
    on_frame: Callable[[int, Status], None] | None,
    finish: Callable[[], Map],
    watcher: Watcher | None,
    posed: Callable[[], float | None] = lambda: None,
) -> tuple[Map, Counter[str]]:
    """The map of all frames, written, and how often each reason kept a frame from its pose.

    finish: completes the map, also where something fails. posed: called as soon as a frame's pose is known, says after
    how many milliseconds that was, if frames come at their times.
    """
    reasons: Counter[str] = Counter()
    try:
        for frame in frames:
            requests.check()
            mapper.process(frame)
            late = posed()
            now = mapper.tracked
            reasons.update([now.reason] if now.reason else ())
            writer.add_frame(frame.timestamp, now.T_world_camera, now.segment, now.reason)
            if watcher:
                counts = mapper.keyframe_count, late, mapper.backlog, mapper.skipped, getattr(frames, "missed", 0)
                watcher.frame(Tracking(now.T_world_camera, now.segment, *counts))
            if on_frame:
                on_frame(mapper.keyframe_count, now.status)
    except (PolarmapError, KeyboardInterrupt):
        with suppress(PolarmapError):
            writer.add_map(finish())
        raise
    result = finish()
    writer.add_map(result)
    if watcher:
        watcher.map(result)
    return result, reasons


def _told(writer: RunWriter, watcher: Watcher | None) -> tuple[Callable[[Keyframe], None], Callable[[int, Sim3], None]]:
    """What is called with keyframes, and with their final poses."""
    if watcher is None:
        return writer.add_keyframe, writer.add_pose

    def keyframe(done: Keyframe) -> None:
        writer.add_keyframe(done)
        watcher.keyframe(done)

    def pose(index: int, final: Sim3) -> None:
        writer.add_pose(index, final)
        watcher.pose(index, final)

    return keyframe, pose


def _fit(sequence: Sequence, poses: Trajectory | PoseSource) -> PoseFit | None:
    """What the pictures say of the poses that were given for them."""
    if not isinstance(poses, Trajectory):
        return None
    front_end = FrontEnd(sequence.camera_file)
    return fit_of_poses(sequence.__getitem__, front_end.intensity, sequence.timestamps, poses.at, front_end.camera)


def _mosaic(sequence: Sequence) -> str:
    """What in a few raw pictures contradicts the camera file, and which key to set; empty if nothing does."""
    chosen = np.unique(np.linspace(0, len(sequence) - 1, min(_LOOKED_AT, len(sequence))).round().astype(int))
    frames = (sequence[int(i)] for i in chosen)
    return "; ".join(check_mosaic((frame.raw for frame in frames), sequence.camera_file))


def track_sequence(
    frames: FrameSource,
    front_end: FrontEnd,
    odometry: VisualOdometry,
    on_frame: Callable[[OdometryUpdate], None] | None = None,
    stop: StopRequests | None = None,
) -> None:
    """Give every frame's grey image to odometry, whose result is then final.

    If this fails or is interrupted, odometry has the result until then. stop: see `run_sequence`. Raises InputError for
    bad frames.
    """
    for frame in frames:
        if stop is not None:
            stop.check()
        update = odometry.process(front_end.grey(frame), frame.timestamp, frame.index, frame.exposure)
        if on_frame:
            on_frame(update)
    odometry.finish()


def require_times(sequence: Sequence) -> None:
    """Raise InputError where a frame has no time."""
    if np.isnan(sequence.timestamps).any():
        raise InputError(
            f"{sequence.path}: the frames have no times, which odometry needs; "
            "add timestamps.txt to the sequence or frame_rate to its camera file"
        )


def nothing_tracked(name: str, reasons: Counter[str]) -> NothingMapped:
    """The error for frames none of which has got a pose. name: the sequence's. reasons: how often each was the one."""
    why = reasons.most_common(1)[0][0] if reasons else "it has no frames"
    return NothingMapped(f"{name}: no frame could be tracked: {why}")
