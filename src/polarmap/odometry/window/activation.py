"""Activation: which immature points become active, so that these stay spread over the image (DSO, section 3.2)."""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pattern import OUTLIER_ENERGY
from polarmap.odometry.points import ActivePoints, ImmaturePoints
from polarmap.odometry.window.residuals import GOOD
from polarmap.odometry.window.tracing import FOUND, GONE, SETTLED, UNCLEAR, refine_depths
from polarmap.odometry.window.window import Window, project

_MAX_LENGTH = 8.0  # pixels of the last search
_MIN_QUALITY = 3.0  # second best over best energy, below which a point is not distinct
_CELL = 2  # pixels
_FIRST_SPACING, _MAX_SPACING, _MIN_SPACING = 2.0, 4.0, 0.0  # cells
_SPACING_GAIN, _LARGEST_CHANGE = 4.0, 0.8  # cells: by which the spacing changes per share of points too many, at most


class Activator:
    """Turns immature points into active points, as many as bring the window to its number of points."""

    def __init__(self, options: OdometryOptions) -> None:
        self._options = options
        self._spacing = _FIRST_SPACING

    def activate(self, window: Window, leaving: set[int]) -> int:
        """Move immature points that are well known into the active points; returns how many.

        leaving: slots of keyframes about to leave, whose immature points are activated now or never.
        """
        self._adapt(len(window.points))
        immature = window.immature
        newest = window.newest
        ready = (
            np.isin(immature.status, (FOUND, SETTLED, UNCLEAR))
            & (immature.length < _MAX_LENGTH)
            & (immature.quality > _MIN_QUALITY)
            & np.isfinite(immature.highest)
        )
        hopeless = (immature.status == GONE) | (np.isin(immature.host, list(leaving)) & ~ready)
        depth = 0.5 * (immature.lowest + np.nan_to_num(immature.highest))
        projection = window.projection_to(newest.T_camera_world, newest.affine, newest.exposure)
        u, v, inside = project(immature.pixel, depth, immature.host, projection, window.camera.shape)
        hopeless |= ready & ~inside
        order = np.argsort(immature.length, kind="stable")
        order = order[(ready & inside)[order]]
        occupied = self._occupied(window, projection)
        chosen = np.sort(order[_spread(occupied, u[order], v[order], self._spacing)])  # as they lie: for memory's sake
        points, activated = self._refined(window, immature.select(chosen))
        used = np.zeros(len(immature), bool)
        used[chosen] = True
        window.immature = immature.select(~(used | hopeless | np.isin(immature.host, list(leaving))))
        window.points = window.points.joined(points)
        return activated

    def _adapt(self, active: int) -> None:
        """Fewer active points than wanted bring the new ones closer together, more push them apart."""
        ratio = active / self._options.points
        change = float(np.clip(_SPACING_GAIN * (ratio - 1.0), -_LARGEST_CHANGE, _LARGEST_CHANGE))
        self._spacing = float(np.clip(self._spacing + change, _MIN_SPACING, _MAX_SPACING))

    def _occupied(self, window: Window, projection) -> np.ndarray:
        height, width = window.camera.shape
        occupied = np.zeros((height // _CELL + 1, width // _CELL + 1), np.bool_)
        points = window.points
        u, v, inside = project(points.pixel, points.inverse_depth, points.host, projection, window.camera.shape)
        occupied[(v[inside] / _CELL).astype(int), (u[inside] / _CELL).astype(int)] = True
        return occupied

    def _refined(self, window: Window, chosen: ImmaturePoints) -> tuple[ActivePoints, int]:
        pairs = window.pairs()
        targets = np.array([k.slot for k in window.keyframes], np.int64)
        options = self._options
        depth, information, state = refine_depths(
            window.images, targets, chosen.host, chosen.pixel, chosen.color, chosen.weight,
            (0.5 * (chosen.lowest + chosen.highest)).astype(np.float32), pairs.KRKi, pairs.Kt, pairs.gain, pairs.offset,
            np.float32(options.huber), np.float32(options.gradient_constant**2), OUTLIER_ENERGY,
        )  # fmt: skip
        good = np.isfinite(depth) & (state == GOOD).any(axis=1)
        points = ActivePoints(
            chosen.host, chosen.pixel, depth, chosen.color, chosen.weight, state, information,
            np.zeros(len(chosen), np.int32),
        )  # fmt: skip
        return points.select(good), int(np.count_nonzero(good))


@njit
def _spread(occupied, u, v, spacing):
    """Which of the pixels, taken in this order, are at least `spacing` cells from all occupied ones."""
    height, width = occupied.shape
    chosen = np.zeros(len(u), np.bool_)
    reach = np.int64(np.ceil(spacing))
    for p in range(len(u)):
        x, y = np.int64(u[p] / _CELL), np.int64(v[p] / _CELL)
        free = True
        for dy in range(-reach, reach + 1):
            for dx in range(-reach, reach + 1):
                if dx * dx + dy * dy < spacing * spacing and 0 <= y + dy < height and 0 <= x + dx < width:
                    free = free and not occupied[y + dy, x + dx]
        if free:
            chosen[p] = True
            occupied[y, x] = True
    return chosen
