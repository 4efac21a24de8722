"""The planes that explain most of the sparse points of a view: walls, floors, table tops.

A plane of space is affine in inverse depth, q(u, v) = q₀ + q_u (u - c_u) + q_v (v - c_v), with (c_u, c_v) the image's
centre, so that fitting one is a linear problem whatever the camera. Planes are found one after the other: local fits
at random points, over neighbourhoods of several sizes, are scored on all points that no plane explains yet (Fischler
and Bolles 1981; Torr and Zisserman 2000 for the score), and the best one is fitted again to what it explains.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import FINITE_MATH, njit

_REACHES = (0.025, 0.05, 0.1)  # of the image diagonal, the half side of a local fit's neighbourhood
_LOCAL_POINTS = 12
_DRAWS = 80  # tries to find that many points
_LOCAL_RANGE = 0.1  # relative difference of inverse depth inside a neighbourhood
_SCORED = 4000  # points that a hypothesis is scored on
_FITTED = 40_000  # points that a plane is fitted to
_REFITS = 5


def dominant_planes(
    inverse_depth: np.ndarray,
    tolerance: float,
    most: int,
    least_share: float,
    hypotheses: int = 300,
    seed: int = 0,
) -> tuple[np.ndarray, np.ndarray]:
    """Planes of the points, those with most points first: (q₀, q_u, q_v) float64 N×3, and their numbers of points.

    inverse_depth: float32 H×W, NaN where there is no point. tolerance: relative error of inverse depth that a point may
    have. most: planes at most. least_share: share of all points that a plane must explain. hypotheses: local fits for
    each plane. Deterministic from the seed.
    """
    rng = np.random.default_rng(seed)
    left = np.ascontiguousarray(inverse_depth, np.float32)
    v, u = (places.astype(np.int32) for places in np.nonzero(left > 0))
    total = u.size
    found, counts = [], []
    while len(found) < most and u.size >= max(least_share * total, 2 * _LOCAL_POINTS):
        plane = _best_hypothesis(left, u, v, tolerance, hypotheses, rng)
        plane = _refit(left, u[:: u.size // _FITTED + 1], v[:: u.size // _FITTED + 1], plane, tolerance)
        rest = np.empty(u.size, np.bool_)
        count = _explain(left, u, v, plane, np.float64(tolerance), rest)
        if count < least_share * total:
            break
        found.append(plane)
        counts.append(count)
        u, v = u[rest], v[rest]
    return np.array(found, np.float64).reshape(-1, 3), np.array(counts, int)


def _best_hypothesis(left, u, v, tolerance, hypotheses, rng) -> np.ndarray:
    scored = rng.choice(u.size, min(u.size, _SCORED), replace=False)
    centres = rng.integers(u.size, size=hypotheses)
    reaches = np.rint(np.hypot(*left.shape) * rng.choice(_REACHES, hypotheses)).astype(np.int64)
    offsets = rng.uniform(-1.0, 1.0, (hypotheses, _DRAWS, 2))
    planes, scores = np.zeros((hypotheses, 3)), np.zeros(hypotheses)
    rows = _relative_rows(left, u[scored], v[scored], np.float64(tolerance))
    _score_hypotheses(left, u, v, rows, centres, reaches, offsets, np.float32(1.0 / tolerance), planes, scores)
    return planes[scores.argmax()]


def _refit(left, u, v, plane, tolerance) -> np.ndarray:
    """Least squares of relative error, reweighted by Geman and McClure's weights."""
    height, width = left.shape
    q = left[v, u].astype(np.float64)
    x, y = (u - 0.5 * (width - 1)) / width, (v - 0.5 * (height - 1)) / width
    for _ in range(_REFITS):
        q0, qu, qv = _weighted_fit(q, x, y, plane[0], plane[1] * width, plane[2] * width, 0.5 * tolerance)
        plane = np.array([q0, qu / width, qv / width])
    return plane


@njit
def solve_symmetric(m, r):
    """Solution of the symmetric 3×3 system with upper triangle m = (00, 01, 02, 11, 12, 22); zeros if singular."""
    c0 = m[3] * m[5] - m[4] * m[4]
    c1 = m[2] * m[4] - m[1] * m[5]
    c2 = m[1] * m[4] - m[2] * m[3]
    determinant = m[0] * c0 + m[1] * c1 + m[2] * c2
    if not abs(determinant) > 1e-12 * abs(m[0] * m[3] * m[5]):
        return 0.0, 0.0, 0.0
    c3, c4, c5 = m[0] * m[5] - m[2] * m[2], m[1] * m[2] - m[0] * m[4], m[0] * m[3] - m[1] * m[1]
    return (
        (c0 * r[0] + c1 * r[1] + c2 * r[2]) / determinant,
        (c1 * r[0] + c3 * r[1] + c4 * r[2]) / determinant,
        (c2 * r[0] + c4 * r[1] + c5 * r[2]) / determinant,
    )


@njit
def _accumulate(m, r, x, y, q, weight):
    m[0] += weight
    m[1] += weight * x
    m[2] += weight * y
    m[3] += weight * x * x
    m[4] += weight * x * y
    m[5] += weight * y * y
    r[0] += weight * q
    r[1] += weight * q * x
    r[2] += weight * q * y


@njit
def _local_fit(left, u, v, reach, offsets):
    """Plane through a few points near (u, v), relative to the image's centre; zeros where there are too few."""
    height, width = left.shape
    m, r = np.zeros(6), np.zeros(3)
    points = 0
    for k in range(offsets.shape[0]):
        i, j = v + int(reach * offsets[k, 0]), u + int(reach * offsets[k, 1])
        if not (0 <= i < height and 0 <= j < width):
            continue
        q = left[i, j]
        if abs(q - left[v, u]) < _LOCAL_RANGE * left[v, u]:  # false where there is no point
            _accumulate(m, r, (j - u) / reach, (i - v) / reach, q, 1.0)
            points += 1
            if points == _LOCAL_POINTS:
                break
    if points < _LOCAL_POINTS // 2:
        return 0.0, 0.0, 0.0
    q, qu, qv = solve_symmetric(m, r)
    qu, qv = qu / reach, qv / reach
    return q + qu * (0.5 * (width - 1) - u) + qv * (0.5 * (height - 1) - v), qu, qv


@njit
def _relative_rows(left, u, v, tolerance):
    """Rows r with r·(q₀, q_u, q_v) = (q/q_k) / tolerance at points k, float32 3×K."""
    height, width = left.shape
    rows = np.empty((3, u.size), np.float32)
    for k in range(u.size):
        scale = 1.0 / (tolerance * left[v[k], u[k]])
        rows[0, k] = scale
        rows[1, k] = scale * (u[k] - 0.5 * (width - 1))
        rows[2, k] = scale * (v[k] - 0.5 * (height - 1))
    return rows


@njit(parallel=True)
def _score_hypotheses(left, u, v, rows, centres, reaches, offsets, target, planes, scores):
    for h in prange(centres.size):
        c = centres[h]
        plane = _local_fit(left, u[c], v[c], reaches[h], offsets[h])
        planes[h, 0], planes[h, 1], planes[h, 2] = plane
        scores[h] = _explained(rows, np.float32(plane[0]), np.float32(plane[1]), np.float32(plane[2]), target)


@njit(fastmath=FINITE_MATH)
def _explained(rows, a, b, c, target):
    """Σ max(0, 1 - e²) over columns r of rows, with e = r·(a, b, c) - target; all float32, rows 3×K."""
    score = np.float32(0.0)
    for k in range(rows.shape[1]):
        error = rows[0, k] * a + rows[1, k] * b + rows[2, k] * c - target
        score += max(np.float32(1.0) - error * error, np.float32(0.0))
    return score


@njit(fastmath=FINITE_MATH)
def _weighted_fit(q, x, y, a, b, c, scale):
    """Value and slopes of the plane through q(x, y), with weights by the distance from a + b x + c y."""
    m0 = m1 = m2 = m3 = m4 = m5 = r0 = r1 = r2 = 0.0
    for k in range(q.size):
        error = (a + b * x[k] + c * y[k] - q[k]) / scale
        root = q[k] / (q[k] * q[k] + error * error)
        weight = root * root
        m0 += weight
        m1 += weight * x[k]
        m2 += weight * y[k]
        m3 += weight * x[k] * x[k]
        m4 += weight * x[k] * y[k]
        m5 += weight * y[k] * y[k]
        r0 += weight * q[k]
        r1 += weight * x[k] * q[k]
        r2 += weight * y[k] * q[k]
    return solve_symmetric((m0, m1, m2, m3, m4, m5), (r0, r1, r2))


@njit
def _explain(left, u, v, plane, tolerance, rest):
    """How many points a plane explains; `rest`, bool, says which are left when those near it are taken away."""
    height, width = left.shape
    count = 0
    for k in range(u.size):
        q = np.float32(plane[0] + plane[1] * (u[k] - 0.5 * (width - 1)) + plane[2] * (v[k] - 0.5 * (height - 1)))
        error = abs(q / left[v[k], u[k]] - np.float32(1.0))
        count += error < tolerance
        rest[k] = error > 1.5 * tolerance
    return count
