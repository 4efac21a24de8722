"""Cameras, poses, and the relation of depth, range and normals."""

from polarmap.geometry.camera import PinholeCamera

__all__ = ["PinholeCamera"]
