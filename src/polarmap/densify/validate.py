"""Which spread depths contradict what other keyframes saw."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np
from numba import prange

from polarmap.data.view import Neighbour
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.warp import relative_motion, transfer_depth
from polarmap.jit import FAST_MATH, njit


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


def contradicted(
    depth: np.ndarray,
    image: np.ndarray,
    others: Sequence[Neighbour],
    camera: PinholeCamera,
    difference: float,
    disagreement: float,
) -> np.ndarray:
    """Points that look different in every other view, or whose depth differs from that of one, bool H×W.

    `contradicts_intensity` of local means by more than `difference`, and `contradicts_depth` by more than the share
    `disagreement` of the depth, for all views at once. image: sqrt(intensity), float32 H×W, as the others have it.
    """
    least, differs = np.full(depth.shape, np.inf, np.float32), np.zeros(depth.shape, bool)
    mean = local_mean(image)
    for other in others:
        known = np.zeros((0, 0), np.float32) if other.depth is None else other.depth
        motion = relative_motion(camera, other.T_other_this)
        _compare(depth, mean, local_mean(other.image), known, *motion, np.float32(disagreement), least, differs)
    return (np.isfinite(least) & (least > difference)) | differs


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


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _compare(depth, image, other, other_depth, M, b, disagreement, least, differs):
    """Both of one view, by one projection. other_depth: empty where it is not known."""
    height, width = depth.shape
    m00, m01, m02, m10, m11, m12 = M[0, 0], M[0, 1], M[0, 2], M[1, 0], M[1, 1], M[1, 2]
    m20, m21, m22, b0, b1, b2 = M[2, 0], M[2, 1], M[2, 2], b[0], b[1], b[2]
    zero, half, deep = np.float32(0.0), np.float32(0.5), other_depth.size > 0
    right, bottom = np.float32(width - 1), np.float32(height - 1)
    for v in prange(height):
        row = np.float32(v)
        x0, y0, w0 = m01 * row + m02, m11 * row + m12, m21 * row + m22
        for u in range(width):
            z, column = depth[v, u], np.float32(u)
            w = z * (m20 * column + w0) + b2
            scale = np.float32(1.0) / w
            x, y = (z * (m00 * column + x0) + b0) * scale, (z * (m10 * column + y0) + b1) * scale
            if not (z > zero and w > zero and x >= zero and y >= zero and x < right and y < bottom):
                continue
            if deep and abs(w - other_depth[np.int32(y + half), np.int32(x + half)]) > disagreement * z:
                differs[v, u] = True
            i, j = np.int32(x), np.int32(y)
            fx, fy = x - np.float32(i), y - np.float32(j)
            above = other[j, i] + fx * (other[j, i + 1] - other[j, i])
            below = other[j + 1, i] + fx * (other[j + 1, i + 1] - other[j + 1, i])
            least[v, u] = min(least[v, u], abs(above + fy * (below - above) - image[v, u]))
