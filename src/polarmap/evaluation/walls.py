"""The wall experiment: how flat planar parts are reconstructed (the paper, Section IV-B).

Points of a wall, a plane fitted to them, and the share of them within a distance of it, for many distances. Where the
true depth is known, walls are planes of the true surface, so that every method is measured at the same pixels; where
not, they are planes found in the points themselves.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.evaluation.metrics import Figure
from polarmap.evaluation.planes import Plane, estimate_normals, find_planes, fit_plane_robustly

THRESHOLDS = (0.005, 0.01, 0.02, 0.03, 0.05, 0.1, 0.2)
"""Metres."""

_FIT_TOLERANCE = 0.05
_TRUE_TOLERANCE = 0.01
_FOUND_TOLERANCE = 0.03
_MAX_ANGLE = np.radians(15.0)
_POINTS_PER_VIEW = 2000  # of a wall that are kept


@dataclass(frozen=True)
class Wall:
    """A planar part. normal, offset: normal · x = offset in the world that it was found in, metres.

    pixels: that show it, over all keyframes; points: those that have depth. within: their share within each of the
    thresholds of the plane fitted to them.
    """

    normal: tuple[float, float, float]
    offset: float
    pixels: int
    points: int
    within: tuple[Figure, ...]


@dataclass(frozen=True)
class WallMetrics:
    """The share of points of walls by distance from planes, all walls together; NaN where they have no points.

    found_in: "the true depth" or "the points". thresholds: metres.
    within: share of the reconstructed points within each of them of the plane fitted to their wall (the paper's
    figure). of_all: the same as a share of *all* pixels that show a wall; NaN where walls are found in points.
    of_truth: share of the reconstructed points within each of them of the true plane, put there by the true poses.
    """

    found_in: str
    walls: tuple[Wall, ...]
    thresholds: tuple[float, ...]
    within: tuple[Figure, ...]
    of_all: tuple[Figure, ...]
    of_truth: tuple[Figure, ...]


@dataclass
class _Collected:
    """Points of a wall from several views, each standing for `weight` pixels. true_distances: from the true plane."""

    points: list[np.ndarray]
    true_distances: list[np.ndarray]
    weights: list[np.ndarray]
    pixels: int = 0
    known: int = 0


class WallCollector:
    """Collects the reconstructed points of known walls, view by view.

    planes: in the true world. Memory grows by at most 2000 points a view and wall.
    """

    def __init__(self, planes: list[Plane]) -> None:
        self.planes = planes
        self._collected = [_Collected([], [], []) for _ in planes]

    def add(self, true_points: np.ndarray, true_normals: np.ndarray, points: np.ndarray, placed: np.ndarray) -> None:
        """Add the pixels of a view; arrays N×3 in metres, NaN where unknown.

        true_points, true_normals: in the true world. points: the reconstructed ones in the run's world. placed: the
        same, put into the true world by the true pose.
        """
        free = np.ones(len(true_points), bool)
        for plane, collected in zip(self.planes, self._collected, strict=True):
            aligned = np.abs(true_normals @ plane.normal) > np.cos(_MAX_ANGLE)
            shown = free & aligned & (plane.distances(true_points) < _TRUE_TOLERANCE)
            free &= ~shown
            known = np.flatnonzero(shown & np.isfinite(points).all(axis=1))
            collected.pixels += int(np.count_nonzero(shown))
            collected.known += len(known)
            kept = known[:: max(1, -(-len(known) // _POINTS_PER_VIEW))]
            if len(kept):
                collected.points.append(points[kept])
                collected.true_distances.append(plane.distances(placed[kept]))
                collected.weights.append(np.full(len(kept), len(known) / len(kept)))

    def metrics(self, thresholds: tuple[float, ...] = THRESHOLDS) -> WallMetrics:
        """The figures of what was added."""
        distances, true_distances, weights = [np.empty(0)], [np.empty(0)], [np.empty(0)]
        walls = []
        for plane, collected in zip(self.planes, self._collected, strict=True):
            if sum(map(len, collected.points)) < 3:
                walls.append(_wall(plane, collected, np.empty(0), np.empty(0), thresholds))
                continue
            points = np.concatenate(collected.points)
            distances.append(fit_plane_robustly(points, _FIT_TOLERANCE).distances(points))
            true_distances.append(np.concatenate(collected.true_distances))
            weights.append(np.concatenate(collected.weights))
            walls.append(_wall(plane, collected, distances[-1], weights[-1], thresholds))
        weight = np.concatenate(weights)
        within = _shares(np.concatenate(distances), weight, thresholds)
        pixels = sum(collected.pixels for collected in self._collected)
        density = weight.sum() / pixels if pixels else float("nan")
        return WallMetrics(
            found_in="the true depth",
            walls=tuple(walls),
            thresholds=thresholds,
            within=within,
            of_all=tuple(share * density if weight.size else 0.0 * density for share in within),
            of_truth=_shares(np.concatenate(true_distances), weight, thresholds),
        )


def true_walls(points: np.ndarray, normals: np.ndarray) -> list[Plane]:
    """Planes that hold at least 4 % of the true surface each, from points on it, evenly spread, float N×3, metres."""
    return find_planes(points, normals, _TRUE_TOLERANCE, _MAX_ANGLE)


def walls_of_points(
    points: np.ndarray, normals: np.ndarray | None = None, thresholds: tuple[float, ...] = THRESHOLDS
) -> WallMetrics:
    """Walls found in reconstructed points themselves, where there is no truth.

    points: float N×3, metres, evenly spread. normals: float N×3, or None: from the points' neighbours. A point is of
    the nearest plane within the largest threshold whose normal is within 45° of its own.
    """
    normals = estimate_normals(points) if normals is None else normals
    planes = find_planes(points, normals, _FOUND_TOLERANCE, _MAX_ANGLE)
    none = (float("nan"),) * len(thresholds)
    if not planes:
        return WallMetrics("the points", (), thresholds, none, none, none)
    distances = np.stack([plane.distances(points) for plane in planes])
    turned = np.abs(np.stack([normals @ plane.normal for plane in planes])) < np.cos(np.pi / 4)
    distances[turned | (distances > max(thresholds))] = np.inf
    nearest = np.argmin(distances, axis=0)
    own = distances[nearest, np.arange(len(points))]
    walls, known = [], np.isfinite(own)
    for number, plane in enumerate(planes):
        of_wall = own[known & (nearest == number)]
        shares = _shares(of_wall, np.ones(len(of_wall)), thresholds)
        walls.append(Wall(tuple(plane.normal.tolist()), plane.offset, len(of_wall), len(of_wall), shares))
    within = _shares(own[known], np.ones(np.count_nonzero(known)), thresholds)
    return WallMetrics("the points", tuple(walls), thresholds, within, none, none)


def _wall(plane: Plane, collected: _Collected, distances, weights, thresholds: tuple[float, ...]) -> Wall:
    shares = _shares(distances, weights, thresholds)
    return Wall(tuple(plane.normal.tolist()), plane.offset, collected.pixels, collected.known, shares)


def _shares(distances: np.ndarray, weights: np.ndarray, thresholds: tuple[float, ...]) -> tuple[float, ...]:
    if not distances.size:
        return (float("nan"),) * len(thresholds)
    return tuple(float(weights[distances < limit].sum() / weights.sum()) for limit in thresholds)
