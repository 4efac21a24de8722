"""What other views see through: a surface cannot stand between their cameras and the points that they see.

A bare surface says nothing of its own depth. But where it would hide, in another view, points that this view's stereo
has matched behind it, it is not there. That tells a wall from a nearer plane that outlines of things lie on by chance:
most clearly from views far apart, for which that plane stands in the middle of things.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numba import prange

from polarmap.data.view import SEEN_BLOCK, Sighting
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import FAST_MATH, njit

_BEHIND = np.float32(1.04)  # depth of a point over that of the surface, from which it is behind it


def hidden_points(surfaces: np.ndarray, sightings: Sequence[Sighting], camera: PinholeCamera, cell: int) -> np.ndarray:
    """In how many other views each surface would hide points of stereo, cell by cell, float32 rows×columns×N.

    surfaces: inverse depth in the middle of the cells, float32 rows×columns×N, not positive where there is none.
    cell: side in pixels.
    """
    hidden = np.zeros(surfaces.shape, np.float32)
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32)
    size = np.array(camera.shape)
    for other in sightings:
        T = np.ascontiguousarray(other.T_other_this[:3], np.float32)
        _count_hidden(surfaces, other.nearest, T, intrinsics, size, cell, hidden)
    return hidden


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _count_hidden(surfaces, nearest, T, intrinsics, size, cell, hidden):
    """Add 1 where the nearest point of the other view in the block of a projection is behind the surface."""
    rows, columns, count = surfaces.shape
    height, width = size
    fx, fy, cx, cy = intrinsics
    zero, half, one = np.float32(0.0), np.float32(0.5), np.float32(1.0)
    right, bottom = np.float32(width) - half, np.float32(height) - half
    shift_x, shift_y, shift_z = fx * T[0, 3], fy * T[1, 3], T[2, 3]
    for i in prange(rows):
        for j in range(columns):
            x = (np.float32(min(j * cell + cell // 2, width - 1)) - cx) / fx
            y = (np.float32(min(i * cell + cell // 2, height - 1)) - cy) / fy
            X0 = fx * (T[0, 0] * x + T[0, 1] * y + T[0, 2])
            Y0 = fy * (T[1, 0] * x + T[1, 1] * y + T[1, 2])
            Z0 = T[2, 0] * x + T[2, 1] * y + T[2, 2]
            for k in range(count):
                q = surfaces[i, j, k]
                Z = Z0 + shift_z * q
                scale, before = one / Z, min(q, Z) > zero
                u, v = (X0 + shift_x * q) * scale + cx, (Y0 + shift_y * q) * scale + cy
                if before and u > -half and v > -half and u < right and v < bottom:
                    seen = nearest[np.uint32(v + half) // SEEN_BLOCK, np.uint32(u + half) // SEEN_BLOCK]
                    if seen * q > _BEHIND * Z:
                        hidden[i, j, k] += one
