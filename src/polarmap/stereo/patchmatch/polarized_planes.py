"""How well the polarization of a pixel fits a plane that stereo tries there.

A plane's normal says along which line through the origin (S1, S2)/S0 lies: diffuse light on one side of it, specular on
the other, mixed light between (densification has the same for whole cells). Only the distance from that
line counts, so that no decision between the two is needed, and weakly polarized light says little.
"""

from __future__ import annotations

import cv2
import numpy as np
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.jit import FAST_MATH, njit

_WINDOW = 5  # pixels, over which polarization is averaged
_INDEPENDENT = 6.0  # measurements in it; demosaicing ties neighbours together
_SYSTEMATIC = 0.015  # of (S1, S2)/S0, by light that was polarized before
_CAP = np.float32(4.0)  # squared standard deviations
_f32 = np.float32


def polarization_field(image: PolarizationImage | None, shape: tuple[int, int]) -> np.ndarray:
    """(S1, S2)/S0 and the inverse of its variance, float32 H×W×3.

    Zeros, which fit every plane, where the image is None or cannot be used.
    """
    if image is None:
        return np.zeros((*shape, 3), np.float32)
    size = (_WINDOW, _WINDOW)
    stokes = [cv2.blur(image.dolp * turn(2.0 * image.aolp), size) for turn in (np.cos, np.sin)]
    variance = cv2.blur(image.sigma_dolp**2, size) / _INDEPENDENT + np.float32(_SYSTEMATIC**2)
    field = np.stack([*stokes, 1.0 / variance], axis=-1).astype(np.float32)
    field[cv2.erode(image.usable.astype(np.uint8), np.ones(size, np.uint8)) == 0] = 0.0
    return field


@njit(fastmath=FAST_MATH)
def plane_misfit(q, gu, gv, u, v, intrinsics, field):
    """Squared distance of the pixel's polarization from what the plane allows, in its variance, at most 4.

    q, gu, gv: inverse depth and its gradient, see `PlaneField`. intrinsics: fx, fy, cx, cy. field: of
    `polarization_field`.
    """
    s1, s2, precision = field[v, u, 0], field[v, u, 1], field[v, u, 2]
    if precision == _f32(0.0):
        return _f32(0.0)
    x = (_f32(u) - intrinsics[2]) / intrinsics[0]
    y = (_f32(v) - intrinsics[3]) / intrinsics[1]
    nx, ny = gu * intrinsics[0], gv * intrinsics[1]
    nz = q - nx * x - ny * y
    dx, dy = nx - nz * x, ny - nz * y  # the plane of incidence in the image
    radial = (dx * x + dy * y) / (_f32(1.0) + x * x + y * y)
    gx, gy = dx - radial * x, dy - radial * y  # the gradient of log range, which specular light is perpendicular to
    diffuse = max(_along(s1, s2, dx, dy), _f32(0.0))
    specular = max(-_along(s1, s2, gx, gy), _f32(0.0))
    nearest = max(diffuse, specular)
    return min((s1 * s1 + s2 * s2 - nearest * nearest) * precision, _CAP)


@njit(fastmath=FAST_MATH)
def _along(s1, s2, x, y):
    """Component of (S1, S2) along the doubled angle of a direction."""
    return (s1 * (x * x - y * y) + s2 * _f32(2.0) * x * y) / max(x * x + y * y, _f32(1e-20))


@njit(parallel=True)
def take_off(cost, weight, q, gu, gv, intrinsics, field, stride):
    """Subtract `weight` times each pixel's misfit from its cost, in place. stride: of the pixels that have planes."""
    for v in prange(cost.shape[0]):
        for u in range(cost.shape[1]):
            cost[v, u] -= weight * plane_misfit(q[v, u], gu[v, u], gv[v, u], u * stride, v * stride, intrinsics, field)
