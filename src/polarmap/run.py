"""A whole run: a sequence mapped into an output folder, or tracked by odometry alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext, suppress
from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.codes import Status
from polarmap.data.map import Map
from polarmap.data.odometry import OdometryUpdate
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError, NothingMapped, PolarmapError
from polarmap.interrupts import StopRequests
from polarmap.io.formats.rounded_positions import warn_of_rounding
from polarmap.io.recording.photometric import read_photometric
from polarmap.io.recording.sequence import Sequence
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.fit import PoseFit, fit_of_poses
from polarmap.pipeline.poses.source import GivenPoses, OdometryPoses, PoseSource, VisualOdometry
from polarmap.prior.priors import Prior
from polarmap.report.run_writer import RunWriter
from polarmap.report.summary import Evidence
from polarmap.sensing.front_end import PolarizationFrontEnd
from polarmap.sensing.grey import GreyFrontEnd
from polarmap.sensing.mosaic_check import check_mosaic

_LOOKED_AT = 3  # raw pictures, for what contradicts the camera file


def run_sequence(
    sequence: Sequence,
    poses: Trajectory | PoseSource,
    writer: RunWriter,
    prior: Prior | None = None,
    config: Config | None = None,
    on_frame: Callable[[int, Status], None] | None = None,
    stop: StopRequests | None = None,
) -> Map:
    """Map `sequence` and write all that comes out through `writer`, keyframe by keyframe.

    poses: a trajectory, or a source such as `odometry_poses(sequence.camera_file, config)`.
    on_frame: called after each frame with the number of keyframes so far, and whether the frame has a pose. If this
    fails or is interrupted, the keyframes and the map until then are written first. stop: requests to stop that the
    caller notes already; they end the run between two frames. Raises InputError for bad frames or poses, PolarmapError
    if the output cannot be written, NothingMapped if no frame had a pose.
    """
    if isinstance(poses, Trajectory):
        poses.require_overlap(sequence.timestamps)
        warn_of_rounding(poses)
    source = GivenPoses(poses.at, poses.why_unknown) if isinstance(poses, Trajectory) else poses
    mapper = Mapper(sequence.camera_file, source, prior, config, writer.add_keyframe, writer.add_pose)
    reasons: Counter[str] = Counter()
    with nullcontext(stop) if stop else StopRequests() as requests, writer:
        try:
            for frame in sequence:
                requests.check()
                mapper.process(frame)
                now = mapper.tracked
                reasons.update([now.reason] if now.reason else ())
                writer.add_frame(frame.timestamp, now.T_world_camera, now.segment, now.reason)
                if on_frame:
                    on_frame(mapper.keyframe_count, now.status)
        except (PolarmapError, KeyboardInterrupt):
            with suppress(PolarmapError):
                writer.add_map(mapper.finish())
            raise
        result = mapper.finish()
        writer.add_map(result)
        requests.check()
        writer.add_evidence(Evidence(_fit(sequence, poses), _mosaic(sequence)))
        requests.check()
        if result.posed == 0:
            raise nothing_tracked(sequence, reasons)
    return result


def _fit(sequence: Sequence, poses: Trajectory | PoseSource) -> PoseFit | None:
    """What the pictures say of the poses that were given for them."""
    if not isinstance(poses, Trajectory):
        return None
    front_end = PolarizationFrontEnd(sequence.camera_file)
    return fit_of_poses(
        sequence.__getitem__,
        lambda frame: front_end(frame).intensity,
        sequence.timestamps,
        poses.at,
        front_end.camera,
    )


def _mosaic(sequence: Sequence) -> str:
    """What in a few raw pictures contradicts the camera file, and which key to set; empty if nothing does."""
    chosen = np.unique(np.linspace(0, len(sequence) - 1, min(_LOOKED_AT, len(sequence))).round().astype(int))
    frames = (sequence[int(i)] for i in chosen)
    raw = (frame.channels if frame.mosaic is None else frame.mosaic for frame in frames)
    return "; ".join(check_mosaic(raw, sequence.camera_file))


def track_sequence(
    sequence: Sequence,
    front_end: GreyFrontEnd,
    odometry: VisualOdometry,
    on_frame: Callable[[OdometryUpdate], None] | None = None,
    stop: StopRequests | None = None,
) -> None:
    """Give every frame's grey image to odometry, whose result is then final.

    If this fails or is interrupted, odometry has the result until then. stop: see `run_sequence`. Raises InputError for
    bad frames.
    """
    for frame in sequence:
        if stop is not None:
            stop.check()
        update = odometry.process(front_end(frame), frame.timestamp, frame.index, frame.exposure)
        if on_frame:
            on_frame(update)
    odometry.finish()


def odometry_poses(camera_file: CameraFile, config: Config | None = None, seed: int = 0) -> OdometryPoses:
    """A source of poses for a `Mapper`: odometry on the frames' grey images. seed: of its choice of points.

    Raises InputError where the camera's photometric calibration cannot be read.
    """
    front_end = grey_front_end(camera_file)
    return OdometryPoses(make_odometry(front_end, config or Config(), seed), front_end)


def grey_front_end(camera_file: CameraFile) -> GreyFrontEnd:
    """What takes a frame to the grey image that odometry wants, with the photometric calibration that the file names.

    Raises InputError where that cannot be read.
    """
    return GreyFrontEnd(camera_file, read_photometric(camera_file))


def make_odometry(front_end: GreyFrontEnd, config: Config, seed: int = 0) -> VisualOdometry:
    """Odometry on the images of a front end, with the options of `config`. seed: of its choice of points."""
    from polarmap.odometry.odometry import Odometry

    return Odometry(front_end.camera, config.odometry, front_end.valid, seed)


def read_poses(path: Path, sequence: Sequence) -> Trajectory:
    """The trajectory in a file, in the times of a sequence.

    As `Sequence.read_poses`, which see.
    """
    return sequence.read_poses(path)


def require_times(sequence: Sequence) -> None:
    """Raise InputError where a frame has no time."""
    if np.isnan(sequence.timestamps).any():
        raise InputError(
            f"{sequence.path}: the frames have no times, which odometry needs; "
            "add timestamps.txt to the sequence or frame_rate to its camera file"
        )


def nothing_tracked(sequence: Sequence, reasons: Counter[str]) -> NothingMapped:
    """The error for a sequence none of whose frames has got a pose. reasons: how often each was the reason."""
    why = reasons.most_common(1)[0][0] if reasons else "it has no frames"
    return NothingMapped(f"{sequence.path}: no frame could be tracked: {why}")
