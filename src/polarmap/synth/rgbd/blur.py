"""Motion blur of an RGB-D frame: its Stokes vectors averaged over views from where the camera was meanwhile."""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.geometry.warp import relative_motion, warp_depth
from polarmap.jit import njit


def blurred(
    stokes: np.ndarray, depth: np.ndarray, camera: PinholeCamera, T_world_camera: np.ndarray, poses: np.ndarray
) -> np.ndarray:
    """Stokes vectors, float32 3×H×W, averaged over the views from `poses` (T_world_camera, N×4×4).

    stokes, depth: of the view from `T_world_camera`, which each view samples through its own depth, warped there. What
    the frame does not show (beyond its border, behind its surfaces) is taken from where the pixel itself lies in it.
    The frame's axes stand for those of all views: within a shutter's time the camera rolls by little.
    """
    total = np.zeros_like(stokes)
    for T_world_view in poses:
        T_frame_view = inverse(T_world_camera) @ T_world_view
        warped = warp_depth(depth, camera, inverse(T_frame_view))
        _add_view(stokes, np.where(np.isfinite(warped), warped, depth), *relative_motion(camera, T_frame_view), total)
    return total / np.float32(len(poses))


@njit(parallel=True)
def _add_view(stokes, depth, M, b, total):
    height, width = depth.shape
    for v in prange(height):
        for u in range(width):
            x, y = _source(depth[v, u], u, v, M, b)
            if not (x == x and y == y):
                x, y = float(u), float(v)
            x, y = min(max(x, 0.0), width - 1.0), min(max(y, 0.0), height - 1.0)
            i, j = min(int(x), width - 2), min(int(y), height - 2)
            p, q = np.float32(x - i), np.float32(y - j)
            for k in range(3):
                top = stokes[k, j, i] + p * (stokes[k, j, i + 1] - stokes[k, j, i])
                bottom = stokes[k, j + 1, i] + p * (stokes[k, j + 1, i + 1] - stokes[k, j + 1, i])
                total[k, v, u] += top + q * (bottom - top)


@njit(error_model="numpy")
def _source(z, u, v, M, b):
    """Where in the frame a view's pixel at depth z lies; an unknown depth is far away."""
    far = not z > 0
    scale = 1.0 if far else float(z)
    shift = 0.0 if far else 1.0
    w = scale * (M[2, 0] * u + M[2, 1] * v + M[2, 2]) + shift * b[2]
    if not w > 0:
        return np.nan, np.nan
    x = (scale * (M[0, 0] * u + M[0, 1] * v + M[0, 2]) + shift * b[0]) / w
    y = (scale * (M[1, 0] * u + M[1, 1] * v + M[1, 2]) + shift * b[1]) / w
    return x, y
