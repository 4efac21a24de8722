"""Accuracy and completeness of a map against the true surface (Knapitsch et al., Tanks and Temples, SIGGRAPH 2017)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from polarmap.errors import InputError
from polarmap.evaluation.metrics import ErrorStatistics, Figure, error_statistics

THRESHOLDS = (0.01, 0.02, 0.05)
"""Metres."""

MAX_POINTS = 500_000
"""Points of each of the two surfaces; spacing grows where they would be more."""

_FARTHEST = 1e150  # that a point may be, so that its square is finite
_LARGEST_KEY = 2.0**62


@dataclass(frozen=True)
class MapMetrics:
    """A reconstructed surface against the true one, both as points at most about `spacing` metres apart.

    accuracy: distances of the reconstructed points from the true surface. completeness: of the true points from the
    reconstructed ones. precision, recall: shares of these below each of the thresholds (metres); fscore: their
    harmonic mean, 0 where both are 0. NaN where one of the surfaces has no point.
    source: what was measured, such as "mesh.ply". frames: whose true depth makes the true surface.
    """

    source: str
    frames: int
    spacing: float
    points: int
    true_points: int
    accuracy: ErrorStatistics
    completeness: ErrorStatistics
    thresholds: tuple[float, ...]
    precision: tuple[Figure, ...]
    recall: tuple[Figure, ...]
    fscore: tuple[Figure, ...]


class VoxelMeans:
    """Collects points and keeps the mean of those in each cell of a grid; the cells grow once they are too many.

    values: N×C, positions first, then whatever is to be averaged with them. Cells have no number that could run over,
    so that points anywhere are told apart as well as their coordinates tell them.
    """

    def __init__(self, size: float, limit: int = MAX_POINTS, channels: int = 3) -> None:
        if not 0 < size < np.inf:
            raise InputError(f"voxels: their size must be positive and finite, not {size}")
        self.size = size
        self._limit = limit
        self._sums, self._counts = np.empty((0, channels)), np.empty(0)
        self._pending: list[np.ndarray] = []
        self._waiting = 0

    def add(self, values: np.ndarray) -> None:
        """Add points, float N×C; those that are not finite, or over 1e150 away, are left out."""
        values = np.asarray(values, float)
        self._pending.append(values[(np.abs(values) < _FARTHEST).all(axis=1)])
        self._waiting += len(self._pending[-1])
        if self._waiting > self._limit:
            self._merge()

    def means(self) -> np.ndarray:
        """One point for each cell that has any, float64 M×C."""
        self._merge()
        return self._sums / self._counts[:, None]

    def _merge(self) -> None:
        sums = np.concatenate([self._sums, *self._pending])
        counts = np.concatenate([self._counts, np.ones(self._waiting)])
        self._pending, self._waiting = [], 0
        self._group(sums, counts)
        while len(self._counts) > self._limit:
            self.size *= 2.0**0.5
            self._group(self._sums, self._counts)

    def _group(self, sums: np.ndarray, counts: np.ndarray) -> None:
        place = number_cells(np.floor(sums[:, :3] / counts[:, None] / self.size))
        cell_count = int(place.max(initial=-1)) + 1
        columns = [np.bincount(place, column, minlength=cell_count) for column in sums.T]
        self._sums = np.stack(columns, axis=1)
        self._counts = np.bincount(place, counts, minlength=cell_count)


def number_cells(cells: np.ndarray) -> np.ndarray:
    """The number of each cell among the different ones in ascending order of (i, j, k), int64 (N,).

    cells: float64 N×3, whole numbers of any size.
    """
    if not len(cells):
        return np.empty(0, np.int64)
    low = cells.min(axis=0)
    sizes = cells.max(axis=0) - low + 1.0
    with np.errstate(over="ignore"):
        few = np.prod(sizes) < _LARGEST_KEY
    if few:
        i, j, k = (cells - low).astype(np.int64).T
        return _ranks((i * int(sizes[1]) + j) * int(sizes[2]) + k)
    i, j, k = (_ranks(axis) for axis in cells.T)  # each below N, so that the product of two fits
    return _ranks(_ranks(i * len(cells) + j) * len(cells) + k)


def _ranks(values: np.ndarray) -> np.ndarray:
    """The place of each value among the different ones in ascending order, int64 (N,)."""
    return np.unique(values, return_inverse=True)[1].astype(np.int64, copy=False)


def sample_triangles(vertices: np.ndarray, faces: np.ndarray, spacing: float, limit: int = MAX_POINTS) -> np.ndarray:
    """Points spread evenly over triangles, one for each spacing² of area and at most `limit`, float64 N×3.

    vertices: N×3. faces: integer M×3. Each triangle gets its share of the area, rounded so that the total is right;
    where in it the points lie is drawn with a fixed seed. Triangles that are not finite are left out.
    """
    corners = np.asarray(vertices, float)[faces]
    corners = corners[np.isfinite(corners).all(axis=(1, 2))]
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    area = np.cumsum(0.5 * np.linalg.norm(np.cross(b - a, c - a), axis=1))
    if not len(area) or area[-1] == 0.0:
        return np.empty((0, 3))
    count = int(np.clip(np.ceil(area[-1] / spacing**2), 1, limit))
    triangle = np.searchsorted(area, (np.arange(count) + 0.5) / count * area[-1])
    root, share = np.random.default_rng(0).random((2, count, 1))
    root = np.sqrt(root)
    return (1 - root) * a[triangle] + root * (1 - share) * b[triangle] + root * share * c[triangle]


def surface_metrics(
    points: np.ndarray,
    truth: np.ndarray,
    thresholds: tuple[float, ...] = THRESHOLDS,
    *,
    spacing: float = 0.0,
    source: str = "points",
    frames: int = 0,
) -> MapMetrics:
    """Compare points of a reconstructed surface with points of the true one, float N×3 and M×3, metres.

    With d(p, S) the distance of p from the nearest point of S, and R, T the two sets:
    P(τ) = |{p ∈ R: d(p, T) < τ}| / |R|, recall C(τ) = |{p ∈ T: d(p, R) < τ}| / |T|, F = 2 P C / (P + C).
    """
    accuracy, completeness = _distances(points, truth), _distances(truth, points)
    precision, recall = (tuple(_share(d, limit) for limit in thresholds) for d in (accuracy, completeness))
    return MapMetrics(
        source=source,
        frames=frames,
        spacing=float(spacing),
        points=len(points),
        true_points=len(truth),
        accuracy=error_statistics(accuracy),
        completeness=error_statistics(completeness),
        thresholds=tuple(thresholds),
        precision=precision,
        recall=recall,
        fscore=tuple(_harmonic(p, r) for p, r in zip(precision, recall, strict=True)),
    )


def _distances(points: np.ndarray, others: np.ndarray) -> np.ndarray:
    """Of each point from the nearest of the others; empty where there is none of either."""
    if not len(points) or not len(others):
        return np.empty(0)
    # A balanced tree of compact nodes is many times slower where the points lie on planes; with several workers, an
    # interruption frees what the others still write to.
    return cKDTree(others, balanced_tree=False, compact_nodes=False).query(points)[0]


def _share(distances: np.ndarray, limit: float) -> float:
    return float(np.mean(distances < limit)) if distances.size else float("nan")


def _harmonic(precision: float, recall: float) -> float:
    total = precision + recall
    return 2.0 * precision * recall / total if total else total
