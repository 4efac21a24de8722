"""The triangles of marching cubes (Lorensen and Cline 1987), derived instead of tabulated by hand.

Corner c of a cell is at (c & 1, c >> 1 & 1, c >> 2 & 1), and bit c of a case tells that its value is negative.
Where a face has both its diagonals' corners of one sign, the negative corners are kept apart: the rule looks at
nothing but that face, so the two cells beside it agree and the surface has no cracks (Nielson and Hamann 1991).
"""

from __future__ import annotations

import numpy as np

EDGES = np.array([(corner, axis) for axis in range(3) for corner in range(8) if not corner >> axis & 1])
"""Lower corner and axis of the 12 edges of a cell, int 12×2."""

_EDGE_BETWEEN = {frozenset((c, c | 1 << axis)): n for n, (c, axis) in enumerate(EDGES.tolist())}


def triangle_table() -> tuple[np.ndarray, np.ndarray]:
    """Number of triangles of each case, int8 (256,), and their edges, int8 256×T×3.

    Triangles are counterclockwise as seen from the positive side.
    """
    cases = [_triangles(case) for case in range(256)]
    counts = np.array([len(triangles) for triangles in cases], np.int8)
    table = np.full((256, counts.max(), 3), -1, np.int8)
    for case, triangles in enumerate(cases):
        if triangles:
            table[case, : len(triangles)] = triangles
    return counts, table


def _triangles(case: int) -> list[tuple[int, int, int]]:
    return [triangle for loop in _loops(case) for triangle in _triangulate(loop)]


def _loops(case: int) -> list[list[int]]:
    """Closed polygons, as lists of edges, in which the surface cuts the cell's faces."""
    after = {start: end for face in _FACES for start, end in _segments(case, face)}
    loops = []
    while after:
        start, edge = after.popitem()
        loops.append([start])
        while edge != start:
            loops[-1].append(edge)
            edge = after.pop(edge)
    return loops


def _segments(case: int, face: list[int]) -> list[tuple[int, int]]:
    """Where the surface cuts a face: from the edge that enters a run of negative corners to the one that leaves it."""
    negative = [case >> corner & 1 for corner in face]
    enters = [n for n in range(4) if negative[n] and not negative[n - 1]]
    segments = []
    for n in enters:
        length = next(m for m in range(1, 4) if not negative[(n + m) % 4])
        last = (n + length - 1) % 4
        segments.append((_edge(face[n - 1], face[n]), _edge(face[last], face[(last + 1) % 4])))
    return segments


def _triangulate(loop: list[int]) -> list[tuple[int, int, int]] | None:
    """Triangles of a polygon, with no diagonal in a face of the cell, where the neighbour could have it too.

    None where there are no such triangles, which happens to parts of a loop but never to a whole one.
    """
    if len(loop) < 3:
        return []
    first, last = loop[0], loop[-1]
    for n in range(1, len(loop) - 1):
        if (n > 1 and _share_face(first, loop[n])) or (n < len(loop) - 2 and _share_face(loop[n], last)):
            continue
        left, right = _triangulate(loop[: n + 1]), _triangulate(loop[n:])
        if left is not None and right is not None:
            return [(first, loop[n], last), *left, *right]
    return None


def _share_face(a: int, b: int) -> bool:
    return bool(_faces_of(a) & _faces_of(b))


def _faces_of(edge: int) -> set[tuple[int, int]]:
    corner, axis = EDGES[edge].tolist()
    return {(other, corner >> other & 1) for other in range(3) if other != axis}


def _edge(a: int, b: int) -> int:
    return _EDGE_BETWEEN[frozenset((a, b))]


def _face_corners(axis: int, side: int) -> list[int]:
    """Corners of a face, counterclockwise as seen from outside the cell."""
    b, c = 1 << (axis + 1) % 3, 1 << (axis + 2) % 3
    corners = [corner | side << axis for corner in (0, b, b | c, c)]
    return corners if side else corners[::-1]


_FACES = [_face_corners(axis, side) for axis in range(3) for side in range(2)]
