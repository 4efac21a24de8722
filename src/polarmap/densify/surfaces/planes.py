"""Planes in two forms: in space, where views share them, and in a view's image, where they give inverse depth.

In space a plane is p = (α, β, γ) with p·X = 1, along its normal. In the image it is (q₀, q_u, q_v) with the inverse
depth q(u, v) = q₀ + q_u (u - c_u) + q_v (v - c_v), (c_u, c_v) the image's centre. Since q = α x + β y + γ in normalized
coordinates, each form is linear in the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.cells import middles_of
from polarmap.jit import njit

_LEAST_DISTANCE = 0.05  # of a plane from the new camera, as a share of that from the old one


class Candidates(NamedTuple):
    """Surfaces that may be what a view shows, planes first.

    planes: (q₀, q_u, q_v), float64 N×3, which are nowhere made into images. free: inverse depth of M others, float32
    M×H×W, 0 where one says nothing.
    """

    planes: np.ndarray
    free: np.ndarray

    @classmethod
    def of(cls, planes: np.ndarray, depths: Sequence[np.ndarray], shape: tuple[int, int]) -> Candidates:
        """Planes and depth maps, float32 H×W z, whose NaN and what is not positive say nothing."""
        free = np.zeros((len(depths), *shape), np.float32)
        for surface, depth in zip(free, depths, strict=True):
            known = np.isfinite(depth) & (depth > 0)
            np.divide(1.0, depth, out=surface, where=known, casting="same_kind")
        return cls(np.ascontiguousarray(planes, np.float64), free)

    def __len__(self) -> int:
        return len(self.planes) + len(self.free)

    @property
    def shape(self) -> tuple[int, int]:
        """Of the image."""
        return self.free.shape[1:]

    def middles(self, cell: int) -> np.ndarray:
        """Inverse depth in the middle of the cells, float32 rows×columns×(N+M). cell: side in pixels."""
        rows, columns = middles_of(self.shape, cell)
        values = np.empty((rows.size, columns.size, len(self)), np.float32)
        _middles(*self, rows, columns, values)
        return values


def evaluate_planes(
    planes: np.ndarray, shape: tuple[int, int], u: np.ndarray | None = None, v: np.ndarray | None = None
) -> np.ndarray:
    """Inverse depth of N planes at pixels u, v (arrays of one shape S), or at all pixels: float32 N×S or N×H×W."""
    if u is None or v is None:
        v, u = np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), indexing="ij")
    du, dv = u - 0.5 * (shape[1] - 1), v - 0.5 * (shape[0] - 1)
    values = np.empty((len(planes), *np.shape(du)), np.float32)
    for value, (q, qu, qv) in zip(values, planes, strict=True):
        value[:] = q + qu * du + qv * dv
    return values


@njit(inline="always")
def candidate_at(planes, free, k, v, u):
    """Inverse depth of surface k of `Candidates` at pixel (u, v)."""
    if k >= planes.shape[0]:
        return free[k - planes.shape[0], v, u]
    height, width = free.shape[1:]
    du, dv = u - 0.5 * (width - 1), v - 0.5 * (height - 1)
    return np.float32(planes[k, 0] + planes[k, 1] * du + planes[k, 2] * dv)


def in_image(planes: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """(q₀, q_u, q_v) of planes (α, β, γ) in the camera's frame, float64 N×3."""
    q_u, q_v = planes[:, 0] / camera.fx, planes[:, 1] / camera.fy
    d_u, d_v = _centre(camera)
    return np.stack([planes[:, 2] + q_u * d_u + q_v * d_v, q_u, q_v], axis=1)


def in_space(planes: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """(α, β, γ) in the camera's frame of planes (q₀, q_u, q_v), float64 N×3."""
    q, q_u, q_v = planes.T
    d_u, d_v = _centre(camera)
    return np.stack([q_u * camera.fx, q_v * camera.fy, q - q_u * d_u - q_v * d_v], axis=1)


def seen_from(planes: np.ndarray, T_other_this: np.ndarray) -> np.ndarray:
    """Planes (α, β, γ) of this frame in the other one, float64 N×3; less those that the other camera is on or behind.

    With X' = R X + t the plane p·X = 1 is R p·X' = 1 + R p·t.
    """
    turned = planes @ T_other_this[:3, :3].T
    scale = 1.0 + turned @ T_other_this[:3, 3]
    kept = scale > _LEAST_DISTANCE
    return turned[kept] / scale[kept, None]


@njit(parallel=True)
def _middles(planes, free, rows, columns, values):
    for i in prange(rows.size):
        for j in range(columns.size):
            for k in range(values.shape[2]):
                values[i, j, k] = candidate_at(planes, free, k, rows[i], columns[j])


def _centre(camera: PinholeCamera) -> tuple[float, float]:
    """Of the image, from the principal point."""
    return 0.5 * (camera.width - 1) - camera.cx, 0.5 * (camera.height - 1) - camera.cy
