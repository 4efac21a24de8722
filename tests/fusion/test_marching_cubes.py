"""The derived marching cubes table: every case closed, manifold and turned toward the positive side."""

from __future__ import annotations

from collections import Counter

import numpy as np
import pytest

from polarmap.fusion.marching_cubes import EDGES, triangle_table

COUNTS, TABLE = triangle_table()


def corner(c: int) -> np.ndarray:
    return np.array([c & 1, c >> 1 & 1, c >> 2 & 1])


def edge_ends(edge: int) -> tuple[int, int]:
    start, axis = EDGES[edge].tolist()
    return start, start | 1 << axis


def triangles_of_field(negative: np.ndarray) -> list[tuple]:
    """Triangles over a grid of signs, each vertex named by the voxel and axis of its edge."""
    triangles = []
    for cell in np.ndindex(*(n - 1 for n in negative.shape)):
        case = sum(int(negative[tuple(cell + corner(c))]) << c for c in range(8))
        for triangle in TABLE[case, : COUNTS[case]]:
            starts = [(*(cell + corner(EDGES[e, 0])).tolist(), int(EDGES[e, 1])) for e in triangle]
            triangles.append(tuple(starts))
    return triangles


def test_every_case_uses_exactly_the_crossed_edges():
    for case in range(256):
        crossed = {e for e in range(12) if len({case >> c & 1 for c in edge_ends(e)}) == 2}
        assert set(TABLE[case, : COUNTS[case]].ravel().tolist()) == crossed


def test_a_corner_cut_off_faces_the_positive_side():
    for c in range(8):
        (triangle,) = TABLE[1 << c, : COUNTS[1 << c]]
        a, b, d = ((corner(edge_ends(e)[0]) + corner(edge_ends(e)[1])) / 2.0 for e in triangle)
        assert np.dot(np.cross(b - a, d - a), corner(c) - 0.5) < 0


@pytest.mark.parametrize("seed", range(4))
def test_random_signs_give_a_closed_manifold(seed):
    """Noise meets all the ambiguous faces; each edge of the surface must have two triangles, turned alike."""
    negative = np.random.default_rng(seed).random((9, 9, 9)) < 0.5
    negative[[0, -1]] = negative[:, [0, -1]] = negative[:, :, [0, -1]] = False
    directed = Counter()
    for a, b, c in triangles_of_field(negative):
        directed.update([(a, b), (b, c), (c, a)])
    assert len(directed) > 1000
    assert all(count == 1 and directed[end, start] == 1 for (start, end), count in directed.items())
