"""Where the mapper has its poses from: a trajectory that is given, or odometry that finds them."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Protocol

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.trajectory import PosedFrame

if TYPE_CHECKING:
    from polarmap.data.frame import Frame

log = logging.getLogger(__name__)

NO_POSE = "no pose is given at its time"

_MOST_HELD = 8  # images that wait until odometry has decided on them


@dataclass(frozen=True, eq=False)
class Candidate:
    """A frame that may become a keyframe of the map: its image and its present T_world_camera, float64 4×4.

    given: whether the pose comes from outside and stays, in a world whose origin may be anywhere.
    """

    index: int
    timestamp: float
    image: PolarizationImage
    T_world_camera: np.ndarray
    given: bool = False


@dataclass(frozen=True, eq=False)
class PoseUpdate:
    """What a source of poses says after a frame.

    T_world_camera: the frame's own pose, float64 4×4 in the world of its `segment`; None where it is not known.
    candidates: frames that may become keyframes now, in order of time; not always this one.
    poses: present T_world_camera of earlier candidates, by frame index, as long as they may still change; one that
        is left out is final.
    """

    T_world_camera: np.ndarray | None = None
    segment: int = 0
    status: Status = Status.TRACKED
    reason: str = ""
    candidates: tuple[Candidate, ...] = ()
    poses: Mapping[int, np.ndarray] = field(default_factory=dict)


class PoseSource(Protocol):
    """Gives poses frame by frame. step: the name under which its time is counted."""

    step: str

    def needs(self, timestamp: float) -> bool:
        """Whether it wants to see the frame of this time, in seconds, at all."""

    def unseen(self, timestamp: float) -> PoseUpdate:
        """The update for a frame that it does not need to see."""

    def track(
        self,
        image: PolarizationImage,
        timestamp: float,
        index: int,
        exposure: float | None = None,
        frame: Frame | None = None,
    ) -> PoseUpdate:
        """Take the next frame.

        exposure: its exposure time in seconds, None or NaN if not known. frame: what was recorded, None if not known.
        """

    def finish(self) -> tuple[PosedFrame, ...] | None:
        """The final poses of all frames in order of time; None where none has changed since its update."""


class GivenPoses:
    """Poses of a trajectory that do not change: every frame that has one is a candidate.

    at: gives T_world_camera (4×4) at a timestamp in seconds, None where it is not known.
    why_unknown: gives the reason in words where it is not, such as `Trajectory.why_unknown`.
    trajectory: what `at` is a method of, if that has `timestamps` and `poses` as a `Trajectory` has; else None.
    """

    step = "poses"

    def __init__(
        self,
        at: Callable[[float], np.ndarray | None],
        why_unknown: Callable[[float], str] = lambda timestamp: NO_POSE,
    ) -> None:
        self._at = at
        self._why_unknown = why_unknown
        owner = getattr(at, "__self__", None)
        self.trajectory = owner if hasattr(owner, "timestamps") and hasattr(owner, "poses") else None

    def needs(self, timestamp: float) -> bool:
        """Whether there is a pose at this time."""
        return self._at(timestamp) is not None

    def unseen(self, timestamp: float) -> PoseUpdate:
        """That there is no pose, and why."""
        return PoseUpdate(status=Status.LOST, reason=self._why_unknown(timestamp))

    def track(
        self,
        image: PolarizationImage,
        timestamp: float,
        index: int,
        exposure: float | None = None,
        frame: Frame | None = None,
    ) -> PoseUpdate:
        """The pose at the frame's time."""
        T_world_camera = self._at(timestamp)
        return self.unseen(timestamp) if T_world_camera is None else given_pose(image, T_world_camera, timestamp, index)

    def finish(self) -> None:
        """Nothing has changed."""
        return None


def given_pose(image: PolarizationImage, T_world_camera: np.ndarray | None, timestamp: float, index: int) -> PoseUpdate:
    """The update for a frame whose pose is given, or is not known."""
    if T_world_camera is None:
        return PoseUpdate(status=Status.LOST, reason=NO_POSE)
    return PoseUpdate(T_world_camera, candidates=(Candidate(index, timestamp, image, T_world_camera, True),))


class VisualOdometry(Protocol):
    """What `OdometryPoses` needs of odometry; `polarmap.odometry.Odometry` is one."""

    def process(
        self, grey: np.ndarray, timestamp: float, index: int, exposure: float | None = None
    ) -> OdometryUpdate: ...
    def finish(self) -> None: ...
    def result(self) -> OdometryResult: ...


class OdometryPoses:
    """Poses that odometry finds as the frames come: its keyframes are the candidates.

    front_end: makes of a recorded frame the image that odometry sees, float32 H×W in [0, 1], such as a `GreyFrontEnd`
    with the camera's photometric calibration; without it, or without a recorded frame, that is the intensity.
    Images of frames that odometry may yet make keyframes are held, at most eight.
    """

    step = "odometry"

    def __init__(self, odometry: VisualOdometry, front_end: Callable[[Frame], np.ndarray] | None = None) -> None:
        self.odometry = odometry
        self._front_end = front_end
        self._held: dict[int, tuple[float, PolarizationImage]] = {}

    def needs(self, timestamp: float) -> bool:
        """Always."""
        return True

    def unseen(self, timestamp: float) -> PoseUpdate:
        """Nothing, for a frame that was not shown."""
        return PoseUpdate(status=Status.LOST, reason=NO_POSE)

    def track(
        self,
        image: PolarizationImage,
        timestamp: float,
        index: int,
        exposure: float | None = None,
        frame: Frame | None = None,
    ) -> PoseUpdate:
        """What odometry knows after this frame. Raises InputError as `Odometry.process` does."""
        grey = image.intensity if frame is None or self._front_end is None else self._front_end(frame)
        update = self.odometry.process(grey, timestamp, index, exposure)
        self._held[index] = timestamp, image
        candidates = [self._candidate(keyframe, update) for keyframe in update.keyframes]
        self._forget(update)
        return PoseUpdate(
            T_world_camera=update.T_world_camera,
            segment=update.segment,
            status=update.status,
            reason=update.reason,
            candidates=tuple(c for c in candidates if c is not None),
            poses=update.keyframe_poses,
        )

    def finish(self) -> tuple[PosedFrame, ...]:
        """Have odometry make its last adjustment; the final poses."""
        self.odometry.finish()
        return self.odometry.result().frames

    def _candidate(self, index: int, update: OdometryUpdate) -> Candidate | None:
        pose = update.keyframe_poses.get(index, update.T_world_camera if index == update.index else None)
        if index not in self._held or pose is None:
            log.warning("frame %d: became a keyframe when its image was not kept any more; it is not mapped", index)
            return None
        return Candidate(index, *self._held[index], pose)

    def _forget(self, update: OdometryUpdate) -> None:
        """Keep this frame and those that odometry holds, unless they are keyframes now."""
        wanted = {update.index, *update.held} - set(update.keyframes)
        held = [(index, entry) for index, entry in self._held.items() if index in wanted]
        self._held = dict(held[-_MOST_HELD:])
