"""Fusion of keyframes whose poses may still change: those that move are taken out and integrated again."""

from __future__ import annotations

import logging
from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np

from polarmap.data.mesh import Mesh, PointCloud
from polarmap.errors import PolarmapError
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.surface_map import SurfaceMap
from polarmap.geometry.camera import PinholeCamera

log = logging.getLogger(__name__)


@dataclass(eq=False)
class _Movable:
    """A depth map that is in the surface at `T_fused` and belongs at `T_world_camera`.

    probes: points in its camera frame by which its motion is measured, N×3.
    """

    depth: np.ndarray
    grey: np.ndarray
    confidence: np.ndarray
    camera: PinholeCamera
    T_fused: np.ndarray
    T_world_camera: np.ndarray
    probes: np.ndarray

    def distance(self) -> float:
        """How far its farthest probe is from where it belongs; 0 without depth."""
        change = self.T_world_camera - self.T_fused
        shifts = self.probes @ change[:3, :3].T + change[:3, 3]
        return float(np.linalg.norm(shifts, axis=1).max(initial=0.0))


class MovableSurface:
    """A surface that follows its keyframes as their poses are adjusted.

    `move` says which poses may still change. Depth maps of those keyframes are held here, since a TSDF gives a depth
    map back only to who brings it; they are fused again as soon as they have moved by more than
    `options.move_tolerance`, and once more, at their final pose to the last bit, when they may not change any more.
    Then they are dropped, so memory is that of the poses which may change, and the surface ends as if every depth map
    had been integrated at its final pose alone.
    """

    def __init__(self, options: FusionOptions | None = None) -> None:
        self.surface = SurfaceMap(options)
        self._movable: dict[int, _Movable] = {}
        self._changing: frozenset[int] = frozenset()

    @property
    def held(self) -> int:
        """Depth maps that are held because they may still move."""
        return len(self._movable)

    def integrate(
        self,
        depth: np.ndarray,
        grey: np.ndarray,
        confidence: np.ndarray,
        camera: PinholeCamera,
        T_world_camera: np.ndarray,
        frame_id: int,
    ) -> None:
        """Add a depth map as `SurfaceMap.integrate` does; it is held if the last `move` had a pose for it.

        The arrays must not change any more.
        """
        self.surface.integrate(depth, grey, confidence, camera, T_world_camera, frame_id)
        if frame_id in self._changing:
            T, probes = T_world_camera.copy(), _probes(depth, camera)
            self._movable[frame_id] = _Movable(depth, grey, confidence, camera, T, T, probes)

    def move(self, poses: Mapping[int, np.ndarray]) -> dict[int, np.ndarray]:
        """Take the present T_world_camera of all keyframes that may still change, by frame id.

        Returns the final poses of those held until now that are not among them.
        """
        self._changing = frozenset(poses)
        settled = {}
        for frame_id, entry in list(self._movable.items()):
            if frame_id in poses:
                entry.T_world_camera = poses[frame_id].copy()
                self._follow(frame_id, entry, self.surface.options.move_tolerance)
            else:
                settled[frame_id] = self._settle(frame_id)
        return settled

    def settle(self) -> dict[int, np.ndarray]:
        """Nothing changes any more: as `move` without poses."""
        return self.move({})

    def mesh(self) -> Mesh | None:
        """The surface, None while nothing was integrated."""
        return self.surface.mesh()

    def points(self) -> PointCloud | None:
        """Points on the surface, None while nothing was integrated."""
        return self.surface.points()

    def _settle(self, frame_id: int) -> np.ndarray:
        entry = self._movable[frame_id]
        self._follow(frame_id, entry, 0.0)
        del self._movable[frame_id]
        return entry.T_world_camera

    def _follow(self, frame_id: int, entry: _Movable, tolerance: float) -> None:
        """Fuse it again if it is farther than `tolerance` voxels from where it belongs."""
        volume = self.surface.volume
        if volume is None or entry.distance() <= tolerance * volume.voxel_size:
            return
        images = entry.depth, entry.grey, entry.confidence, entry.camera
        self.surface.remove(*images, entry.T_fused, frame_id)
        try:
            self.surface.integrate(*images, entry.T_world_camera, frame_id)
            entry.T_fused = entry.T_world_camera
        except PolarmapError as error:  # no room there; its old blocks have just become free
            log.warning("keyframe %d stays where it was fused first: %s", frame_id, error)
            self.surface.integrate(*images, entry.T_fused, frame_id)


def _probes(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """The image's corners and centre at the median depth, 5×3; none without depth."""
    known = depth[np.isfinite(depth)]
    if not known.size:
        return np.empty((0, 3))
    right, low = camera.width - 1, camera.height - 1
    pixels = np.array([(0, 0, 1), (right, 0, 1), (0, low, 1), (right, low, 1), (right / 2, low / 2, 1)])
    return float(np.median(known)) * (pixels @ np.linalg.inv(camera.matrix).T)
