"""Times and poses in the messages of ROS."""

from __future__ import annotations

import logging
from typing import Any

import numpy as np

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.geometry.pose import from_quaternion
from polarmap.io.formats.times import from_nanoseconds

log = logging.getLogger(__name__)

_TOLERANCE = 0.02  # of a quaternion's norm


def stamp_of(header: Any) -> int:
    """The time in a message's header, nanoseconds; 0 where it is not set."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec)


def pose_of(position: Any, orientation: Any) -> np.ndarray:
    """4×4 motion of a geometry_msgs Point or Vector3 and a Quaternion; InputError where that is no rotation."""
    quaternion = np.array([orientation.x, orientation.y, orientation.z, orientation.w], float)
    norm = float(np.linalg.norm(quaternion))
    if not abs(norm - 1.0) <= _TOLERANCE:
        raise InputError(f"a quaternion of norm {norm:.3g}, expected 1")
    return from_quaternion(np.array([position.x, position.y, position.z], float), quaternion)


def stamped_trajectory(source: str, nanoseconds: list[int], poses: np.ndarray) -> Trajectory:
    """The poses in order of time, N×4×4; of several at one time the first. Raises InputError as `Trajectory` does."""
    order = np.argsort(np.array(nanoseconds, np.int64), kind="stable")
    ordered = np.array(nanoseconds, np.int64)[order]
    kept = np.append(True, np.diff(ordered) > 0) if len(ordered) else np.zeros(0, bool)
    times = ordered[kept]
    seconds = np.array([from_nanoseconds(time) for time in times.tolist()], float)
    return Trajectory(seconds, poses[order][kept], source, times)
