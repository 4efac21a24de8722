"""Candidate points: pixels whose gradient stands out in their region (DSO, section 3.2)."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.jit import njit
from polarmap.odometry.pyramid import Pyramid

_BLOCK = 32  # pixels of a region that shares a threshold
_BINS = 64  # of the histogram of gradient magnitudes, one grey value each
_COARSER_FACTOR = 0.75  # of the threshold, from block size to block size
_BORDER = 4  # pixels; the pattern and the gradients under it fit in, and a rest for rounding
_FIRST_SPACING, _MAX_SPACING, _MIN_SPACING = 8.0, 40.0, 1.0  # pixels, side d of the blocks
_TRIALS = 4  # of a spacing
_FEWEST, _MOST = 0.8, 1.25  # found over wanted points, with which a spacing is kept
_THINNED_ABOVE = 1.1  # found over wanted points


class PointSelector:
    """Chooses about `count` pixels of an image, spread over it.

    The image is cut into d×d blocks, and in each the pixel of largest gradient is taken if it stands out: the
    median gradient of its 32×32 region plus `threshold`, smoothed over 3×3 regions. Where no d×d block of a
    2d×2d block has one, the larger block is tried with 0.75 of the threshold, then the 4d×4d one. d follows
    from image to image what was found.
    """

    def __init__(self, threshold: float, seed: int = 0, valid: np.ndarray | None = None) -> None:
        """valid: bool H×W, pixels that the lens shows; those within 4 pixels of others are not chosen."""
        self._threshold = threshold
        self._valid = None if valid is None or valid.all() else _eroded(valid)
        self._seed = seed
        self._spacing = _FIRST_SPACING

    def select(self, pyramid: Pyramid, count: int) -> np.ndarray:
        """Pixels (u, v), int32 N×2, row by row, at least 4 from the border; N within a quarter of `count` if it can."""
        level = pyramid.levels[0]
        thresholds = _region_thresholds(level, self._threshold)
        for _ in range(_TRIALS):
            mask = np.zeros(level.shape[:2], np.bool_)
            found = _pick(level, thresholds, max(1, round(self._spacing)), self._seed, mask)
            wanted = self._spacing * np.sqrt(max(found, 1) / count)
            previous, self._spacing = round(self._spacing), float(np.clip(wanted, _MIN_SPACING, _MAX_SPACING))
            if _FEWEST * count <= found <= _MOST * count or round(self._spacing) == previous:
                break
        if self._valid is not None:
            mask &= self._valid
        v, u = np.divmod(np.flatnonzero(mask), mask.shape[1])  # faster than np.nonzero of two axes
        if len(u) > _THINNED_ABOVE * count:  # thin evenly
            keep = np.random.default_rng(self._seed).permutation(len(u))[:count]
            keep.sort()
            u, v = u[keep], v[keep]
        self._seed += 1
        return np.stack([u, v], axis=1).astype(np.int32)


def _eroded(valid: np.ndarray) -> np.ndarray:
    size = 2 * _BORDER + 1
    return cv2.erode(valid.astype(np.uint8), np.ones((size, size), np.uint8)) > 0


def _region_thresholds(level: np.ndarray, above_median: float) -> np.ndarray:
    """Threshold on the gradient magnitude of each 32×32 region, float32."""
    medians = _region_medians(level)
    padded = np.pad(medians + np.float32(above_median), 1, mode="edge")
    rows, columns = medians.shape
    windows = [padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3)]
    return np.mean(windows, axis=0, dtype=np.float32)


@njit
def _region_medians(level):
    height, width = level.shape[:2]
    rows, columns = (height + _BLOCK - 1) // _BLOCK, (width + _BLOCK - 1) // _BLOCK
    medians = np.empty((rows, columns), np.float32)
    last_bin = np.float32(_BINS - 1)
    for r in range(rows):
        histogram, bins = np.zeros(_BINS, np.int64), np.zeros(_BLOCK, np.uint32)
        for c in range(columns):
            histogram[:] = 0
            left, right = c * _BLOCK, min((c + 1) * _BLOCK, width)
            count = 0
            for y in range(r * _BLOCK, min((r + 1) * _BLOCK, height)):
                for x in range(left, right):
                    g = np.sqrt(level[y, x, 1] * level[y, x, 1] + level[y, x, 2] * level[y, x, 2])
                    bins[x - left] = np.uint32(min(g, last_bin))
                for x in range(right - left):
                    histogram[bins[x]] += 1
                count += right - left
            below = 0
            median = 0
            while 2 * (below + histogram[median]) < count:
                below += histogram[median]
                median += 1
            medians[r, c] = median
    return medians


@njit
def _direction(block, seed):
    """A unit vector that looks random, from a hash of the block's number."""
    h = np.uint32(block * 2654435761 + seed * 40503 + 12345)
    h ^= h >> np.uint32(15)
    h *= np.uint32(2246822519)
    h ^= h >> np.uint32(13)
    angle = np.float32(h & np.uint32(1023)) * np.float32(np.pi / 1024)
    return np.cos(angle), np.sin(angle)


@njit
def _pick(level, thresholds, spacing, seed, mask):
    """Marks the chosen pixels in `mask`; returns their number.

    Among the pixels of a block above the threshold, the one with the largest gradient along a random direction is
    taken, so that edges of every direction are found.
    """
    height, width = level.shape[:2]
    size = 4 * spacing
    rows, columns = (height + size - 1) // size, (width + size - 1) // size
    counts = np.zeros(rows, np.int64)
    for r in range(rows):
        for c in range(columns):
            found_in_largest = 0
            for half in range(4):
                y1, x1 = r * size + (half // 2) * 2 * spacing, c * size + (half % 2) * 2 * spacing
                found_in_middle = 0
                for quarter in range(4):
                    y0, x0 = y1 + (quarter // 2) * spacing, x1 + (quarter % 2) * spacing
                    found_in_middle += _pick_one(level, thresholds, y0, x0, spacing, np.float32(1.0), seed, mask)
                if found_in_middle == 0:
                    found_in_middle = _pick_one(
                        level, thresholds, y1, x1, 2 * spacing, np.float32(_COARSER_FACTOR), seed, mask
                    )
                found_in_largest += found_in_middle
            if found_in_largest == 0:
                found_in_largest = _pick_one(
                    level, thresholds, r * size, c * size, size, np.float32(_COARSER_FACTOR**2), seed, mask
                )
            counts[r] += found_in_largest
    return counts.sum()


@njit
def _pick_one(level, thresholds, y0, x0, size, factor, seed, mask):
    height, width = level.shape[:2]
    du, dv = _direction(y0 * width + x0, seed)
    best = np.float32(0.0)
    best_x, best_y = -1, -1
    for y in range(max(y0, _BORDER), min(y0 + size, height - _BORDER)):
        for x in range(max(x0, _BORDER), min(x0 + size, width - _BORDER)):
            gx, gy = level[y, x, 1], level[y, x, 2]
            threshold = factor * thresholds[y // _BLOCK, x // _BLOCK]
            if gx * gx + gy * gy > threshold * threshold:
                along = abs(du * gx + dv * gy)
                if along > best:
                    best, best_x, best_y = along, x, y
    if best_x < 0:
        return 0
    mask[best_y, best_x] = True
    return 1
