"""Odometry that knows the answer: it replays true poses, and starts late, errs, adjusts and gets lost as others do."""

from __future__ import annotations

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate, SparsePoints
from polarmap.data.trajectory import PosedFrame
from polarmap.errors import InputError
from polarmap.geometry.pose import inverse


class FakeOdometry:
    """Every third frame is a keyframe, the last `window` of which may move.

    poses: true T_world_camera by frame index. scale: its unit in true ones. start: frames needed to begin, each time.
    lost: frames that cannot be tracked. error: translation by which a new keyframe is off; it halves with every
    keyframe that comes after, and `finish` takes what is left from those that may still move.
    known: z of points that it says every keyframe shows.
    """

    def __init__(
        self, poses, *, scale=1.0, start=2, lost=(), error=(0.0, 0.0, 0.0), every=3, window=3, known=None
    ) -> None:
        self._known = known
        self._poses, self._scale, self._start, self._lost = poses, scale, start, frozenset(lost)
        self._error, self._every, self._window = np.array(error, float), every, window
        self._segment, self._world = 0, None
        self._first: int | None = None
        self._moving: list[int] = []
        self._estimates: dict[int, np.ndarray] = {}
        self._frames: dict[int, tuple[float, int, bool]] = {}
        self._without: dict[int, str] = {}
        self._seen: dict[int, float] = {}

    def process(self, grey, timestamp, index, exposure=None) -> OdometryUpdate:
        assert grey.dtype == np.float32 and grey.ndim == 2
        if self._seen and not timestamp > max(self._seen.values()):
            raise InputError(f"frame {index}: time {timestamp} s does not come after the last frame's")
        self._seen[index] = timestamp
        if index in self._lost:
            return self._lose(index)
        if self._world is None:
            return self._begin(index)
        return self._track(index)

    def wait(self) -> None:
        """It is never behind."""

    def finish(self) -> None:
        for index in self._moving:
            self._estimates[index] = self._true(index)

    def result(self) -> OdometryResult:
        frames = tuple(
            PosedFrame(i, t, segment, self._estimates[i], is_keyframe)
            for i, (t, segment, is_keyframe) in sorted(self._frames.items())
        )
        return OdometryResult(frames, self._points(), tuple(sorted(self._without.items())), {"tracking": 12.0})

    def _lose(self, index) -> OdometryUpdate:
        if self._world is not None:
            self._segment, self._world, self._moving = self._segment + 1, None, []
        self._first = None
        return self._without_pose(index, Status.LOST, "too few points are seen again")

    def _begin(self, index) -> OdometryUpdate:
        self._first = index if self._first is None else self._first
        if index - self._first < self._start:
            return self._without_pose(index, Status.STARTING, "waiting for parallax", held=(self._first,))
        self._world = inverse(self._poses[self._first])
        self._without.pop(self._first)
        self._add_keyframe(self._first)
        self._add_keyframe(index)
        return self._update(index, (self._first, index))

    def _track(self, index) -> OdometryUpdate:
        if index - self._moving[-1] < self._every:
            self._estimates[index] = self._true(index)
            self._frames[index] = self._seen[index], self._segment, False
            return self._update(index, ())
        self._add_keyframe(index)
        return self._update(index, (index,))

    def _add_keyframe(self, index) -> None:
        self._moving = [*self._moving, index][-self._window :]
        self._frames[index] = self._seen[index], self._segment, True
        for age, keyframe in enumerate(reversed(self._moving)):
            self._estimates[keyframe] = self._true(keyframe)
            self._estimates[keyframe][:3, 3] += 0.5**age * self._error

    def _update(self, index, keyframes) -> OdometryUpdate:
        poses = {keyframe: self._estimates[keyframe].copy() for keyframe in self._moving}
        T = self._estimates[index].copy()
        t = self._seen[index]
        known = {keyframe: self._known for keyframe in keyframes if self._known is not None}
        return OdometryUpdate(
            index, t, Status.TRACKED, self._segment, T, keyframes=keyframes, keyframe_poses=poses, keyframe_depths=known
        )

    def _without_pose(self, index, status, reason, held=()) -> OdometryUpdate:
        self._without[index] = reason
        return OdometryUpdate(index, self._seen[index], status, self._segment, reason=reason, held=held)

    def _true(self, index) -> np.ndarray:
        T = self._world @ self._poses[index]
        T[:3, 3] /= self._scale
        return T

    def _points(self) -> SparsePoints:
        """Two points a keyframe."""
        hosts = np.array([i for i, (_, _, is_keyframe) in sorted(self._frames.items()) if is_keyframe], np.int64)
        host = np.repeat(hosts, 2)
        n = len(host)
        return SparsePoints(
            position=np.arange(3.0 * n).reshape(n, 3),
            inverse_depth=np.full(n, 0.5, np.float32),
            inverse_depth_std=np.linspace(0.01, 0.02, n, dtype=np.float32),
            host=host,
            pixel=np.zeros((n, 2), np.float32),
            intensity=np.linspace(0, 1, n, dtype=np.float32),
            segment=np.array([self._frames[i][1] for i in host.tolist()], np.int64),
        )
