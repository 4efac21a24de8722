"""What fusion gives: a triangle mesh or a point cloud in the world frame."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components


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


def drop_small_components(mesh: Mesh, min_faces: int) -> Mesh:
    """The mesh without its connected pieces of fewer than `min_faces` triangles, and without loose vertices."""
    n = len(mesh.vertices)
    a, b, c = mesh.faces.T
    edges = coo_array((np.ones(2 * len(a), bool), (np.concatenate([a, a]), np.concatenate([b, c]))), shape=(n, n))
    _, piece = connected_components(edges, directed=False)
    faces = mesh.faces[np.bincount(piece[a], minlength=1)[piece[a]] >= min_faces]
    return _with_faces(mesh, faces)


def _shifted(points: np.ndarray, shift: np.ndarray) -> np.ndarray:
    return (points + shift).astype(np.float32) if np.any(shift) else points


def _with_faces(mesh: Mesh, faces: np.ndarray) -> Mesh:
    used = np.zeros(len(mesh.vertices), bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return Mesh(mesh.vertices[used], renumbered[faces], mesh.normals[used], mesh.grey[used])
