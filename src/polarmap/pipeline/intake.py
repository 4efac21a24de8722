"""What comes in: is the picture fit, where was the camera, and do the two agree?"""

from __future__ import annotations

import logging
from collections import Counter
from dataclasses import dataclass

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.codes import Status
from polarmap.data.sensor import SensorNoise
from polarmap.data.trajectory import PosedFrame
from polarmap.geometry.camera import PinholeCamera
from polarmap.pipeline.poses.follower import ODD, PoseFollower
from polarmap.pipeline.poses.given import GivenPoses
from polarmap.pipeline.poses.source import Candidate, PoseSource, PoseUpdate, given_pose
from polarmap.sensing.frame_check import FrameCheck
from polarmap.sensing.front_end import SensedFrame
from polarmap.timing import StepClock

log = logging.getLogger(__name__)

_BIT_DEPTH = 8  # of images whose sensor is not known


@dataclass(frozen=True, eq=False)
class Arrival:
    """What is known of a frame that has come in.

    update: of its pose; where it is left out, its reason says why. withdrawn: earlier frames, by index, that have
    turned out to be odd since, and why.
    """

    update: PoseUpdate
    left_out: bool = False
    withdrawn: tuple[tuple[int, str], ...] = ()


class Intake:
    """Judges frames in order of time and finds their poses.

    camera_file: of the frames; None where pictures come without their sensor being known. valid: bool H×W, the pixels
    that the lens shows, all if None.
    frames, posed: how many have come, and how many of them have a pose. left_out: how many were not used, by reason.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        source: PoseSource | None,
        clock: StepClock,
        camera_file: CameraFile | None = None,
        valid: np.ndarray | None = None,
    ) -> None:
        self._source = source
        self._clock = clock
        noise = (SensorNoise(), _BIT_DEPTH) if camera_file is None else (camera_file.noise, camera_file.bit_depth)
        self._check = FrameCheck(*noise, valid)
        self._follower = PoseFollower(camera, getattr(source, "trajectory", None))
        self._unfit: dict[int, str] = {}  # frames that odometry may use and stereo may not
        self._given = False  # whether the last frame's pose was
        self.frames = self.posed = 0
        self.left_out: Counter[str] = Counter()

    def pass_by(self, timestamp: float) -> Arrival | None:
        """Leave out a frame of this time that the source of poses does not want to see; None if it does."""
        if self._source is None or self._source.needs(timestamp):
            return None
        return self._leave_out(self._source.unseen(timestamp))

    def take(self, frame: SensedFrame, T_world_camera: np.ndarray | None = None) -> Arrival:
        """Take the next frame. T_world_camera: its pose; the source of poses is asked where it is None."""
        self._given = T_world_camera is not None or self._source is None or self._source.given
        with self._clock("polarization"):
            intensity = frame.intensity
        with self._clock("frame check"):
            verdict = self._check.judge(intensity, frame.index, frame.timestamp, frame.exposure)
        withdrawn = [] if verdict.earlier is None else [(verdict.earlier[0], verdict.earlier[1].text)]
        if verdict.fault and (self._given or verdict.fault.severe):
            return self._leave_out(PoseUpdate(status=Status.LOST, reason=verdict.fault.text), withdrawn)
        if verdict.fault:
            self._unfit[frame.index] = verdict.fault.text
        with self._clock((self._source or GivenPoses).step):
            update = self._pose(frame, T_world_camera, fit=verdict.fault is None)
        if self._given and self._follower.odd is not None:
            withdrawn.append((self._follower.odd, ODD))
        if self._given and update.T_world_camera is None:
            return self._leave_out(update, withdrawn)
        self.frames += 1
        self.posed += update.T_world_camera is not None
        return self._arrived(update, withdrawn)

    def refusal(self, index: int) -> str:
        """Why the last frame that has a pose may not be a keyframe, by what the pictures show; "" if it may."""
        unfit = self._unfit.get(index)
        reason = unfit or self._follower.contradiction(index)
        self.left_out.update([reason] if reason else ())
        return reason

    def is_pose_at_fault(self, index: int) -> bool:
        """Whether a frame that was refused has a given pose which cannot be right, so that it counts as without one."""
        at_fault = self._given and index not in self._unfit
        self.posed -= at_fault
        return at_fault

    def rest(self) -> PoseUpdate | None:
        """What the source of poses has still to say of the frames that have come; None where that is nothing."""
        return None if self._source is None else self._source.rest()

    def finish(self) -> tuple[PosedFrame, ...] | None:
        """The final poses of all frames in order of time, if the source has better ones than it gave."""
        trajectory = None if self._source is None else self._source.finish()
        if trajectory is not None:
            self.posed = len(trajectory)
        return trajectory

    def segmented(self, keyframes: frozenset[int]) -> tuple[PosedFrame, ...] | None:
        """The poses of all frames, if given ones fell into segments; else None."""
        return self._follower.segmented(keyframes)

    def _pose(self, frame: SensedFrame, T_world_camera: np.ndarray | None, fit: bool) -> PoseUpdate:
        if T_world_camera is None and self._source is not None:
            update = self._source.update(frame)
        else:
            update = given_pose(frame, T_world_camera)
        if self._given:
            return self._follower.follow(update)
        if update.T_world_camera is not None and fit:
            self._follower.note(Candidate(frame, update.T_world_camera), update.segment)
        return update

    def _leave_out(self, update: PoseUpdate, withdrawn: list[tuple[int, str]] | None = None) -> Arrival:
        self.frames += 1
        self.left_out[update.reason] += 1
        return self._arrived(update, withdrawn or [], left_out=True)

    def _arrived(self, update: PoseUpdate, withdrawn: list[tuple[int, str]], left_out: bool = False) -> Arrival:
        for index, reason in withdrawn:
            self._unfit[index] = reason
            log.warning("frame %d: %s; it is left out", index, reason)
        return Arrival(update, left_out, tuple(withdrawn))
