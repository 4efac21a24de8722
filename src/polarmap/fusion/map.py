"""The map as it grows: a TSDF whose voxel size follows from the first depth map unless it is given."""

from __future__ import annotations

import numpy as np

from polarmap.fusion.mesh import Mesh, PointCloud
from polarmap.fusion.scale import choose_voxel_size
from polarmap.fusion.volume import TsdfVolume
from polarmap.geometry.camera import PinholeCamera
from polarmap.options import Options, parameter

_MIN_PIXELS = 100


class FusionOptions(Options):
    """How depth maps are fused."""

    voxel_size: float | None = parameter(
        None, "side of a voxel; from the first depth map if not given", "m", ge=1e-6, le=1e4
    )
    truncation: float | None = parameter(
        None, "distance at which the surface's influence ends; 5 voxels if not given", "m", ge=1e-6, le=1e5
    )
    max_blocks: int = parameter(
        200_000, "most blocks of 8³ voxels that may be allocated, 6 KiB each", "blocks", ge=1, le=4_000_000
    )
    move_tolerance: float = parameter(
        0.5,
        "a keyframe that odometry has moved by more than this, at its median depth, is fused again at once; "
        "otherwise when its pose is final",
        "voxels",
        ge=0,
        le=1e4,
    )
    min_confidence: float = parameter(0.1, "less confident pixels are not fused", ge=0, le=1)
    min_weight: float = parameter(0.4, "summed confidence from which a voxel counts for the mesh", ge=0, le=1e4)
    min_faces: int = parameter(100, "smaller pieces of the mesh are dropped", "triangles", ge=0, le=10_000_000)


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
        return self.volume and self.volume.mesh(self.options.min_weight, self.options.min_faces)

    def points(self) -> PointCloud | None:
        """Points on the surface, None while nothing was integrated."""
        return self.volume and self.volume.points(self.options.min_weight)

    def _usable(self, confidence: np.ndarray) -> np.ndarray:
        return np.where(confidence >= self.options.min_confidence, confidence, np.float32(0.0))

    def _new_volume(self, depth: np.ndarray, camera: PinholeCamera) -> TsdfVolume:
        voxel_size = self.options.voxel_size or choose_voxel_size(depth, camera)
        return TsdfVolume(voxel_size, self.options.truncation, self.options.max_blocks)
