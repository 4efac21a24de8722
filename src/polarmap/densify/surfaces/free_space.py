"""What other views see through: a surface cannot stand between their cameras and the points that they see.

A bare surface says nothing of its own depth. But where it would hide, in another view, points that this view's stereo
has matched behind it, it is not there. That tells a wall from a nearer plane that outlines of things lie on by chance.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import prange

from polarmap.data.view import Neighbour
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit

_BEHIND = np.float32(1.04)  # depth of a point over that of the surface, from which it is behind it
_REACH = 1  # pixels about a projection, all of whose points must be behind


def hidden_points(
    surfaces: np.ndarray, neighbours: Sequence[Neighbour], camera: PinholeCamera, cell: int
) -> np.ndarray:
    """In how many other views each surface would hide points of stereo, cell by cell, float32 rows×columns×N.

    surfaces: inverse depth in the middle of the cells, float32 N×rows×columns, not positive where there is none.
    neighbours: those that were not mapped are passed over. cell: side in pixels.
    """
    count, rows, columns = surfaces.shape
    hidden = np.zeros((rows, columns, count), np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    for other in neighbours:
        if other.seen is not None:
            T = np.ascontiguousarray(other.T_other_this[:3], np.float32)
            _count_hidden(surfaces, other.seen, T, intrinsics, cell, hidden)
    return hidden


@njit(parallel=True)
def _count_hidden(surfaces, depth, T, intrinsics, cell, hidden):
    """Add 1 where the nearest point of the other view around a projection is behind the surface."""
    count, rows, columns = surfaces.shape
    height, width = depth.shape
    fx, fy, cx, cy = intrinsics
    for i in prange(rows):
        for j in range(columns):
            x = (np.float32(min(j * cell + cell // 2, width - 1)) - cx) / fx
            y = (np.float32(min(i * cell + cell // 2, height - 1)) - cy) / fy
            for k in range(count):
                q = surfaces[k, i, j]
                if not q > 0:
                    continue
                X = T[0, 0] * x + T[0, 1] * y + T[0, 2] + T[0, 3] * q
                Y = T[1, 0] * x + T[1, 1] * y + T[1, 2] + T[1, 3] * q
                Z = T[2, 0] * x + T[2, 1] * y + T[2, 2] + T[2, 3] * q
                if not Z > 0:
                    continue
                u = int(np.rint(fx * X / Z + cx))
                v = int(np.rint(fy * Y / Z + cy))
                if u < _REACH or v < _REACH or u >= width - _REACH or v >= height - _REACH:
                    continue
                nearest = np.float32(np.inf)
                for b in range(v - _REACH, v + _REACH + 1):
                    for a in range(u - _REACH, u + _REACH + 1):
                        if depth[b, a] > 0:
                            nearest = min(nearest, depth[b, a])
                if nearest < np.inf and nearest * q > _BEHIND * Z:
                    hidden[i, j, k] += np.float32(1.0)
