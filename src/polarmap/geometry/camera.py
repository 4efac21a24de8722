"""Pinhole camera in OpenCV axes: x right, y down, z forward; the first pixel's centre is at (0, 0)."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import numpy as np

from polarmap.errors import InputError


@dataclass(frozen=True)
class PinholeCamera:
    """Intrinsics of an undistorted image, in pixels.

    Raises InputError where a size or a focal length is not positive and finite.
    """

    width: int
    height: int
    fx: float
    fy: float
    cx: float
    cy: float

    def __post_init__(self) -> None:
        if self.width < 1 or self.height < 1:
            raise InputError(f"camera: image size {self.width}x{self.height} is not positive")
        if not all(np.isfinite(v) for v in (self.fx, self.fy, self.cx, self.cy)):
            raise InputError("camera: fx, fy, cx and cy must be finite numbers")
        if self.fx <= 0 or self.fy <= 0:
            raise InputError(f"camera: focal lengths must be positive, not fx={self.fx}, fy={self.fy}")

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width), as NumPy has it."""
        return self.height, self.width

    @property
    def matrix(self) -> np.ndarray:
        """K, float64 3×3."""
        return np.array([[self.fx, 0.0, self.cx], [0.0, self.fy, self.cy], [0.0, 0.0, 1.0]])

    def scaled(self, factor: float) -> PinholeCamera:
        """The camera of the image resampled by `factor` (0.5 halves it), pixel areas kept aligned."""
        return PinholeCamera(
            width=max(1, round(self.width * factor)),
            height=max(1, round(self.height * factor)),
            fx=self.fx * factor,
            fy=self.fy * factor,
            cx=(self.cx + 0.5) * factor - 0.5,
            cy=(self.cy + 0.5) * factor - 0.5,
        )

    def resized(self, size: tuple[int, int]) -> PinholeCamera:
        """The camera of the image resampled to (height, width), whatever its proportions."""
        height, width = size
        x, y = width / self.width, height / self.height
        return PinholeCamera(
            width, height, self.fx * x, self.fy * y, (self.cx + 0.5) * x - 0.5, (self.cy + 0.5) * y - 0.5
        )

    def normalized(self) -> np.ndarray:
        """Normalized coordinates (x, y) = ((u-cx)/fx, (v-cy)/fy) of every pixel, float32 H×W×2, read-only."""
        return _normalized(self)

    def unproject(self, pixels: np.ndarray) -> np.ndarray:
        """The points at z = 1 that are seen at pixels (u, v), ...×2: normalized coordinates and 1, float64 ...×3."""
        xy = (pixels - np.array([self.cx, self.cy])) / np.array([self.fx, self.fy])
        return np.concatenate([xy, np.ones((*xy.shape[:-1], 1))], axis=-1)

    def rays(self) -> np.ndarray:
        """Unit viewing rays v, pointing away from the camera, float32 H×W×3, read-only."""
        return _rays(self)


@lru_cache(maxsize=8)
def _normalized(camera: PinholeCamera) -> np.ndarray:
    x = (np.arange(camera.width) - camera.cx) / camera.fx
    y = (np.arange(camera.height) - camera.cy) / camera.fy
    return _frozen(np.stack(np.meshgrid(x, y), axis=-1).astype(np.float32))


@lru_cache(maxsize=8)
def _rays(camera: PinholeCamera) -> np.ndarray:
    xy = camera.normalized()
    rays = np.concatenate([xy, np.ones((*xy.shape[:2], 1), np.float32)], axis=-1)
    return _frozen(rays / np.linalg.norm(rays, axis=-1, keepdims=True))


def _frozen(array: np.ndarray) -> np.ndarray:
    array.setflags(write=False)
    return array
