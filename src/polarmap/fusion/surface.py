"""A surface whose keyframes may still move: those that do are taken out and integrated again."""

from __future__ import annotations

import logging
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np

from polarmap.data.depth_map import DepthMap
from polarmap.data.mesh import Mesh, PointCloud
from polarmap.errors import PolarmapError
from polarmap.fusion.depth_store import DepthStore, MemoryStore
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.surface_map import SurfaceMap
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.sim3 import Sim3

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Movable:
    """A depth map that is in the surface at pose `fused` and belongs at `pose`.

    probes: points in its camera frame by which its motion is measured, N×3.
    """

    fused: Sim3
    pose: Sim3
    probes: np.ndarray

    def distance(self) -> float:
        """How far its farthest probe is from where it belongs; 0 without depth."""
        change = self.pose.matrix - self.fused.matrix
        shifts = self.probes @ change[:3, :3].T + change[:3, 3]
        return float(np.linalg.norm(shifts, axis=1).max(initial=0.0))


class Surface:
    """A surface that follows its keyframes as their poses, and scales, are adjusted.

    Depth maps of keyframes that may move are kept in a store, since a TSDF gives a depth map back only to who brings
    it. They are fused again as soon as they have moved by more than `options.move_tolerance`, and once more, at their
    final pose to the last bit, when they are settled. Then they are dropped, so the store holds what may still change,
    and the surface ends as if every depth map had been integrated at its final pose alone.

    store: where depth maps are kept; in memory by default. map: all that is integrated now.
    """

    def __init__(self, options: FusionOptions | None = None, store: DepthStore | None = None) -> None:
        self.map = SurfaceMap(options)
        self._store = store if store is not None else MemoryStore()
        self._movable: dict[int, _Movable] = {}

    @property
    def movable(self) -> frozenset[int]:
        """Frame numbers of the depth maps that are kept because they may still move."""
        return frozenset(self._movable)

    @property
    def voxel_size(self) -> float | None:
        """In the unit of the poses; None while nothing was integrated."""
        return None if self.map.volume is None else self.map.volume.voxel_size

    @property
    def blocks(self) -> int:
        """Blocks of 8³ voxels that hold the surface."""
        return 0 if self.map.volume is None else self.map.volume.block_count

    @property
    def left_out(self) -> int:
        """Points that lay too far from the origin."""
        return 0 if self.map.volume is None else self.map.volume.left_out

    def integrate(self, frame_id: int, depth_map: DepthMap, pose: Sim3, movable: bool = False) -> None:
        """Add a depth map at T_world_camera, its depth times the pose's scale; kept if it may move later.

        Raises PolarmapError where there is no room for it.
        """
        self._add(frame_id, depth_map, pose)
        if movable:
            self._store.put(frame_id, depth_map)
            self._movable[frame_id] = _Movable(pose, pose, _probes(depth_map.depth, depth_map.camera))

    def move(self, poses: Mapping[int, Sim3]) -> None:
        """Take present T_world_camera of keyframes by frame number; those that cannot move stay."""
        for frame_id, entry in self._movable.items():
            if frame_id in poses:
                entry.pose = poses[frame_id]
                self._follow(frame_id, entry, self.map.options.move_tolerance)

    def settle(self, frame_ids: Collection[int] | None = None) -> dict[int, Sim3]:
        """These keyframes, all by default, have their final poses now; returns those of the ones that could move."""
        settled = {}
        for frame_id in [i for i in self._movable if frame_ids is None or i in frame_ids]:
            entry = self._movable[frame_id]
            self._follow(frame_id, entry, 0.0)
            del self._movable[frame_id]
            self._store.drop(frame_id)
            settled[frame_id] = entry.pose
        return settled

    def mesh(self) -> Mesh | None:
        """The surface, None while nothing was integrated."""
        return self.map.mesh()

    def points(self) -> PointCloud | None:
        """Points on the surface, None while nothing was integrated."""
        return self.map.points()

    def _follow(self, frame_id: int, entry: _Movable, tolerance: float) -> None:
        """Fuse it again if it is farther than `tolerance` voxels from where it belongs."""
        if self.voxel_size is None or entry.distance() <= tolerance * self.voxel_size:
            return
        depth_map = self._store.get(frame_id)
        self._remove(frame_id, depth_map, entry.fused)
        try:
            self._add(frame_id, depth_map, entry.pose)
            entry.fused = entry.pose
        except PolarmapError as error:  # no room there; its old blocks have just become free
            log.warning("keyframe %d stays where it was fused first: %s", frame_id, error)
            self._add(frame_id, depth_map, entry.fused)

    def _add(self, frame_id: int, depth_map: DepthMap, pose: Sim3) -> None:
        m = depth_map.scaled(pose.scale)
        self.map.integrate(m.depth, m.grey, m.confidence, m.camera, pose.rigid, frame_id)

    def _remove(self, frame_id: int, depth_map: DepthMap, pose: Sim3) -> None:
        m = depth_map.scaled(pose.scale)
        self.map.remove(m.depth, m.grey, m.confidence, m.camera, pose.rigid, frame_id)


def _probes(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """The image's corners and centre at the median depth, 5×3; none without depth."""
    known = depth[np.isfinite(depth)]
    if not known.size:
        return np.empty((0, 3))
    right, low = camera.width - 1, camera.height - 1
    pixels = np.array([(0, 0, 1), (right, 0, 1), (0, low, 1), (right, low, 1), (right / 2, low / 2, 1)])
    return float(np.median(known)) * (pixels @ np.linalg.inv(camera.matrix).T)
