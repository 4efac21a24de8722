"""The frames between the two that made a start: they have waited, and get their poses once there is a map."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable

import numpy as np

from polarmap.odometry.back_end import BackEnd, Sighting
from polarmap.odometry.local_map import alignment_problem, packed
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.records import FrameRecord
from polarmap.odometry.start.starter import WaitingFrame
from polarmap.odometry.track.tracker import Alignment


class FramesBetween:
    """Aligns the frames to the first keyframe, each from where the one before it is; part of the back end's work.

    first: the frame that became the first keyframe. record: of the same.
    """

    def __init__(
        self,
        back_end: BackEnd,
        factory: PyramidFactory,
        first: WaitingFrame,
        record: FrameRecord,
        frames: Iterable[WaitingFrame],
    ) -> None:
        self._back_end = back_end
        self._factory = factory
        self._exposure = first.exposure
        self._reference = record.reference
        self._tracker = back_end.tracker_of_first()
        self._T = np.eye(4)
        self._left = deque(frames)

    @property
    def left(self) -> int:
        """Frames that are not aligned yet."""
        return len(self._left)

    def align(self, most: int) -> tuple[FrameRecord, ...]:
        """Records of the next frames, at most so many, without those that cannot be aligned for sure."""
        next_ones = (self._left.popleft() for _ in range(min(most, len(self._left))))
        return tuple(record for record in map(self._record, next_ones) if record is not None)

    def _record(self, frame: WaitingFrame) -> FrameRecord | None:
        pyramid = self._factory.make(frame.image)
        found = self._found(pyramid, frame.exposure / self._exposure)
        self._factory.give_back(pyramid)
        if found is None:
            return None
        self._T = T = found.T_frame_reference
        record = FrameRecord(frame.index, frame.timestamp, self._reference, T)
        sighting = Sighting(record, self._reference.index, T, found.gain, found.offset, frame.exposure)
        self._back_end.follow(sighting, packed(frame.image))
        return record

    def _found(self, pyramid: Pyramid, gain: float) -> Alignment | None:
        """The alignment from the first of some motions from which it can be believed."""
        found = (self._tracker.align(pyramid, [T], gain, 0.0, np.inf) for T in (self._T, np.eye(4)))
        return next((alignment for alignment in found if not alignment_problem(alignment, 1.0)), None)
