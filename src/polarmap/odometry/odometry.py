"""Direct sparse odometry: poses of a moving camera from its grey images (Engel, Koltun, Cremers 2016).

image ──> pyramid ──> start (two frames) ──> track against newest keyframe ──> trace immature points
                                                           │ keyframe?
                                          activate points ──> adjust window ──> marginalize
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.back_end import Adjustment, Realigned, Sighting
from polarmap.odometry.local_map import LocalMap, packed
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.records import FrameRecord, KeyframeRecord, PointArchive
from polarmap.odometry.start.direct import Start
from polarmap.odometry.start.starter import Starter, WaitingFrame
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
        self._without_pose: list[tuple[int, str]] = []
        self._archive = PointArchive()
        self._exposure = 1.0
        self._segment = -1
        self._last_timestamp = self._last_index = -math.inf
        self._map: LocalMap | None = None
        self._starter = self._new_starter()

    def process(self, image: np.ndarray, timestamp: float, index: int, exposure: float | None = None) -> OdometryUpdate:
        """Take the next image, float32 H×W in [0, 1].

        timestamp: seconds. index: names the frame, and increases as time does. exposure: in any unit; where it is None
        or NaN, that of the frame before.
        Raises InputError where the image does not fit the camera or is not finite, or time or index do not increase.
        """
        tracked = self.track(image, timestamp, index, exposure)
        return tracked.update if tracked.work is None else self.adopt(tracked.work, tracked.work())

    def track(
        self,
        image: np.ndarray,
        timestamp: float,
        index: int,
        exposure: float | None = None,
        catch_up: Callable[[], None] | None = None,
    ) -> Tracked:
        """The first half of `process`: the frame's pose, and the work that is left to do with it.

        Work must be done in the order of frames, one at a time, on any thread; what it returns is given to `adopt` in
        the same order, on the thread that tracks. Frames may be tracked meanwhile: against the keyframe before, if one
        is under way, and none of them becomes a keyframe until that is adopted.
        catch_up: does and adopts all that is left, called where the frame cannot be tracked before that, or a map ends.
        Raises InputError as `process` does.
        """
        self._check(image, timestamp, index)
        if exposure is not None and math.isfinite(exposure) and exposure > 0:
            self._exposure = float(exposure)
        exposure = self._exposure
        with self._clock("pyramid"):
            pyramid = self._factory.make(image)
        update = None
        if self._map is not None:
            tracked = self._track(self._map, image, pyramid, timestamp, index, exposure, catch_up)
            if tracked.update.status is not Status.LOST:
                return tracked
            update = tracked.update
        frame = WaitingFrame(index, timestamp, np.array(image, np.float32), exposure)
        update = self._start(frame, pyramid, update)
        if update.T_world_camera is None:
            self._without_pose.append((index, update.reason))
        return Tracked(update, None)

    def adopt(self, work: Work, done: Done) -> OdometryUpdate:
        """The second half of `process`: go on with what `work` has returned; the update of its frame, as it is now."""
        local, frame = work.local, work.sighting.frame
        local.move(done.realigned)
        if done.adjustment is None or work.keyframe is None:
            keyframes, poses, depths = (), local.keyframe_poses(), {}
        else:
            local.adopt(done.adjustment, frame, work.keyframe)
            keyframes, poses, depths = (frame.index,), done.adjustment.poses, {frame.index: done.adjustment.depths}
        return OdometryUpdate(
            frame.index, frame.timestamp, Status.TRACKED, self._segment, frame.T_world_camera, "", keyframes, poses,
            keyframe_depths=depths,
        )  # fmt: skip

    def wait(self) -> OdometryUpdate | None:
        """None: nothing is left to do after `process`. See `ThreadedOdometry.wait`."""
        return None

    def finish(self) -> None:
        """No frame will come any more: poses that wait for a last alignment get it, and `result` is final."""
        if self._map is not None:
            with self._clock("align again"):
                self._map.finish()

    def result(self) -> OdometryResult:
        """All that is known now, after any number of frames."""
        frames = tuple(frame.posed() for frame in sorted(self._frames, key=lambda frame: frame.timestamp))
        posed = {frame.index for frame in frames}
        without = tuple((index, reason) for index, reason in self._without_pose if index not in posed)
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

    def _start(self, frame: WaitingFrame, pyramid: Pyramid, lost: OdometryUpdate | None) -> OdometryUpdate:
        """Begin a map with this frame, or wait; `lost`: what tracking said of it, None if there is no map yet."""
        with self._clock("start"):
            start = self._starter.add(frame, pyramid)
        if start is not None:
            return self._begin(start, frame, pyramid)
        self._factory.give_back(pyramid)
        held = tuple(waiting.index for waiting in self._starter.waiting[:1])
        status = Status.STARTING if lost is None else Status.LOST
        reason = self._starter.reason if lost is None else f"{lost.reason}; no new map: {self._starter.reason}"
        segment = max(self._segment, 0)
        return OdometryUpdate(frame.index, frame.timestamp, status, segment, None, reason, held=held)

    def _begin(self, start: Start, frame: WaitingFrame, pyramid: Pyramid) -> OdometryUpdate:
        """A new map from the first waiting frame and this one."""
        self._give_up()
        self._segment += 1
        first, *between = self._starter.waiting
        self._starter = self._new_starter()
        with self._clock("start"):
            self._map = local = LocalMap(
                self.camera, self.options, self._factory, self._archive, self._segment, self._valid, self._seed
            )
            self._frames.extend(local.begin(start, first, between, frame, pyramid))
        return OdometryUpdate(
            frame.index, frame.timestamp, Status.TRACKED, self._segment, local.keyframe_poses()[frame.index], "",
            (first.index, frame.index), local.keyframe_poses(), keyframe_depths=local.back_end.depths(),
        )  # fmt: skip

    def _give_up(self) -> None:
        if self._map is not None:
            self._map.close()
            self._map = None

    # Tracking

    def _track(
        self,
        local: LocalMap,
        image: np.ndarray,
        pyramid: Pyramid,
        timestamp: float,
        index: int,
        exposure: float,
        catch_up: Callable[[], None] | None,
    ) -> Tracked:
        with self._clock("track"):
            found, problem = local.track(pyramid, exposure)
        if found is None and catch_up is not None:
            again = local.under_way is not None
            catch_up()
            if again:
                with self._clock("track"):
                    found, problem = local.track(pyramid, exposure)
        if found is None:
            local.misses += 1
            if local.misses > _PATIENCE:
                self._give_up()
            return Tracked(OdometryUpdate(index, timestamp, Status.LOST, self._segment, None, problem), None)
        if local.misses:
            local.misses, self._starter = 0, self._new_starter()
        frame = local.take(found, index, timestamp, exposure)
        self._frames.append(frame)
        keyframe = local.begin_keyframe(frame) if local.wants_keyframe(found) else None
        work = Work(
            local, local.sighting(frame, found, exposure), pyramid, keyframe,
            packed(image) if keyframe is None else None, self._factory, self._clock,
        )  # fmt: skip
        held = () if local.under_way is None else (local.under_way.index,)
        update = OdometryUpdate(
            index, timestamp, Status.TRACKED, self._segment, frame.T_world_camera, "",
            keyframe_poses=local.keyframe_poses(), held=held,
        )  # fmt: skip
        return Tracked(update, work)


@dataclass(frozen=True, eq=False)
class Tracked:
    """A frame whose pose is known, or known to be unknown.

    update: says nothing of keyframes but at a start; one that the frame is to become is among `held`. work: what is
    left to do; None if nothing is.
    """

    update: OdometryUpdate
    work: Work | None


@dataclass(frozen=True, eq=False)
class Done:
    """What work has come to: an adjustment, if the frame has become a keyframe, and earlier frames' better poses."""

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
            return Done(adjustment, () if self.keyframe is not None else back_end.realign())

    def without_trace(self) -> Work:
        """The same for a frame that becomes no keyframe, in which no immature points are searched."""
        if self.pyramid is not None:
            self.factory.give_back(self.pyramid)
        return replace(self, pyramid=None)
