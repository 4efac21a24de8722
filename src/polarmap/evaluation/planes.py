"""Planes in points: found by RANSAC on points with normals, and fitted to points with outliers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from polarmap.errors import InputError

_MOST_POINTS = 20_000  # that hypotheses are scored by
_HYPOTHESES = 200
_REFINEMENTS = 5
_NEIGHBOURS = 16


@dataclass(frozen=True, eq=False)
class Plane:
    """Points x with normal · x = offset. normal: float64 (3,), of unit length."""

    normal: np.ndarray
    offset: float

    def distances(self, points: np.ndarray) -> np.ndarray:
        """Of points N×3, not negative, float64 N."""
        return np.abs(points @ self.normal - self.offset)


def find_planes(
    points: np.ndarray,
    normals: np.ndarray,
    tolerance: float,
    max_angle: float = np.radians(15.0),
    least_share: float = 0.04,
    most: int = 8,
) -> list[Plane]:
    """The planes that hold most points, one after the other, each without the points of those before it.

    points: float N×3. normals: float N×3 of unit length; their sign does not matter. A point is of a plane within
    `tolerance` of it (the points' unit) whose normal differs from its own by less than `max_angle`. Ends with the
    first plane that holds less than `least_share` of all points, or with `most`. Deterministic.
    """
    rng = np.random.default_rng(0)
    left = rng.permutation(len(points))[:_MOST_POINTS]
    points, normals = np.asarray(points, float)[left], np.asarray(normals, float)[left]
    least = max(3.0, least_share * len(points))
    planes: list[Plane] = []
    while len(planes) < most and len(points) >= least:
        seeds = rng.permutation(len(points))[:_HYPOTHESES]
        counts = [
            _members(Plane(normals[i], points[i] @ normals[i]), points, normals, tolerance, max_angle) for i in seeds
        ]
        members = max(counts, key=np.count_nonzero)
        for _ in range(_REFINEMENTS):
            if np.count_nonzero(members) < least:
                return planes
            plane = fit_plane(points[members])
            members = _members(plane, points, normals, tolerance, max_angle)
        planes.append(plane)
        points, normals = points[~members], normals[~members]
    return planes


def fit_plane(points: np.ndarray) -> Plane:
    """The plane with the least sum of squared distances, of at least three points N×3."""
    if len(points) < 3:
        raise InputError(f"plane: {len(points)} points do not make one")
    centre = points.mean(axis=0)
    _, axes = np.linalg.eigh((points - centre).T @ (points - centre))
    return Plane(axes[:, 0], float(centre @ axes[:, 0]))


def fit_plane_robustly(points: np.ndarray, tolerance: float) -> Plane:
    """The plane within `tolerance` of most points N×3, then fitted to those by least squares (RANSAC)."""
    rng = np.random.default_rng(0)
    sample = np.asarray(points, float)[rng.permutation(len(points))[:_MOST_POINTS]]
    plane = fit_plane(sample)
    candidates = [plane] + [fit_plane(sample[rng.integers(len(sample), size=3)]) for _ in range(_HYPOTHESES)]
    plane = max(candidates, key=lambda candidate: np.count_nonzero(candidate.distances(sample) < tolerance))
    for _ in range(_REFINEMENTS):
        members = sample[plane.distances(sample) < tolerance]
        if len(members) < 3:
            break
        plane = fit_plane(members)
    return plane


def estimate_normals(points: np.ndarray) -> np.ndarray:
    """Normals of unit length, of either sign, from the nearest neighbours of each point, float64 N×3."""
    count = min(_NEIGHBOURS, len(points))
    if count < 3:
        raise InputError(f"normals: {len(points)} points are too few")
    _, nearest = cKDTree(points).query(points, k=count)
    local = points[nearest] - points[nearest].mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("nki,nkj->nij", local, local))
    return axes[:, :, 0]


def _members(plane: Plane, points: np.ndarray, normals: np.ndarray, tolerance: float, max_angle: float) -> np.ndarray:
    near = plane.distances(points) < tolerance
    return near & (np.abs(normals @ plane.normal) > np.cos(max_angle))
