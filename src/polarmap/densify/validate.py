"""Which spread depths contradict what other keyframes saw."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.warp import relative_motion, transfer_depth
from polarmap.jit import njit


def contradicts_depth(
    depth: np.ndarray,
    other_depth: np.ndarray,
    camera: PinholeCamera,
    T_other_this: np.ndarray,
    tolerance: np.ndarray | float,
) -> np.ndarray:
    """Points whose depth in another keyframe differs by more than `tolerance` from its map, bool H×W.

    The paper's two-view check (Section III-C); points that the other map does not know are not contradicted.
    """
    expected, found = transfer_depth(depth, other_depth, camera, T_other_this)
    return np.abs(expected - found) > tolerance


def contradicts_intensity(
    depth: np.ndarray,
    image: np.ndarray,
    others: Sequence[tuple[np.ndarray, np.ndarray]],
    camera: PinholeCamera,
    tolerance: float,
) -> np.ndarray:
    """Points that look different, by more than `tolerance`, in every other view that they fall into, bool H×W.

    image: float32 H×W, a `local_mean`. others: (image, T_other_this) pairs. A bare wall has no texture to match, but
    depth that leaks onto it from an object lands on something else.
    """
    least = np.full(depth.shape, np.inf, np.float32)
    for other, T_other_this in others:
        _least_difference(depth, image, other, *relative_motion(camera, T_other_this), least)
    return np.isfinite(least) & (least > tolerance)


def local_mean(image: np.ndarray) -> np.ndarray:
    """Means of 3×3 pixels, float32 H×W: what `contradicts_intensity` compares, less noisy than single pixels."""
    return cv2.blur(image, (3, 3))


@njit(parallel=True)
def _least_difference(depth, image, other, M, b, least):
    height, width = depth.shape
    for v in prange(height):
        for u in range(width):
            z = depth[v, u]
            if not z > 0:
                continue
            w = z * (M[2, 0] * u + M[2, 1] * v + M[2, 2]) + b[2]
            if w <= 0:
                continue
            x = (z * (M[0, 0] * u + M[0, 1] * v + M[0, 2]) + b[0]) / w
            y = (z * (M[1, 0] * u + M[1, 1] * v + M[1, 2]) + b[1]) / w
            if x < 0 or y < 0 or x >= width - 1 or y >= height - 1:
                continue
            i = np.int64(x)
            j = np.int64(y)
            fx = np.float32(x - i)
            fy = np.float32(y - j)
            above = other[j, i] + fx * (other[j, i + 1] - other[j, i])
            below = other[j + 1, i] + fx * (other[j + 1, i + 1] - other[j + 1, i])
            least[v, u] = min(least[v, u], abs(above + fy * (below - above) - image[v, u]))
