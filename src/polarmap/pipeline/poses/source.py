"""Where the mapper has its poses from: what a trajectory, odometry or another program gives for each frame."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Protocol

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.trajectory import PosedFrame
from polarmap.geometry.sim3 import Sim3
from polarmap.sensing.front_end import FrontEnd, SensedFrame

NO_POSE = "no pose is given at its time"


@dataclass(frozen=True, eq=False)
class Candidate:
    """A frame that may become a keyframe of the map, with its present T_world_camera, float64 4×4.

    given: whether the pose comes from outside and stays, in a world whose origin may be anywhere.
    known: z of points that the frame shows, as far as the source knows them, float32 N; None where it knows none.
    """

    frame: SensedFrame
    T_world_camera: np.ndarray
    given: bool = False
    known: np.ndarray | None = None

    @property
    def index(self) -> int:
        """The frame's."""
        return self.frame.index

    @property
    def timestamp(self) -> float:
        """The frame's, in seconds."""
        return self.frame.timestamp


@dataclass(frozen=True, eq=False)
class PoseUpdate:
    """What a source of poses says after a frame.

    T_world_camera: the frame's own pose, float64 4×4 in the world of its `segment`; None where it is not known.
    candidates: frames that may become keyframes now, in order of time; not always this one.
    moved: present T_world_camera of earlier candidates by frame index, with the scale by which their depth has grown
        since they were candidates. final: indices of those that will not move any more; what was never among `moved`
        is final from the start.
    """

    T_world_camera: np.ndarray | None = None
    segment: int = 0
    status: Status = Status.TRACKED
    reason: str = ""
    candidates: tuple[Candidate, ...] = ()
    moved: Mapping[int, Sim3] = field(default_factory=dict)
    final: frozenset[int] = frozenset()


class PoseSource(Protocol):
    """Gives poses frame by frame.

    step: the name under which its time is counted. given: whether its poses come from outside, so that they are to be
    judged by the pictures before they are believed. front_end: what must make the images that it sees; None if any may.
    """

    step: str
    given: bool
    front_end: FrontEnd | None

    def needs(self, timestamp: float) -> bool:
        """Whether it wants to see the frame of this time, in seconds, at all."""
        ...

    def unseen(self, timestamp: float) -> PoseUpdate:
        """The update for a frame that it does not need to see."""
        ...

    def update(self, frame: SensedFrame) -> PoseUpdate:
        """Take the next frame."""
        ...

    def rest(self) -> PoseUpdate | None:
        """What it has still to say of the frames that have come, before `finish`; None where that is nothing."""
        ...

    def finish(self) -> tuple[PosedFrame, ...] | None:
        """The final poses of all frames in order of time; None where none has changed since its update."""
        ...


def given_pose(frame: SensedFrame, T_world_camera: np.ndarray | None) -> PoseUpdate:
    """The update for a frame whose pose is given, or is not known."""
    if T_world_camera is None:
        return PoseUpdate(status=Status.LOST, reason=NO_POSE)
    return PoseUpdate(T_world_camera, candidates=(Candidate(frame, T_world_camera, given=True),))
