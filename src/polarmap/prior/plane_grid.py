"""Piecewise planar interpolation of scattered values: one plane per cell of a grid, joined across all but edges.

The image is cut into square cells. Cell i carries a plane p_i(x) = a_i + g_i·x, and the planes together minimize

    E = Σ_points c ρ(p_i(x) - q)  +  λ Σ_neighbours w_ij s_ij [ (p_i(m) - p_j(m))² + |g_i - g_j|² ]

with m the middle of the border between cells i and j and lengths in cells. w_ij = exp(-|ΔI|/contrast) falls with the
step of intensity, so that surfaces may part where the image has an edge; ρ and s_ij are reweighted from one solution
to the next, so that outliers lose their say (Geman-McClure) and a jump or crease costs its size, not its square.
Inverse depth is what to interpolate: a plane of space is exactly affine in it.

Each solution is found by conjugate gradients, preconditioned by one V-cycle of Galerkin multigrid that merges 2×2
cells into one with a common plane. All of it is linear in the number of cells, which does not grow with the image.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import prange

from polarmap.geometry.cells import cell_means
from polarmap.jit import FINITE_MATH, njit

_CELLS = 4800  # 8×8 pixels at 640×480; finer cells gain nothing that the points do not already say
_RIDGE = 1e-9  # keeps planes apart from any point well defined
_MIN_COUPLING = 1e-5
_JUMP = 0.01  # jumps below this share of the value cost their square
_STIFFNESS = 1.0
_ITERATIONS = (30, 10, 10, 10)  # of conjugate gradients, before the first reweighting and after each
_OVERCORRECTION = 1.5  # planes common to merged cells are too stiff, their corrections too short


def interpolate_planes(
    values: np.ndarray, weights: np.ndarray, guide: np.ndarray, contrast: float, noise: float, flatness: float
) -> np.ndarray:
    """Values known at scattered pixels, interpolated over the whole image along its surfaces.

    values: float32 H×W, positive. weights: float32 H×W, 0 where `values` is not known; at least one is not.
    guide: float32 H×W, the image whose edges may part surfaces. contrast: the step in `guide` that weakens the
    bond of two cells e-fold. noise: expected relative error of the values. flatness: what a slope of one per cell
    costs, in points; the larger, the less is extrapolated along slopes.
    Returns float32 H×W, not bounded by the values.
    """
    cell = max(1, round((guide.size / _CELLS) ** 0.5))
    cell_guide = cell_means(guide, cell)
    planes = solve_planes(values, weights, cell_guide, cell, contrast, noise, flatness)
    out = np.empty(guide.shape, np.float32)
    _evaluate(planes, guide, cell_guide, cell, 1.0 / contrast, out)
    return out


def solve_planes(
    values: np.ndarray,
    weights: np.ndarray,
    cell_guide: np.ndarray,
    cell: int,
    contrast: float,
    noise: float,
    flatness: float,
) -> np.ndarray:
    """The planes (value at the image centre, slope along u and v per cell) of all cells, float64 rows×columns×3."""
    bonds = _bonds(cell_guide, contrast)
    planes = np.zeros((*cell_guide.shape, 3))
    planes[..., 0] = np.average(values[weights > 0], weights=weights[weights > 0])
    moments, rhs = np.empty((*cell_guide.shape, 6)), np.empty((*cell_guide.shape, 3))
    for round_, iterations in enumerate(_ITERATIONS):
        first = round_ == 0
        _pool(values, weights, planes, cell, np.inf if first else noise, moments, rhs)
        right, down = _couplings(bonds, planes, np.inf if first else _JUMP)
        planes = _conjugate_gradients(_hierarchy(moments, right, down, flatness), rhs, planes, iterations)
    return planes


class _Level(NamedTuple):
    """One grid of the hierarchy. Symmetric 3×3 blocks are stored as their upper triangle, 6 numbers."""

    right: np.ndarray  # coupling to the cell at the right, rows×columns×6, 0 in the last column
    down: np.ndarray  # coupling to the cell below, 0 in the last row
    diagonal: np.ndarray  # points, ridge, and the couplings to all neighbours
    inverse: np.ndarray  # of the diagonal


def _bonds(cell_guide: np.ndarray, contrast: float) -> np.ndarray:
    """w_ij to the right and downward neighbour, float64 2×rows×columns, 0 where there is none."""
    bonds = np.zeros((2, *cell_guide.shape))
    bonds[0, :, :-1] = np.exp(-np.abs(np.diff(cell_guide, axis=1)) / contrast) + _MIN_COUPLING
    bonds[1, :-1] = np.exp(-np.abs(np.diff(cell_guide, axis=0)) / contrast) + _MIN_COUPLING
    return bonds


def _couplings(bonds: np.ndarray, planes: np.ndarray, jump: float) -> tuple[np.ndarray, np.ndarray]:
    right, down = np.empty((*planes.shape[:2], 6)), np.empty((*planes.shape[:2], 6))
    _couple(bonds[0], planes, 0, 1, jump, right)
    _couple(bonds[1], planes, 1, 0, jump, down)
    return right, down


def _hierarchy(moments: np.ndarray, right: np.ndarray, down: np.ndarray, flatness: float) -> list[_Level]:
    data = moments.copy()
    data[..., 0] += _RIDGE
    data[..., (3, 5)] += flatness
    levels = []
    while True:
        diagonal, inverse = np.empty_like(data), np.empty_like(data)
        _diagonal(data, right, down, diagonal, inverse)
        levels.append(_Level(right, down, diagonal, inverse))
        if data.shape[:2] == (1, 1):
            return levels
        data, right, down = _merge(data, right, down)


def _merge(data: np.ndarray, right: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of the grid of half the size; a coupling inside a merged cell vanishes."""
    shape = ((data.shape[0] + 1) // 2, (data.shape[1] + 1) // 2, 6)
    merged = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    _merge_blocks(data, right, down, *merged)
    return merged


def _conjugate_gradients(levels: list[_Level], rhs: np.ndarray, planes: np.ndarray, iterations: int) -> np.ndarray:
    right, down, diagonal, _ = levels[0]
    residual, product, nothing = np.empty_like(rhs), np.empty_like(rhs), np.zeros_like(rhs)
    _residual(right, down, diagonal, rhs, planes, 0, 1, residual)
    direction, last = np.zeros_like(rhs), np.inf
    for _ in range(iterations):
        step = _v_cycle(levels, residual)
        energy = _dot(residual, step)
        direction = step + (energy / last) * direction
        _residual(right, down, diagonal, nothing, direction, 0, 1, product)
        curvature = -_dot(direction, product)
        if not (energy > 0.0 and curvature > 0.0):  # solved to rounding
            break
        length = energy / curvature
        planes = planes + length * direction
        residual += length * product
        last = energy
    return planes


def _v_cycle(levels: list[_Level], rhs: np.ndarray, depth: int = 0) -> np.ndarray:
    """An approximate solution of levels[depth] for `rhs`, by a symmetric operator."""
    level, planes, residual = levels[depth], np.zeros_like(rhs), np.empty_like(rhs)
    _sweep(level, rhs, (0, 1), planes, residual)
    if depth + 1 < len(levels):
        coarse_rhs = np.empty((*levels[depth + 1].diagonal.shape[:2], 3))
        _residual(level.right, level.down, level.diagonal, rhs, planes, 0, 1, residual)
        _restrict(residual, coarse_rhs)
        _correct(planes, _v_cycle(levels, coarse_rhs, depth + 1), _OVERCORRECTION)
        _sweep(level, rhs, (1, 0), planes, residual)
    return planes


def _sweep(level: _Level, rhs: np.ndarray, colours: tuple[int, int], planes: np.ndarray, scratch: np.ndarray) -> None:
    """One Gauss-Seidel sweep, over the cells of one colour of the chessboard and then those of the other."""
    for colour in colours:
        _residual(level.right, level.down, level.diagonal, rhs, planes, colour, 2, scratch)
        _update(level.inverse, scratch, colour, planes)


@njit(inline="always")
def _times(blocks, i, j, x, y, z):
    """Product of the symmetric block blocks[i, j] with a vector."""
    return (
        blocks[i, j, 0] * x + blocks[i, j, 1] * y + blocks[i, j, 2] * z,
        blocks[i, j, 1] * x + blocks[i, j, 3] * y + blocks[i, j, 4] * z,
        blocks[i, j, 2] * x + blocks[i, j, 4] * y + blocks[i, j, 5] * z,
    )


@njit(parallel=True)
def _pool(values, weights, planes, cell, noise, moments, rhs):
    """Normal equations of each cell's points, reweighted by their distance from the present planes."""
    height, width = values.shape
    rows, columns = rhs.shape[:2]
    for i in prange(rows):
        for j in range(columns):
            m, r, p = moments[i, j], rhs[i, j], planes[i, j]
            m[:] = 0.0
            r[:] = 0.0
            for v in range(i * cell, min((i + 1) * cell, height)):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    weight = np.float64(weights[v, u])
                    if weight > 0.0:
                        q = np.float64(values[v, u])
                        x = (u + 0.5) / cell - 0.5 * columns
                        y = (v + 0.5) / cell - 0.5 * rows
                        error = (p[0] + p[1] * x + p[2] * y - q) / (q * noise)
                        weight /= (1.0 + error * error) ** 2
                        m[0] += weight
                        m[1] += weight * x
                        m[2] += weight * y
                        m[3] += weight * x * x
                        m[4] += weight * x * y
                        m[5] += weight * y * y
                        r[0] += weight * q
                        r[1] += weight * q * x
                        r[2] += weight * q * y


@njit
def _couple(bonds, planes, di, dj, jump, out):
    """λ w s [v vᵀ + diag(0, 1, 1)], v = (1, m), of each cell with its neighbour at (di, dj)."""
    rows, columns = bonds.shape
    out[:] = 0.0
    for i in range(rows - di):
        for j in range(columns - dj):
            p, q = planes[i, j], planes[i + di, j + dj]
            x = j + 0.5 * (1 + dj) - 0.5 * columns
            y = i + 0.5 * (1 + di) - 0.5 * rows
            slope_u, slope_v = p[1] - q[1], p[2] - q[2]
            step = p[0] - q[0] + slope_u * x + slope_v * y
            size = np.sqrt(step * step + slope_u * slope_u + slope_v * slope_v)
            allowed = jump * abs(p[0] + p[1] * x + p[2] * y)
            strength = _STIFFNESS * bonds[i, j]
            if size > allowed:
                strength *= allowed / size
            block = out[i, j]
            block[0] = strength
            block[1] = strength * x
            block[2] = strength * y
            block[3] = strength * (x * x + 1.0)
            block[4] = strength * x * y
            block[5] = strength * (y * y + 1.0)


@njit
def _merge_blocks(data, right, down, coarse_data, coarse_right, coarse_down):
    rows, columns = data.shape[:2]
    for i in range(rows):
        for j in range(columns):
            for k in range(6):
                coarse_data[i // 2, j // 2, k] += data[i, j, k]
                if j % 2 == 1:
                    coarse_right[i // 2, j // 2, k] += right[i, j, k]
                if i % 2 == 1:
                    coarse_down[i // 2, j // 2, k] += down[i, j, k]


@njit
def _diagonal(data, right, down, diagonal, inverse):
    for i in range(data.shape[0]):
        for j in range(data.shape[1]):
            m, n = diagonal[i, j], inverse[i, j]
            for k in range(6):
                m[k] = data[i, j, k] + right[i, j, k] + down[i, j, k]
                if j > 0:
                    m[k] += right[i, j - 1, k]
                if i > 0:
                    m[k] += down[i - 1, j, k]
            n[0] = m[3] * m[5] - m[4] * m[4]
            n[1] = m[2] * m[4] - m[1] * m[5]
            n[2] = m[1] * m[4] - m[2] * m[3]
            n[3] = m[0] * m[5] - m[2] * m[2]
            n[4] = m[1] * m[2] - m[0] * m[4]
            n[5] = m[0] * m[3] - m[1] * m[1]
            determinant = m[0] * n[0] + m[1] * n[1] + m[2] * n[2]
            for k in range(6):
                n[k] /= determinant


@njit
def _residual(right, down, diagonal, rhs, planes, colour, colours, out):
    """rhs - A planes at the cells of one colour of the chessboard (colours = 2), or at all (colours = 1)."""
    rows, columns = planes.shape[:2]
    for i in range(rows):
        for j in range((i + colour) % colours, columns, colours):
            x, y, z = _times(diagonal, i, j, planes[i, j, 0], planes[i, j, 1], planes[i, j, 2])
            a, b, c = rhs[i, j, 0] - x, rhs[i, j, 1] - y, rhs[i, j, 2] - z
            if j + 1 < columns:
                x, y, z = _times(right, i, j, planes[i, j + 1, 0], planes[i, j + 1, 1], planes[i, j + 1, 2])
                a, b, c = a + x, b + y, c + z
            if j > 0:
                x, y, z = _times(right, i, j - 1, planes[i, j - 1, 0], planes[i, j - 1, 1], planes[i, j - 1, 2])
                a, b, c = a + x, b + y, c + z
            if i + 1 < rows:
                x, y, z = _times(down, i, j, planes[i + 1, j, 0], planes[i + 1, j, 1], planes[i + 1, j, 2])
                a, b, c = a + x, b + y, c + z
            if i > 0:
                x, y, z = _times(down, i - 1, j, planes[i - 1, j, 0], planes[i - 1, j, 1], planes[i - 1, j, 2])
                a, b, c = a + x, b + y, c + z
            out[i, j, 0] = a
            out[i, j, 1] = b
            out[i, j, 2] = c


@njit
def _update(inverse, residual, colour, planes):
    for i in range(planes.shape[0]):
        for j in range((i + colour) % 2, planes.shape[1], 2):
            x, y, z = _times(inverse, i, j, residual[i, j, 0], residual[i, j, 1], residual[i, j, 2])
            planes[i, j, 0] += x
            planes[i, j, 1] += y
            planes[i, j, 2] += z


@njit(fastmath=FINITE_MATH)
def _dot(a, b):
    """Without the thread pool of BLAS, which costs more than it saves here."""
    total = 0.0
    for i in range(a.shape[0]):
        for j in range(a.shape[1]):
            for k in range(3):
                total += a[i, j, k] * b[i, j, k]
    return total


@njit
def _restrict(residual, coarse):
    coarse[:] = 0.0
    for i in range(residual.shape[0]):
        for j in range(residual.shape[1]):
            for k in range(3):
                coarse[i // 2, j // 2, k] += residual[i, j, k]


@njit
def _correct(planes, coarse, factor):
    for i in range(planes.shape[0]):
        for j in range(planes.shape[1]):
            for k in range(3):
                planes[i, j, k] += factor * coarse[i // 2, j // 2, k]


@njit(parallel=True)
def _evaluate(planes, guide, cell_guide, cell, sharpness, out):
    """Bilinear blend of the four nearest cells' planes, of those most that look like the pixel."""
    height, width = guide.shape
    rows, columns = cell_guide.shape
    for v in prange(height):
        row = (v + 0.5) / cell - 0.5
        y = (v + 0.5) / cell - 0.5 * rows
        top = int(np.floor(row))
        for u in range(width):
            column = (u + 0.5) / cell - 0.5
            x = (u + 0.5) / cell - 0.5 * columns
            left = int(np.floor(column))
            total, norm = 0.0, 0.0
            for di in range(2):
                i = min(max(top + di, 0), rows - 1)
                for dj in range(2):
                    j = min(max(left + dj, 0), columns - 1)
                    p = planes[i, j]
                    difference = sharpness * (guide[v, u] - cell_guide[i, j])
                    weight = (1.0 - abs(row - top - di)) * (1.0 - abs(column - left - dj))
                    weight /= 1.0 + difference * difference
                    total += weight * (p[0] + p[1] * x + p[2] * y)
                    norm += weight
            out[v, u] = total / norm
