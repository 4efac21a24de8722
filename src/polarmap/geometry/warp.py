"""Carry depth between posed views."""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit


def relative_motion(camera: PinholeCamera, T_target_source: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """M = K R K⁻¹ and b = K t, float32: pixel p at depth z goes to z·M p + b (homogeneous)."""
    K = camera.matrix
    M = K @ T_target_source[:3, :3] @ np.linalg.inv(K)
    return M.astype(np.float32), (K @ T_target_source[:3, 3]).astype(np.float32)


def transfer_depth(
    depth: np.ndarray, other_depth: np.ndarray, camera: PinholeCamera, T_other_this: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """What another view's depth map says where this view's points fall.

    depth, other_depth: float32 H×W, NaN where unknown. T_other_this: 4×4.
    Returns (expected, found), float32 H×W: the depth each point of this view has in the other camera, and the
    depth stored there at the nearest pixel; NaN where either is unknown or the point falls outside.
    """
    expected = np.empty_like(depth)
    found = np.empty_like(depth)
    _transfer(depth, other_depth, *relative_motion(camera, T_other_this), expected, found)
    return expected, found


@njit(parallel=True)
def _transfer(depth, other, M, b, expected, found):
    height, width = depth.shape
    for v in prange(height):
        for u in range(width):
            expected[v, u] = np.nan
            found[v, u] = np.nan
            z = depth[v, u]
            if not z > 0:
                continue
            w = z * (M[2, 0] * u + M[2, 1] * v + M[2, 2]) + b[2]
            if w <= 0:
                continue
            x = np.int64(np.floor((z * (M[0, 0] * u + M[0, 1] * v + M[0, 2]) + b[0]) / w + np.float32(0.5)))
            y = np.int64(np.floor((z * (M[1, 0] * u + M[1, 1] * v + M[1, 2]) + b[1]) / w + np.float32(0.5)))
            if x < 0 or y < 0 or x >= width or y >= height:
                continue
            expected[v, u] = w
            found[v, u] = other[y, x]


def warp_depth(depth: np.ndarray, camera: PinholeCamera, T_target_source: np.ndarray) -> np.ndarray:
    """The depth map as the target view sees it: points splatted to 2×2 pixels, the nearest one kept.

    depth: float32 H×W, NaN where unknown. Returns float32 H×W, NaN where no point falls.
    """
    warped = np.full(camera.shape, np.inf, np.float32)
    _splat(depth, *relative_motion(camera, T_target_source), warped)
    warped[np.isinf(warped)] = np.nan
    return warped


@njit
def _splat(depth, M, b, warped):
    height, width = depth.shape
    for v in range(height):
        for u in range(width):
            z = depth[v, u]
            if not z > 0:
                continue
            w = z * (M[2, 0] * u + M[2, 1] * v + M[2, 2]) + b[2]
            if w <= 0:
                continue
            x = np.int64(np.floor((z * (M[0, 0] * u + M[0, 1] * v + M[0, 2]) + b[0]) / w))
            y = np.int64(np.floor((z * (M[1, 0] * u + M[1, 1] * v + M[1, 2]) + b[1]) / w))
            for j in range(max(y, 0), min(y + 2, height)):
                for i in range(max(x, 0), min(x + 2, width)):
                    warped[j, i] = min(warped[j, i], w)
