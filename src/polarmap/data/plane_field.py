"""What stereo gives: the plane of every pixel."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.geometry.camera import PinholeCamera


@dataclass(frozen=True)
class PlaneField:
    """The best plane of every pixel, float32 H×W each.

    inverse_depth: 1/z at the pixel. gradient_u, gradient_v: its change per pixel.
    score: how well it matches, from 0 for not at all to 1. sigma: standard deviation of inverse_depth by image noise,
    infinite where the image does not respond to depth by more than noise.
    window: side in pixels of what was compared, so that a pixel without texture may have been matched by its
        neighbours'.
    """

    inverse_depth: np.ndarray
    gradient_u: np.ndarray
    gradient_v: np.ndarray
    score: np.ndarray
    sigma: np.ndarray
    window: int = 1

    @classmethod
    def empty(cls, shape: tuple[int, int]) -> PlaneField:
        """No match anywhere: unit depth of score 0."""
        zero = np.zeros(shape, np.float32)
        one = np.ones(shape, np.float32)
        return cls(one, zero, zero, zero, one * np.inf)

    @property
    def depth(self) -> np.ndarray:
        """z, float32 H×W."""
        return 1.0 / self.inverse_depth

    def normals(self, camera: PinholeCamera) -> np.ndarray:
        """Unit normals toward the camera, float32 H×W×3: a plane αX + βY + γZ = 1 has 1/z = αx + βy + γ."""
        xy = camera.normalized()
        alpha, beta = self.gradient_u * camera.fx, self.gradient_v * camera.fy
        gamma = self.inverse_depth - alpha * xy[..., 0] - beta * xy[..., 1]
        normal = -np.stack([alpha, beta, gamma], axis=-1)
        return normal / np.linalg.norm(normal, axis=-1, keepdims=True)
