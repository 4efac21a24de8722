"""Depth, range, normals, and what a polarizer pixel sees of them.

With x = (x, y) normalized coordinates, n the normal and w = ln r the log range, the plane of incidence cuts the
image plane along d = n_xy - n_z x, and d ∝ M ∇w with M = I + x xᵀ, tan²θ = (1+|x|²) ∇wᵀ M ∇w.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit


def range_factor(camera: PinholeCamera) -> np.ndarray:
    """sqrt(1 + x² + y²), the ratio of range to depth, float32 H×W."""
    xy = camera.normalized()
    return np.sqrt(1.0 + xy[..., 0] ** 2 + xy[..., 1] ** 2)


def normals_from_depth(
    depth: np.ndarray,
    camera: PinholeCamera,
    radius: int = 1,
    stride: int = 1,
    max_slope: float = 0.02,
    max_step: float = 0.05,
    where: np.ndarray | None = None,
) -> np.ndarray:
    """Unit normals toward the camera, float32 H×W×3, NaN where too few neighbours are known.

    where: bool H×W, the pixels whose normals are wanted, all by default; NaN elsewhere.

    On a plane αX + βY + γZ = 1 inverse depth is αx + βy + γ, so a least squares fit of inverse depth to the
    (2 radius + 1)² neighbours that lie `stride` pixels apart gives planes exactly. Neighbours whose inverse depth
    differs by more than the share `max_slope` per pixel of distance, or `max_step`, belong to another surface.
    """
    rows, columns = (np.arange(size) for size in depth.shape)
    where = np.ones(depth.shape, bool) if where is None else where
    return _normals_of(depth, camera, rows, columns, where, radius, stride, max_slope, max_step)


def normals_at(
    depth: np.ndarray,
    camera: PinholeCamera,
    rows: np.ndarray,
    columns: np.ndarray,
    radius: int = 1,
    stride: int = 1,
    max_slope: float = 0.02,
    max_step: float = 0.05,
) -> np.ndarray:
    """`normals_from_depth` in these rows and columns alone, float32 R×C×3. rows, columns: integers R and C."""
    everywhere = np.ones((len(rows), len(columns)), bool)
    return _normals_of(depth, camera, rows, columns, everywhere, radius, stride, max_slope, max_step)


def _normals_of(depth, camera, rows, columns, where, radius, stride, max_slope, max_step) -> np.ndarray:
    normals = np.empty((len(rows), len(columns), 3), np.float32)
    q = (1.0 / depth).astype(np.float32)
    limits = np.float32(max_slope), np.float32(max_step)
    lens = camera.normalized(), np.float32(camera.fx), np.float32(camera.fy)
    _normals(q, *lens, rows, columns, where, radius, stride, *limits, normals)
    return normals


@njit
def _plane_slopes(q, v, u, radius, stride, max_slope, max_step):
    """Slopes along u and v of the plane through q(u, v) that fits the known neighbours; NaN where none does."""
    height, width = q.shape
    here = q[v, u]
    uu = np.float32(0.0)
    uv = np.float32(0.0)
    vv = np.float32(0.0)
    uq = np.float32(0.0)
    vq = np.float32(0.0)
    for dj in range(-radius, radius + 1):
        j = v + dj * stride
        if j < 0 or j >= height:
            continue
        for di in range(-radius, radius + 1):
            i = u + di * stride
            if i < 0 or i >= width:
                continue
            du = np.float32(i - u)
            dv = np.float32(j - v)
            step = q[j, i] - here
            if abs(step) <= here * min(max_slope * (abs(du) + abs(dv)), max_step):
                uu += du * du
                uv += du * dv
                vv += dv * dv
                uq += du * step
                vq += dv * step
    determinant = uu * vv - uv * uv
    if not determinant > np.float32(0.1):
        return np.float32(np.nan), np.float32(np.nan)
    return (vv * uq - uv * vq) / determinant, (uu * vq - uv * uq) / determinant


@njit(parallel=True)
def _normals(q, xy, fx, fy, rows, columns, where, radius, stride, max_slope, max_step, normals):
    for i in prange(rows.size):
        for j in range(columns.size):
            if not where[i, j]:
                normals[i, j] = np.nan
                continue
            v, u = rows[i], columns[j]
            slope_u, slope_v = _plane_slopes(q, v, u, radius, stride, max_slope, max_step)
            alpha = slope_u * fx
            beta = slope_v * fy
            gamma = q[v, u] - alpha * xy[v, u, 0] - beta * xy[v, u, 1]
            length = np.sqrt(alpha * alpha + beta * beta + gamma * gamma)
            normals[i, j, 0] = -alpha / length
            normals[i, j, 1] = -beta / length
            normals[i, j, 2] = -gamma / length


def incidence_direction(normals: np.ndarray, camera: PinholeCamera, orthographic: bool = False) -> np.ndarray:
    """d, where the plane of incidence cuts the image plane, float32 H×W×2; its angle is the azimuth.

    d = n_xy - n_z x under perspective, n_xy under an orthographic camera.
    """
    d = normals[..., :2]
    if orthographic:
        return np.ascontiguousarray(d)
    return d - normals[..., 2:] * camera.normalized()


def zenith_of(normals: np.ndarray, camera: PinholeCamera, orthographic: bool = False) -> np.ndarray:
    """Angle between the normal and the direction to the camera, float32 H×W radians in [0, π/2]."""
    towards = -normals[..., 2] if orthographic else -np.einsum("hwc,hwc->hw", normals, camera.rays())
    return np.arccos(np.clip(towards, 0.0, 1.0))


def normals_from_cues(
    azimuth: np.ndarray, zenith: np.ndarray, camera: PinholeCamera, orthographic: bool = False
) -> np.ndarray:
    """Unit normals toward the camera from azimuth and zenith, float32 H×W×3, NaN where a cue is NaN.

    n = cos θ (-v) + sin θ m, m the unit vector of the plane of incidence that is perpendicular to the ray v
    and meets the image plane along the azimuth.
    """
    d = np.stack([np.cos(azimuth), np.sin(azimuth), np.zeros_like(azimuth)], axis=-1)
    v = np.broadcast_to(np.float32([0.0, 0.0, 1.0]), d.shape) if orthographic else camera.rays()
    m = d - np.einsum("hwc,hwc->hw", d, v)[..., None] * v
    m /= np.linalg.norm(m, axis=-1, keepdims=True)
    return (np.sin(zenith)[..., None] * m - np.cos(zenith)[..., None] * v).astype(np.float32)


def log_range_gradient(
    azimuth: np.ndarray, zenith: np.ndarray, camera: PinholeCamera, orthographic: bool = False
) -> np.ndarray:
    """∇w per pixel that the cues ask for, float32 H×W×2 (along u, along v).

    Under perspective w is the log range: ∇w = M⁻¹ d̂ tan θ / sqrt((1+|x|²) d̂ᵀM⁻¹d̂). The orthographic option
    follows the paper, w the log depth and ∇w = d̂ tan θ.
    """
    d = np.stack([np.cos(azimuth), np.sin(azimuth)], axis=-1)
    tangent = np.tan(np.minimum(zenith, np.float32(1.5)))
    if orthographic:
        gradient = d * tangent[..., None]
    else:
        xy = camera.normalized()
        x2 = np.einsum("hwc,hwc->hw", xy, xy)
        along = np.einsum("hwc,hwc->hw", d, xy)
        inverse_d = d - xy * (along / (1.0 + x2))[..., None]  # M⁻¹ d by Sherman and Morrison
        metric = np.einsum("hwc,hwc->hw", d, inverse_d)
        gradient = inverse_d * (tangent / np.sqrt((1.0 + x2) * metric))[..., None]
    return (gradient / np.float32([camera.fx, camera.fy])).astype(np.float32)
