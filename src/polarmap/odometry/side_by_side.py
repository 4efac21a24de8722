"""Odometry whose back end runs beside it: a frame waits for its pose, and for nothing else.

    track frame n ──> pose                 track frame n+1 ──> pose           track frame n+2 ──> pose, keyframe n
          └─ work n ─> [ trace, activate, adjust, marginalize, choose points, align again ] ─┘ adopted

Work is done in the order of frames by one thread (as DSO's mapping thread does), and what came of it is adopted on the
thread that calls. A frame becomes a keyframe some frames after it was tracked. Until then frames are tracked against
the keyframe before, and none of them becomes one. A start is such work as well: frames that come meanwhile wait, and
are tracked a few at a time once there is a map.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.odometry.odometry import Odometry
from polarmap.odometry.work import AnyDone, AnyWork, StartWork, Work

_MOST_TRACED = 8  # frames that wait for the back end, each with a pyramid; further ones are not traced
_MOST_QUEUED = 24  # frames that wait; with more of them the next one waits, or tracking would outrun the map
_MOST_WAITING = 24  # frames that wait for a start, or to be tracked since, each with its image; the next one waits
_TRACKED_AT_ONCE = 2  # of those, before a new frame

_Job = TypeVar("_Job")
_Result = TypeVar("_Result")


class Executor(Protocol):
    """Does jobs one after the other, in order; `concurrent.futures.ThreadPoolExecutor(1)` is one."""

    def submit(self, work: Callable[[_Job], _Result], job: _Job, /) -> Future[_Result]:
        """Have work(job) done."""
        ...


class ThreadedOdometry:
    """`Odometry` with the same interface, whose `process` returns as soon as the frame's pose is known.

        odometry = ThreadedOdometry(Odometry(camera))
        for index, (image, timestamp) in enumerate(video):
            update = odometry.process(image, timestamp, index)
        last = odometry.wait()
        odometry.finish()
        result = odometry.result()

    An update's keyframes are those that were adopted since the update before: mostly of earlier frames, which were
    among `held` until then. Poses of one run to another differ by which frames those are, as with any two threads.
    Where a frame cannot be tracked, the back end is waited for, and it is tried again. While a map begins, frames have
    the status STARTING and get their poses later: `result` has them.

    executor: does the work; a thread of its own by default. One that does it at once gives what `Odometry` gives.
    untraced: frames in which no immature points were searched since more than eight waited for the back end. They have
    their poses all the same.
    What goes wrong in the back end is raised by the next call, and by every one after it.
    """

    def __init__(self, odometry: Odometry, executor: Executor | None = None) -> None:
        self.camera, self.options = odometry.camera, odometry.options
        self.untraced = 0
        self._odometry = odometry
        self._own: ThreadPoolExecutor | None = None
        if executor is None:
            executor = self._own = ThreadPoolExecutor(1, "polarmap-odometry")
        self._executor: Executor = executor
        self._queue: deque[tuple[AnyWork, Future[AnyDone]]] = deque()
        self._news: list[OdometryUpdate] = []
        self._last: OdometryUpdate | None = None
        self._failure: BaseException | None = None

    def process(self, image: np.ndarray, timestamp: float, index: int, exposure: float | None = None) -> OdometryUpdate:
        """As `Odometry.process`; the image may be used for something else afterwards."""
        self._adopt_done()
        for _ in range(_TRACKED_AT_ONCE):
            if not self._track_waiting():
                break
        while self._odometry.waiting >= _MOST_WAITING and not self._track_waiting():
            self._adopt_next()
        tracked = self._odometry.track(image, timestamp, index, exposure, self._adopt_tracked)
        self._last = tracked.update
        self._submit(tracked.work)
        self._adopt_done()
        return self._with_news(self._last)

    def wait(self) -> OdometryUpdate | None:
        """Have the back end do all that is left: the last frame's update with the keyframes that came of it, if any."""
        self._adopt_all()
        return self._with_news(self._last) if self._news and self._last is not None else None

    def finish(self) -> None:
        """As `Odometry.finish`, when all is done that is left. Keyframes that came of it are known to `wait` before."""
        try:
            self._adopt_all()
            self._odometry.finish()
        finally:
            self.close()

    def result(self) -> OdometryResult:
        """As `Odometry.result`, when all is done that is left."""
        self._adopt_all()
        return self._odometry.result()

    def close(self) -> None:
        """End the thread, once it has done what it is at; what waits is left undone."""
        if self._own is not None:
            self._own.shutdown(wait=True, cancel_futures=True)

    def _submit(self, work: AnyWork | None) -> None:
        if work is None:
            return
        while len(self._queue) >= _MOST_QUEUED:
            self._adopt_next()
        if isinstance(work, Work) and work.keyframe is None and len(self._queue) >= _MOST_TRACED:
            work = work.without_trace()
            self.untraced += 1
        self._queue.append((work, self._executor.submit(_done, work)))

    def _track_waiting(self) -> bool:
        """Track one of the frames that came before there was a map."""
        tracked = self._odometry.track_waiting(self._adopt_tracked)
        if tracked is not None:
            self._submit(tracked.work)
        return tracked is not None

    def _adopt_done(self) -> None:
        self._raise_failure()
        while self._queue and self._queue[0][1].done():
            self._adopt_next()

    def _adopt_all(self) -> None:
        """Have everything done, and all frames tracked."""
        self._raise_failure()
        while self._queue or self._track_waiting():
            if self._queue:
                self._adopt_next()

    def _adopt_tracked(self) -> None:
        """Have everything done but a start."""
        self._raise_failure()
        while any(not isinstance(work, StartWork) for work, _ in self._queue):
            self._adopt_next()

    def _adopt_next(self) -> None:
        """Wait for the work that has waited longest, and go on with what came of it."""
        _, future = self._queue[0]
        self._failure = future.exception()
        self._raise_failure()
        self._queue.popleft()
        adopted = self._odometry.adopt(future.result())
        update = adopted.update
        if update is not None and update.keyframes:
            self._news.append(update)
        if update is not None and self._last is not None and update.index == self._last.index:
            self._last = replace(update, keyframes=(), keyframe_depths={})
        self._submit(adopted.work)

    def _raise_failure(self) -> None:
        if self._failure is not None:
            raise self._failure

    def _with_news(self, update: OdometryUpdate) -> OdometryUpdate:
        """An update with the keyframes that were adopted since the one before."""
        news, self._news = self._news, []
        if not news:
            return update
        if update.segment != news[-1].segment:  # a map has begun since, in which the frame is not tracked yet
            update = replace(update, segment=news[-1].segment, status=Status.STARTING, keyframe_poses={})
        poses, depths = dict(update.keyframe_poses), dict(update.keyframe_depths)
        for other in news:
            poses.update(other.keyframe_poses)
            depths.update(other.keyframe_depths)
        keyframes = (*(index for other in news for index in other.keyframes), *update.keyframes)
        held = tuple(index for index in update.held if index not in keyframes)
        return replace(update, keyframes=keyframes, keyframe_poses=poses, keyframe_depths=depths, held=held)


def _done(work: AnyWork) -> AnyDone:
    return work()
