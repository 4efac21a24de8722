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
from polarmap.jit import FAST_MATH, FINITE_MATH, njit

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
        solution = _bordered(planes)
        _conjugate_gradients(_hierarchy(moments, right, down, flatness), _bordered(rhs), solution, iterations)
        planes = np.ascontiguousarray(solution[1:-1, 1:-1])
    return planes


class _Levels(NamedTuple):
    """The grids of the hierarchy, the finest first, one after the other in arrays of all their cells.

    Symmetric 3×3 blocks are stored as their upper triangle, 6 numbers. There is a border of one cell of zeros all round
    each grid, as in all vectors that these are multiplied with, so that kernels need not ask where they are. Their
    indices are unsigned, since negative ones would mean the other end to Numba.
    """

    rows: np.ndarray  # with the border, int64 of each grid
    columns: np.ndarray
    starts: np.ndarray  # the first cell
    right: np.ndarray  # coupling to the cell at the right, cells×6, 0 in the last column
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


def _hierarchy(moments: np.ndarray, right: np.ndarray, down: np.ndarray, flatness: float) -> _Levels:
    data = moments.copy()
    data[..., 0] += _RIDGE
    data[..., (3, 5)] += flatness
    levels = []
    while True:
        diagonal, inverse = np.empty_like(data), np.empty_like(data)
        _diagonal(data, right, down, diagonal, inverse)
        levels.append([_bordered(blocks) for blocks in (right, down, diagonal, inverse)])
        if data.shape[:2] == (1, 1):
            break
        data, right, down = _merge(data, right, down)
    rows, columns = np.array([blocks[0].shape[:2] for blocks in levels]).T.copy()
    starts = np.cumsum(rows * columns) - rows * columns
    together = (np.concatenate([grid.reshape(-1, 6) for grid in kind]) for kind in zip(*levels, strict=True))
    return _Levels(rows, columns, starts, *together)


def _bordered(values: np.ndarray) -> np.ndarray:
    """With a border of zeros, rows×columns×K to (rows + 2)×(columns + 2)×K."""
    rows, columns, count = values.shape
    bordered = np.zeros((rows + 2, columns + 2, count))
    bordered[1:-1, 1:-1] = values
    return bordered


def _merge(data: np.ndarray, right: np.ndarray, down: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Blocks of the grid of half the size; a coupling inside a merged cell vanishes."""
    shape = ((data.shape[0] + 1) // 2, (data.shape[1] + 1) // 2, 6)
    merged = np.zeros(shape), np.zeros(shape), np.zeros(shape)
    _merge_blocks(data, right, down, *merged)
    return merged


@njit(parallel=True, error_model="numpy")
def _pool(values, weights, planes, cell, noise, moments, rhs):
    """Normal equations of each cell's points, reweighted by their distance from the present planes."""
    height, width = values.shape
    rows, columns = rhs.shape[:2]
    size, sharpness = 1.0 / cell, 1.0 / noise
    for i in prange(rows):
        for j in range(columns):
            p0, p1, p2 = planes[i, j, 0], planes[i, j, 1], planes[i, j, 2]
            m0 = m1 = m2 = m3 = m4 = m5 = r0 = r1 = r2 = 0.0
            for v in range(i * cell, min((i + 1) * cell, height)):
                y = (v + 0.5) * size - 0.5 * rows
                for u in range(j * cell, min((j + 1) * cell, width)):
                    if weights[v, u] > 0.0:
                        q = np.float64(values[v, u])
                        x = (u + 0.5) * size - 0.5 * columns
                        error = (p0 + p1 * x + p2 * y - q) * sharpness
                        root = q * q / (q * q + error * error)
                        weight = weights[v, u] * root * root
                        m0 += weight
                        m1 += weight * x
                        m2 += weight * y
                        m3 += weight * x * x
                        m4 += weight * x * y
                        m5 += weight * y * y
                        r0 += weight * q
                        r1 += weight * q * x
                        r2 += weight * q * y
            m, r = moments[i, j], rhs[i, j]
            m[0], m[1], m[2], m[3], m[4], m[5] = m0, m1, m2, m3, m4, m5
            r[0], r[1], r[2] = r0, r1, r2


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


@njit(inline="always")
def _times(blocks, k, x, y, z):
    """Product of the symmetric block blocks[k] with a vector."""
    return (
        blocks[k, 0] * x + blocks[k, 1] * y + blocks[k, 2] * z,
        blocks[k, 1] * x + blocks[k, 3] * y + blocks[k, 4] * z,
        blocks[k, 2] * x + blocks[k, 4] * y + blocks[k, 5] * z,
    )


@njit(inline="always")
def _pulled(right, above, down, upper, middle, lower, rhs, left):
    """A cell's right side and what its neighbours' planes add to it, from the rows of blocks and planes around it.

    left: place of its left neighbour.
    """
    here, after = left + np.uint64(1), left + np.uint64(2)
    a0, b0, c0 = _times(right, here, middle[after, 0], middle[after, 1], middle[after, 2])
    a1, b1, c1 = _times(right, left, middle[left, 0], middle[left, 1], middle[left, 2])
    a2, b2, c2 = _times(down, here, lower[here, 0], lower[here, 1], lower[here, 2])
    a3, b3, c3 = _times(above, here, upper[here, 0], upper[here, 1], upper[here, 2])
    return (
        rhs[here, 0] + ((a0 + a1) + (a2 + a3)),
        rhs[here, 1] + ((b0 + b1) + (b2 + b3)),
        rhs[here, 2] + ((c0 + c1) + (c2 + c3)),
    )


@njit(inline="always")
def _of_colour(row, colour, columns):
    """The first place of a colour of the chessboard in a row, and how many there are."""
    first = (row + np.uint64(colour)) % np.uint64(2)
    return first, (np.uint64(columns) + np.uint64(1) - first) // np.uint64(2)


@njit(fastmath=FAST_MATH)
def _residual(right, down, diagonal, rhs, planes, out):
    """rhs - A planes."""
    one, two = np.uint64(1), np.uint64(2)
    for i in range(np.uint64(planes.shape[0] - 2)):
        here, below = i + one, i + two
        of_row, block, result = planes[here], diagonal[here], out[here]
        for j in range(np.uint64(planes.shape[1] - 2)):
            k = j + one
            a, b, c = _pulled(right[here], down[i], down[here], planes[i], of_row, planes[below], rhs[here], j)
            x, y, z = _times(block, k, of_row[k, 0], of_row[k, 1], of_row[k, 2])
            result[k, 0], result[k, 1], result[k, 2] = a - x, b - y, c - z


@njit(fastmath=FAST_MATH)
def _relax(right, down, inverse, rhs, colour, planes):
    """Gauss-Seidel at the cells of one colour of the chessboard."""
    one, two = np.uint64(1), np.uint64(2)
    for i in range(np.uint64(planes.shape[0] - 2)):
        here, below = i + one, i + two
        of_row, block = planes[here], inverse[here]
        first, count = _of_colour(i, colour, planes.shape[1] - 2)
        for n in range(count):
            j = first + two * n
            a, b, c = _pulled(right[here], down[i], down[here], planes[i], of_row, planes[below], rhs[here], j)
            k = j + one
            of_row[k, 0], of_row[k, 1], of_row[k, 2] = _times(block, k, a, b, c)


@njit(fastmath=FAST_MATH)
def _descend(right, down, inverse, rhs, nothing, planes, coarse):
    """One Gauss-Seidel sweep from planes of 0, and what it leaves of `rhs`, summed over 2×2 cells into `coarse`, zeros.

    It leaves something where it begins alone: at the cells of the first colour, by what those of the second have
    changed since. nothing: zeros, of a row.
    """
    one, two = np.uint64(1), np.uint64(2)
    for i in range(np.uint64(planes.shape[0] - 2)):
        of_row, block, target = planes[i + one], inverse[i + one], rhs[i + one]
        first, count = _of_colour(i, 0, planes.shape[1] - 2)
        for n in range(count):
            k = first + two * n + one
            of_row[k, 0], of_row[k, 1], of_row[k, 2] = _times(block, k, target[k, 0], target[k, 1], target[k, 2])
    _relax(right, down, inverse, rhs, 1, planes)
    for i in range(np.uint64(planes.shape[0] - 2)):
        here, below, total = i + one, i + two, coarse[i // two + one]
        first, count = _of_colour(i, 0, planes.shape[1] - 2)
        for n in range(count):
            j = first + two * n
            a, b, c = _pulled(right[here], down[i], down[here], planes[i], planes[here], planes[below], nothing, j)
            total[n + one, 0] += a
            total[n + one, 1] += b
            total[n + one, 2] += c


@njit(fastmath=FAST_MATH)
def _ascend(right, down, inverse, rhs, coarse, planes):
    """Add the planes of the grid of half the size, and sweep in the other order."""
    one, two = np.uint64(1), np.uint64(2)
    for i in range(np.uint64(planes.shape[0] - 2)):
        of_row, from_row = planes[i + one], coarse[i // two + one]
        for j in range(np.uint64(planes.shape[1] - 2)):
            for k in range(3):
                of_row[j + one, k] += _OVERCORRECTION * from_row[j // two + one, k]
    _relax(right, down, inverse, rhs, 1, planes)
    _relax(right, down, inverse, rhs, 0, planes)


@njit(fastmath=FINITE_MATH)
def _dot(a, b):
    """Without the thread pool of BLAS, which costs more than it saves here."""
    a, b, total = a.ravel(), b.ravel(), 0.0
    for k in range(a.size):
        total += a[k] * b[k]
    return total


@njit
def _grid(values, levels, depth):
    """What `values`, cells×K of all grids, has of one of them, (rows + 2)×(columns + 2)×K."""
    rows, columns, start = levels.rows[depth], levels.columns[depth], levels.starts[depth]
    return values[start : start + rows * columns].reshape(rows, columns, values.shape[1])


@njit
def _v_cycle(levels, sides, planes, nothing):
    """An approximate solution for the right side in the finest grid of `sides`, by a symmetric operator, into that of
    `planes`; both cells×3 of all grids. nothing: zeros, of a row.
    """
    last = levels.rows.size - 1
    planes[:] = 0.0
    sides[levels.rows[0] * levels.columns[0] :] = 0.0
    for depth in range(last):
        right, down = _grid(levels.right, levels, depth), _grid(levels.down, levels, depth)
        inverse, side = _grid(levels.inverse, levels, depth), _grid(sides, levels, depth)
        _descend(right, down, inverse, side, nothing, _grid(planes, levels, depth), _grid(sides, levels, depth + 1))
    blocks = _grid(levels.right, levels, last), _grid(levels.down, levels, last), _grid(levels.inverse, levels, last)
    _relax(*blocks, _grid(sides, levels, last), 0, _grid(planes, levels, last))  # of one cell
    for depth in range(last - 1, -1, -1):
        right, down = _grid(levels.right, levels, depth), _grid(levels.down, levels, depth)
        inverse, side = _grid(levels.inverse, levels, depth), _grid(sides, levels, depth)
        _ascend(right, down, inverse, side, _grid(planes, levels, depth + 1), _grid(planes, levels, depth))


@njit
def _conjugate_gradients(levels, rhs, planes, iterations):
    """Better `planes`, in place; both with a border."""
    right, down = _grid(levels.right, levels, 0), _grid(levels.down, levels, 0)
    diagonal = _grid(levels.diagonal, levels, 0)
    sides, steps = np.zeros((levels.right.shape[0], 3)), np.zeros((levels.right.shape[0], 3))
    residual, step = _grid(sides, levels, 0), _grid(steps, levels, 0)
    product, direction, nothing = np.zeros_like(rhs), np.zeros_like(rhs), np.zeros_like(rhs)
    _residual(right, down, diagonal, rhs, planes, residual)
    last = np.inf
    for _ in range(iterations):
        _v_cycle(levels, sides, steps, nothing[0])
        energy = _dot(residual, step)
        _add_scaled(step, energy / last, direction, direction)
        _residual(right, down, diagonal, nothing, direction, product)
        curvature = -_dot(direction, product)
        if not (energy > 0.0 and curvature > 0.0):  # solved to rounding
            break
        _add_scaled(planes, energy / curvature, direction, planes)
        _add_scaled(residual, energy / curvature, product, residual)
        last = energy


@njit(fastmath=FAST_MATH)
def _add_scaled(a, factor, b, out):
    """a + factor · b."""
    a, b, out = a.ravel(), b.ravel(), out.ravel()
    for k in range(out.size):
        out[k] = a[k] + factor * b[k]


@njit(parallel=True, error_model="numpy")
def _evaluate(planes, guide, cell_guide, cell, sharpness, out):
    """Bilinear blend of the four nearest cells' planes, of those most that look like the pixel."""
    height, width = guide.shape
    rows, columns = cell_guide.shape
    size = 1.0 / cell
    for v in prange(height):
        row = (v + 0.5) * size - 0.5
        y = row + 0.5 - 0.5 * rows
        top = int(np.floor(row))
        lower = row - top
        a, b = max(top, 0), min(top + 1, rows - 1)
        for u in range(width):
            column = (u + 0.5) * size - 0.5
            x = column + 0.5 - 0.5 * columns
            left = int(np.floor(column))
            righter = column - left
            c, d = max(left, 0), min(left + 1, columns - 1)
            total, norm = 0.0, 0.0
            for i, j, weight in (
                (a, c, (1.0 - lower) * (1.0 - righter)),
                (a, d, (1.0 - lower) * righter),
                (b, c, lower * (1.0 - righter)),
                (b, d, lower * righter),
            ):
                difference = sharpness * (guide[v, u] - cell_guide[i, j])
                weight /= 1.0 + difference * difference
                total += weight * (planes[i, j, 0] + planes[i, j, 1] * x + planes[i, j, 2] * y)
                norm += weight
            out[v, u] = total / norm
