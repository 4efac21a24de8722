"""Poses that odometry finds as the frames come."""

from __future__ import annotations

import logging
from typing import TYPE_CHECKING, Protocol

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.data.trajectory import PosedFrame
from polarmap.geometry.sim3 import Sim3
from polarmap.io.recording.photometric import read_photometric
from polarmap.pipeline.config import Config
from polarmap.pipeline.poses.source import NO_POSE, Candidate, PoseUpdate
from polarmap.sensing.front_end import FrontEnd, SensedFrame

if TYPE_CHECKING:
    from polarmap.odometry.odometry import Odometry
    from polarmap.odometry.side_by_side import ThreadedOdometry

log = logging.getLogger(__name__)

_MOST_HELD = 16  # images that wait until odometry has decided on them


class VisualOdometry(Protocol):
    """What `OdometryPoses` needs of odometry: an `Odometry` is one, and so is a `ThreadedOdometry`."""

    def process(
        self, image: np.ndarray, timestamp: float, index: int, exposure: float | None = None
    ) -> OdometryUpdate: ...
    def wait(self) -> OdometryUpdate | None: ...
    def finish(self) -> None: ...
    def result(self) -> OdometryResult: ...


class OdometryPoses:
    """Poses by odometry on the frames' grey images: its keyframes are the candidates. A `PoseSource`.

    front_end: what makes the images, with the camera's photometric calibration; None if any may. Frames that odometry
    may yet make keyframes are held, at most 16: as many come within half a second, which a start may take.
    """

    step = "odometry"
    given = False

    def __init__(self, odometry: VisualOdometry, front_end: FrontEnd | None = None) -> None:
        self.odometry = odometry
        self.front_end = front_end
        self._held: dict[int, SensedFrame] = {}
        self._moving: frozenset[int] = frozenset()

    def needs(self, timestamp: float) -> bool:
        """Always."""
        return True

    def unseen(self, timestamp: float) -> PoseUpdate:
        """Nothing, for a frame that was not shown."""
        return PoseUpdate(status=Status.LOST, reason=NO_POSE)

    def update(self, frame: SensedFrame) -> PoseUpdate:
        """What odometry knows after this frame. Raises InputError as `Odometry.process` does."""
        update = self.odometry.process(frame.grey, frame.timestamp, frame.index, frame.exposure)
        self._held[frame.index] = frame
        return self._told(update)

    def rest(self) -> PoseUpdate | None:
        """What odometry has still to say of the frames so far, before `finish`: candidates that it was late with.

        None where that is nothing, as always with odometry that does all its work at once.
        """
        update = self.odometry.wait()
        return None if update is None else self._told(update)

    def finish(self) -> tuple[PosedFrame, ...]:
        """Have odometry make its last adjustment; the final poses."""
        self.odometry.finish()
        return self.odometry.result().frames

    def _told(self, update: OdometryUpdate) -> PoseUpdate:
        candidates = [self._candidate(keyframe, update) for keyframe in update.keyframes]
        self._forget(update)
        moved = {index: Sim3.from_matrix(T) for index, T in update.keyframe_poses.items()}
        return PoseUpdate(
            T_world_camera=update.T_world_camera,
            segment=update.segment,
            status=update.status,
            reason=update.reason,
            candidates=tuple(c for c in candidates if c is not None),
            moved=moved,
            final=self._final(update),
        )

    def _final(self, update: OdometryUpdate) -> frozenset[int]:
        """Keyframes that have left the window. A lost frame moves none, and odometry may go on after it."""
        if update.T_world_camera is None:
            return frozenset()
        before, self._moving = self._moving, frozenset(update.keyframe_poses)
        return before - self._moving

    def _candidate(self, index: int, update: OdometryUpdate) -> Candidate | None:
        pose = update.keyframe_poses.get(index, update.T_world_camera if index == update.index else None)
        if index not in self._held or pose is None:
            log.warning("frame %d: became a keyframe when its image was not kept any more; it is not mapped", index)
            return None
        return Candidate(self._held[index], pose, known=update.keyframe_depths.get(index))

    def _forget(self, update: OdometryUpdate) -> None:
        """Keep this frame and those that odometry holds, unless they are keyframes now."""
        wanted = {update.index, *update.held} - set(update.keyframes)
        held = [(index, frame) for index, frame in self._held.items() if index in wanted]
        self._held = dict(held[-_MOST_HELD:])


def odometry_poses(
    camera_file: CameraFile, config: Config | None = None, seed: int = 0, side_by_side: bool = False
) -> OdometryPoses:
    """A source of poses for a `Mapper`: odometry on the frames' grey images. seed: of its choice of points.

    side_by_side: see `make_odometry`. Raises InputError where the camera's photometric calibration cannot be read.
    """
    front_end = calibrated_front_end(camera_file)
    return OdometryPoses(make_odometry(front_end, config or Config(), seed, side_by_side), front_end)


def calibrated_front_end(camera_file: CameraFile) -> FrontEnd:
    """A front end with the photometric calibration that the camera file names.

    Raises InputError where that cannot be read.
    """
    return FrontEnd(camera_file, read_photometric(camera_file))


def make_odometry(
    front_end: FrontEnd, config: Config, seed: int = 0, side_by_side: bool = False
) -> Odometry | ThreadedOdometry:
    """Odometry on the grey images of a front end, with the options of `config`. seed: of its choice of points.

    side_by_side: all but the frames' own poses is found by a second thread, so that no frame waits for it; keyframes
    then come some frames late, and results are not the same from run to run.
    """
    from polarmap.odometry.odometry import Odometry
    from polarmap.odometry.side_by_side import ThreadedOdometry

    odometry = Odometry(front_end.camera, config.odometry, front_end.valid_grey, seed)
    return ThreadedOdometry(odometry) if side_by_side else odometry
