"""What fusion gives: a triangle mesh or a point cloud in the world frame."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from polarmap.data.mesh import Mesh


def drop_small_components(mesh: Mesh, min_faces: int) -> Mesh:
    """The mesh without its connected pieces of fewer than `min_faces` triangles, and without loose vertices."""
    n = len(mesh.vertices)
    a, b, c = mesh.faces.T
    edges = coo_array((np.ones(2 * len(a), bool), (np.concatenate([a, a]), np.concatenate([b, c]))), shape=(n, n))
    _, piece = connected_components(edges, directed=False)
    faces = mesh.faces[np.bincount(piece[a], minlength=1)[piece[a]] >= min_faces]
    return _with_faces(mesh, faces)


def _with_faces(mesh: Mesh, faces: np.ndarray) -> Mesh:
    used = np.zeros(len(mesh.vertices), bool)
    used[faces] = True
    renumbered = np.cumsum(used, dtype=np.int32) - 1
    return Mesh(mesh.vertices[used], renumbered[faces], mesh.normals[used], mesh.grey[used])
