"""The map as it grows: a TSDF whose voxel size follows from the first depth map unless it is given."""

from __future__ import annotations

import numpy as np

from polarmap.data.mesh import Mesh, PointCloud
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.volume import TsdfVolume
from polarmap.fusion.voxel_size import choose_voxel_size
from polarmap.geometry.camera import PinholeCamera

_MIN_PIXELS = 100


class SurfaceMap:
    """Depth maps in, mesh and points out; a depth map can be taken out again."""

    def __init__(self, options: FusionOptions | None = None) -> None:
        self.options = options or FusionOptions()
        self.volume: TsdfVolume | None = None

    def integrate(
        self,
        depth: np.ndarray,
        grey: np.ndarray,
        confidence: np.ndarray,
        camera: PinholeCamera,
        T_world_camera: np.ndarray,
        frame_id: int,
    ) -> bool:
        """Add a depth map as `TsdfVolume.integrate` does; False if it has too few pixels to tell anything."""
        confidence = self._usable(confidence)
        if np.count_nonzero(np.isfinite(depth) & (confidence > 0)) < _MIN_PIXELS:
            return False
        if self.volume is None:
            self.volume = self._new_volume(depth, camera)
        self.volume.integrate(depth, grey, confidence, camera, T_world_camera, frame_id)
        return True

    def remove(
        self,
        depth: np.ndarray,
        grey: np.ndarray,
        confidence: np.ndarray,
        camera: PinholeCamera,
        T_world_camera: np.ndarray,
        frame_id: int,
    ) -> None:
        """Take out a depth map that was integrated with the same arguments."""
        if self.volume is not None and frame_id in self.volume.frame_ids:
            self.volume.remove(depth, grey, self._usable(confidence), camera, T_world_camera, frame_id)

    def mesh(self) -> Mesh | None:
        """The surface, None while nothing was integrated."""
        return None if self.volume is None else self.volume.mesh(self.options.min_weight, self.options.min_faces)

    def points(self) -> PointCloud | None:
        """Points on the surface, None while nothing was integrated."""
        return None if self.volume is None else self.volume.points(self.options.min_weight)

    def _usable(self, confidence: np.ndarray) -> np.ndarray:
        return np.where(confidence >= self.options.min_confidence, confidence, np.float32(0.0))

    def _new_volume(self, depth: np.ndarray, camera: PinholeCamera) -> TsdfVolume:
        voxel_size = self.options.voxel_size or choose_voxel_size(depth, camera)
        return TsdfVolume(voxel_size, self.options.truncation, self.options.max_blocks)
