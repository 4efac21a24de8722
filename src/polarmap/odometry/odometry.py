"""Direct sparse odometry: poses of a moving camera from its grey images (Engel, Koltun, Cremers 2016).

    image ──> pyramid ──> start (two frames) ──> track to newest keyframe ──> trace candidates
                                                          │ keyframe?
                                                 activate ──> adjust window ──> marginalize
"""

from __future__ import annotations

import logging
import math
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.odometry.keyframing import KeyframeMapper
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.results import OdometryResult, OdometryUpdate, PosedFrame, SparsePoints, Status
from polarmap.odometry.starting import Starter, WaitingFrame
from polarmap.odometry.tracing import trace
from polarmap.odometry.tracker import Alignment, Tracker
from polarmap.timing import StepClock

log = logging.getLogger(__name__)

_MIN_INLIERS = 0.4
_MIN_SEEN = 0.15
_PATIENCE = 8  # frames without a pose until the map is given up


@dataclass(eq=False)
class _KeyframeRecord:
    """What stays of a keyframe for good."""

    index: int
    segment: int
    T_world_camera: np.ndarray


@dataclass(eq=False)
class _FrameRecord:
    """A tracked frame, by its motion from a keyframe."""

    index: int
    timestamp: float
    reference: _KeyframeRecord
    T_frame_reference: np.ndarray

    @property
    def T_world_camera(self) -> np.ndarray:
        return self.reference.T_world_camera @ inverse(self.T_frame_reference)


class Odometry:
    """Poses of a stream of images.

        odometry = Odometry(camera)
        for index, (image, timestamp) in enumerate(video):
            update = odometry.process(image, timestamp, index)
        result = odometry.result()

    camera: of the undistorted images. photometric: undoes response and vignetting of each image.
    The unit of length is arbitrary: the mean inverse depth at the start is 1.
    """

    def __init__(
        self, camera: PinholeCamera, options: OdometryOptions | None = None, photometric=None, seed: int = 0
    ) -> None:
        self.camera = camera
        self.options = options or OdometryOptions()
        self._photometric = photometric
        self._seed = seed
        self._factory = PyramidFactory(camera)
        self._clock = StepClock()
        self._scale = (640 + 480) / (camera.width + camera.height)
        self._frames: list[_FrameRecord] = []
        self._without_pose: list[tuple[int, str]] = []
        self._archive: list[tuple] = []
        self._segment = -1
        self._last_timestamp = -math.inf
        self._new_segment()

    def process(
        self, image: np.ndarray, timestamp: float, index: int, exposure: float | None = None
    ) -> OdometryUpdate:
        """Take the next image, float32 H×W in [0, 1]; timestamp in seconds; exposure in any unit, None if unknown.

        Raises InputError where the image does not fit the camera, or time does not increase.
        """
        self._check(image, timestamp, index)
        exposure = 1.0 if exposure is None or not np.isfinite(exposure) else float(exposure)
        with self._clock("pyramid"):
            if self._photometric is not None:
                image = self._photometric.correct(image)
            pyramid = self._factory.make(image)
        if self._tracker is None:
            update = self._start(pyramid, image, timestamp, index, exposure)
        else:
            update = self._track(pyramid, timestamp, index, exposure)
        if update.T_world_camera is None:
            self._without_pose.append((index, update.reason))
        return update

    def finish(self) -> None:
        """Nothing more will come."""

    def result(self) -> OdometryResult:
        """All poses and points known now."""
        keyframes = {(r.segment, r.index) for r in self._all_records}
        frames = tuple(
            PosedFrame(
                f.index, f.timestamp, f.reference.segment, f.T_world_camera,
                (f.reference.segment, f.index) in keyframes,
            )
            for f in sorted(self._frames, key=lambda f: f.timestamp)
        )  # fmt: skip
        posed = {f.index for f in frames}
        without = tuple((i, reason) for i, reason in self._without_pose if i not in posed)
        return OdometryResult(frames, self._points(), without, dict(self._clock.milliseconds))

    def _check(self, image, timestamp, index) -> None:
        if np.shape(image) != self.camera.shape:
            raise InputError(f"frame {index}: image {np.shape(image)} does not fit the camera {self.camera.shape}")
        if not math.isfinite(timestamp):
            raise InputError(f"frame {index}: it has no time; odometry needs one for every frame")
        if timestamp <= self._last_timestamp:
            kind = "the same time as" if timestamp == self._last_timestamp else "an earlier time than"
            raise InputError(f"frame {index}: {kind} the frame before ({timestamp} s); sort and remove duplicates")
        self._last_timestamp = timestamp

    def _new_segment(self) -> None:
        self._segment += 1
        self._mapper = KeyframeMapper(self.camera, self.options, self._seed, self._archive_points)
        self._tracker: Tracker | None = None
        self._records: dict[int, _KeyframeRecord] = {}  # by frame index, of keyframes in the window
        if self._segment == 0:
            self._all_records: list[_KeyframeRecord] = []
        self._starter = Starter(self.camera, self.options, self._seed)
        self._usual_rms = 8.0

    # --- start

    def _start(self, pyramid, image, timestamp, index, exposure) -> OdometryUpdate:
        frame = WaitingFrame(index, timestamp, np.array(image, np.float32), exposure)
        with self._clock("start"):
            start = self._starter.add(frame, pyramid)
            if start is None:
                self._factory.give_back(pyramid)
                return self._starting(index, timestamp, self._starter.reason)
            first, *between = self._starter.waiting
            first_pyramid = self._factory.make(first.image)
            adjusted = self._mapper.begin(
                (first.index, first_pyramid, first.exposure), (index, pyramid, exposure), start.T_second_first,
                start.gain, start.offset, start.pixels, start.inverse_depth,
            )  # fmt: skip
            log.info("start: %s", adjusted)
            for number, keyframe in zip((first.index, index), self._mapper.window.keyframes, strict=True):
                record = _KeyframeRecord(number, self._segment, keyframe.T_world_camera)
                self._records[number] = record
                self._all_records.append(record)
            self._usual_rms = max(adjusted.rms, 1.0)
            self._backfill(first, first_pyramid, between)
            self._frames.append(_FrameRecord(index, timestamp, self._records[index], np.eye(4)))
            self._tracker = Tracker(self._factory.cameras, self.options.huber)
            self._set_reference(pyramid)
        T = self._frames[-1].T_world_camera
        return OdometryUpdate(
            index, timestamp, Status.TRACKED, self._segment, T, "", (first.index, index), self._keyframe_poses()
        )

    def _starting(self, index, timestamp, reason) -> OdometryUpdate:
        held = tuple(frame.index for frame in self._starter.waiting[:1])
        return OdometryUpdate(index, timestamp, Status.STARTING, self._segment, None, reason, held=held)

    def _backfill(self, first: WaitingFrame, pyramid: Pyramid, between: list[WaitingFrame]) -> None:
        """Poses of the frames between the two that started the map, aligned to the first."""
        record = self._records[first.index]
        self._frames.append(_FrameRecord(first.index, first.timestamp, record, np.eye(4)))
        window = self._mapper.window
        points = window.points
        tracker = Tracker(self._factory.cameras, self.options.huber)
        tracker.set_reference(pyramid, points.pixel, points.inverse_depth, np.sqrt(points.information))
        T = np.eye(4)
        for frame in between:
            frame_pyramid = self._factory.make(frame.image)
            found = tracker.align(frame_pyramid, [T, np.eye(4)], frame.exposure / first.exposure, 0.0, self._usual_rms)
            if found is not None and found.inliers > _MIN_INLIERS:
                T = found.T_frame_reference
                self._frames.append(_FrameRecord(frame.index, frame.timestamp, record, T))
            self._factory.give_back(frame_pyramid)

    # --- tracking

    def _track(self, pyramid, timestamp, index, exposure) -> OdometryUpdate:
        window = self._mapper.window
        newest = window.newest
        with self._clock("track"):
            found = self._tracker.align(
                pyramid, self._hypotheses(), *self._expected_brightness(exposure), self._usual_rms
            )
        self.last_alignment = found
        if found is None or found.inliers < _MIN_INLIERS or found.seen < _MIN_SEEN:
            return self._lose(pyramid, timestamp, index, found)
        self._misses = 0
        affine = np.array(
            [
                newest.affine[0] + np.log(found.gain) - np.log(exposure / newest.exposure),
                found.offset + found.gain * newest.affine[1],
            ]
        )
        reference = self._records[newest.index]
        frame = _FrameRecord(index, timestamp, reference, found.T_frame_reference)
        self._frames.append(frame)
        self._recent.append(frame)
        self._last_brightness = (affine, exposure)
        T_camera_world = found.T_frame_reference @ newest.T_camera_world
        with self._clock("trace"):
            projection = window.projection_to(T_camera_world, affine, exposure)
            trace(
                window.candidates, pyramid.levels[0], projection, self.options.huber,
                self.options.search_length / self._scale,
            )  # fmt: skip
        self._usual_rms = 0.9 * self._usual_rms + 0.1 * found.rms
        keyframes = ()
        if self._is_keyframe(found, exposure, newest.exposure):
            self._make_keyframe(pyramid, index, frame, T_camera_world, affine, exposure)
            keyframes = (index,)
        else:
            self._factory.give_back(pyramid)
        return OdometryUpdate(
            index, timestamp, Status.TRACKED, self._segment, frame.T_world_camera, "", keyframes, self._keyframe_poses()
        )

    def _make_keyframe(self, pyramid, index, frame, T_camera_world, affine, exposure) -> None:
        with self._clock("adjust"):
            adjusted = self._mapper.add(index, pyramid, T_camera_world, affine, exposure)
        log.debug("keyframe %d: %s, %d points", index, adjusted, len(self._mapper.window.points))
        record = _KeyframeRecord(index, self._segment, self._mapper.window.newest.T_world_camera)
        self._records[index] = record
        self._all_records.append(record)
        frame.reference, frame.T_frame_reference = record, np.eye(4)
        for keyframe in self._mapper.window.keyframes:
            self._records[keyframe.index].T_world_camera = keyframe.T_world_camera
        present = {keyframe.index for keyframe in self._mapper.window.keyframes}
        self._records = {i: r for i, r in self._records.items() if i in present}
        with self._clock("reference"):
            self._set_reference(pyramid)

    def _set_reference(self, pyramid: Pyramid) -> None:
        pixels, inverse_depth, weights = self._mapper.reference_points()
        self._tracker.set_reference(pyramid, pixels, inverse_depth, weights)
        self._first_rms = None
        newest = self._mapper.window.newest
        self._last_brightness = (newest.affine, newest.exposure)
        if not hasattr(self, "_recent") or self._segment_of_recent != self._segment:
            self._recent: deque[_FrameRecord] = deque(self._frames[-2:], maxlen=2)
            self._segment_of_recent = self._segment
        self._factory.give_back(pyramid)

    def _is_keyframe(self, found: Alignment, exposure: float, exposure_reference: float) -> bool:
        options = self.options
        if self._first_rms is None:
            self._first_rms = found.rms
        flow = options.flow_weight * found.flow + options.translation_weight * found.translation_flow
        score = self._scale * flow + options.brightness_weight * abs(np.log(found.gain))
        return score > 1.0 or found.rms > 2.0 * self._first_rms

    def _expected_brightness(self, exposure: float) -> tuple[float, float]:
        """Gain and offset against the reference if brightness goes on as in the last frame."""
        newest = self._mapper.window.newest
        affine, _ = self._last_brightness
        gain = exposure / newest.exposure * np.exp(affine[0] - newest.affine[0])
        return float(gain), float(affine[1] - gain * newest.affine[1])

    def _hypotheses(self):
        """T_frame_reference to try, the likeliest first."""
        reference = self._records[self._mapper.window.newest.index]
        last = inverse(self._recent[-1].T_world_camera) @ reference.T_world_camera
        before = inverse(self._recent[0].T_world_camera) @ reference.T_world_camera
        motion = last @ inverse(before)
        yield motion @ last
        yield motion @ motion @ last
        yield last
        yield np.eye(4)
        from polarmap.geometry.lie import se3_exp

        for size in (0.02, 0.05):
            for axis in range(3):
                for sign in (-size, size):
                    xi = np.zeros(6)
                    xi[3 + axis] = sign
                    yield se3_exp(xi) @ motion @ last

    def _lose(self, pyramid, timestamp, index, found) -> OdometryUpdate:
        self._factory.give_back(pyramid)
        self._misses = getattr(self, "_misses", 0) + 1
        reason = "no match" if found is None else f"only {100 * found.inliers:.0f} % match, {100 * found.seen:.0f} % seen"
        if self._misses > _PATIENCE:
            self._new_segment()
            self._misses = 0
        return OdometryUpdate(index, timestamp, Status.LOST, self._segment, None, reason)

    # --- results

    def _keyframe_poses(self) -> dict[int, np.ndarray]:
        return {index: record.T_world_camera for index, record in self._records.items()}

    def _archive_points(self, points) -> None:
        by_slot = {keyframe.slot: self._records[keyframe.index] for keyframe in self._mapper.window.keyframes if keyframe.index in self._records}
        for slot, record in by_slot.items():
            own = points.host == slot
            if own.any():
                self._archive.append(
                    (record, points.pixel[own], points.inverse_depth[own], points.information[own], points.color[own, 4])
                )

    def _points(self) -> SparsePoints:
        return SparsePoints(*(np.zeros(0) for _ in range(7)))
