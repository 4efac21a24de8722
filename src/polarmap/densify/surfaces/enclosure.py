"""What no sight line passes: planes that all points of a view lie on or before.

A room's floor has no points behind it, anywhere in the view. Where it has points on all sides of a bare area, the floor
is there, and a label that lies behind it would need a hole. Without this a bare floor is given to the wall that it
meets: both have the points of the edge between them, and no other.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from polarmap.jit import njit

_CLOSE = 0.01  # relative error of inverse depth at which a point is on a plane
_BEHIND = 0.05  # by which a point is behind it
_MOST_BEHIND = 0.02  # share of all points that may be, since some are always wrong
_POINTS = 20_000
_LEAST_CELLS = 30  # with points on the plane
_NEIGHBOURHOOD = 7  # cells, the side of the square in which a tenth must have such points, too
_LEAST_DENSITY = 0.1
_STEP = (0.03, 0.08)  # of log inverse depth, over which a label comes to be behind


def behind_enclosure(
    middles: np.ndarray,
    planes: np.ndarray,
    inverse_depth: np.ndarray,
    reliability: np.ndarray,
    mirrored: np.ndarray,
    cell: int,
) -> np.ndarray:
    """How far each surface is behind what encloses the view in each cell, in [0, 1], float32 rows×columns×N.

    middles: inverse depth of N surfaces in the middle of the cells, float32 rows×columns×N; the first ones are `planes`
    (q₀, q_u, q_v), float64 M×3. inverse_depth, reliability: points, float32 H×W, NaN and 0 where there is none.
    mirrored: bool H×W, where points may be pictures in a mirror. cell: side of a cell in pixels.

    A plane encloses the convex hull of the cells that have points on it, if no points of the view are behind it but
    mirrored ones.
    """
    rows, columns, _ = middles.shape
    v, u = np.nonzero(reliability > 0)
    thinned = slice(None, None, u.size // _POINTS + 1)
    v, u = v[thinned], u[thinned]
    q, weight = inverse_depth[v, u], reliability[v, u]
    solid = np.where(mirrored[v, u], np.float32(0.0), weight)
    cells = (v // cell) * columns + u // cell
    all_points = np.bincount(cells, weight, rows * columns).reshape(rows, columns)
    nearest = np.zeros((rows, columns), np.float32)
    least_behind = _MOST_BEHIND * float(solid.sum(dtype=np.float64))
    du, dv = u - 0.5 * (inverse_depth.shape[1] - 1), v - 0.5 * (inverse_depth.shape[0] - 1)
    for k, plane in enumerate(np.asarray(planes, np.float64)):
        on_plane = np.zeros(rows * columns)
        if _points_behind(plane, du, dv, q, weight, solid, cells, on_plane) <= least_behind:
            enclosed = _hull(on_plane.reshape(rows, columns), all_points)
            nearest = np.maximum(nearest, np.where(enclosed, middles[..., k], np.float32(0.0)))
    behind = np.zeros(middles.shape, np.float32)
    _shares_behind(middles, nearest, behind)
    return behind


@njit
def _points_behind(plane, du, dv, q, weight, solid, cells, on_plane):
    """Weight of the points that are behind a plane; adds that of those on it to their cells."""
    total = 0.0
    for k in range(q.size):
        ratio = (plane[0] + plane[1] * du[k] + plane[2] * dv[k]) / q[k]
        if (1.0 - _BEHIND) * ratio > 1.0:
            total += solid[k]
        elif abs(ratio - 1.0) < _CLOSE:
            on_plane[cells[k]] += weight[k]
    return total


@njit(parallel=True, error_model="numpy")
def _shares_behind(middles, nearest, behind):
    low, width = np.float32(_STEP[0]), np.float32(_STEP[1] - _STEP[0])
    for i in prange(middles.shape[0]):
        for j in range(middles.shape[1]):
            if not nearest[i, j] > 0:
                continue
            farthest = np.float32(1e-3) * nearest[i, j]
            for k in range(middles.shape[2]):
                step = np.log(nearest[i, j] / max(middles[i, j, k], farthest))
                behind[i, j, k] = min(max((step - low) / width, np.float32(0.0)), np.float32(1.0))


def _hull(on_plane: np.ndarray, all_points: np.ndarray) -> np.ndarray:
    """Convex hull of the cells most of whose points are on the plane, in company of other such cells, bool."""
    of_plane = (on_plane > 0.5 * all_points) & (on_plane > 0)
    density = cv2.blur(of_plane.astype(np.float32), (_NEIGHBOURHOOD, _NEIGHBOURHOOD))
    cells = np.argwhere(of_plane & (density > _LEAST_DENSITY))[:, ::-1].astype(np.int32)
    region = np.zeros(on_plane.shape, np.uint8)
    if len(cells) >= _LEAST_CELLS:
        cv2.fillConvexPoly(region, cv2.convexHull(cells), 1)
    return region > 0
