"""Fusion of depth maps into a truncated signed distance field that exists only near surfaces."""

from __future__ import annotations

import logging
import math
from collections.abc import Hashable
from dataclasses import dataclass

import numpy as np

from polarmap.data.mesh import Mesh, PointCloud
from polarmap.errors import InputError, PolarmapError
from polarmap.fusion.block_index import BLOCK_SIDE, COORDINATE_LIMIT, BlockIndex, coordinates
from polarmap.fusion.components import drop_small_components
from polarmap.fusion.depth_view import DepthView, prepare_view
from polarmap.fusion.extraction import Blocks, arrange_blocks, extract_mesh, extract_points
from polarmap.fusion.integration import ONE, accumulate, count_unaddressable, touched_blocks
from polarmap.geometry.camera import PinholeCamera

log = logging.getLogger(__name__)

TRUNCATION_VOXELS = 5.0
MAX_TRUNCATION_VOXELS = 64.0
_GROWTH = 3  # times the blocks that are needed, so that they are seldom copied
MAX_VIEWS_PER_BLOCK = np.iinfo(np.int32).max // ONE


@dataclass(frozen=True)
class VoxelSums:
    """The whole state of a volume, blocks in the order of their coordinates.

    coordinates: int32 N×3, of blocks. sums: int32 N×8×8×8×3, per voxel [i, j, k] the sums of weight·distance,
    weight, and weight·grey, each times 65536; the distance in truncations. views: int32 (N,), how many depth maps
    touch the block.
    """

    coordinates: np.ndarray
    sums: np.ndarray
    views: np.ndarray


class TsdfVolume:
    """Truncated signed distances in blocks of 8³ voxels, found by voxel-block hashing (Nießner et al. 2013).

    Voxel (i, j, k) has its centre at (i + ½, j + ½, k + ½)·voxel_size in the world. A depth map changes the blocks
    that its rays meet within ±truncation of the depth, and none else: there, a voxel at depth z on a ray with depth d
    takes min(1, (d - z)/truncation) with the pixel's confidence as its weight, unless z is beyond d + truncation. So
    the volume is the sum of what each depth map gives by itself, in whatever order they came, and because the sums
    are integers, `remove` leaves exactly what there would be had the depth map never come. The price: a depth map
    does not carve blocks it sees through, and weights have no cap. A wrong surface alone in free space has to be
    removed by its small weight or size (`mesh`).

    Sums overflow beyond 32767 depth maps of full confidence on one block, which `integrate` refuses. A block takes
    6 KiB; at most `max_blocks` are allocated. Blocks have numbers up to 8 million voxels from the origin along each
    axis; points beyond are left out, counted in `left_out`, and the first of them are warned of.

    voxel_size: metres (or odometry units). truncation: metres, from 1 to 64 voxels, default 5 voxels.
    Raises InputError where these are out of range.
    """

    def __init__(self, voxel_size: float, truncation: float | None = None, max_blocks: int = 200_000) -> None:
        truncation = TRUNCATION_VOXELS * voxel_size if truncation is None else truncation
        if not (voxel_size > 0 and math.isfinite(voxel_size)):
            raise InputError(f"fusion: voxel_size must be positive and finite, not {voxel_size}")
        if not voxel_size <= truncation <= MAX_TRUNCATION_VOXELS * voxel_size:
            raise InputError(f"fusion: truncation {truncation:g} must be 1 to 64 voxels of {voxel_size:g}")
        if max_blocks < 1:
            raise InputError(f"fusion: max_blocks must be at least 1, not {max_blocks}")
        self.voxel_size = float(voxel_size)
        self.truncation = float(truncation)
        self.max_blocks = int(max_blocks)
        self._index = BlockIndex()
        self._sums = np.zeros((0, BLOCK_SIDE, BLOCK_SIDE, BLOCK_SIDE, 3), np.int32)
        self._views = np.zeros(0, np.int32)
        self._checksums: dict[Hashable, int] = {}
        self._left_out: dict[Hashable, int] = {}

    @property
    def left_out(self) -> int:
        """Points of the depth maps in the volume that are too far from the origin to be in it."""
        return sum(self._left_out.values())

    @property
    def block_count(self) -> int:
        """Blocks of 8³ voxels in use."""
        return len(self._index)

    @property
    def bytes(self) -> int:
        """Memory set aside for voxels and index."""
        return self._sums.nbytes + self._views.nbytes + self._index.bytes

    @property
    def frame_ids(self) -> tuple[Hashable, ...]:
        """The depth maps in the volume, in the order in which they came."""
        return tuple(self._checksums)

    def integrate(
        self,
        depth: np.ndarray,
        grey: np.ndarray,
        confidence: np.ndarray | None,
        camera: PinholeCamera,
        T_world_camera: np.ndarray,
        frame_id: Hashable,
    ) -> None:
        """Add a depth map.

        depth: float32 H×W, z in metres, NaN where none. grey: float32 H×W, share of full scale. confidence: float32
        H×W in [0, 1], or None for 1 everywhere; pixels with 0 or NaN are left out. T_world_camera: 4×4 rigid motion.
        frame_id: any name not in use, for `remove`.

        Raises InputError where these do not fit together, PolarmapError beyond `max_blocks` or 32767 depth maps on a
        block; the volume is then as it was.
        """
        if frame_id in self._checksums:
            raise InputError(f"fusion: frame {frame_id} is in the volume already; remove it first")
        view = prepare_view(depth, grey, confidence, camera, T_world_camera)
        keys = touched_blocks(view, self.voxel_size, self.truncation, self.max_blocks)
        self._reserve(keys)
        slots = self._index.insert(keys)
        self._views[slots] += 1
        self._accumulate(slots, keys, view, 1)
        self._checksums[frame_id] = view.checksum()
        self._count_left_out(view, frame_id)

    def remove(
        self,
        depth: np.ndarray,
        grey: np.ndarray,
        confidence: np.ndarray | None,
        camera: PinholeCamera,
        T_world_camera: np.ndarray,
        frame_id: Hashable,
    ) -> None:
        """Take a depth map out again, exactly; the arguments are those it was integrated with.

        The volume keeps no depth maps, only a checksum of each, so the caller brings it back. Blocks that no depth
        map touches any more are freed. Raises InputError where `frame_id` is not in the volume or was integrated
        with other data.
        """
        if frame_id not in self._checksums:
            raise InputError(f"fusion: frame {frame_id} is not in the volume")
        view = prepare_view(depth, grey, confidence, camera, T_world_camera)
        if view.checksum() != self._checksums[frame_id]:
            raise InputError(f"fusion: frame {frame_id} was integrated with another depth, grey, confidence or pose")
        keys = touched_blocks(view, self.voxel_size, self.truncation, self.max_blocks)
        slots = self._index.find(keys)
        self._accumulate(slots, keys, view, -1)
        self._views[slots] -= 1
        self._index.discard(keys[self._views[slots] == 0])
        del self._checksums[frame_id]
        self._left_out.pop(frame_id, None)

    def mesh(self, min_weight: float = 0.0, min_faces: int = 0) -> Mesh:
        """Surface by marching cubes, where all eight voxels around have a summed weight above `min_weight`.

        Connected pieces of fewer than `min_faces` triangles are left out. Takes 3 KiB a block meanwhile.
        """
        mesh = extract_mesh(self._blocks(min_weight), self.voxel_size, min_weight)
        return drop_small_components(mesh, min_faces) if min_faces > 1 else mesh

    def points(self, min_weight: float = 0.0) -> PointCloud:
        """A point on each crossed edge between two voxels with a summed weight above `min_weight`.

        These are the mesh's vertices and more: a point needs two voxels where a triangle needs eight.
        """
        return extract_points(self._blocks(min_weight), self.voxel_size, min_weight)

    def voxel_sums(self) -> VoxelSums:
        """A copy of the volume's whole state."""
        keys = self._index.keys()
        slots = self._index.find(keys)
        return VoxelSums(coordinates(keys), self._sums[slots], self._views[slots])

    def _count_left_out(self, view: DepthView, frame_id: Hashable) -> None:
        count = count_unaddressable(view, self.voxel_size, self.truncation)
        if count == 0:
            return
        if not self._left_out:
            reach = COORDINATE_LIMIT * BLOCK_SIDE * self.voxel_size
            away = max(float(np.abs(view.centre).max()), float(view.depth.max()))
            log.warning(
                "frame %s: %d of its points are left out of the map: they are up to %.3g from its origin, and with "
                "voxels of %g it ends at %.3g; look for wrong poses, or for poses and fusion.voxel_size in different "
                "units; a scene that really is as large needs a larger fusion.voxel_size",
                frame_id, count, away, self.voxel_size, reach,
            )  # fmt: skip
        self._left_out[frame_id] = count

    def _blocks(self, min_weight: float) -> Blocks:
        if not min_weight >= 0:
            raise InputError(f"fusion: min_weight must not be negative, but is {min_weight}")
        return arrange_blocks(self._index, self._sums)

    def _accumulate(self, slots: np.ndarray, keys: np.ndarray, view: DepthView, sign: int) -> None:
        accumulate(self._sums, slots, keys, view, self.voxel_size, self.truncation, sign)

    def _reserve(self, keys: np.ndarray | None) -> None:
        """Storage for the blocks of one more view, None standing for too many; PolarmapError beyond the limits."""
        slots = np.empty(0, np.int32) if keys is None else self._index.find(keys)
        needed = self.block_count + np.count_nonzero(slots < 0)
        if keys is None or needed > self.max_blocks:
            raise PolarmapError(
                f"fusion: the map needs more than {self.max_blocks} blocks of voxels of {self.voxel_size:g} m; "
                "use a larger voxel size or raise max_blocks"
            )
        if (self._views[slots[slots >= 0]] >= MAX_VIEWS_PER_BLOCK).any():
            raise PolarmapError(f"fusion: more than {MAX_VIEWS_PER_BLOCK} depth maps on one block; remove some first")
        if needed > len(self._sums):
            self._grow(min(_GROWTH * needed, self.max_blocks))

    def _grow(self, capacity: int) -> None:
        sums = np.zeros((capacity, *self._sums.shape[1:]), np.int32)  # pages untouched take no memory yet
        views = np.zeros(capacity, np.int32)
        used = self._index.end
        sums[:used], views[:used] = self._sums[:used], self._views[:used]
        self._sums, self._views = sums, views
