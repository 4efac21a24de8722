"""Fusion of depth maps: truncated signed distances in hashed voxel blocks, mesh and point cloud."""

from polarmap.fusion.mesh import Mesh, PointCloud, drop_small_components
from polarmap.fusion.scale import choose_voxel_size
from polarmap.fusion.volume import TsdfVolume, VoxelSums

__all__ = ["Mesh", "PointCloud", "TsdfVolume", "VoxelSums", "choose_voxel_size", "drop_small_components"]
