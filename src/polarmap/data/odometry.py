"""What odometry returns: an update for every frame, and everything at the end."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.trajectory import PosedFrame


@dataclass(frozen=True, eq=False)
class OdometryUpdate:
    """What is known after a frame.

    index, timestamp: those of the frame.
    segment: the map segment the frame belongs to, from 0; a new one begins after every loss.
    T_world_camera: the present estimate, float64 4×4, in the segment's world and unit of length; None unless the
        status is TRACKED. The world is the camera of the segment's first keyframe.
    reason: why there is no pose; empty where there is one.
    keyframes: indices of the frames that became keyframes with this one, in order of time; at a start they
        include an earlier frame.
    keyframe_poses: present T_world_camera of every keyframe that adjustment may still move, by frame index.
    held: indices of earlier frames that may yet become keyframes.
    keyframe_depths: of each new keyframe, by frame index, z of the points that it shows, float32 N.
    """

    index: int
    timestamp: float
    status: Status
    segment: int
    T_world_camera: np.ndarray | None = None
    reason: str = ""
    keyframes: tuple[int, ...] = ()
    keyframe_poses: dict[int, np.ndarray] = field(default_factory=dict)
    held: tuple[int, ...] = ()
    keyframe_depths: dict[int, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True, eq=False)
class SparsePoints:
    """Points of the map, N of them.

    position: float64 N×3 in their segment's world.
    inverse_depth, inverse_depth_std: float32 N, along the host keyframe's z axis, with its standard deviation.
    host: int64 N, index of the keyframe whose pixel the point is. pixel: float32 N×2, (u, v) there.
    intensity: float32 N in [0, 1]. segment: int64 N.
    """

    position: np.ndarray
    inverse_depth: np.ndarray
    inverse_depth_std: np.ndarray
    host: np.ndarray
    pixel: np.ndarray
    intensity: np.ndarray
    segment: np.ndarray


@dataclass(frozen=True, eq=False)
class OdometryResult:
    """All that is known: the frames that have a pose, the points, and the frames that have none with the reason.

    milliseconds: time spent by step, over all frames.
    """

    frames: tuple[PosedFrame, ...]
    points: SparsePoints
    without_pose: tuple[tuple[int, str], ...]
    milliseconds: dict[str, float]

    @property
    def segments(self) -> tuple[int, ...]:
        """Segments that have frames, the one with most frames first."""
        counts = Counter(frame.segment for frame in self.frames)
        return tuple(segment for segment, _ in sorted(counts.items(), key=lambda item: (-item[1], item[0])))
