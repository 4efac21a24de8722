"""How scenes place their things: poses by a centre and an axis, and the usual texture."""

from __future__ import annotations

import numpy as np

from polarmap.synth.scene import Pattern, Texture

Point = tuple[float, float, float]

X_AXIS, Y_AXIS, Z_AXIS = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def noise(size: float, seed: int, contrast: float = 0.9) -> Texture:
    """Value noise of five octaves from `size` metres down."""
    return Texture(Pattern.NOISE, size=size, contrast=contrast, octaves=5, seed=seed)


def pose(centre: Point, z_axis: Point = Z_AXIS, up: Point = Z_AXIS, turn: float = 0.0) -> np.ndarray:
    """T_world_object with the object's z along `z_axis` and its x level, then turned about z by `turn`."""
    z = np.asarray(z_axis, float)
    x = np.cross(up, z)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-6 else np.array([1.0, 0.0, 0.0])
    y = np.cross(z, x)
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x, z], axis=1)
    T[:3, 3] = centre
    return T
