"""Image pyramids with gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit

_MIN_SIDE = 50  # pixels of the coarsest level's shorter side


@dataclass(frozen=True, eq=False)
class Pyramid:
    """A frame at half the resolution from level to level.

    levels: float32 H×W×3 each: intensity in [0, 255], its gradients along u and v per pixel of that level (central
    differences, zero at the border). Level 0 is the full image.
    """

    levels: tuple[np.ndarray, ...]

    @property
    def shape(self) -> tuple[int, int]:
        """Height and width of level 0."""
        return self.levels[0].shape[:2]


class PyramidFactory:
    """Makes pyramids, re-using the memory of those that are given back."""

    def __init__(self, camera: PinholeCamera) -> None:
        self.cameras = level_cameras(camera)
        self._free: list[Pyramid] = []

    def make(self, image: np.ndarray) -> Pyramid:
        """The pyramid of an image in [0, 1], float32 H×W of the camera."""
        pyramid = self._free.pop() if self._free else self._empty()
        first = pyramid.levels[0]
        _scale(image, first)
        for fine, coarse in zip(pyramid.levels, pyramid.levels[1:], strict=False):
            _halve(fine, coarse)
        for level in pyramid.levels:
            _gradients(level)
        return pyramid

    def give_back(self, pyramid: Pyramid) -> None:
        """Take a pyramid's memory for a later one; the caller must not use it any more."""
        self._free.append(pyramid)

    def _empty(self) -> Pyramid:
        return Pyramid(tuple(np.empty((c.height, c.width, 3), np.float32) for c in self.cameras))


def level_cameras(camera: PinholeCamera) -> tuple[PinholeCamera, ...]:
    """The cameras of a pyramid's levels; each halves the last, down to a shorter side of at least 50 pixels."""
    cameras = [camera]
    while min(cameras[-1].height, cameras[-1].width) // 2 >= _MIN_SIDE:
        last = cameras[-1]
        half = PinholeCamera(
            last.width // 2, last.height // 2, last.fx / 2, last.fy / 2, last.cx / 2 - 0.25, last.cy / 2 - 0.25
        )
        cameras.append(half)
    return tuple(cameras)


@njit(parallel=True)
def _scale(image, level):
    height, width = image.shape
    for y in prange(height):
        for x in range(width):
            level[y, x, 0] = np.float32(255.0) * image[y, x]


@njit(parallel=True)
def _halve(fine, coarse):
    """Mean of 2×2 pixels; an odd last row or column is left out."""
    height, width = coarse.shape[:2]
    for row in prange(height):
        y = np.int64(row)
        for x in range(width):
            above = fine[2 * y, 2 * x, 0] + fine[2 * y, 2 * x + 1, 0]
            below = fine[2 * y + 1, 2 * x, 0] + fine[2 * y + 1, 2 * x + 1, 0]
            coarse[y, x, 0] = np.float32(0.25) * (above + below)


@njit(parallel=True)
def _gradients(level):
    height, width = level.shape[:2]
    half = np.float32(0.5)
    for row in prange(height):
        y = np.int64(row)
        if y == 0 or y == height - 1:
            level[y, :, 1:] = 0.0
            continue
        level[y, 0, 1:] = 0.0
        level[y, width - 1, 1:] = 0.0
        for x in range(1, width - 1):
            level[y, x, 1] = half * (level[y, x + 1, 0] - level[y, x - 1, 0])
            level[y, x, 2] = half * (level[y + 1, x, 0] - level[y - 1, x, 0])


@njit(inline="always")
def sample(images, k, u, v):
    """Intensity and gradients of images[k] (float32 K×H×W×3) at a pixel, bilinear.

    The caller keeps (u, v) inside. The image is chosen by number since a slice would cost more than the sampling.
    """
    x = np.int64(u)
    y = np.int64(v)
    fu = u - np.float32(x)
    fv = v - np.float32(y)
    w11 = fu * fv
    w10 = fv - w11
    w01 = fu - w11
    w00 = np.float32(1.0) - fu - w10
    i = (
        w00 * images[k, y, x, 0] + w01 * images[k, y, x + 1, 0]
        + w10 * images[k, y + 1, x, 0] + w11 * images[k, y + 1, x + 1, 0]
    )  # fmt: skip
    gx = (
        w00 * images[k, y, x, 1] + w01 * images[k, y, x + 1, 1]
        + w10 * images[k, y + 1, x, 1] + w11 * images[k, y + 1, x + 1, 1]
    )  # fmt: skip
    gy = (
        w00 * images[k, y, x, 2] + w01 * images[k, y, x + 1, 2]
        + w10 * images[k, y + 1, x, 2] + w11 * images[k, y + 1, x + 1, 2]
    )  # fmt: skip
    return i, gx, gy
