"""What is left to do with frames when their poses are known, or with those that wait for a map: the back end's jobs.

Jobs are done in the order in which they were made, one at a time, on any thread. What one returns is adopted on the
thread that tracks, in the same order.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polarmap.data.odometry import OdometryUpdate
from polarmap.odometry.back_end import Adjustment, Realigned, Sighting
from polarmap.odometry.between import FramesBetween
from polarmap.odometry.local_map import LocalMap
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.records import FrameRecord, KeyframeRecord
from polarmap.odometry.start.starter import Starter, WaitingFrame
from polarmap.timing import StepClock

_BETWEEN_AT_ONCE = 4  # frames between the first two keyframes that a job aligns, so that no keyframe waits for all


@dataclass(frozen=True, eq=False)
class Tracked:
    """A frame whose pose is known, or known to be unknown yet.

    update: says nothing of keyframes; one that the frame is to become is among `held`. work: what is left to do; None
    if nothing is.
    """

    update: OdometryUpdate
    work: AnyWork | None


@dataclass(frozen=True, eq=False)
class Adopted:
    """What followed from a job: the update of its frame, None where it is about none, and the job that it leads to."""

    update: OdometryUpdate | None
    work: AnyWork | None


@dataclass(frozen=True, eq=False)
class Done:
    """What `Work` has come to: an adjustment, if the frame has become a keyframe, and earlier frames' better poses."""

    work: Work
    adjustment: Adjustment | None
    realigned: Realigned


@dataclass(frozen=True, eq=False)
class Work:
    """What the back end has to do with a tracked frame; to be called once.

    pyramid: None where immature points are not to be searched in the frame; a keyframe has one. keyframe: the record of
    the keyframe that it becomes. image: uint16 H×W of a frame that becomes none.
    """

    local: LocalMap
    sighting: Sighting
    pyramid: Pyramid | None
    keyframe: KeyframeRecord | None
    image: np.ndarray | None
    factory: PyramidFactory
    clock: StepClock

    def __call__(self) -> Done:
        back_end, adjustment = self.local.back_end, None
        if self.pyramid is not None:
            with self.clock("trace"):
                back_end.trace(self.pyramid, self.sighting)
        if self.pyramid is not None and self.keyframe is not None:
            with self.clock("adjust"):
                adjustment = back_end.add_keyframe(self.pyramid, self.sighting, self.keyframe)
        elif self.pyramid is not None:
            self.factory.give_back(self.pyramid)
        if self.image is not None:
            back_end.follow(self.sighting, self.image)
        with self.clock("align again"):
            return Done(self, adjustment, () if self.keyframe is not None else back_end.realign())

    def without_trace(self) -> Work:
        """The same for a frame that becomes no keyframe, in which no immature points are searched."""
        if self.pyramid is not None:
            self.factory.give_back(self.pyramid)
        return replace(self, pyramid=None)


@dataclass(frozen=True, eq=False)
class Begun:
    """A map that was begun.

    frames: the first two keyframes. depths: z of the points that each shows, float32 N, by frame index.
    """

    local: LocalMap
    frames: tuple[FrameRecord, FrameRecord]
    depths: dict[int, np.ndarray]
    between: FramesBetween


@dataclass(frozen=True, eq=False)
class Started:
    """What `StartWork` has come to.

    reasons: why there is no start, for each of the work's frames but those from the second keyframe on. begun: the map,
    if there is a start. first: index of the frame that a start is looked for from, if there is one. realigned: of the
    maps that were closed.
    """

    work: StartWork
    reasons: tuple[str, ...]
    begun: Begun | None
    first: tuple[int, ...]
    realigned: Realigned


@dataclass(frozen=True, eq=False)
class StartWork:
    """Look for a start with the next frames, and begin a map with the first of them that gives one.

    new_map: makes the map. closing: maps that were given up. Frames after that which gave the start are not looked at.
    """

    starter: Starter
    frames: tuple[WaitingFrame, ...]
    new_map: Callable[[], LocalMap]
    closing: tuple[LocalMap, ...]
    factory: PyramidFactory
    clock: StepClock

    def __call__(self) -> Started:
        realigned = _closed(self.closing, self.clock)
        reasons: list[str] = []
        for frame in self.frames:
            with self.clock("start"):
                begun = self._begun(frame)
            if begun is not None:
                return Started(self, tuple(reasons), begun, (), realigned)
            reasons.append(self.starter.reason)
        first = tuple(frame.index for frame in self.starter.waiting[:1])
        return Started(self, tuple(reasons), None, first, realigned)

    def _begun(self, second: WaitingFrame) -> Begun | None:
        pyramid = self.factory.make(second.image)
        start = self.starter.add(second, pyramid)
        if start is None:
            self.factory.give_back(pyramid)
            return None
        first, *between = self.starter.waiting
        local = self.new_map()
        frames = local.begin(start, first, second, pyramid)
        rest = FramesBetween(local.back_end, self.factory, first, frames[0], between)
        return Begun(local, frames, local.back_end.depths(), rest)


@dataclass(frozen=True, eq=False)
class Settled:
    """What `SettleWork` has come to: records of frames between the first two keyframes; `realigned` of closed maps."""

    work: SettleWork
    frames: tuple[FrameRecord, ...]
    realigned: Realigned


@dataclass(frozen=True, eq=False)
class SettleWork:
    """What is left to do when a map has begun: align a few of the frames between its first two keyframes.

    closing: maps that were given up.
    """

    local: LocalMap
    between: FramesBetween
    closing: tuple[LocalMap, ...]
    clock: StepClock

    def __call__(self) -> Settled:
        realigned = _closed(self.closing, self.clock)
        with self.clock("start"):
            return Settled(self, self.between.align(_BETWEEN_AT_ONCE), realigned)


AnyWork = Work | StartWork | SettleWork
AnyDone = Done | Started | Settled


def _closed(maps: tuple[LocalMap, ...], clock: StepClock) -> Realigned:
    with clock("align again"):
        return tuple(moved for local in maps for moved in local.close())
