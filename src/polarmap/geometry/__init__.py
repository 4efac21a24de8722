"""Cameras, poses, and the relation of depth, range and normals."""
