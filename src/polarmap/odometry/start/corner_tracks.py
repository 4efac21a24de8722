"""Corners of one frame followed through later frames by pyramidal Lucas-Kanade, without drift.

Every track is first carried on from the frame before (Lucas and Kanade, IJCAI 1981; Bouguet's pyramid) and then
aligned anew with its patch of the *first* frame, by the inverse compositional method (Baker and Matthews, IJCV 2004,
section 3.2) with a gain and an offset projected out, so that errors do not add up and a change of exposure does
not matter. Where the frames are too far apart for that, ORB descriptors (Rublee et al., ICCV 2011) are matched with
the first frame instead.
"""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.jit import njit
from polarmap.options import Options, parameter

_LEVELS = 4  # of the Lucas-Kanade pyramid above the image
_BLOCK = 5  # side of the window over which a corner's strength is summed, pixels
_STEPS = 12  # of the alignment at most
_CONVERGED = 0.02  # pixels
_MIN_SHARE = 0.4  # of the tracks must survive a step; otherwise descriptors are matched
_DESCRIPTORS = 1200
_ORB_BORDER = 31  # pixels at the image's border without ORB key points


class CornerOptions(Options):
    """Which corners are followed and when a track ends."""

    corners: int = parameter(700, "corners that are followed at most", ge=50, le=5000)
    grid: int = parameter(8, "cells along the image's width among which the corners are spread", ge=1, le=64)
    spacing: int = parameter(4, "least distance of two corners", "pixels", ge=1, le=50)
    patch_radius: int = parameter(6, "of the square patch that is aligned with the first frame", "pixels", ge=3, le=20)
    min_correlation: float = parameter(0.85, "with the patch of the first frame; the track ends below", ge=0, le=0.999)
    max_correction: float = parameter(
        3.0, "by the alignment with the first frame; the track ends beyond", "pixels", ge=0.01, le=100
    )


class CornerTracks:
    """Corners of a first image and where they are in the latest one.

    first: float64 N×2, whole pixels (u, v) of the first image. current: float64 N×2, (u, v) in the latest image.
    """

    def __init__(self, image: np.ndarray, options: CornerOptions | None = None) -> None:
        """image: the first one, float32 H×W in [0, 1]."""
        self._options = options or CornerOptions()
        self._first_image = _tone(image)
        self._latest = _eight_bit(self._first_image)
        self._first_eight_bit = self._latest
        self._described: tuple | None = None
        self._follow(_strong_corners(self._first_image, self._options))

    def __len__(self) -> int:
        return len(self.first)

    def advance(self, image: np.ndarray) -> None:
        """Finds the corners in the next image, float32 H×W; those that are lost are left out from here on."""
        toned = _tone(image)
        eight_bit = _eight_bit(toned)
        before = len(self)
        if before:
            self._carry(eight_bit)
            self._align(toned)
        if len(self) < _MIN_SHARE * before or before == 0:
            self._match_descriptors(eight_bit, toned)
        self._latest = eight_bit

    def _follow(self, corners: np.ndarray) -> None:
        self.first = corners.astype(float)
        self.current = self.first.copy()
        self._templates = _templates(self._first_image, corners, self._options.patch_radius)

    def _carry(self, image: np.ndarray) -> None:
        found, status, _ = cv2.calcOpticalFlowPyrLK(
            self._latest,
            image,
            self.current.astype(np.float32)[:, None],
            None,
            winSize=(17, 17),
            maxLevel=_LEVELS,
            criteria=(cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 20, 0.03),
        )
        self.current = found[:, 0].astype(float)
        self._keep(status[:, 0] > 0)

    def _align(self, image: np.ndarray) -> None:
        aligned, correlation = _aligned(image, self.current, *self._templates)
        near = np.abs(aligned - self.current).max(axis=1, initial=0.0) <= self._options.max_correction
        self.current = aligned
        self._keep(near & (correlation >= self._options.min_correlation))

    def _keep(self, kept: np.ndarray) -> None:
        self.first, self.current = self.first[kept], self.current[kept]
        self._templates = tuple(array[kept] for array in self._templates)

    def _match_descriptors(self, eight_bit: np.ndarray, toned: np.ndarray) -> None:
        """Replaces the tracks by key points matched between the first image and this one, if those are more."""
        if min(eight_bit.shape) <= 2 * _ORB_BORDER:
            return
        kept = self.first, self.current, self._templates
        orb = cv2.ORB_create(_DESCRIPTORS)
        if self._described is None:
            self._described = orb.detectAndCompute(self._first_eight_bit, None)
        pairs = _mutual_matches(self._described, orb.detectAndCompute(eight_bit, None))
        corners, unique = np.unique(np.rint(pairs[:, :2]).astype(np.int64), axis=0, return_index=True)
        inside = _inside(corners, toned.shape, self._options.patch_radius + 1)
        corners, pairs = corners[inside], pairs[unique[inside]]
        self._follow(corners)
        self.current = pairs[:, 2:] + (corners - pairs[:, :2])
        self._align(toned)
        if len(self) <= len(kept[0]):
            self.first, self.current, self._templates = kept


def _tone(image: np.ndarray) -> np.ndarray:
    """I / (I + median), lightly smoothed, float32: the same for any exposure, and dark parts keep their contrast."""
    clean = np.maximum(np.nan_to_num(image, nan=0.0, posinf=1.0), 0.0)
    level = max(float(np.median(clean[::4, ::4])), 1e-4)
    return cv2.GaussianBlur((clean / (clean + level)).astype(np.float32), (3, 3), 0.7)


def _eight_bit(toned: np.ndarray) -> np.ndarray:
    return np.rint(toned * 255).astype(np.uint8)


def _inside(corners: np.ndarray, shape: tuple[int, int], border: int) -> np.ndarray:
    high = np.array([shape[1], shape[0]]) - 1 - border
    return ((corners >= border) & (corners <= high)).all(axis=1)


def _strong_corners(image: np.ndarray, options: CornerOptions) -> np.ndarray:
    """Shi and Tomasi's corners (CVPR 1994) that stand out from the noise, the strongest of each cell, int64 N×2."""
    if min(image.shape) < 2 * options.patch_radius + 5:
        return np.zeros((0, 2), np.int64)
    strength = cv2.cornerMinEigenVal(image, _BLOCK, ksize=3)
    side = 2 * options.spacing + 1
    peak = (strength == cv2.dilate(strength, np.ones((side, side), np.uint8))) & (strength > _least_strength(image))
    v, u = np.nonzero(peak)
    corners = np.stack([u, v], axis=1)
    corners = corners[_inside(corners, image.shape, options.patch_radius + 1)]
    return _spread(corners, strength[corners[:, 1], corners[:, 0]], image.shape, options)


def _least_strength(image: np.ndarray) -> float:
    """Several times what noise alone gives; the noise from second differences (Immerkaer, CVIU 1996), robustly."""
    kernel = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    noise = float(np.median(np.abs(cv2.filter2D(image, -1, kernel)))) / (0.6745 * 6)
    return max(8 * noise**2, (0.5 / 255) ** 2)


def _spread(corners: np.ndarray, strength: np.ndarray, shape: tuple[int, int], options: CornerOptions) -> np.ndarray:
    """The strongest of each cell in turn until there are enough, so that no part of the image has them all."""
    size = shape[1] / options.grid
    order = np.argsort(-strength, kind="stable")
    corners = corners[order]
    cell = (corners[:, 1] // size) * options.grid + corners[:, 0] // size
    by_cell = np.argsort(cell, kind="stable")
    starts = np.flatnonzero(np.diff(cell[by_cell], prepend=-1.0))
    rank = np.empty(len(corners), np.int64)
    rank[by_cell] = np.arange(len(corners)) - np.repeat(starts, np.diff(starts, append=len(corners)))
    return corners[np.argsort(rank, kind="stable")[: options.corners]]


def _templates(image: np.ndarray, corners: np.ndarray, radius: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Per corner: the patch with mean 0 and norm 1, the update's two rows H⁻¹ Jᵀ, and whether H is regular.

    J is the patch's gradient without its component along a constant and along the patch itself, which a change of
    offset and gain would explain.
    """
    span = np.arange(-radius, radius + 1)
    rows, columns = corners[:, 1, None, None] + span[:, None], corners[:, 0, None, None] + span
    count = len(span) ** 2
    patch = image[rows, columns].reshape(-1, count)
    gradient = np.stack(
        [image[rows, columns + 1] - image[rows, columns - 1], image[rows + 1, columns] - image[rows - 1, columns]]
    )
    J = 0.5 * gradient.reshape(2, -1, count).transpose(1, 0, 2)
    patch = patch - patch.mean(axis=1, keepdims=True)
    norm = np.maximum(np.linalg.norm(patch, axis=1), 1e-6)
    patch, J = patch / norm[:, None], J / norm[:, None, None]
    J = J - J.mean(axis=2, keepdims=True)
    J = J - (J @ patch[:, :, None]) * patch[:, None]
    H = (J @ J.transpose(0, 2, 1)).astype(float) + 1e-9 * np.eye(2)
    return patch.astype(np.float32), (np.linalg.inv(H) @ J).astype(np.float32)


@njit(error_model="numpy")
def _aligned(image, guess, patches, updates):
    """Positions aligned with the patches, float64 N×2, and the normalized correlation there (0 outside the image)."""
    count = len(guess)
    found, correlation = guess.copy(), np.zeros(count)
    side = int(np.sqrt(patches.shape[1]) + 0.5)
    for i in range(count):
        u, v = guess[i, 0], guess[i, 1]
        for _ in range(_STEPS):
            correlation[i], du, dv = _step(image, u, v, patches[i], updates[i], side)
            u, v = u - du, v - dv
            if correlation[i] <= 0.0 or du * du + dv * dv < _CONVERGED**2:
                break
        found[i, 0], found[i, 1] = u, v
    return found, correlation


@njit(error_model="numpy")
def _step(image, u, v, patch, update, side):
    """Correlation at (u, v) and the displacement by which the patch is off there; (0, 0, 0) outside the image."""
    left, top = u - side // 2, v - side // 2
    if not (left >= 0 and top >= 0 and left + side < image.shape[1] and top + side < image.shape[0]):
        return 0.0, 0.0, 0.0
    column, row = int(left), int(top)
    a, b = np.float32(left - column), np.float32(top - row)
    one = np.float32(1.0)
    w00, w01, w10, w11 = (one - a) * (one - b), a * (one - b), (one - a) * b, a * b
    total, square, product, du, dv = 0.0, 0.0, 0.0, 0.0, 0.0
    k = 0
    for y in range(row, row + side):
        for x in range(column, column + side):
            value = w00 * image[y, x] + w01 * image[y, x + 1] + w10 * image[y + 1, x] + w11 * image[y + 1, x + 1]
            total += value
            square += value * value
            product += value * patch[k]
            du += value * update[0, k]
            dv += value * update[1, k]
            k += 1
    norm = np.sqrt(max(square - total * total / k, 1e-12))
    return product / norm, du / norm, dv / norm


def _mutual_matches(first: tuple, second: tuple) -> np.ndarray:
    """Pixels (u, v, u', v') of key points that are each other's best match, clearly so, float64 N×4."""
    (points, descriptors), (other_points, other_descriptors) = first, second
    if descriptors is None or other_descriptors is None or min(len(points), len(other_points)) < 2:
        return np.zeros((0, 4))
    matcher = cv2.BFMatcher(cv2.NORM_HAMMING)
    forward = matcher.knnMatch(descriptors, other_descriptors, k=2)
    backward = {m.queryIdx: m.trainIdx for m in matcher.match(other_descriptors, descriptors)}
    good = [m for m, n in forward if m.distance < 0.8 * n.distance and backward.get(m.trainIdx) == m.queryIdx]
    return np.array([points[m.queryIdx].pt + other_points[m.trainIdx].pt for m in good], float).reshape(-1, 4)
