"""What a run gives in the end: the surface of each segment."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polarmap.data.mesh import Mesh, PointCloud
from polarmap.data.trajectory import PosedFrame


@dataclass(frozen=True)
class SegmentMap:
    """The surface of one segment in its own world and unit; mesh and cloud are None where no keyframe had depth.

    origin: float64 (3,), of mesh and cloud in the world of the poses: add it to their coordinates.
    left_out: points of depth maps that are too far from there for the voxels' numbers.
    """

    segment: int
    keyframes: int
    mesh: Mesh | None
    cloud: PointCloud | None
    voxel_size: float | None
    blocks: int
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    left_out: int = 0


@dataclass(frozen=True)
class Map:
    """The fused map; mesh and cloud are None where no keyframe had depth.

    frames: how many were given, posed: how many of them had a pose, keyframes: how many became one. unfit: how many
    were not used, by reason: pictures that are black, say, and given poses that their neighbours contradict.
    voxel_size: metres (or units of the poses). milliseconds: summed over the run, by step.
    origin: float64 (3,), of mesh and cloud in the world of the poses: add it to their coordinates. Zero unless the
    poses are far from zero, see `polarmap.geometry.origin`. left_out: points of depth maps that are too far from there
    for the voxels' numbers.
    segment: the one that mesh, cloud, voxel_size and blocks are of, which is that with most keyframes.
    others: the surfaces of the other segments. trajectory: final poses of all frames that odometry tracked, or whose
    given poses were taken if those jumped and a new segment began; None where poses were given and did not.
    """

    mesh: Mesh | None
    cloud: PointCloud | None
    frames: int
    posed: int
    keyframes: int
    voxel_size: float | None
    blocks: int
    milliseconds: dict[str, float]
    segment: int = 0
    others: tuple[SegmentMap, ...] = ()
    trajectory: tuple[PosedFrame, ...] | None = None
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    left_out: int = 0
    unfit: dict[str, int] = field(default_factory=dict)
