"""Poses that are given: a trajectory, or any function of time."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.trajectory import Trajectory
from polarmap.pipeline.poses.source import NO_POSE, PoseUpdate, given_pose
from polarmap.sensing.front_end import FrontEnd, SensedFrame


class GivenPoses:
    """Poses that do not change: every frame that has one is a candidate. A `PoseSource`.

    at: gives T_world_camera (4×4) at a timestamp in seconds, None where it is not known.
    why_unknown: gives the reason in words where it is not.
    trajectory: what the poses are from, if that is known as a whole; else each is judged by those before it.
    """

    step = "poses"
    given = True
    front_end: FrontEnd | None = None

    def __init__(
        self,
        at: Callable[[float], np.ndarray | None],
        why_unknown: Callable[[float], str] = lambda timestamp: NO_POSE,
        trajectory: Trajectory | None = None,
    ) -> None:
        self._at = at
        self._why_unknown = why_unknown
        self.trajectory = trajectory

    @classmethod
    def of(cls, trajectory: Trajectory) -> GivenPoses:
        """The poses of a trajectory."""
        return cls(trajectory.at, trajectory.why_unknown, trajectory)

    def needs(self, timestamp: float) -> bool:
        """Whether there is a pose at this time."""
        return self._at(timestamp) is not None

    def unseen(self, timestamp: float) -> PoseUpdate:
        """That there is no pose, and why."""
        return PoseUpdate(status=Status.LOST, reason=self._why_unknown(timestamp))

    def update(self, frame: SensedFrame) -> PoseUpdate:
        """The pose at the frame's time."""
        T_world_camera = self._at(frame.timestamp)
        return self.unseen(frame.timestamp) if T_world_camera is None else given_pose(frame, T_world_camera)

    def rest(self) -> None:
        """It is never late."""
        return None

    def finish(self) -> None:
        """Nothing has changed."""
        return None
