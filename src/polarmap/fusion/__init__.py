"""Fusion of depth maps: truncated signed distances in hashed voxel blocks, mesh and point cloud."""
