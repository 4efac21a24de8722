"""One map segment while it lives: its window of keyframes, the tracker on top of it, and the latest frames."""

from __future__ import annotations

import logging
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, field

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.jit import njit
from polarmap.odometry.keyframe_rule import ViewChange, vga_scale
from polarmap.odometry.keyframing import KeyframeMapper
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import ActivePoints
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.records import FrameRecord, KeyframeRecord, PointArchive
from polarmap.odometry.start.direct import Start
from polarmap.odometry.start.starter import WaitingFrame
from polarmap.odometry.track.motion import FeatureMatcher, usual_motions
from polarmap.odometry.track.tracker import Alignment, Tracker
from polarmap.odometry.window.tracing import trace
from polarmap.odometry.window.window import KeyframeState

log = logging.getLogger(__name__)

_MIN_INLIERS = 0.7  # of the points in view, below which a frame is not tracked
_SURE_INLIERS = 0.85  # below which motions from matched corners are tried too
_MIN_POINTS = 400  # of the reference in view, those that it spread to neighbouring pixels included
_MAX_UNCERTAINTY = 0.15  # pixels; usual are 0.01 to 0.03
_MAX_GAIN = 6.0  # of brightness from one frame to the next
_KEPT, _TAKEN = 0.9, 0.1  # shares of the usual residual and of a frame's, which make the next usual one
_MAX_RMS_GROWTH = 2.0  # of the residual since the keyframe, above which a new one is made
_EARLY_KEYFRAME = 0.25  # of the keyframe score is enough for every keyframe that there is, until it is 1
_REALIGN_AFTER = 2  # keyframes, when a keyframe's frames are aligned to it once more
_REALIGNED = 40  # frames of a keyframe that are, at most
_REALIGN_LEVELS = 2


@dataclass(frozen=True, eq=False)
class _Follower:
    """A frame to be aligned to its keyframe once more: image uint16 H×W, brightness as it was found."""

    frame: FrameRecord
    image: np.ndarray
    gain: float
    offset: float


@dataclass(frozen=True, eq=False)
class _Reference:
    """A keyframe that frames are aligned to; the pyramid has all levels, and is given back when it is done."""

    keyframe: KeyframeState
    pyramid: Pyramid
    followers: list[_Follower] = field(default_factory=list)


class LocalMap:
    """Tracks frames against the newest keyframe and grows the map with new ones.

    noise: of a residual, in grey values. misses: frames in a row that could not be tracked.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        options: OdometryOptions,
        factory: PyramidFactory,
        archive: PointArchive,
        segment: int,
        valid: np.ndarray | None = None,
        seed: int = 0,
    ) -> None:
        self._options = options
        self._factory = factory
        self._archive = archive
        self._segment = segment
        self._camera = camera
        self._mapper = KeyframeMapper(camera, options, seed, self._points_gone, valid)
        self._tracker = Tracker(factory.cameras, options.huber)
        self._matcher = FeatureMatcher(camera)
        self._records: dict[int, KeyframeRecord] = {}  # by frame index, of the window's keyframes
        self._latest: deque[FrameRecord] = deque(maxlen=2)
        self._references: deque[_Reference] = deque()
        self.noise = 1.0
        self.misses = 0

    def begin(
        self, start: Start, first: WaitingFrame, between: list[WaitingFrame], second: WaitingFrame, pyramid: Pyramid
    ) -> list[FrameRecord]:
        """Make the map from the start that `first` and `second` gave; records of all frames from one to the other.

        pyramid: of the second frame; the map keeps it.
        """
        first_pyramid = self._factory.make(first.image)
        adjusted = self._mapper.begin(
            (first.index, first_pyramid, first.exposure), (second.index, pyramid, second.exposure), start
        )
        self.noise = adjusted.rms
        self._usual_rms = adjusted.rms
        for keyframe in self._mapper.window.keyframes:
            self._records[keyframe.index] = KeyframeRecord(keyframe.index, self._segment, keyframe.T_world_camera)
        frames = [FrameRecord(first.index, first.timestamp, self._records[first.index], np.eye(4))]
        self._references.append(_Reference(self._mapper.window.keyframes[0], first_pyramid))
        frames += self._between(first, between)
        frames.append(FrameRecord(second.index, second.timestamp, self._records[second.index], np.eye(4)))
        self._latest.extend(frames[-2:])
        self._set_reference(pyramid)
        return frames

    def track(self, pyramid: Pyramid, exposure: float) -> tuple[Alignment | None, str]:
        """Align a frame to the newest keyframe; None with the reason where it cannot be done for sure."""
        brightness = self._expected_brightness(exposure)
        found = self._tracker.align(pyramid, self._usual_motions(), *brightness, self._usual_rms)
        if self._problem(found, brightness[0]) or found.inliers < _SURE_INLIERS:
            motions = self._matcher.motions(pyramid.levels[0])
            other = self._tracker.align(pyramid, motions, *brightness, self._usual_rms)
            if not self._problem(other, brightness[0]) and (found is None or other.rms < found.rms):
                found = other
        problem = self._problem(found, brightness[0])
        return (None if problem else found), problem

    def take(self, found: Alignment, index: int, timestamp: float, exposure: float) -> FrameRecord:
        """The record of a frame that was tracked; what follows is expected to go on like it."""
        newest = self._mapper.window.newest
        frame = FrameRecord(index, timestamp, self._records[newest.index], found.T_frame_reference)
        self._latest.append(frame)
        a = newest.affine[0] + np.log(found.gain) - np.log(exposure / newest.exposure)
        self._affine = np.array([a, found.offset + found.gain * newest.affine[1]])
        self._usual_rms = _KEPT * self._usual_rms + _TAKEN * found.rms
        if self._first_rms is None:
            self._first_rms = found.rms
        return frame

    def trace(self, pyramid: Pyramid, found: Alignment, exposure: float) -> None:
        """Search the immature points in the frame that was taken last."""
        window = self._mapper.window
        T = found.T_frame_reference @ window.newest.T_camera_world
        projection = window.projection_to(T, self._affine, exposure)
        length = self._options.search_length / vga_scale(self._camera)
        trace(window.immature, pyramid.levels[0], projection, self._options.huber, length)

    def wants_keyframe(self, found: Alignment) -> bool:
        """DSO's rule (section 3.1, step 2); a map of few keyframes wants more of them sooner."""
        change = ViewChange(found.flow, found.translation_flow, float(abs(np.log(found.gain))))
        score = change.score(self._camera, self._options)
        needed = min(1.0, _EARLY_KEYFRAME * len(self._mapper.window.keyframes))
        return score > needed or found.rms > _MAX_RMS_GROWTH * self._first_rms

    def add_keyframe(self, pyramid: Pyramid, frame: FrameRecord, exposure: float) -> dict[int, np.ndarray]:
        """Make the frame that was taken last a keyframe; poses of all keyframes that this has moved, by index.

        The map keeps the pyramid.
        """
        before = self._mapper.window.newest
        T = frame.T_frame_reference @ before.T_camera_world
        self._records[frame.index] = KeyframeRecord(frame.index, self._segment, frame.T_world_camera)
        adjusted, left = self._mapper.add(frame.index, pyramid, T, self._affine, exposure)
        self.noise = adjusted.rms
        log.debug("keyframe %d: %s, %d points", frame.index, adjusted, len(self._mapper.window.points))
        window = self._mapper.window
        for keyframe in (*window.keyframes, *left):
            self._records[keyframe.index].T_world_camera = keyframe.T_world_camera
        poses = self.keyframe_poses()
        for keyframe in left:
            del self._records[keyframe.index]
        frame.reference, frame.T_frame_reference = self._records[frame.index], np.eye(4)
        self._set_reference(pyramid)
        while len(self._references) > _REALIGN_AFTER:
            self._realign(self._references.popleft())
        return poses

    def follow(self, frame: FrameRecord, image: np.ndarray, found: Alignment) -> None:
        """Hold the image, float32 H×W in [0, 1], of a frame that is no keyframe, to make its pose better later."""
        followers = self._references[-1].followers
        if len(followers) < _REALIGNED:
            followers.append(
                _Follower(frame, _packed(np.ascontiguousarray(image, np.float32)), found.gain, found.offset)
            )

    def finish(self) -> None:
        """Align the frames of all keyframes that have waited for it."""
        while self._references:
            self._realign(self._references.popleft())

    def keyframe_poses(self) -> dict[int, np.ndarray]:
        """T_world_camera of the window's keyframes by frame index."""
        return {index: record.T_world_camera for index, record in self._records.items()}

    def keyframe_depths(self, indices: Collection[int]) -> dict[int, np.ndarray]:
        """z of the points that these keyframes of the window show, float32 N each, by frame index."""
        depths = {}
        for keyframe in self._mapper.window.keyframes:
            if keyframe.index in indices:
                _, inverse_depth, _ = self._mapper.points_in(keyframe)
                depths[keyframe.index] = (1.0 / inverse_depth[inverse_depth > 0]).astype(np.float32)
        return depths

    def archived(self) -> PointArchive:
        """The archive with the window's points."""
        return self._archive.joined(self._mapper.window.points, self._records_by_slot(), self.noise)

    def close(self) -> None:
        """Leave the window's points to the archive; the map must not be used any more."""
        self._points_gone(self._mapper.window.points)
        self.finish()

    def _between(self, first: WaitingFrame, between: list[WaitingFrame]) -> list[FrameRecord]:
        """Records of the frames between the two that made the start, aligned to the first."""
        reference = self._references[0]
        tracker = Tracker(self._factory.cameras, self._options.huber)
        tracker.set_reference(reference.pyramid, *self._mapper.points_in(reference.keyframe))
        records = []
        T = np.eye(4)
        for frame in between:
            pyramid = self._factory.make(frame.image)
            found = tracker.align(pyramid, [T, np.eye(4)], frame.exposure / first.exposure, 0.0, self._usual_rms)
            self._factory.give_back(pyramid)
            if self._problem(found, 1.0):
                continue
            T = found.T_frame_reference
            record = FrameRecord(frame.index, frame.timestamp, self._records[first.index], T)
            records.append(record)
            self.follow(record, frame.image, found)
        return records

    def _set_reference(self, pyramid: Pyramid) -> None:
        newest = self._mapper.window.newest
        points = self._mapper.points_in(newest)
        self._tracker.set_reference(pyramid, *points)
        self._matcher.set_reference(pyramid.levels[0], points[0], points[1])
        self._references.append(_Reference(newest, pyramid))
        self._affine = newest.affine
        self._first_rms: float | None = None

    def _realign(self, reference: _Reference) -> None:
        """Align frames to their keyframe again, whose points later keyframes have made better."""
        if reference.followers and reference.keyframe in self._mapper.window.keyframes:
            tracker = Tracker(self._factory.cameras[:_REALIGN_LEVELS], self._options.huber)
            tracker.set_reference(reference.pyramid, *self._mapper.points_in(reference.keyframe))
            for follower in reference.followers:
                pyramid = self._factory.make(follower.image)
                found = tracker.realign(pyramid, follower.frame.T_frame_reference, follower.gain, follower.offset)
                if found is not None and found[1] > _MIN_INLIERS:
                    follower.frame.T_frame_reference = found[0]
                self._factory.give_back(pyramid)
        self._factory.give_back(reference.pyramid)

    def _usual_motions(self):
        reference = self._records[self._mapper.window.newest.index].T_world_camera
        last, before = (inverse(frame.T_world_camera) @ reference for frame in reversed(self._latest))
        return usual_motions(last, before)

    def _expected_brightness(self, exposure: float) -> tuple[float, float]:
        """Gain and offset against the reference if brightness stays as in the last frame."""
        newest = self._mapper.window.newest
        gain = exposure / newest.exposure * np.exp(self._affine[0] - newest.affine[0])
        return float(gain), float(self._affine[1] - gain * newest.affine[1])

    def _problem(self, found: Alignment | None, expected_gain: float) -> str:
        """Why an alignment is not to be believed; empty if it is."""
        if found is None or found.count < _MIN_POINTS:
            return "too few points of the map are in view"
        if found.inliers < _MIN_INLIERS:
            return f"the image does not fit the map: {100 * found.inliers:.0f} % of the points match"
        if not 1 / _MAX_GAIN < found.gain / expected_gain < _MAX_GAIN:
            return f"the brightness changed by a factor of {found.gain / expected_gain:.2g}"
        if not found.uncertainty < _MAX_UNCERTAINTY:
            return "too little contrast in view"
        return ""

    def _records_by_slot(self) -> dict[int, KeyframeRecord]:
        return {keyframe.slot: self._records[keyframe.index] for keyframe in self._mapper.window.keyframes}

    def _points_gone(self, points: ActivePoints) -> None:
        self._archive.add(points, self._records_by_slot(), self.noise)


@njit
def _packed(image):
    """An image in [0, 1] as uint16 up to 65535."""
    packed = np.empty(image.shape, np.uint16)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            value = min(max(image[y, x], np.float32(0.0)), np.float32(1.0))
            packed[y, x] = np.uint16(np.float32(65535.0) * value + np.float32(0.5))
    return packed
