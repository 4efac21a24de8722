"""Marching cubes over voxel blocks: one vertex on each crossed voxel edge, shared by all triangles around it.

A voxel owns its three edges toward +x, +y and +z. Blocks are numbered in the order of their keys, so the result does
not depend on the order in which they were allocated.
"""

from __future__ import annotations

from functools import lru_cache
from typing import NamedTuple

import numpy as np
from numba import prange

from polarmap.data.mesh import Mesh, PointCloud
from polarmap.fusion.block_index import BLOCK_SIDE, STEP_I, STEP_J, STEP_K, BlockIndex, unpack
from polarmap.fusion.integration import ONE
from polarmap.fusion.marching_cubes import EDGES, triangle_table
from polarmap.jit import njit

UNSEEN = np.float32(2.0)  # no distance is above 1
APRON = BLOCK_SIDE + 3  # a block and its surroundings: one voxel before, two behind
NO_VERTEX = np.int16(-1)
CLEARANCE = np.float32(1e-3)  # of a voxel, kept between a vertex and a voxel's centre: no triangle is a needle's point


class Blocks(NamedTuple):
    """Blocks in the order of their keys, and where their neighbours are.

    keys: int64 (N,). sums: as `accumulate` has them, slots×8×8×8×3. slots: int32 (N,).
    neighbours: int32 N×27, number of the block at offset (i, j, k) - 1 in column 9 i + 3 j + k; -1 for none.
    """

    keys: np.ndarray
    sums: np.ndarray
    slots: np.ndarray
    neighbours: np.ndarray


def arrange_blocks(index: BlockIndex, sums: np.ndarray) -> Blocks:
    """All blocks of the index, arranged for extraction."""
    keys = index.keys()
    slots = index.find(keys)
    number = np.full(index.end + 1, -1, np.int32)  # the last, reached as -1, stands for no block
    number[slots] = np.arange(len(keys))
    steps = (-1, 0, 1)
    offsets = [STEP_I * i + STEP_J * j + STEP_K * k for i in steps for j in steps for k in steps]
    neighbours = np.empty((len(keys), 27), np.int32)
    for column, offset in enumerate(offsets):
        neighbours[:, column] = number[index.find(keys + offset)]
    return Blocks(keys, sums, slots, neighbours)


def extract_mesh(blocks: Blocks, voxel_size: float, min_weight: float) -> Mesh:
    """Triangles of the zero level, in cells all of whose eight voxels have a weight above `min_weight`."""
    counts, table = _triangles_of_cases()
    weight_above = round(min_weight * ONE)
    edge_ranks, vertex_counts, face_counts = _survey(blocks, weight_above, counts, True)
    first_vertex, first_face = _starts(vertex_counts), _starts(face_counts)
    vertices = _vertices(blocks, edge_ranks, first_vertex, weight_above, voxel_size)
    faces = _faces(blocks, edge_ranks, first_vertex, first_face, weight_above, counts, table, EDGES)
    return Mesh(vertices[0], faces, *vertices[1:])


def extract_points(blocks: Blocks, voxel_size: float, min_weight: float) -> PointCloud:
    """A point wherever the sign changes between two voxels next to each other with a weight above `min_weight`."""
    weight_above = round(min_weight * ONE)
    edge_ranks, vertex_counts, _ = _survey(blocks, weight_above, _triangles_of_cases()[0], False)
    return PointCloud(*_vertices(blocks, edge_ranks, _starts(vertex_counts), weight_above, voxel_size))


@lru_cache(maxsize=1)
def _triangles_of_cases() -> tuple[np.ndarray, np.ndarray]:
    return triangle_table()


def _starts(counts: np.ndarray) -> np.ndarray:
    """Where each block's share begins, and the total at the end, int64 (N+1,)."""
    return np.concatenate([[0], np.cumsum(counts, dtype=np.int64)])


@njit(parallel=True)
def _survey(blocks, weight_above, triangle_counts, in_cells):
    """Number the crossed edges within each block, and count them and the triangles.

    With `in_cells` an edge counts only where a cell around it has all its corners.
    """
    n = len(blocks.keys)
    edge_ranks = np.full((n, BLOCK_SIDE, BLOCK_SIDE, BLOCK_SIDE, 3), NO_VERTEX)
    vertex_counts, face_counts = np.zeros(n, np.int32), np.zeros(n, np.int32)
    for b in prange(n):
        field = np.empty((APRON, APRON, APRON), np.float32)
        if _load_field(field, blocks, b, weight_above):
            vertex_counts[b] = _number_edges(edge_ranks[b], field, in_cells)
            face_counts[b] = _count_faces(field, triangle_counts)
    return edge_ranks, vertex_counts, face_counts


@njit
def _load_field(field, blocks, b, weight_above):
    """Distances in and around block b, voxel (0, 0, 0) at [1, 1, 1]; False where no sign can change."""
    low, high = UNSEEN, -UNSEEN
    for i in range(APRON):
        for j in range(APRON):
            for k in range(APRON):
                distance = _distance(blocks, b, i - 1, j - 1, k - 1, weight_above)
                field[i, j, k] = distance
                if distance != UNSEEN:
                    low, high = min(low, distance), max(high, distance)
    return low < 0.0 <= high


@njit(inline="always")
def _distance(blocks, b, i, j, k, weight_above):
    """Mean distance, in truncations, at a voxel counted from block b's first; UNSEEN where there is too little."""
    number = _owner(blocks, b, i, j, k)
    if number < 0:
        return UNSEEN
    voxel = blocks.sums[blocks.slots[number], i & 7, j & 7, k & 7]
    if voxel[1] <= weight_above:
        return UNSEEN
    return np.float32(voxel[0]) / np.float32(voxel[1])


@njit(inline="always")
def _owner(blocks, b, i, j, k):
    """Number of the block that holds a voxel counted from block b's first, -1 for none."""
    return blocks.neighbours[b, 9 * ((i >> 3) + 1) + 3 * ((j >> 3) + 1) + (k >> 3) + 1]


@njit
def _number_edges(ranks, field, in_cells):
    count = 0
    for i in range(1, BLOCK_SIDE + 1):
        for j in range(1, BLOCK_SIDE + 1):
            for k in range(1, BLOCK_SIDE + 1):
                for axis in range(3):
                    if _crossed(field, i, j, k, axis) and not (in_cells and not _in_cell(field, i, j, k, axis)):
                        ranks[i - 1, j - 1, k - 1, axis] = count
                        count += 1
    return count


@njit(inline="always")
def _crossed(field, i, j, k, axis):
    a = field[i, j, k]
    b = field[_next(i, j, k, axis)]
    return a != UNSEEN and b != UNSEEN and (a < 0.0) != (b < 0.0)


@njit
def _in_cell(field, i, j, k, axis):
    """Whether one of the four cells around an edge has all its corners."""
    for s in range(2):
        for t in range(2):
            di, dj, dk = (0, s, t) if axis == 0 else ((s, 0, t) if axis == 1 else (s, t, 0))
            if _case(field, i - di, j - dj, k - dk) >= 0:
                return True
    return False


@njit
def _case(field, i, j, k):
    """Which corners of the cell at [i, j, k] are negative, as bits; -1 where one is unseen."""
    case = 0
    for corner in range(8):
        value = field[i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2)]
        if value == UNSEEN:
            return -1
        case |= (value < 0.0) << corner
    return case


@njit
def _count_faces(field, triangle_counts):
    count = 0
    for i in range(1, BLOCK_SIDE + 1):
        for j in range(1, BLOCK_SIDE + 1):
            for k in range(1, BLOCK_SIDE + 1):
                case = _case(field, i, j, k)
                if case > 0:
                    count += triangle_counts[case]
    return count


@njit(parallel=True)
def _vertices(blocks, edge_ranks, first_vertex, weight_above, voxel_size):
    """Positions and normals, float32 V×3, and grey, float32 (V,), of all numbered edges."""
    total = first_vertex[-1]
    positions, normals = np.empty((total, 3), np.float32), np.empty((total, 3), np.float32)
    grey = np.empty(total, np.float32)
    for b in prange(len(blocks.keys)):
        start, end = first_vertex[b], first_vertex[b + 1]
        if start < end:
            field = np.empty((APRON, APRON, APRON), np.float32)
            _load_field(field, blocks, b, weight_above)
            parts = positions[start:end], normals[start:end], grey[start:end]
            _place_vertices(parts, field, edge_ranks[b], blocks, b, voxel_size)
    return positions, normals, grey


@njit
def _place_vertices(parts, field, ranks, blocks, b, voxel_size):
    positions, normals, grey = parts
    corner = unpack(blocks.keys[b])
    for i in range(BLOCK_SIDE):
        for j in range(BLOCK_SIDE):
            for k in range(BLOCK_SIDE):
                for axis in range(3):
                    n = ranks[i, j, k, axis]
                    if n == NO_VERTEX:
                        continue
                    t = _crossing(field, i + 1, j + 1, k + 1, axis)
                    voxel = (i, j, k)
                    for a in range(3):
                        along = corner[a] * BLOCK_SIDE + voxel[a] + 0.5 + (t if a == axis else 0.0)
                        positions[n, a] = along * voxel_size
                    _normal(normals[n], field, i + 1, j + 1, k + 1, axis, t)
                    here, there = _grey(blocks, b, voxel), _grey(blocks, b, _next(i, j, k, axis))
                    grey[n] = here + t * (there - here)


@njit(inline="always")
def _next(i, j, k, axis):
    """The voxel at the far end of an edge."""
    return i + (axis == 0), j + (axis == 1), k + (axis == 2)


@njit(inline="always")
def _crossing(field, i, j, k, axis):
    """Where along an edge, in (0, 1), the distance passes zero."""
    a = field[i, j, k]
    b = field[_next(i, j, k, axis)]
    return min(max(a / (a - b), CLEARANCE), np.float32(1.0) - CLEARANCE)


@njit(inline="always")
def _grey(blocks, b, voxel):
    i, j, k = voxel
    sums = blocks.sums[blocks.slots[_owner(blocks, b, i, j, k)], i & 7, j & 7, k & 7]
    return np.float32(sums[2]) / np.float32(sums[1])


@njit
def _normal(out, field, i, j, k, axis, t):
    """Unit gradient between the edge's two voxels, which points to where the distance is positive."""
    ni, nj, nk = _next(i, j, k, axis)
    square = np.float32(0.0)
    for a in range(3):
        here, there = _slope(field, i, j, k, a), _slope(field, ni, nj, nk, a)
        out[a] = here + t * (there - here)
        square += out[a] * out[a]
    if square > 0.0:
        out /= np.sqrt(square)
    else:
        out[axis] = 1.0 if field[i, j, k] < 0.0 else -1.0


@njit(inline="always")
def _slope(field, i, j, k, axis):
    """Central difference along an axis, one-sided beside an unseen voxel, 0 between two."""
    di, dj, dk = int(axis == 0), int(axis == 1), int(axis == 2)
    here, before, after = field[i, j, k], field[i - di, j - dj, k - dk], field[i + di, j + dj, k + dk]
    if before == UNSEEN and after == UNSEEN:
        return np.float32(0.0)
    if before == UNSEEN:
        return after - here
    if after == UNSEEN:
        return here - before
    return np.float32(0.5) * (after - before)


@njit(parallel=True)
def _faces(blocks, edge_ranks, first_vertex, first_face, weight_above, triangle_counts, table, edges):
    faces = np.empty((first_face[-1], 3), np.int32)
    for b in prange(len(blocks.keys)):
        start, end = first_face[b], first_face[b + 1]
        if start < end:
            field = np.empty((APRON, APRON, APRON), np.float32)
            _load_field(field, blocks, b, weight_above)
            _fill_faces(faces[start:end], field, blocks, b, edge_ranks, first_vertex, triangle_counts, table, edges)
    return faces


@njit
def _fill_faces(faces, field, blocks, b, edge_ranks, first_vertex, triangle_counts, table, edges):
    n = 0
    for i in range(BLOCK_SIDE):
        for j in range(BLOCK_SIDE):
            for k in range(BLOCK_SIDE):
                case = _case(field, i + 1, j + 1, k + 1)
                if case <= 0:
                    continue
                for triangle in table[case, : triangle_counts[case]]:
                    for a in range(3):
                        faces[n, a] = _vertex_of(triangle[a], i, j, k, blocks, b, edge_ranks, first_vertex, edges)
                    n += 1


@njit(inline="always")
def _vertex_of(edge, i, j, k, blocks, b, edge_ranks, first_vertex, edges):
    """Number of the vertex on an edge of the cell at voxel (i, j, k) of block b."""
    corner, axis = edges[edge]
    i, j, k = i + (corner & 1), j + (corner >> 1 & 1), k + (corner >> 2)
    owner = _owner(blocks, b, i, j, k)
    return first_vertex[owner] + edge_ranks[owner, i & 7, j & 7, k & 7, axis]
