"""Follows poses that are given from outside, and leaves out those that their neighbours or the pictures contradict."""

from __future__ import annotations

import logging
import math
from collections import deque
from collections.abc import Collection
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.trajectory import PosedFrame
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse, is_rigid
from polarmap.pipeline.poses.check import JudgedPoses, judge_poses
from polarmap.pipeline.poses.pictures import ENOUGH, Agreement, agreement, confirms, contradicts
from polarmap.pipeline.poses.source import Candidate, PoseUpdate

log = logging.getLogger(__name__)

SAME_PICTURE = "the picture is the same as the one before it, though its pose is another"
CONTRADICTED = "the picture does not show what moving from the one before it to its pose would"
ODD = "the picture and its pose do not fit those after it"

_LOOK_BACK = 3  # frames of a segment, when the first is judged
_HELD = 6  # frames, to compare a doubtful one with
_REMEMBERED = 90  # poses that judge a new one where there is no trajectory to look at whole
_SAME_TIME = 1e-6  # seconds
_PATIENCE = 3  # keyframes in a row that pictures contradict, before they are taken after all


class TimedPoses(Protocol):
    """A trajectory: seconds, increasing, N, and T_world_camera, N×4×4."""

    timestamps: np.ndarray
    poses: np.ndarray


class PoseFollower:
    """Judges given poses in order of time, and divides them into segments where they are elsewhere from then on.

    camera: of the images. trajectory: what the poses are taken from, if that is known as a whole; else each is judged
    by those before it.
    odd: the first frame of a segment, by index, once the third shows that its picture and pose do not fit; else None.
    """

    def __init__(self, camera: PinholeCamera, trajectory: TimedPoses | None = None) -> None:
        self._camera = camera
        self._judge = _Past() if trajectory is None else _Whole(trajectory)
        self._recent: deque[Candidate] = deque(maxlen=_HELD)
        self._usual: deque[Agreement] = deque(maxlen=_HELD)
        self._contradicted = 0  # keyframes in a row
        self._piece = 0
        self._segment = 0
        self._in_segment = 0  # frames taken
        self.odd: int | None = None
        self._posed: list[tuple[int, float, int, np.ndarray]] = []

    def follow(self, update: PoseUpdate) -> PoseUpdate:
        """The update of a frame whose pose is given, with its segment, or without its pose and with the reason."""
        if not update.candidates or not is_rigid(np.asarray(update.T_world_camera, np.float64)):
            return replace(update, segment=self._segment)
        candidate = update.candidates[0]
        reason, piece = self._judge(candidate)
        if (reason or piece != self._piece) and not self._is_confirmed(candidate):
            if reason:
                return self._left_out(reason)
            self._begin_segment(candidate)
        self._piece = piece
        self.odd = None
        if self._is_frozen(candidate):
            return self._left_out(SAME_PICTURE)
        self._recent.append(candidate)
        self._posed.append((candidate.index, candidate.timestamp, self._segment, candidate.T_world_camera))
        self._in_segment += 1
        if self._in_segment == _LOOK_BACK:
            self._look_at_the_first()
        return replace(update, segment=self._segment)

    def note(self, candidate: Candidate, segment: int) -> None:
        """Take a frame whose pose was found, not given: it is not judged, but `contradiction` can be asked of it."""
        if segment != self._segment:
            self._recent.clear()
            self._usual.clear()
        self._segment = segment
        self._recent.append(candidate)

    def segmented(self, keyframes: Collection[int]) -> tuple[PosedFrame, ...] | None:
        """All frames whose given poses were taken, if those fell into segments; else None. keyframes: their indices."""
        if not self._posed or self._posed[-1][2] == 0:
            return None
        return tuple(PosedFrame(*posed, is_keyframe=posed[0] in keyframes) for posed in self._posed)

    def contradiction(self, index: int) -> str:
        """Why the last frame taken should not be a keyframe; "" if its picture fits its pose."""
        if len(self._recent) < 2 or self._recent[-1].index != index:
            return ""
        now = self._agreement(-2, -1)
        usual = list(self._usual) or ([self._agreement(-3, -2)] if len(self._recent) > 2 else [])
        if contradicts(now, usual) and self._fits_an_older_one(usual):
            self._take_back(-2)
            return ""
        if self._contradicted < _PATIENCE and contradicts(now, usual):
            self._contradicted += 1
            self._take_back(-1)
            return CONTRADICTED
        if self._contradicted >= _PATIENCE:
            self._usual.clear()
        self._contradicted = 0
        if now.corners >= ENOUGH:
            self._usual.append(now)
        return ""

    def _fits_an_older_one(self, usual: list[Agreement]) -> bool:
        """Whether the last frame fits the last but two, so that the one between them is odd."""
        if len(self._recent) < 3:
            return False
        older = self._agreement(-3, -1)
        return confirms(older, usual[-1]) and not contradicts(older, usual)

    def _look_at_the_first(self) -> None:
        """With the third frame: whether the first fits neither of the others, which fit each other."""
        first, later, over = (self._agreement(*pair) for pair in ((0, 1), (1, 2), (0, 2)))
        if contradicts(first, [later]) and contradicts(over, [later]):
            self.odd = self._recent[0].index
            self._take_back(0)

    def _take_back(self, position: int) -> None:
        """Forget one of the last frames."""
        index = self._recent[position].index
        del self._recent[position]
        self._posed = [*self._posed[:-_HELD], *(posed for posed in self._posed[-_HELD:] if posed[0] != index)]

    def _left_out(self, reason: str) -> PoseUpdate:
        return PoseUpdate(status=Status.LOST, reason=reason, segment=self._segment)

    def _begin_segment(self, candidate: Candidate) -> None:
        self._segment += 1
        self._in_segment = 0
        self._recent.clear()
        self._usual.clear()
        log.warning("frame %d: the poses jump and stay there, so a new segment begins", candidate.index)

    def _is_confirmed(self, candidate: Candidate) -> bool:
        """Whether the pictures show a motion like the one that is doubtful."""
        if len(self._recent) < 2:
            return False
        self._recent.append(candidate)
        try:
            doubtful = self._agreement(-2, -1)
            return doubtful.corners >= ENOUGH and confirms(doubtful, self._agreement(0, -2))
        finally:
            self._recent.pop()

    def _agreement(self, before: int, after: int) -> Agreement:
        first, second = self._recent[before], self._recent[after]
        motion = inverse(second.T_world_camera) @ first.T_world_camera
        return agreement(first.frame.intensity, second.frame.intensity, motion, self._camera)

    def _is_frozen(self, candidate: Candidate) -> bool:
        if not self._recent:
            return False
        last = self._recent[-1]
        before, now = last.frame.intensity, candidate.frame.intensity
        if before is now or not np.array_equal(before[::16], now[::16]) or not np.array_equal(before, now):
            return False
        tolerance = 1e-6 * (1.0 + np.abs(last.T_world_camera).max())
        moved = np.abs(candidate.T_world_camera - last.T_world_camera).max() > tolerance
        return bool(moved) and now.max() > now.min()


@dataclass(frozen=True, eq=False)
class _Whole:
    """Judges frames by a trajectory that is known before and after."""

    timestamps: np.ndarray
    judged: JudgedPoses

    def __init__(self, trajectory: TimedPoses) -> None:
        object.__setattr__(self, "timestamps", trajectory.timestamps)
        object.__setattr__(self, "judged", judge_poses(trajectory.timestamps, trajectory.poses))

    def __call__(self, candidate: Candidate) -> tuple[str, int]:
        """Why a frame is left out, and its piece: by the poses at its time, or before and after it."""
        time, last = candidate.timestamp, len(self.timestamps) - 1
        after = min(int(np.searchsorted(self.timestamps, time - _SAME_TIME)), last)
        before = after if abs(self.timestamps[after] - time) <= _SAME_TIME else max(after - 1, 0)
        reasons, pieces = self.judged.reasons, self.judged.pieces
        if pieces[before] != pieces[after]:
            return reasons[before] or reasons[after] or "its time lies between poses that are far apart", pieces[before]
        return reasons[before] or reasons[after], int(pieces[after])


class _Past:
    """Judges frames by the poses before them; after many that agree with each other it gives in."""

    def __init__(self) -> None:
        self._poses: deque[tuple[float, np.ndarray]] = deque(maxlen=_REMEMBERED)
        self._pieces = 0

    def __call__(self, candidate: Candidate) -> tuple[str, int]:
        time, T = candidate.timestamp, np.asarray(candidate.T_world_camera, np.float64)
        if not math.isfinite(time) or (self._poses and time <= self._poses[-1][0]):
            self._poses.clear()
        if math.isfinite(time):
            self._poses.append((time, T))
        if len(self._poses) < 2:
            return "", self._pieces
        times, poses = (np.array(values) for values in zip(*self._poses, strict=True))
        judged = judge_poses(times, poses)
        if judged.pieces[-1] > 0 and not judged.reasons[-1]:
            self._pieces += 1
            kept = [p for p, piece in zip(self._poses, judged.pieces, strict=True) if piece == judged.pieces[-1]]
            self._poses = deque(kept, maxlen=_REMEMBERED)
        return judged.reasons[-1], self._pieces
