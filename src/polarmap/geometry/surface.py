"""Depth, range, normals, and what a polarizer pixel sees of them.

With x = (x, y) normalized coordinates, n the normal and w = ln r the log range, the plane of incidence cuts the
image plane along d = n_xy - n_z x, and d ∝ M ∇w with M = I + x xᵀ, tan²θ = (1+|x|²) ∇wᵀ M ∇w.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import FAST_MATH, njit


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
    normals = np.full((*depth.shape, 3), np.nan, np.float32)
    where = np.ones(depth.shape, bool) if where is None else where
    q, *lens, allowed = _inverse_depth_and_limits(depth, camera, radius, stride, max_slope, max_step)
    _normals(q, *lens, where, radius, stride, allowed, normals)
    return normals


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
    normals = np.empty((len(rows), len(columns), 3), np.float32)
    q, *lens, allowed = _inverse_depth_and_limits(depth, camera, radius, stride, max_slope, max_step)
    _normals_at(q, *lens, rows, columns, radius, stride, allowed, normals)
    return normals


def _inverse_depth_and_limits(depth, camera, radius, stride, max_slope, max_step):
    """1/z, the lens, and the relative step to each neighbour up to which it is of the same surface."""
    away = np.abs(np.arange(-radius, radius + 1)) * stride
    allowed = np.minimum(max_slope * (away[:, None] + away), max_step).astype(np.float32)
    q = (1.0 / depth).astype(np.float32)
    return q, camera.normalized(), np.float32(camera.fx), np.float32(camera.fy), allowed


@njit(parallel=True)
def _normals_at(q, xy, fx, fy, rows, columns, radius, stride, allowed, normals):
    for i in prange(rows.size):
        for j in range(columns.size):
            v, u = rows[i], columns[j]
            moments = _moments(q, v, u, radius, stride, allowed)
            _normal(*moments, q[v, u], xy[v, u, 0], xy[v, u, 1], fx, fy, normals[i, j])


@njit(parallel=True)
def _normals(q, xy, fx, fy, where, radius, stride, allowed, normals):
    """Pixels well inside the image are summed up row by row, which compiles to vector instructions."""
    height, width = q.shape
    reach = radius * stride
    for v in prange(height):
        first, last = _ends(where[v])
        left, right = max(first, reach), min(last, width - reach)
        if v < reach or v + reach >= height or left >= right:
            left = right = last
        sums = np.zeros((5, max(right - left, 0)), np.float32)
        if sums.size:
            _moments_of_row(q, np.int64(v), left, right, radius, stride, allowed, sums)
        for u in range(first, last):
            if where[v, u]:
                x, y, out = xy[v, u, 0], xy[v, u, 1], normals[v, u]
                if left <= u < right:
                    k = u - left
                    _normal(sums[0, k], sums[1, k], sums[2, k], sums[3, k], sums[4, k], q[v, u], x, y, fx, fy, out)
                else:
                    _normal(*_moments(q, np.int64(v), u, radius, stride, allowed), q[v, u], x, y, fx, fy, out)


@njit
def _ends(wanted):
    """The first of a row that is wanted, and the one after the last."""
    first, last = 0, wanted.size
    while first < last and not wanted[first]:
        first += 1
    while first < last and not wanted[last - 1]:
        last -= 1
    return first, last


@njit(fastmath=FAST_MATH)
def _moments_of_row(q, v, left, right, radius, stride, allowed, sums):
    """`_moments` of all pixels from `left` to before `right`, 5×N."""
    here = q[v, left:right]
    for b in range(2 * radius + 1):
        away = (b - radius) * stride
        dv = np.float32(away)
        for a in range(2 * radius + 1):
            aside = (a - radius) * stride
            du = np.float32(aside)
            there = q[v + away, left + aside : right + aside]
            for k in range(here.size):
                step = there[k] - here[k]
                same = abs(step) <= here[k] * allowed[b, a]
                weight = np.float32(1.0) if same else np.float32(0.0)
                step = step if same else np.float32(0.0)
                sums[0, k] += weight * (du * du)
                sums[1, k] += weight * (du * dv)
                sums[2, k] += weight * (dv * dv)
                sums[3, k] += du * step
                sums[4, k] += dv * step


@njit
def _moments(q, v, u, radius, stride, allowed):
    """Σ du², Σ du dv, Σ dv², Σ du dq and Σ dv dq over the neighbours of the same surface."""
    height, width = q.shape
    here, zero = q[v, u], np.float32(0.0)
    uu, uv, vv, uq, vq = zero, zero, zero, zero, zero
    for b in range(2 * radius + 1):
        j = v + (b - radius) * stride
        if not 0 <= j < height:
            continue
        dv = np.float32((b - radius) * stride)
        for a in range(2 * radius + 1):
            i = u + (a - radius) * stride
            if not 0 <= i < width:
                continue
            du, step = np.float32((a - radius) * stride), q[j, i] - here
            if abs(step) <= here * allowed[b, a]:
                uu += du * du
                uv += du * dv
                vv += dv * dv
                uq += du * step
                vq += dv * step
    return uu, uv, vv, uq, vq


@njit(error_model="numpy")
def _normal(uu, uv, vv, uq, vq, q, x, y, fx, fy, out):
    """Of the plane of these moments, into `out`; NaN where the neighbours do not make one."""
    determinant = uu * vv - uv * uv
    if not determinant > np.float32(0.1):
        out[:] = np.nan
        return
    alpha = (vv * uq - uv * vq) / determinant * fx
    beta = (uu * vq - uv * uq) / determinant * fy
    gamma = q - alpha * x - beta * y
    length = np.sqrt(alpha * alpha + beta * beta + gamma * gamma)
    out[0], out[1], out[2] = -alpha / length, -beta / length, -gamma / length


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
