"""One map segment while it lives: the latest frames, what they are tracked against, and the back end behind it.

Tracking reads a `Reference`, which does not change, and the records of frames and keyframes, which change in `adopt`
alone. All else is the back end's. So `work` may be done on another thread while frames are tracked; what it returns
counts from `adopt` on.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.jit import njit
from polarmap.odometry.back_end import MIN_INLIERS, Adjustment, BackEnd, Realigned, Sighting, frame_affine
from polarmap.odometry.keyframe_rule import ViewChange
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pyramid import Pyramid, PyramidFactory
from polarmap.odometry.records import FrameRecord, KeyframeRecord, PointArchive
from polarmap.odometry.start.direct import Start
from polarmap.odometry.start.starter import WaitingFrame
from polarmap.odometry.track.motion import usual_motions
from polarmap.odometry.track.tracker import Alignment

_SURE_INLIERS = 0.85  # below which motions from matched corners are tried too
_MIN_POINTS = 400  # of the reference in view, those that it spread to neighbouring pixels included
_MAX_UNCERTAINTY = 0.15  # pixels; usual are 0.01 to 0.03
_MAX_GAIN = 6.0  # of brightness from one frame to the next
_KEPT, _TAKEN = 0.9, 0.1  # shares of the usual residual and of a frame's, which make the next usual one
_MAX_RMS_GROWTH = 2.0  # of the residual since the keyframe, above which a new one is made
_EARLY_KEYFRAME = 0.25  # of the keyframe score is enough for every keyframe that there is, until it is 1


class LocalMap:
    """Tracks frames against the newest keyframe, and has the back end grow the map.

    misses: frames in a row that could not be tracked. under_way: a keyframe was handed to the back end, and what came
    of it is not adopted yet; frames are tracked against the one before as long.
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
        self._segment = segment
        self._camera = camera
        self.back_end = BackEnd(camera, options, factory, archive, valid, seed)
        self._records: dict[int, KeyframeRecord] = {}  # by frame index, of the window's keyframes
        self._latest: deque[FrameRecord] = deque(maxlen=2)
        self._first_rms = np.inf  # of the first frame tracked against the reference; there is none yet
        self.misses = 0
        self.under_way: FrameRecord | None = None

    def begin(
        self, start: Start, first: WaitingFrame, second: WaitingFrame, pyramid: Pyramid
    ) -> tuple[FrameRecord, FrameRecord]:
        """Make the map from the start that two frames gave; their records. `settle` is to follow.

        pyramid: of the second frame; the map keeps it.
        """
        poses = self.back_end.begin(start, first, second, (self._factory.make(first.image), pyramid))
        self._usual_rms = self.back_end.noise
        self._records = {index: KeyframeRecord(index, self._segment, pose) for index, pose in poses.items()}
        records = (
            FrameRecord(first.index, first.timestamp, self._records[first.index], np.eye(4)),
            FrameRecord(second.index, second.timestamp, self._records[second.index], np.eye(4)),
        )
        self._before_second = records[0]
        self._latest.extend((records[1], records[1]))
        self._reference = self.back_end.accept(self._records)
        self._affine = self._reference.affine
        return records

    def settle(self, between: Sequence[FrameRecord], last: bool) -> None:
        """Take the next frames between the first two keyframes; last: no more of them come.

        Then the motion up to the second keyframe is known, by which the frame after it is looked for. Until then the
        camera is expected to rest.
        """
        if between:
            self._before_second = between[-1]
        if last and self._latest[0] is self._latest[1]:
            self._latest[0] = self._before_second

    def track(self, pyramid: Pyramid, exposure: float) -> tuple[Alignment | None, str]:
        """Align a frame to the newest keyframe; None with the reason where it cannot be done for sure."""
        brightness = self._expected_brightness(exposure)
        tracker = self._reference.tracker
        found = tracker.align(pyramid, self._usual_motions(), *brightness, self._usual_rms)
        if alignment_problem(found, brightness[0]) or found.inliers < _SURE_INLIERS:
            motions = self._reference.matcher.motions(pyramid.levels[0])
            other = tracker.align(pyramid, motions, *brightness, self._usual_rms)
            if not alignment_problem(other, brightness[0]) and (found is None or other.rms < found.rms):
                found = other
        problem = alignment_problem(found, brightness[0])
        return (None if problem else found), problem

    def take(self, found: Alignment, index: int, timestamp: float, exposure: float) -> FrameRecord:
        """The record of a frame that was tracked; what follows is expected to go on like it."""
        reference = self._reference
        frame = FrameRecord(index, timestamp, self._records[reference.index], found.T_frame_reference)
        self._latest.append(frame)
        self._affine = frame_affine(found.gain, found.offset, exposure, reference.affine, reference.exposure)
        self._usual_rms = _KEPT * self._usual_rms + _TAKEN * found.rms
        if not np.isfinite(self._first_rms):
            self._first_rms = found.rms
        return frame

    def wants_keyframe(self, found: Alignment) -> bool:
        """DSO's rule (section 3.1, step 2); a map of few keyframes wants more of them sooner. One at a time."""
        if self.under_way is not None:
            return False
        change = ViewChange(found.flow, found.translation_flow, float(abs(np.log(found.gain))))
        score = change.score(self._camera, self._options)
        needed = min(1.0, _EARLY_KEYFRAME * self._reference.keyframes)
        return score > needed or found.rms > _MAX_RMS_GROWTH * self._first_rms

    def sighting(self, frame: FrameRecord, found: Alignment, exposure: float) -> Sighting:
        """What the back end is told of the frame that was taken last."""
        return Sighting(frame, self._reference.index, found.T_frame_reference, found.gain, found.offset, exposure)

    def begin_keyframe(self, frame: FrameRecord) -> KeyframeRecord:
        """The record with which the back end is to make the frame that was taken last a keyframe; `adopt` must come."""
        self.under_way = frame
        return KeyframeRecord(frame.index, self._segment, frame.T_world_camera)

    def adopt(self, adjustment: Adjustment, frame: FrameRecord, record: KeyframeRecord) -> None:
        """Go on with what the back end made of a frame that became a keyframe; its record `begin_keyframe` gave."""
        self._records[record.index] = record
        for index, T_world_camera in adjustment.poses.items():
            self._records[index].T_world_camera = T_world_camera
        for index in adjustment.left:
            del self._records[index]
        self.under_way = None
        frame.reference, frame.T_frame_reference = record, np.eye(4)
        self._reference = adjustment.reference
        self._first_rms = np.inf
        if self._latest[-1] is frame:
            self._affine = self._reference.affine

    def finish(self) -> Realigned:
        """Align the frames of all keyframes that have waited for it. Nothing may be under way."""
        return self.back_end.finish()

    def keyframe_poses(self) -> dict[int, np.ndarray]:
        """T_world_camera of the window's keyframes by frame index."""
        return {index: record.T_world_camera for index, record in self._records.items()}

    def close(self) -> Realigned:
        """Leave the window's points to the archive, and `finish`; the back end must not be used any more."""
        self.back_end.archive_window()
        return self.finish()

    def _usual_motions(self):
        reference = self._records[self._reference.index].T_world_camera
        last, before = (inverse(frame.T_world_camera) @ reference for frame in reversed(self._latest))
        return usual_motions(last, before)

    def _expected_brightness(self, exposure: float) -> tuple[float, float]:
        """Gain and offset against the reference if brightness stays as in the last frame."""
        reference = self._reference
        gain = exposure / reference.exposure * np.exp(self._affine[0] - reference.affine[0])
        return float(gain), float(self._affine[1] - gain * reference.affine[1])


def alignment_problem(found: Alignment | None, expected_gain: float) -> str:
    """Why an alignment is not to be believed; empty if it is."""
    if found is None or found.count < _MIN_POINTS:
        return "too few points of the map are in view"
    if found.inliers < MIN_INLIERS:
        return f"the image does not fit the map: {100 * found.inliers:.0f} % of the points match"
    if not 1 / _MAX_GAIN < found.gain / expected_gain < _MAX_GAIN:
        return f"the brightness changed by a factor of {found.gain / expected_gain:.2g}"
    if not found.uncertainty < _MAX_UNCERTAINTY:
        return "too little contrast in view"
    return ""


def packed(image: np.ndarray) -> np.ndarray:
    """An image in [0, 1] as uint16 up to 65535."""
    return _pack(np.ascontiguousarray(image, np.float32))


@njit
def _pack(image):
    result = np.empty(image.shape, np.uint16)
    for y in range(image.shape[0]):
        for x in range(image.shape[1]):
            value = min(max(image[y, x], np.float32(0.0)), np.float32(1.0))
            result[y, x] = np.uint16(np.float32(65535.0) * value + np.float32(0.5))
    return result
