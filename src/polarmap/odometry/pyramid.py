"""Image pyramids with gradients."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

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
    """Makes pyramids, re-using the memory of those that are given back. Threads may share one."""

    def __init__(self, camera: PinholeCamera) -> None:
        self.cameras = level_cameras(camera)
        self._free: list[Pyramid] = []

    def make(self, image: np.ndarray) -> Pyramid:
        """The pyramid of an image, H×W of the camera: float32 in [0, 1], or uint16 up to 65535."""
        try:
            pyramid = self._free.pop()
        except IndexError:
            pyramid = self._empty()
        packed = image.dtype == np.uint16
        plane = np.ascontiguousarray(image, np.uint16 if packed else np.float32)
        scale = np.float32(255.0 / 65535.0 if packed else 255.0)
        for level in pyramid.levels:
            plane, scale = _fill(plane, scale, level), np.float32(1.0)
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


@njit
def _fill(plane, scale, level):
    """Intensity, scale · plane, and its gradients into a level; returns the intensity at half the resolution.

    Half: the mean of 2×2 pixels; an odd last row or column is left out. The last three rows of intensity are kept
    beside the level, since vector instructions read rows of one channel faster than every third number.
    """
    height, width = plane.shape
    half = np.empty((height // 2, width // 2), np.float32)
    rows = np.empty((3, width), np.float32)
    for y in range(height + 1):
        if y < height:
            for x in range(width):
                rows[y % 3, x] = scale * np.float32(plane[y, x])
            if y % 2 == 1:
                _halve(rows[(y - 1) % 3], rows[y % 3], half[y // 2])
        if y > 0:
            above, here, below = rows[max(y - 2, 0) % 3], rows[(y - 1) % 3], rows[min(y, height - 1) % 3]
            _differences(above, here, below, 1 < y < height, level[y - 1])
    return half


@njit(inline="always")
def _halve(upper, lower, half):
    for x in range(len(half)):
        above, below = upper[2 * x] + upper[2 * x + 1], lower[2 * x] + lower[2 * x + 1]
        half[x] = np.float32(0.25) * (above + below)


@njit(inline="always")
def _differences(above, here, below, inner, level):
    """A row of a level; gradients are zero in the first and last row and column."""
    last = len(here) - 1
    half = np.float32(0.5) if inner else np.float32(0.0)
    level[0, 0], level[0, 1], level[0, 2] = here[0], 0.0, 0.0
    level[last, 0], level[last, 1], level[last, 2] = here[last], 0.0, 0.0
    for x in range(1, last):
        level[x, 0] = here[x]
        level[x, 1] = half * (here[x + 1] - here[x - 1])
        level[x, 2] = half * (below[x] - above[x])


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
