"""Frames that wait: for a start, or to be tracked in the map that has begun since they came."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from polarmap.odometry.start.starter import WaitingFrame


class FrameQueue:
    """Frames in order of time, each with an image of its own.

    starting: those that were given to the work which looks for a start; they wait until it is adopted.
    """

    def __init__(self) -> None:
        self.starting: tuple[WaitingFrame, ...] = ()
        self._unstarted: deque[WaitingFrame] = deque()
        self._untracked: deque[WaitingFrame] = deque()

    def __len__(self) -> int:
        return len(self.starting) + len(self._unstarted) + len(self._untracked)

    def __iter__(self) -> Iterator[WaitingFrame]:
        for frames in (self.starting, self._unstarted, self._untracked):
            yield from frames

    @property
    def has_untracked(self) -> bool:
        """Whether frames are to be tracked before any that comes."""
        return bool(self._untracked)

    def wait_for_start(self, frame: WaitingFrame) -> None:
        """Have a frame, which comes after all those that do so, wait for a start."""
        self._unstarted.append(_with_own_image(frame))

    def wait_for_tracking(self, frame: WaitingFrame) -> None:
        """Have the latest frame wait until those before it are tracked."""
        self._untracked.append(_with_own_image(frame))

    def next_untracked(self) -> WaitingFrame:
        """Take the frame that is to be tracked next."""
        return self._untracked.popleft()

    def next_starting(self) -> tuple[WaitingFrame, ...]:
        """The frames that a start is to be looked for with now; none as long as there are such."""
        if self.starting:
            return ()
        self.starting = tuple(self._unstarted)
        self._unstarted.clear()
        return self.starting

    def forget_unstarted(self) -> None:
        """No start is needed for those that wait for one."""
        self._unstarted.clear()

    def track(self, rest: tuple[WaitingFrame, ...]) -> None:
        """A map has begun: those that the start did not look at any more, `rest`, are tracked, and then all others."""
        self._untracked.extendleft(reversed((*rest, *self._unstarted)))
        self._unstarted.clear()


def _with_own_image(frame: WaitingFrame) -> WaitingFrame:
    return replace(frame, image=np.array(frame.image, np.float32))
