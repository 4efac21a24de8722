"""How uncertain the depth of chosen surfaces is: by what else could be there, and by the surfaces themselves.

Belief propagation carries a decision over a whole bare wall, and with it far more certainty than there is: what a
network expects of a wall, or what an outline beside it suggests, is one opinion, not one for each cell. So the costs of
a connected piece are averaged, and count as a few independent ones.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from polarmap.jit import njit

_TEMPERATURE = np.float32(8.0)  # belief by which another label is e times less likely
_LARGEST_STEP = np.float32(0.5)  # of log depth
_OPINIONS = 1.5  # independent errors that the mean cost of a piece stands for
_SHARE = np.float32(0.6)  # of the mean step that is a standard deviation: two thirds of the errors are to be below it
_PLANE_SIGMA = (0.5, 3.0)  # of a plane on its points, and what is added beside them, in deviations of a point
_FREE_SIGMA = np.float32(0.01)  # relative, of a free surface on points
_FREE_DRIFT = np.float32(3.2)  # likewise, per image diagonal from them
_NEAR_POINTS = 3.0  # pixels in which a plane's deviation rises


def undecided_sigma(costs: np.ndarray, beliefs: np.ndarray, surfaces: np.ndarray, label: np.ndarray, cell: int):
    """Relative standard deviation of every pixel's depth by the other surfaces that may be there, float32 H×W.

    costs, beliefs: of cells, float32 rows×columns×N (see `label_cells`). surfaces: inverse depth, float32 N×H×W.
    label: which surface was chosen, int16 H×W. cell: side in pixels.
    """
    spread = np.empty(label.shape, np.float32)
    _spread_of_beliefs(beliefs, surfaces, label, cell, spread)
    pieces, of_piece = _pieces(beliefs.argmin(axis=2))
    likelihood = np.exp(-_OPINIONS * _excess(costs, pieces, of_piece)).astype(np.float32)
    whole = np.empty(label.shape, np.float32)
    _spread_of_pieces(likelihood, pieces, surfaces, label, cell, whole)
    return _SHARE * np.maximum(spread, whole)


def surface_sigma(distance: np.ndarray, planar: np.ndarray, point_sigma: float) -> np.ndarray:
    """Relative standard deviation of the depth of a surface that is the right one, float32 H×W.

    distance: in pixels from the nearest point on it. planar: bool H×W. point_sigma: relative standard deviation of a
    point by noise. A plane is known by all its points, a free surface by those around alone.
    """
    on, beside = _PLANE_SIGMA
    plane = point_sigma * (on + beside * (1.0 - np.exp(-distance / np.float32(_NEAR_POINTS))))
    drift = _FREE_DRIFT / np.float32(np.hypot(*distance.shape))
    return np.where(planar, plane, np.hypot(_FREE_SIGMA, drift * distance)).astype(np.float32)


def _pieces(best: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of each cell's connected piece of one label, int32 rows×columns, and the pieces' labels."""
    pieces, of_piece = np.zeros(best.shape, np.int32), []
    for label in np.unique(best):
        count, numbers = cv2.connectedComponents((best == label).astype(np.uint8), connectivity=4)
        pieces += np.where(numbers > 0, numbers - 1 + len(of_piece), 0).astype(np.int32)
        of_piece += [label] * (count - 1)
    return pieces, np.array(of_piece)


def _excess(costs: np.ndarray, pieces: np.ndarray, of_piece: np.ndarray) -> np.ndarray:
    """By how much a label's mean cost over each piece exceeds that of the piece's own, not negative, pieces×N."""
    index, count = pieces.ravel(), len(of_piece)
    flat = costs.reshape(index.size, -1)
    total = np.stack([np.bincount(index, weights=cost, minlength=count) for cost in flat.T], axis=1)
    mean = total / np.bincount(index, minlength=count)[:, None]
    return np.maximum(mean - mean[np.arange(count), of_piece][:, None], 0.0)


@njit
def _step(q, chosen):
    """Difference of log depth between inverse depths, capped, also where there is none."""
    return min(abs(np.log(q / chosen)), _LARGEST_STEP) if q > 0 and chosen > 0 else _LARGEST_STEP


@njit(parallel=True)
def _spread_of_beliefs(beliefs, surfaces, label, cell, spread):
    """Mean distance of log depth from the chosen label's, over labels as likely as their beliefs say."""
    height, width = label.shape
    for v in prange(height):
        for u in range(width):
            belief, chosen = beliefs[v // cell, u // cell], surfaces[label[v, u], v, u]
            total, steps = np.float32(0.0), np.float32(0.0)
            for k in range(beliefs.shape[2]):
                likelihood = np.exp(-belief[k] / _TEMPERATURE)
                total += likelihood
                steps += likelihood * _step(surfaces[k, v, u], chosen)
            spread[v, u] = steps / total


@njit(parallel=True)
def _spread_of_pieces(likelihood, pieces, surfaces, label, cell, spread):
    """The same, over labels as likely as the mean costs of the pixel's piece say."""
    height, width = label.shape
    for v in prange(height):
        for u in range(width):
            likely, chosen = likelihood[pieces[v // cell, u // cell]], surfaces[label[v, u], v, u]
            total, steps = np.float32(0.0), np.float32(0.0)
            for k in range(likely.size):
                total += likely[k]
                steps += likely[k] * _step(surfaces[k, v, u], chosen)
            spread[v, u] = steps / total
