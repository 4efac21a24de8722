"""A map in the world: a triangle mesh or a point cloud."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np


@dataclass(frozen=True)
class PointCloud:
    """Points on surfaces.

    points: float32 N×3 in metres, world frame. normals: float32 N×3, unit, toward the free space that the cameras
    saw. grey: float32 N, share of full scale.
    """

    points: np.ndarray
    normals: np.ndarray
    grey: np.ndarray

    def shifted(self, shift: np.ndarray) -> PointCloud:
        """The same in a world whose coordinates are larger by `shift` (3,)."""
        return replace(self, points=_shifted(self.points, shift))


@dataclass(frozen=True)
class Mesh:
    """Triangles with shared vertices, counterclockwise as seen from free space.

    vertices: float32 N×3 in metres, world frame. faces: int32 M×3. normals: float32 N×3, unit, toward the free
    space that the cameras saw. grey: float32 N, share of full scale.
    """

    vertices: np.ndarray
    faces: np.ndarray
    normals: np.ndarray
    grey: np.ndarray

    def shifted(self, shift: np.ndarray) -> Mesh:
        """The same in a world whose coordinates are larger by `shift` (3,)."""
        return replace(self, vertices=_shifted(self.vertices, shift))


def _shifted(points: np.ndarray, shift: np.ndarray) -> np.ndarray:
    return (points + shift).astype(np.float32) if np.any(shift) else points
