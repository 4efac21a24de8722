"""Normals of measured depth: planes over windows as large as the surface allows, which cross no edge and no crease.

On a plane inverse depth is linear in the pixel, q = a·du + b·dv + c, so a window's sums give its plane by least
squares and how far it is off. A pixel takes the plane of the largest window that holds it and is flat to the depth's
noise: its own if that is, else one that lies to the side (Nagao and Matsuyama 1979, for planes). Walls get the large
windows, which average the steps of stored depth away; next to a crease or an edge the window beside it serves; only
bent and thin things are left to small ones. On a bent surface the windows beside are no flatter, and its own is
taken.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit

_RADII = (6, 3, 1)
_FLATNESS = 2.0  # rms of a flat window, in standard deviations of the noise
_CLEARLY_FLATTER = 2.0  # ratio of rms that tells a window across an edge from one on a bent surface
_LEAST_EVEN = 0.005  # rms of the smallest window, as a share of inverse depth, beyond which it spans a step
_OUTLIER = 4.0  # how far from its plane a pixel may be, likewise
_LEAST_SHARE = 0.5  # of a window's pixels that must be known
_DEPTH_BINS = 8  # in which noise is measured
_EVERY = 3  # pixel takes part in that
_LEAST_DETERMINANT = 1e-3
_MEDIAN_OF_NORMAL = 0.6745  # of the absolute value, for a standard deviation of 1


def plane_normals(depth: np.ndarray, camera: PinholeCamera, step: float = 0.0) -> np.ndarray:
    """Unit normals toward the camera, float32 H×W×3, NaN where no plane fits.

    depth: z, float32 H×W metres, NaN where unknown. step: that of stored depth in metres, such as 1/5000; 0 for none.
    Noise is measured in the depth itself, as a function of depth; it is at least that of the step.
    """
    q = (1.0 / depth).astype(np.float64)
    planes = _fit(q)
    tolerance = _FLATNESS * _noise(q, _true_step(depth, step))
    normals = np.empty((*depth.shape, 3), np.float32)
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    _choose(q, planes, np.array(_RADII), tolerance, intrinsics, normals)
    return normals


def _true_step(depth: np.ndarray, step: float) -> float:
    """The largest step whose multiples all depths are: millimetres are often stored at 5000 per metre."""
    known = depth[np.isfinite(depth)]
    if step <= 0.0 or known.size == 0:
        return step
    return step * max(int(np.gcd.reduce(np.rint(known / step).astype(np.int64))), 1)


def _noise(q: np.ndarray, step: float) -> np.ndarray:
    """Standard deviation of inverse depth at each pixel, float64 H×W, as a function of depth.

    From second differences along both axes, [1 -2 1] across [1 -2 1], which bent surfaces hardly have and whose
    variance is 36 times that of one pixel (Immerkær 1996); in each bin of depth their median. At least that of the
    step.
    """
    least = step * np.sqrt(1.0 / 12.0) * q**2 + 1e-7 * q
    along = q[:, :-2] - 2.0 * q[:, 1:-1] + q[:, 2:]
    off = np.abs(along[:-2] - 2.0 * along[1:-1] + along[2:]).ravel()[::_EVERY]
    measured = np.isfinite(off)
    here, off = q[1:-1, 1:-1].ravel()[::_EVERY][measured], off[measured]
    if here.size < 16 * _DEPTH_BINS:
        return least
    edges = np.quantile(here, np.linspace(0.0, 1.0, _DEPTH_BINS + 1))
    inside = np.searchsorted(edges[1:-1], here)
    bins = [inside == k for k in range(_DEPTH_BINS) if (inside == k).any()]
    centres = [float(np.median(here[part])) for part in bins]
    sigmas = [float(np.median(off[part])) / (6.0 * _MEDIAN_OF_NORMAL) for part in bins]
    return np.maximum(np.interp(q, centres, sigmas), least)


def _fit(q: np.ndarray) -> np.ndarray:
    """(a, b, c, rms) of the plane in the square of each radius around each pixel, radii×4×H×W; NaN where none.

    Sums are float64: a residual is a millionth of what it is the difference of.
    """
    height, width = q.shape
    known, filled = np.isfinite(q).astype(np.float64), np.nan_to_num(q)
    planes = np.empty((len(_RADII), 4, height, width), np.float32)
    rows = np.empty((height, 6, width))  # a row's sums lie together
    for k, radius in enumerate(_RADII):
        _row_sums(known, filled, radius, rows)
        _planes(rows, radius, planes[k])
    return planes


@njit(parallel=True)
def _row_sums(known, q, radius, sums):
    for v in prange(q.shape[0]):
        _sum_row(known[v], q[v], radius, sums[v])


@njit
def _sum_row(known, q, radius, sums):
    """Sums over 2 radius + 1 pixels of a row: of 1, du, du², q, q du, q², known pixels only."""
    width = q.size
    sums[:] = 0.0
    for i in range(-radius, radius + 1):
        du = float(i)
        for u in range(max(0, -i), min(width, width - i)):
            one, value = known[u + i], q[u + i]
            sums[0, u] += one
            sums[1, u] += du * one
            sums[2, u] += du * du * one
            sums[3, u] += value
            sums[4, u] += du * value
            sums[5, u] += value * value


@njit(parallel=True)
def _planes(rows, radius, planes):
    for v in prange(len(rows)):
        _planes_of_row(rows, v, radius, planes[:, v])


@njit
def _planes_of_row(rows, v, radius, planes):
    height, width = len(rows), rows.shape[2]
    least = _LEAST_SHARE * (2 * radius + 1) ** 2
    sums = np.zeros((10, width))
    for j in range(max(v - radius, 0), min(v + radius + 1, height)):
        _add_row(rows[j], float(j - v), sums)
    for u in range(width):
        n, su, sv, suu, suv = sums[0, u], sums[1, u], sums[2, u], sums[3, u], sums[4, u]
        svv, sq, suq, svq, sqq = sums[5, u], sums[6, u], sums[7, u], sums[8, u], sums[9, u]
        a, b, c, rms = np.nan, np.nan, np.nan, np.nan
        if n >= least and n > 3.0:
            a, b, c, rms = _solve(n, su, sv, sq, suu - su * su / n, suv - su * sv / n, svv - sv * sv / n,
                                  suq - su * sq / n, svq - sv * sq / n, sqq - sq * sq / n)  # fmt: skip
        planes[0, u], planes[1, u], planes[2, u], planes[3, u] = a, b, c, rms


@njit
def _add_row(row, dv, sums):
    """Add a row's sums, dv below the windows' centre, to those of 1, du, dv, du², du dv, dv², q, q du, q dv, q²."""
    for u in range(row.shape[1]):
        n, su, sq = row[0, u], row[1, u], row[3, u]
        sums[0, u] += n
        sums[1, u] += su
        sums[2, u] += dv * n
        sums[3, u] += row[2, u]
        sums[4, u] += dv * su
        sums[5, u] += dv * dv * n
        sums[6, u] += sq
        sums[7, u] += row[4, u]
        sums[8, u] += dv * sq
        sums[9, u] += row[5, u]


@njit(error_model="numpy")
def _solve(n, su, sv, sq, uu, uv, vv, uq, vq, qq):
    """The plane from centred second moments: slopes, value at the window's centre, rms of n - 3 degrees of freedom."""
    determinant = uu * vv - uv * uv
    if not determinant > _LEAST_DETERMINANT:
        return np.nan, np.nan, np.nan, np.nan
    a = (vv * uq - uv * vq) / determinant
    b = (uu * vq - uv * uq) / determinant
    c = (sq - a * su - b * sv) / n
    return a, b, c, np.sqrt(max(qq - a * uq - b * vq, 0.0) / (n - 3.0))


@njit(parallel=True)
def _choose(q, planes, radii, tolerance, intrinsics, normals):
    height, width = q.shape
    for v in prange(height):
        for u in range(width):
            a, b, c = _best_plane(q, planes, radii, tolerance[v, u], u, v)
            fx, fy, cx, cy = intrinsics
            alpha, beta = a * fx, b * fy
            gamma = c - alpha * ((u - cx) / fx) - beta * ((v - cy) / fy)
            length = np.sqrt(alpha * alpha + beta * beta + gamma * gamma)
            facing = length > 0.0 and c > 0.0
            normals[v, u, 0] = -alpha / length if facing else np.nan
            normals[v, u, 1] = -beta / length if facing else np.nan
            normals[v, u, 2] = -gamma / length if facing else np.nan


@njit
def _best_plane(q, planes, radii, tolerance, u, v):
    """(a, b, c) with c the plane's value at this pixel; NaN where the pixel is unknown or on no plane."""
    nothing = (np.nan, np.nan, np.nan)
    if q[v, u] != q[v, u]:
        return nothing
    best, rms = nothing, np.inf
    for k in range(len(radii)):
        best, rms = _flattest(q, planes[k], 0, tolerance, u, v)
        if rms <= tolerance:
            return best
        aside, least = _flattest(q, planes[k], radii[k], tolerance, u, v)
        if not _CLEARLY_FLATTER * least < rms:
            continue
        best, rms = aside, least
        if rms <= tolerance:
            return best
    return best if rms <= _LEAST_EVEN * q[v, u] else nothing


@njit
def _flattest(q, planes, reach, tolerance, u, v):
    """The plane of least rms among windows up to `reach` pixels aside whose plane meets this pixel, and its rms."""
    height, width = q.shape
    a, b, c, least = np.nan, np.nan, np.nan, np.inf
    stride = max(1, reach // 3)  # windows a pixel apart are nearly the same
    for j in range(v - reach, v + reach + 1, stride):
        for i in range(u - reach, u + reach + 1, stride):
            if not (0 <= j < height and 0 <= i < width and planes[3, j, i] < least):
                continue
            rms = planes[3, j, i]
            here = planes[2, j, i] + planes[0, j, i] * (u - i) + planes[1, j, i] * (v - j)
            if abs(here - q[v, u]) <= _OUTLIER * max(tolerance / _FLATNESS, rms):
                a, b, c, least = planes[0, j, i], planes[1, j, i], here, rms
    return (a, b, c), least
