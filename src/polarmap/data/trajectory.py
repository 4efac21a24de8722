"""Poses of the camera over time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy.spatial.transform import Rotation, Slerp

from polarmap.data.times import MOST_SECONDS, all_nanoseconds, typical_step
from polarmap.errors import InputError

_LEAST_GAP = 0.1  # seconds
_SLOWEST_STEP = 0.51  # seconds between poses; interpolation across more is a guess
_GAP_STEPS = 1.5
_ROUNDING = 2e-6  # seconds, of times with six decimals


@dataclass(frozen=True, eq=False)
class Trajectory:
    """Poses of the camera over time.

    timestamps: seconds, strictly increasing, float64 N.
    poses: T_world_camera, float64 N×4×4.
    source: the file they came from, for messages.
    nanoseconds: the same times exactly, int64 N; None for those of the timestamps' shortest decimal numbers.
    Raises InputError where the shapes do not fit, a number is not finite, or time does not increase.
    """

    timestamps: np.ndarray
    poses: np.ndarray
    source: str = "trajectory"
    nanoseconds: np.ndarray | None = None

    def __post_init__(self) -> None:
        count = len(self.timestamps)
        if count == 0 or np.shape(self.timestamps) != (count,) or np.shape(self.poses) != (count, 4, 4):
            raise InputError(f"{self.source}: needs at least one pose, and one timestamp for each")
        if not (np.isfinite(self.timestamps).all() and np.isfinite(self.poses).all()):
            raise InputError(f"{self.source}: timestamps and poses must be finite")
        if np.abs(self.timestamps).max() > MOST_SECONDS:
            raise InputError(f"{self.source}: timestamps beyond {MOST_SECONDS:g} s; are they in nanoseconds?")
        if self.nanoseconds is None:
            object.__setattr__(self, "nanoseconds", all_nanoseconds(np.asarray(self.timestamps).tolist()))
        if ((np.diff(self.timestamps) <= 0) & (np.diff(self.nanoseconds) <= 0)).any():
            raise InputError(f"{self.source}: timestamps must increase from pose to pose")

    def __len__(self) -> int:
        return len(self.timestamps)

    @cached_property
    def longest_gap(self) -> float:
        """Seconds between two poses up to which the motion between them is known.

        It is one and a half times the median step, so that the rate of the poses decides and a pose that is missing
        makes a gap; at least 0.1 s, and that where the poses are fewer than two a second.
        """
        step = typical_step(self.timestamps) if len(self) > 2 else None
        usual = _LEAST_GAP if step is None or step > _SLOWEST_STEP else max(_LEAST_GAP, _GAP_STEPS * step)
        return usual + _ROUNDING

    def at(self, timestamp: float, max_difference: float = 0.02, max_gap: float | None = None) -> np.ndarray | None:
        """T_world_camera at a time, float64 4×4, or None where the trajectory does not know it.

        Between two poses that are at most `max_gap` seconds apart (`longest_gap` if None), the position is
        interpolated linearly and the rotation along the shortest arc; elsewhere it is the nearest pose, at most
        `max_difference` seconds away. Raises InputError where `timestamp` is NaN, as it is in a sequence without times.
        """
        if math.isnan(timestamp):
            raise InputError(
                f"{self.source}: the frames have no times to look poses up by; "
                "add timestamps.txt to the sequence or frame_rate to its camera file"
            )
        after = int(np.searchsorted(self.timestamps, timestamp))
        before = max(after - 1, 0)
        after = min(after, len(self) - 1)
        if self.timestamps[after] == timestamp:
            return self.poses[after].copy()
        if before < after and self.timestamps[after] - self.timestamps[before] <= (max_gap or self.longest_gap):
            return self._interpolated(before, after, timestamp)
        nearest = min(before, after, key=lambda i: abs(self.timestamps[i] - timestamp))
        if abs(self.timestamps[nearest] - timestamp) > max_difference + _ROUNDING:
            return None
        return self.poses[nearest].copy()

    def why_unknown(self, timestamp: float) -> str:
        """Why `at` knows no pose at a time: it lies outside the trajectory's times, or in a gap between them."""
        if self.timestamps[0] <= timestamp <= self.timestamps[-1]:
            return "its time is in a gap of the trajectory"
        return "its time is outside the trajectory's times"

    def require_overlap(self, timestamps: Sequence[float] | np.ndarray, max_difference: float = 0.02) -> None:
        """Raise InputError, with both ranges of time, unless `at` knows one of these timestamps at least."""
        if any(self.at(timestamp, max_difference) is not None for timestamp in timestamps):
            return
        raise InputError(
            f"{self.source}: poses from {self.timestamps[0]:.6f} to {self.timestamps[-1]:.6f} s, but frames "
            f"from {min(timestamps):.6f} to {max(timestamps):.6f} s; both must be seconds of the same clock"
        )

    def _interpolated(self, before: int, after: int, timestamp: float) -> np.ndarray:
        times, poses = self.timestamps[[before, after]], self.poses[[before, after]]
        share = (timestamp - times[0]) / (times[1] - times[0])
        T = np.eye(4)
        T[:3, :3] = Slerp([0.0, 1.0], Rotation.from_matrix(poses[:, :3, :3]))(share).as_matrix()
        T[:3, 3] = (1.0 - share) * poses[0, :3, 3] + share * poses[1, :3, 3]
        return T


@dataclass(frozen=True, eq=False)
class PosedFrame:
    """A tracked frame: T_world_camera, float64 4×4, after the last adjustment that concerned it."""

    index: int
    timestamp: float
    segment: int
    T_world_camera: np.ndarray
    is_keyframe: bool
