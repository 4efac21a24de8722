"""The back end of a map segment: what is done with a frame once its pose is known (DSO's mapping thread).

It owns the window. What it is given it does in order, on one thread at a time, which need not be that which tracks;
what it finds it returns, as things that nobody changes afterwards.
"""

from __future__ import annotations

import logging
from collections import deque
from dataclasses import dataclass, field

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.keyframe_rule import vga_scale
from polarmap.odometry.keyframing import KeyframeMapper
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import ActivePoints
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.records import FrameRecord, KeyframeRecord, PointArchive
from polarmap.odometry.start.direct import Start
from polarmap.odometry.start.starter import WaitingFrame
from polarmap.odometry.track.motion import FeatureMatcher
from polarmap.odometry.track.tracker import Tracker
from polarmap.odometry.window.tracing import trace
from polarmap.odometry.window.window import KeyframeState

log = logging.getLogger(__name__)

MIN_INLIERS = 0.7  # of the points in view, below which a frame is not tracked
_REALIGN_AFTER = 2  # keyframes, when a keyframe's frames are aligned to it once more
_REALIGNED = 40  # frames of a keyframe that are, at most
_REALIGN_LEVELS = 1  # the finest; the first alignment is right to a fraction of its pixels
_REALIGNED_AT_ONCE = 2  # frames, when another one comes: no fewer than come, and no long work in one go

Realigned = tuple[tuple[FrameRecord, np.ndarray], ...]
"""Frames with their new T_frame_reference."""


def move(realigned: Realigned) -> None:
    """Give frames the poses that were found when they were aligned again."""
    for frame, T_frame_reference in realigned:
        frame.T_frame_reference = T_frame_reference


@dataclass(frozen=True, eq=False)
class Sighting:
    """A frame that was aligned to a keyframe of the window.

    frame: its record, which the back end hands back and does not read. reference: index of the keyframe.
    T_frame_reference: float64 4×4. gain, offset: a reference intensity I is expected as gain I + offset.
    exposure: relative to other frames.
    """

    frame: FrameRecord
    reference: int
    T_frame_reference: np.ndarray
    gain: float
    offset: float
    exposure: float


@dataclass(frozen=True, eq=False)
class Reference:
    """What frames are tracked against: the newest keyframe as it was when it was adjusted.

    index: of the frame. affine: a, b. keyframes: how many the window has.
    """

    index: int
    affine: np.ndarray
    exposure: float
    keyframes: int
    tracker: Tracker
    matcher: FeatureMatcher


@dataclass(frozen=True, eq=False)
class Adjustment:
    """What has changed when a frame has become a keyframe.

    reference: the new one. poses: T_world_camera by index of all keyframes that have moved, those that `left` the
    window with it included. depths: z of the points that the new keyframe shows, float32 N.
    """

    reference: Reference
    poses: dict[int, np.ndarray]
    left: tuple[int, ...]
    depths: np.ndarray


@dataclass(frozen=True, eq=False)
class _Follower:
    """A frame to be aligned to its keyframe once more: image uint16 H×W, brightness as it was found."""

    sighting: Sighting
    image: np.ndarray


@dataclass(frozen=True, eq=False)
class _Again:
    """A frame to be aligned again now."""

    tracker: Tracker
    follower: _Follower


@dataclass(frozen=True, eq=False)
class _Host:
    """A keyframe that frames were aligned to; the pyramid has all levels, and is given back when it is done."""

    keyframe: KeyframeState
    pyramid: Pyramid
    followers: list[_Follower] = field(default_factory=list)


class BackEnd:
    """Traces, adds keyframes, adjusts, and aligns frames again.

    noise: of a residual, in grey values.
    """

    def __init__(
        self,
        camera: PinholeCamera,
        options: OdometryOptions,
        factory: PyramidFactory,
        archive: PointArchive,
        valid: np.ndarray | None = None,
        seed: int = 0,
    ) -> None:
        self._options = options
        self._factory = factory
        self._archive = archive
        self._camera = camera
        self._mapper = KeyframeMapper(camera, options, seed, self._points_gone, valid)
        self._records: dict[int, KeyframeRecord] = {}  # by frame index, of the window's keyframes
        self._hosts: deque[_Host] = deque()
        self._again: deque[_Again] = deque()
        self._retired: tuple[int, Tracker] | None = None  # the keyframe whose frames were aligned again last
        self.noise = 1.0

    def begin(
        self, start: Start, first: WaitingFrame, second: WaitingFrame, pyramids: tuple[Pyramid, Pyramid]
    ) -> dict[int, np.ndarray]:
        """Make the map from the start that two frames gave; their poses, T_world_camera by index.

        The back end keeps the pyramids. `accept` must follow.
        """
        adjusted = self._mapper.begin(
            (first.index, pyramids[0], first.exposure), (second.index, pyramids[1], second.exposure), start
        )
        self.noise = adjusted.rms
        keyframes = self._mapper.window.keyframes
        self._hosts.extend(map(_Host, keyframes, pyramids))
        return {keyframe.index: keyframe.T_world_camera for keyframe in keyframes}

    def accept(self, records: dict[int, KeyframeRecord]) -> Reference:
        """Take the records of the first keyframes, by index, to which points are kept; what to track against."""
        self._records.update(records)
        return self._reference(self._mapper.points_in(self._mapper.window.newest))

    def tracker_of_first(self) -> Tracker:
        """For the frames between the first keyframe and the second."""
        host = self._hosts[0]
        return self._tracker(host, len(self._factory.cameras), self._mapper.points_in(host.keyframe))

    def trace(self, pyramid: Pyramid, sighting: Sighting) -> None:
        """Search the immature points in a frame."""
        window = self._mapper.window
        keyframe = self._keyframe(sighting.reference)
        T = sighting.T_frame_reference @ keyframe.T_camera_world
        projection = window.projection_to(T, _affine(sighting, keyframe), sighting.exposure)
        length = self._options.search_length / vga_scale(self._camera)
        trace(window.immature, pyramid.levels[0], projection, self._options.huber, length)

    def follow(self, sighting: Sighting, image: np.ndarray) -> None:
        """Hold the image, uint16 H×W, of a frame that is no keyframe, to make its pose better later."""
        for host in self._hosts:
            if host.keyframe.index == sighting.reference and len(host.followers) < _REALIGNED:
                host.followers.append(_Follower(sighting, image))
        if self._retired is not None and self._retired[0] == sighting.reference:  # it comes late
            self._again.append(_Again(self._retired[1], _Follower(sighting, image)))

    def add_keyframe(self, pyramid: Pyramid, sighting: Sighting, record: KeyframeRecord) -> Adjustment:
        """Make a frame a keyframe that was traced already, with this record. The back end keeps the pyramid."""
        before = self._keyframe(sighting.reference)
        T = sighting.T_frame_reference @ before.T_camera_world
        self._records[record.index] = record
        adjusted, left = self._mapper.add(record.index, pyramid, T, _affine(sighting, before), sighting.exposure)
        self.noise = adjusted.rms
        window = self._mapper.window
        log.debug("keyframe %d: %s, %d points", record.index, adjusted, len(window.points))
        poses = {keyframe.index: keyframe.T_world_camera for keyframe in (*left, *window.keyframes)}
        for keyframe in left:
            del self._records[keyframe.index]
        self._hosts.append(_Host(window.newest, pyramid))
        points = self._mapper.points_in(window.newest)
        reference = self._reference(points)
        while len(self._hosts) > _REALIGN_AFTER:
            self._retire(self._hosts.popleft())
        return Adjustment(reference, poses, tuple(k.index for k in left), _depths(points[1]))

    def depths(self) -> dict[int, np.ndarray]:
        """z of the points that each keyframe of the window shows, float32 N, by frame index."""
        keyframes = self._mapper.window.keyframes
        return {keyframe.index: _depths(self._mapper.points_in(keyframe)[1]) for keyframe in keyframes}

    def realign(self, most: int = _REALIGNED_AT_ONCE) -> Realigned:
        """Align some of the frames to their keyframe again whose points later keyframes have made better."""
        realigned = []
        for _ in range(min(most, len(self._again))):
            again = self._again.popleft()
            sighting = again.follower.sighting
            pyramid = self._factory.make(again.follower.image)
            found = again.tracker.realign(pyramid, sighting.T_frame_reference, sighting.gain, sighting.offset)
            if found is not None and found[1] > MIN_INLIERS:
                realigned.append((sighting.frame, found[0]))
            self._factory.give_back(pyramid)
        return tuple(realigned)

    def finish(self) -> Realigned:
        """Align the frames of all keyframes that have waited for it."""
        while self._hosts:
            self._retire(self._hosts.popleft())
        return self.realign(len(self._again))

    def archived(self) -> PointArchive:
        """The archive with the window's points."""
        return self._archive.joined(self._mapper.window.points, self._records_by_slot(), self.noise)

    def archive_window(self) -> None:
        """Leave the window's points to the archive; nothing can be added any more."""
        self._points_gone(self._mapper.window.points)

    def _keyframe(self, index: int) -> KeyframeState:
        """A keyframe that frames are tracked against: the newest, or the one before, which both stay in the window."""
        return next(k for k in reversed(self._mapper.window.keyframes) if k.index == index)

    def _reference(self, points: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Reference:
        host = self._hosts[-1]
        matcher = FeatureMatcher(self._camera)
        matcher.set_reference(host.pyramid.levels[0], points[0], points[1])
        keyframe = host.keyframe
        return Reference(
            keyframe.index, keyframe.affine.copy(), keyframe.exposure, len(self._mapper.window.keyframes),
            self._tracker(host, len(self._factory.cameras), points), matcher,
        )  # fmt: skip

    def _tracker(self, host: _Host, levels: int, points: tuple[np.ndarray, np.ndarray, np.ndarray]) -> Tracker:
        tracker = Tracker(self._factory.cameras[:levels], self._options.huber)
        tracker.set_reference(host.pyramid, *points)
        return tracker

    def _retire(self, host: _Host) -> None:
        """Have a keyframe's frames aligned to it as its points are now."""
        if host.followers and host.keyframe in self._mapper.window.keyframes:
            tracker = self._tracker(host, _REALIGN_LEVELS, self._mapper.points_in(host.keyframe))
            self._again.extend(_Again(tracker, follower) for follower in host.followers)
            self._retired = (host.keyframe.index, tracker)
        self._factory.give_back(host.pyramid)

    def _records_by_slot(self) -> dict[int, KeyframeRecord]:
        return {keyframe.slot: self._records[keyframe.index] for keyframe in self._mapper.window.keyframes}

    def _points_gone(self, points: ActivePoints) -> None:
        self._archive.add(points, self._records_by_slot(), self.noise)


def _affine(sighting: Sighting, keyframe: KeyframeState) -> np.ndarray:
    """a, b of a frame by those of the keyframe that it was aligned to."""
    return frame_affine(sighting.gain, sighting.offset, sighting.exposure, keyframe.affine, keyframe.exposure)


def frame_affine(
    gain: float, offset: float, exposure: float, affine: np.ndarray, reference_exposure: float
) -> np.ndarray:
    """a, b of a frame in which a reference's intensity I is expected as gain I + offset (DSO, equation 4)."""
    a = affine[0] + np.log(gain) - np.log(exposure / reference_exposure)
    return np.array([a, offset + gain * affine[1]])


def _depths(inverse_depth: np.ndarray) -> np.ndarray:
    return (1.0 / inverse_depth[inverse_depth > 0]).astype(np.float32)
