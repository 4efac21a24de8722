"""Direct sparse odometry: poses of a moving camera from its grey images (Engel, Koltun, Cremers 2016).

image ──> pyramid ──> start (two frames) ──> track against newest keyframe ──> trace immature points
                                                           │ keyframe?
                                          activate points ──> adjust window ──> marginalize
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.back_end import move
from polarmap.odometry.frame_queue import FrameQueue
from polarmap.odometry.local_map import LocalMap, packed
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pyramid import PyramidFactory
from polarmap.odometry.records import FrameRecord, PointArchive
from polarmap.odometry.start.starter import Starter, WaitingFrame
from polarmap.odometry.work import Adopted, AnyDone, Begun, Done, Settled, SettleWork, Started, StartWork, Tracked, Work
from polarmap.timing import StepClock

_PATIENCE = 60  # frames without a pose until the map is given up


class Odometry:
    """Poses of a stream of images.

        odometry = Odometry(camera)
        for index, (image, timestamp) in enumerate(video):
            update = odometry.process(image, timestamp, index)
        result = odometry.result()

    camera: of the undistorted images. valid: bool H×W, the pixels that its lens shows, all if None. seed: of the
    choice of points.
    The unit of length is arbitrary: the mean inverse depth at the start is about 1. Memory does not grow with the
    number of frames but for their poses, and a cloud of at most 400 000 points.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        options: OdometryOptions | None = None,
        valid: np.ndarray | None = None,
        seed: int = 0,
    ) -> None:
        self.camera = camera
        self.options = options or OdometryOptions()
        self._valid = valid
        self._seed = seed
        self._factory = PyramidFactory(camera)
        self._clock = StepClock()
        self._frames: list[FrameRecord] = []
        self._without_pose: dict[int, str] = {}
        self._archive = PointArchive()
        self._exposure = 1.0
        self._segment = -1
        self._last_timestamp = self._last_index = -math.inf
        self._map: LocalMap | None = None
        self._closing: tuple[LocalMap, ...] = ()
        self._starter = self._new_starter()
        self._first: tuple[int, ...] = ()  # the frame that a start is looked for from
        self._queue = FrameQueue()

    def process(self, image: np.ndarray, timestamp: float, index: int, exposure: float | None = None) -> OdometryUpdate:
        """Take the next image, float32 H×W in [0, 1].

        timestamp: seconds. index: names the frame, and increases as time does. exposure: in any unit; where it is None
        or NaN, that of the frame before.
        Raises InputError where the image does not fit the camera or is not finite, or time or index do not increase.
        """
        tracked = self.track(image, timestamp, index, exposure)
        update, work = tracked.update, tracked.work
        while work is not None:
            adopted = self.adopt(work())
            update, work = adopted.update or update, adopted.work
        return update

    def track(
        self,
        image: np.ndarray,
        timestamp: float,
        index: int,
        exposure: float | None = None,
        catch_up: Callable[[], None] | None = None,
    ) -> Tracked:
        """The first half of `process`: the frame's pose, and the work that is left to do with it.

        Work must be done in the order in which it was given, one at a time, on any thread; what it returns is given to
        `adopt` in the same order, on the thread that tracks, and leads to more of it. Frames may be tracked meanwhile:
        against the keyframe before, if one is under way, and none of them becomes a keyframe until that is adopted.
        While a start is under way, frames wait for it, each with its image (`waiting`), as do those that come when the
        map has begun and earlier ones wait yet: `track_waiting`.
        catch_up: does and adopts all work but that of a start, called where the frame cannot be tracked before that.
        Raises InputError as `process` does.
        """
        self._check(image, timestamp, index)
        if exposure is not None and math.isfinite(exposure) and exposure > 0:
            self._exposure = float(exposure)
        frame = WaitingFrame(index, timestamp, image, self._exposure)
        if not self._queue.has_untracked:
            return self._take(frame, catch_up)
        self._queue.wait_for_tracking(frame)
        return Tracked(self._unposed(frame, "frames before it are tracked first"), None)

    def track_waiting(self, catch_up: Callable[[], None] | None = None) -> Tracked | None:
        """As `track`, for the frame that has waited longest for a map that has begun meanwhile; None if none does."""
        return self._take(self._queue.next_untracked(), catch_up) if self._queue.has_untracked else None

    @property
    def waiting(self) -> int:
        """Frames that wait for a start, or to be tracked since."""
        return len(self._queue)

    def adopt(self, done: AnyDone) -> Adopted:
        """The second half of `process`: go on with what work has returned."""
        if isinstance(done, Started):
            return self._adopt_start(done)
        move(done.realigned)
        if isinstance(done, Settled):
            return self._adopt_settled(done)
        return Adopted(self._adopt_frame(done), None)

    def wait(self) -> OdometryUpdate | None:
        """None: nothing is left to do after `process`. See `ThreadedOdometry.wait`."""
        return None

    def finish(self) -> None:
        """No frame will come any more: poses that wait for a last alignment get it, and `result` is final."""
        if self._map is not None:
            with self._clock("align again"):
                move(self._map.finish())

    def result(self) -> OdometryResult:
        """All that is known now, after any number of frames."""
        frames = tuple(frame.posed() for frame in sorted(self._frames, key=lambda frame: frame.timestamp))
        posed = {frame.index for frame in frames}
        without = tuple(item for item in sorted(self._without_pose.items()) if item[0] not in posed)
        archive = self._archive if self._map is None else self._map.back_end.archived()
        return OdometryResult(frames, archive.points(self.camera), without, dict(self._clock.milliseconds))

    def _check(self, image: np.ndarray, timestamp: float, index: int) -> None:
        if np.shape(image) != self.camera.shape:
            raise InputError(f"frame {index}: image {np.shape(image)} does not fit the camera {self.camera.shape}")
        if not np.isfinite(np.sum(image)):
            raise InputError(f"frame {index}: the image has values that are no finite numbers")
        if not math.isfinite(timestamp):
            raise InputError(f"frame {index}: it has no time; odometry needs one for every frame")
        if timestamp <= self._last_timestamp:
            kind = "the same time as" if timestamp == self._last_timestamp else "an earlier time than"
            raise InputError(
                f"frame {index}: at {timestamp} s it has {kind} the frame before it ({self._last_timestamp} s); "
                "sort the frames and remove duplicates"
            )
        if index <= self._last_index:
            raise InputError(
                f"frame {index}: its index does not come after that of the frame before, {self._last_index}"
            )
        self._last_timestamp, self._last_index = timestamp, index

    # Start

    def _new_starter(self) -> Starter:
        return Starter(self.camera, self.options, self._seed, self._valid)

    def _next_start(self) -> StartWork | None:
        """The work that looks for a start with the frames that wait; one at a time."""
        frames = self._queue.next_starting()
        if not frames:
            return None
        closing, self._closing = self._closing, ()
        new_map = partial(
            LocalMap, self.camera, self.options, self._factory, self._archive, self._segment + 1, self._valid,
            self._seed,
        )  # fmt: skip
        return StartWork(self._starter, frames, new_map, closing, self._factory, self._clock)

    def _adopt_start(self, done: Started) -> Adopted:
        """Go on with a map that has begun, unless the one before was found again meanwhile."""
        work = done.work
        move(done.realigned)
        self._queue.starting = ()
        if work.starter is not self._starter:
            return Adopted(None, self._next_start())
        for frame, reason in zip(work.frames, done.reasons, strict=False):
            reason = f"{frame.problem}; no new map: {reason}" if frame.problem else reason
            self._without_pose[frame.index] = reason
        if done.begun is not None:
            return self._begin(done.begun, work.frames[len(done.reasons) + 1 :])
        self._first = done.first
        return Adopted(self._unposed(frame, reason), self._next_start())

    def _begin(self, begun: Begun, rest: tuple[WaitingFrame, ...]) -> Adopted:
        """Go on with a new map; `rest` and all that have come since are to be tracked in it."""
        self._give_up()
        closing, self._closing = self._closing, ()
        self._map = local = begun.local
        self._segment += 1
        self._begin_search()
        self._queue.track(rest)
        self._frames.extend(begun.frames)
        first, second = begun.frames
        update = OdometryUpdate(
            second.index, second.timestamp, Status.TRACKED, self._segment, second.T_world_camera, "",
            (first.index, second.index), local.keyframe_poses(), self._held(), begun.depths,
        )  # fmt: skip
        return Adopted(update, SettleWork(local, begun.between, closing, self._clock))

    def _adopt_settled(self, done: Settled) -> Adopted:
        work = done.work
        last = work.between.left == 0
        self._frames.extend(done.frames)
        work.local.settle(done.frames, last)
        return Adopted(None, None if last else replace(work, closing=()))

    def _begin_search(self) -> None:
        """Look for a start from the next frame on."""
        self._starter, self._first = self._new_starter(), ()

    def _give_up(self) -> None:
        if self._map is not None:
            self._closing += (self._map,)
            self._map = None

    def _held(self) -> tuple[int, ...]:
        """Frames that may yet become keyframes."""
        local = self._map
        under_way = () if local is None or local.under_way is None else (local.under_way.index,)
        return (*self._first, *under_way, *(frame.index for frame in self._queue))

    def _unposed(self, frame: WaitingFrame, reason: str) -> OdometryUpdate:
        self._without_pose[frame.index] = reason
        status = Status.LOST if frame.problem else Status.STARTING
        segment = max(self._segment, 0)
        return OdometryUpdate(frame.index, frame.timestamp, status, segment, None, reason, held=self._held())

    # Tracking

    def _take(self, frame: WaitingFrame, catch_up: Callable[[], None] | None) -> Tracked:
        """Track a frame if there is a map, and have it wait for a start if it cannot be tracked."""
        if self._map is not None:
            tracked = self._track(self._map, frame, catch_up)
            if isinstance(tracked, Tracked):
                return tracked
            frame = replace(frame, problem=tracked)
        self._queue.wait_for_start(frame)
        work = self._next_start()
        return Tracked(self._unposed(frame, frame.problem or "a start of the map is looked for"), work)

    def _track(self, local: LocalMap, frame: WaitingFrame, catch_up: Callable[[], None] | None) -> Tracked | str:
        """The frame with its pose, or why it has none."""
        with self._clock("pyramid"):
            pyramid = self._factory.make(frame.image)
        with self._clock("track"):
            found, problem = local.track(pyramid, frame.exposure)
        if found is None and catch_up is not None:
            again = local.under_way is not None
            catch_up()
            if again:
                with self._clock("track"):
                    found, problem = local.track(pyramid, frame.exposure)
        if found is None:
            self._factory.give_back(pyramid)
            local.misses += 1
            if local.misses > _PATIENCE:
                self._give_up()
            return problem
        if local.misses:
            local.misses = 0
            self._queue.forget_unstarted()
            self._begin_search()
        record = local.take(found, frame.index, frame.timestamp, frame.exposure)
        self._frames.append(record)
        keyframe = local.begin_keyframe(record) if local.wants_keyframe(found) else None
        work = Work(
            local, local.sighting(record, found, frame.exposure), pyramid, keyframe,
            packed(frame.image) if keyframe is None else None, self._factory, self._clock,
        )  # fmt: skip
        return Tracked(self._tracked(local, record), work)

    def _tracked(self, local: LocalMap, record: FrameRecord) -> OdometryUpdate:
        return OdometryUpdate(
            record.index, record.timestamp, Status.TRACKED, self._segment, record.T_world_camera, "",
            keyframe_poses=local.keyframe_poses(), held=self._held(),
        )  # fmt: skip

    def _adopt_frame(self, done: Done) -> OdometryUpdate:
        """The update of a tracked frame, as it is now."""
        work, frame = done.work, done.work.sighting.frame
        if done.adjustment is None or work.keyframe is None:
            return self._tracked(work.local, frame)
        work.local.adopt(done.adjustment, frame, work.keyframe)
        return replace(
            self._tracked(work.local, frame), keyframes=(frame.index,), keyframe_poses=done.adjustment.poses,
            keyframe_depths={frame.index: done.adjustment.depths},
        )  # fmt: skip
