"""Activation: which candidates become active points, so that these stay spread over the image (DSO, section 3.2)."""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import ActivePoints, Candidates
from polarmap.odometry.window.residuals import GOOD
from polarmap.odometry.window.tracing import FOUND, GONE, SETTLED, UNCLEAR, refine_depths
from polarmap.odometry.window.window import Window

_MAX_LENGTH = 8.0  # pixels of the last search
_MIN_QUALITY = 3.0
_CELL = 2  # pixels
_MAX_SPACING, _MIN_SPACING = 4.0, 0.0  # cells


class Activator:
    """Turns candidates into active points, as many as bring the window to its number of points."""

    def __init__(self, options: OdometryOptions) -> None:
        self._options = options
        self._spacing = 2.0

    def activate(self, window: Window, leaving: set[int]) -> int:
        """Move candidates that are well known into the active points; returns how many.

        leaving: slots of keyframes about to leave, whose candidates are activated now or never.
        """
        self._adapt(len(window.points))
        candidates = window.candidates
        newest = window.newest
        ready = (
            np.isin(candidates.status, (FOUND, SETTLED, UNCLEAR))
            & (candidates.length < _MAX_LENGTH)
            & (candidates.quality > _MIN_QUALITY)
            & np.isfinite(candidates.highest)
        )
        hopeless = (candidates.status == GONE) | (np.isin(candidates.host, list(leaving)) & ~ready)
        depth = 0.5 * (candidates.lowest + np.nan_to_num(candidates.highest))
        projection = window.projection_to(newest.T_camera_world, newest.affine, newest.exposure)
        u, v, inside = project(candidates.pixel, depth, candidates.host, projection, window.camera.shape)
        hopeless |= ready & ~inside
        order = np.argsort(candidates.length, kind="stable")
        order = order[(ready & inside)[order]]
        occupied = self._occupied(window, projection)
        chosen = order[_spread(occupied, u[order], v[order], self._spacing)]
        points, activated = self._refined(window, candidates.select(chosen))
        used = np.zeros(len(candidates), bool)
        used[chosen] = True
        window.candidates = candidates.select(~(used | hopeless | np.isin(candidates.host, list(leaving))))
        window.points = window.points.joined(points)
        return activated

    def _adapt(self, active: int) -> None:
        """Fewer active points than wanted bring the new ones closer together, more push them apart."""
        ratio = active / self._options.points
        change = float(np.clip(4.0 * (ratio - 1.0), -0.8, 0.8))
        self._spacing = float(np.clip(self._spacing + change, _MIN_SPACING, _MAX_SPACING))

    def _occupied(self, window: Window, projection) -> np.ndarray:
        height, width = window.camera.shape
        occupied = np.zeros((height // _CELL + 1, width // _CELL + 1), np.bool_)
        points = window.points
        u, v, inside = project(points.pixel, points.inverse_depth, points.host, projection, window.camera.shape)
        occupied[(v[inside] / _CELL).astype(int), (u[inside] / _CELL).astype(int)] = True
        return occupied

    def _refined(self, window: Window, chosen: Candidates) -> tuple[ActivePoints, int]:
        pairs = window.pairs()
        targets = np.array([k.slot for k in window.keyframes], np.int64)
        options = self._options
        depth, information, state = refine_depths(
            window.images, targets, chosen.host, chosen.pixel, chosen.color, chosen.weight,
            (0.5 * (chosen.lowest + chosen.highest)).astype(np.float32), pairs.KRKi, pairs.Kt, pairs.gain, pairs.offset,
            np.float32(options.huber), np.float32(options.gradient_constant**2), np.float32(8 * 12.0**2),
        )  # fmt: skip
        good = np.isfinite(depth) & (state == GOOD).any(axis=1)
        points = ActivePoints(
            chosen.host, chosen.pixel, depth, chosen.color, chosen.weight, state, information,
            np.zeros(len(chosen), np.int32),
        )  # fmt: skip
        return points.select(good), int(np.count_nonzero(good))


def project(pixel, inverse_depth, host, projection, shape):
    """Pixels u, v (N each) of hosted points in a frame, and whether they are inside by four pixels."""
    rays = np.concatenate([pixel, np.ones((len(pixel), 1), np.float32)], axis=1)
    p = np.einsum("nij,nj->ni", projection.KRKi[host], rays) + inverse_depth[:, None] * projection.Kt[host]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    inside = (p[:, 2] > 0) & (u > 3) & (v > 3) & (u < shape[1] - 4) & (v < shape[0] - 4)
    return u, v, inside


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
