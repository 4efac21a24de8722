"""One plane for each bare region of a view, from the points at its border and the angle of polarization within it.

A wall without texture has points only where it ends: along the line to the ceiling, round a picture. A line of points
leaves one turn of the plane open, and polarization closes it. With p = (α, β, γ) the plane αX + βY + γZ = 1, whose
normal is along p, both are linear in p:

    points      α x + β y + γ = 1/z
    azimuth     N·p = 0,  N = v × e  for diffuse light (e, v and the normal are in one plane),
                          N = e      for specular light (e is across the normal),

e the direction in space of the field that the polarizers see, perpendicular to the viewing ray v. That is exact under
perspective, for a whole region at once, and needs no zenith. Points of things that stand before a region are outliers:
planes through a few points are tried and scored by the points that they explain and by the polarization.
"""

from __future__ import annotations

from typing import NamedTuple

import cv2
import numpy as np

from polarmap.densify.surfaces.dominant_planes import solve_symmetric
from polarmap.densify.surfaces.planes import in_image
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import FINITE_MATH, njit

_GREY_STEP = 0.01  # of sqrt(intensity) between neighbouring cells, which ends a region
_STOKES_STEP = 0.04  # of (S1, S2)/S0
_LEAST_AREA = 0.004  # of the image
_MOST_REGIONS = 30
_REACH = 2  # cells beyond the region in which its border's points may lie
_LEAST_POINTS = 20
_MOST_POINTS = 1500
_MOST_CELLS = 400
_TRIALS = 120
_REFITS = 4
_CLEAR_VARIANCE = 0.3  # rad², of an angle of polarization that says something
_CLEAR_SHARE = 0.3  # of a region's cells that must have one
_MODEL_VARIANCE = 0.01  # rad², of the angle by what the model leaves out
_CELLS_WORTH = 10.0  # independent angles that a region's cells amount to, since their errors are alike
_LEAST_EXPLAINED = 15.0  # points, weighted


class _Angles(NamedTuple):
    """Constraints N·p = 0 of cells, for one kind of reflection. vectors, rays: float64 N×3. weights: float64 N."""

    vectors: np.ndarray
    rays: np.ndarray
    weights: np.ndarray


def region_planes(
    inverse_depth: np.ndarray,
    reliability: np.ndarray,
    grey: np.ndarray,
    stokes: np.ndarray,
    variance: np.ndarray,
    camera: PinholeCamera,
    cell: int,
    tolerance: float,
    seed: int = 0,
) -> np.ndarray:
    """Planes (q₀, q_u, q_v) of the larger regions without edges, float64 N×3, see `dominant_planes`.

    inverse_depth, reliability: points, float32 H×W, NaN and 0 where there is none. grey, stokes, variance: mean
    sqrt(intensity), mean (S1, S2)/S0 and its variance, of cells, float32 rows×columns(×2). camera: of the image.
    cell: side of a cell in pixels. tolerance: relative error of inverse depth that a point may have.
    """
    rng = np.random.default_rng(seed)
    regions, areas = _regions(grey, stokes)
    angle_variance = variance / np.maximum(4.0 * np.einsum("hwc,hwc->hw", stokes, stokes), 1e-9)
    clear = angle_variance < _CLEAR_VARIANCE
    kinds = _field_constraints(stokes, camera, cell)
    planes = []
    for region in np.argsort(-areas)[:_MOST_REGIONS]:
        if areas[region] < _LEAST_AREA * grey.size:
            break
        within = regions == region + 1
        near = cv2.dilate(within.astype(np.uint8), np.ones((2 * _REACH + 1,) * 2, np.uint8))
        chosen = _points_in(near, reliability, cell)
        if chosen.size < _LEAST_POINTS:
            continue
        at = np.divmod(rng.permutation(chosen)[:_MOST_POINTS], reliability.shape[1])
        points = np.stack([(at[1] - camera.cx) / camera.fx, (at[0] - camera.cy) / camera.fy, np.ones(at[0].size)], 1)
        points /= inverse_depth[at][:, None]  # so that p·row is 1 on the plane
        angles = _region_angles(within, clear, angle_variance, kinds, rng)
        plane = _fit(points, reliability[at].astype(np.float64), angles, tolerance, rng)
        if plane is not None:
            planes.append(plane)
    return in_image(np.array(planes, np.float64).reshape(-1, 3), camera)


@njit
def _points_in(near, reliability, cell):
    """Places, in the flattened image, of the points in the cells where `near` is not 0, ascending int64."""
    height, width = reliability.shape
    found, count = np.empty(np.count_nonzero(near) * cell * cell, np.int64), 0
    for i in range(near.shape[0]):
        if not near[i].any():
            continue
        for v in range(i * cell, min((i + 1) * cell, height)):
            for j in range(near.shape[1]):
                if near[i, j]:
                    for u in range(j * cell, min((j + 1) * cell, width)):
                        if reliability[v, u] > 0:
                            found[count] = v * width + u
                            count += 1
    return found[:count]


def _regions(grey: np.ndarray, stokes: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Number of each cell's region from 1, 0 on edges, and the regions' areas in cells."""
    smooth = cv2.blur(stokes, (3, 3))
    flat = (_largest_step(grey[..., None]) < _GREY_STEP) & (_largest_step(smooth) < _STOKES_STEP)
    _, regions, stats, _ = cv2.connectedComponentsWithStats(flat.astype(np.uint8), connectivity=4)
    return regions, stats[1:, cv2.CC_STAT_AREA]


def _largest_step(values: np.ndarray) -> np.ndarray:
    """Between a cell and its left and upper neighbour."""
    step = np.zeros(values.shape[:2], np.float32)
    step[:, 1:] = np.linalg.norm(np.diff(values, axis=1), axis=-1)
    step[1:] = np.maximum(step[1:], np.linalg.norm(np.diff(values, axis=0), axis=-1))
    return step


def _field_constraints(stokes: np.ndarray, camera: PinholeCamera, cell: int) -> tuple[np.ndarray, ...]:
    """N for diffuse and for specular light, and the viewing rays, float64 rows×columns×3 each, of unit length."""
    rows, columns = stokes.shape[:2]
    u, v = np.meshgrid((np.arange(columns) + 0.5) * cell - 0.5, (np.arange(rows) + 0.5) * cell - 0.5)
    rays = _unit(np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones_like(u)], axis=-1))
    angle = 0.5 * np.arctan2(stokes[..., 1], stokes[..., 0])
    seen = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=-1)
    field = _unit(seen - np.einsum("hwc,hwc->hw", seen, rays)[..., None] * rays)
    return np.cross(rays, field), field, rays


def _unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def _region_angles(within, clear, variance, kinds, rng) -> list[_Angles]:
    """The constraints of the region's clear cells for both kinds of reflection; none where few are clear."""
    cells = np.flatnonzero(within & clear)
    if cells.size < _CLEAR_SHARE * np.count_nonzero(within):
        return []
    cells = rng.permutation(cells)[:_MOST_CELLS]
    weights = 1.0 / (variance.ravel()[cells] + _MODEL_VARIANCE).astype(np.float64)
    diffuse, specular, rays = (kind.reshape(-1, 3)[cells] for kind in kinds)
    return [_Angles(vectors, rays, weights) for vectors in (diffuse, specular)]


def _fit(points, weights, angles, tolerance, rng) -> np.ndarray | None:
    """The plane that explains points and polarization best, as either kind of reflection; None where none does."""
    candidates = angles or [_Angles(np.empty((0, 3)), np.empty((0, 3)), np.empty(0))]
    best, best_score = None, 0.0
    rows = np.ascontiguousarray((points / tolerance).T, np.float32)
    for constraints in candidates:
        picks = rng.integers(len(points), size=(_TRIALS, 4))
        counts = rng.integers(2, 5, _TRIALS) if len(constraints.weights) else np.full(_TRIALS, 3)
        plane, score = _best_trial(points, rows, weights.astype(np.float32), *constraints, picks, counts, tolerance)
        if score > best_score:
            best, best_score = _refined(points, weights, *constraints, plane, tolerance), score
    if best is None:
        return None
    explained = np.abs(points @ best - 1.0) < tolerance
    return best if weights[explained].sum() >= _LEAST_EXPLAINED else None


@njit
def _add(m, row, weight):
    m[0] += weight * row[0] * row[0]
    m[1] += weight * row[0] * row[1]
    m[2] += weight * row[0] * row[2]
    m[3] += weight * row[1] * row[1]
    m[4] += weight * row[1] * row[2]
    m[5] += weight * row[2] * row[2]


@njit
def _angle_information(vectors, weights):
    """Mean information of the angles, as the upper triangle of a 3×3 matrix, times the cells they are worth."""
    m = np.zeros(6)
    for k in range(weights.size):
        _add(m, vectors[k], weights[k])
    if weights.size:
        m *= 2.0 * _CELLS_WORTH / weights.size  # sin² of a typical zenith is a half
    return m


@njit
def _misfit(plane, vectors, rays, weights):
    """Weighted mean of the capped squared error of the angle, in its variance."""
    length = np.sqrt(plane[0] ** 2 + plane[1] ** 2 + plane[2] ** 2)
    total, norm = 0.0, 1e-12
    for k in range(weights.size):
        along = (vectors[k, 0] * plane[0] + vectors[k, 1] * plane[1] + vectors[k, 2] * plane[2]) / length
        cosine = (rays[k, 0] * plane[0] + rays[k, 1] * plane[1] + rays[k, 2] * plane[2]) / length
        error = along * along * weights[k] / max(1.0 - cosine * cosine, 1e-3)
        total += weights[k] * min(error, 4.0)
        norm += weights[k]
    return total / norm


@njit
def _best_trial(points, rows, weights, vectors, rays, angle_weights, picks, counts, tolerance):
    """The plane with the best score of all trials; each goes through a few points, and obeys the angles."""
    information = _angle_information(vectors, angle_weights)
    best, best_score = np.zeros(3), 0.0
    for trial in range(counts.size):
        m, r, scale = information.copy(), np.zeros(3), 0.0
        for k in range(counts[trial]):
            scale += points[picks[trial, k], 2] / counts[trial]
        m *= scale * scale  # angles do not depend on the length of p, which is about 1/z
        for k in range(counts[trial]):
            row = points[picks[trial, k]] / tolerance
            _add(m, row, 1.0)
            r += row / tolerance
        trace = m[0] + m[3] + m[5]
        for k in (0, 3, 5):
            m[k] += 1e-9 * trace
        plane = np.array(solve_symmetric(m, r))
        if plane[0] == 0.0 and plane[1] == 0.0 and plane[2] == 0.0:
            continue
        score = np.float64(_explained(rows, weights, plane.astype(np.float32), np.float32(1.0 / tolerance)))
        if score > best_score:  # or else the angles need not be looked at
            score *= np.exp(-0.5 * _misfit(plane, vectors, rays, angle_weights))
        if score > best_score:
            best, best_score = plane, score
    return best, best_score


@njit(fastmath=FINITE_MATH)
def _explained(rows, weights, plane, target):
    """Σ w max(0, 1 - e²) over columns r of rows, with e = r·plane - target; all float32."""
    score = np.float32(0.0)
    for k in range(weights.size):
        error = rows[0, k] * plane[0] + rows[1, k] * plane[1] + rows[2, k] * plane[2] - target
        score += weights[k] * max(np.float32(1.0) - error * error, np.float32(0.0))
    return score


@njit
def _refined(points, weights, vectors, rays, angle_weights, plane, tolerance):
    """Fitted again to all points, which weigh less the worse they fit, and to the angles."""
    information = 2.0 * _angle_information(vectors, angle_weights) * np.median(points[:, 2]) ** 2
    sharpness = 1.0 / (tolerance * tolerance)
    m, r, row = np.empty(6), np.empty(3), np.empty(3)
    for _ in range(_REFITS):
        m[:], r[:] = information, 0.0
        for k in range(weights.size):
            row[0], row[1], row[2] = points[k, 0], points[k, 1], points[k, 2]
            error = row[0] * plane[0] + row[1] * plane[1] + row[2] * plane[2] - 1.0
            weight = weights[k] * sharpness / (1.0 + sharpness * error * error) ** 2
            _add(m, row, weight)
            for c in range(3):
                r[c] += weight * row[c]
        plane = np.array(solve_symmetric(m, r))
    return plane
