"""How uncertain the depth of chosen surfaces is: by what else could be there, and by the surfaces themselves.

Belief propagation carries a decision over a whole bare wall, and with it far more certainty than there is: what a
network expects of a wall, or what an outline beside it suggests, is one opinion, not one for each cell. So the costs of
a connected piece are averaged, and count as a few independent ones.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.densify.surfaces.labels import best_labels
from polarmap.jit import njit

_TEMPERATURE = np.float32(8.0)  # belief by which another label is e times less likely
_LARGEST_STEP = np.float32(0.5)  # of log depth
_OPINIONS = 1.5  # independent errors that the mean cost of a piece stands for
_SHARE = np.float32(0.6)  # of the mean step that is a standard deviation: two thirds of the errors are to be below it
_PLANE_SIGMA = (0.5, 3.0)  # of a plane on its points, and what is added beside them, in deviations of a point
_FREE_SIGMA = np.float32(0.01)  # relative, of a free surface on points
_FREE_DRIFT = np.float32(3.2)  # likewise, per image diagonal from them
_NEAR_POINTS = 3.0  # pixels in which a plane's deviation rises


def undecided_sigma(
    costs: np.ndarray, beliefs: np.ndarray, middles: np.ndarray, label: np.ndarray, cell: int
) -> np.ndarray:
    """Relative standard deviation of every pixel's depth by the other surfaces that may be there, float32 H×W.

    costs, beliefs: of cells, float32 rows×columns×N (see `label_cells`). middles: inverse depth of the surfaces in the
    middle of the cells, float32 rows×columns×N. label: which surface was chosen, int16 H×W. cell: side in pixels.
    """
    pieces, of_piece = connected_pieces(best_labels(beliefs))
    as_pieces = np.exp(-_OPINIONS * _excess(costs, pieces, of_piece)).astype(np.float32)
    as_cells = np.exp(beliefs / -_TEMPERATURE)
    with np.errstate(invalid="ignore", divide="ignore"):
        logs = np.log(middles)
    sigma = np.empty(label.shape, np.float32)
    _mean_steps(as_cells, as_pieces, pieces, logs, label, cell, sigma)
    return _SHARE * sigma


def surface_sigma(distance: np.ndarray, planar: np.ndarray, point_sigma: float) -> np.ndarray:
    """Relative standard deviation of the depth of a surface that is the right one, float32 H×W.

    distance: in pixels from the nearest point on it. planar: bool H×W. point_sigma: relative standard deviation of a
    point by noise. A plane is known by all its points, a free surface by those around alone.
    """
    sigma = np.empty(distance.shape, np.float32)
    drift = _FREE_DRIFT / np.float32(np.hypot(*distance.shape))
    _surface_sigma(distance, planar, np.float32(point_sigma), drift, sigma)
    return sigma


@njit(parallel=True)
def _surface_sigma(distance, planar, point_sigma, drift, sigma):
    on, beside = np.float32(_PLANE_SIGMA[0]), np.float32(_PLANE_SIGMA[1])
    faster, one = np.float32(-1.0 / _NEAR_POINTS), np.float32(1.0)
    for v in prange(distance.shape[0]):
        for u in range(distance.shape[1]):
            if planar[v, u]:
                sigma[v, u] = point_sigma * (on + beside * (one - np.exp(faster * distance[v, u])))
            else:
                drifted = drift * distance[v, u]
                sigma[v, u] = np.sqrt(_FREE_SIGMA * _FREE_SIGMA + drifted * drifted)


def connected_pieces(best: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of each cell's connected piece of one label, int64 rows×columns, and the pieces' labels.

    best: integers rows×columns. Cells are connected to the left, right, upper and lower one.
    """
    pieces, of_piece = np.empty(best.shape, np.int64), np.empty(best.size, np.int64)
    count = _number_pieces(best, np.arange(best.size), pieces, of_piece)
    return pieces, of_piece[:count]


@njit
def _number_pieces(best, parent, pieces, of_piece):
    """By union of neighbours, whose pieces then have as their root the first cell of all, which comes first."""
    rows, columns = best.shape
    for i in range(rows):
        for j in range(columns):
            here = i * columns + j
            if j > 0 and best[i, j - 1] == best[i, j]:
                _unite(parent, here - 1, here)
            if i > 0 and best[i - 1, j] == best[i, j]:
                _unite(parent, here - columns, here)
    count = 0
    for i in range(rows):
        for j in range(columns):
            root = _root(parent, i * columns + j)
            if root == i * columns + j:
                pieces[i, j], of_piece[count] = count, best[i, j]
                count += 1
            else:
                pieces[i, j] = pieces[root // columns, root % columns]
    return count


@njit
def _unite(parent, a, b):
    a, b = _root(parent, a), _root(parent, b)
    parent[max(a, b)] = min(a, b)


@njit
def _root(parent, k):
    while parent[k] != k:
        parent[k] = parent[parent[k]]
        k = parent[k]
    return k


def _excess(costs: np.ndarray, pieces: np.ndarray, of_piece: np.ndarray) -> np.ndarray:
    """By how much a label's mean cost over each piece exceeds that of the piece's own, not negative, pieces×N."""
    count = len(of_piece)
    total = np.zeros((count, costs.shape[2]))
    _add_up(costs, pieces, total)
    mean = total / np.bincount(pieces.ravel(), minlength=count)[:, None]
    return np.maximum(mean - mean[np.arange(count), of_piece][:, None], 0.0)


@njit
def _add_up(costs, pieces, total):
    for i in range(costs.shape[0]):
        for j in range(costs.shape[1]):
            for k in range(costs.shape[2]):
                total[pieces[i, j], k] += costs[i, j, k]


@njit(parallel=True)
def _mean_steps(as_cells, as_pieces, pieces, logs, label, cell, sigma):
    """Mean distance of log depth from the chosen label's, over labels as likely as they are to the cell or its piece,
    whichever is more.
    """
    height, width = label.shape
    for i in prange(logs.shape[0]):
        for j in range(logs.shape[1]):
            by_piece = as_pieces[pieces[i, j]]
            last, found = -1, np.float32(0.0)
            for v in range(i * cell, min((i + 1) * cell, height)):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    if label[v, u] != last:
                        last = label[v, u]
                        found = _mean_step(as_cells[i, j], by_piece, logs[i, j], last)
                    sigma[v, u] = found


@njit
def _mean_step(by_cell, by_piece, log, chosen):
    cells, cell_steps = np.float32(0.0), np.float32(0.0)
    parts, part_steps = np.float32(0.0), np.float32(0.0)
    for k in range(log.size):
        step = abs(log[k] - log[chosen])
        if not step < _LARGEST_STEP:  # nor where one of them has no depth
            step = _LARGEST_STEP
        cells += by_cell[k]
        cell_steps += by_cell[k] * step
        parts += by_piece[k]
        part_steps += by_piece[k] * step
    return max(cell_steps / cells, part_steps / parts)
