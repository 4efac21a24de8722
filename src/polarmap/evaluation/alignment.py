"""The similarity that best takes one set of points to another (Umeyama, PAMI 13(4), 1991)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError


@dataclass(frozen=True)
class Similarity:
    """x -> scale · rotation · x + translation. rotation: float64 3×3. translation: float64 (3,)."""

    scale: float
    rotation: np.ndarray
    translation: np.ndarray

    def apply(self, points: np.ndarray) -> np.ndarray:
        """The points N×3, moved."""
        return self.scale * points @ self.rotation.T + self.translation


def umeyama(source: np.ndarray, target: np.ndarray, with_scale: bool = True) -> Similarity:
    """The similarity (rigid motion unless `with_scale`) with the least Σ |target - T(source)|², N×3 points both.

    With Σ = (1/N) Σ (y - ȳ)(x - x̄)ᵀ = U D Vᵀ and S = diag(1, 1, det U det V): R = U S Vᵀ, c = tr(D S)/σ_x²,
    t = ȳ - c R x̄ (equations 34-43). S keeps a mirrored set from becoming a reflection.
    Raises InputError where there is no point, or the scale is wanted of points that are all the same.
    """
    if source.shape != target.shape or source.ndim != 2 or source.shape[1] != 3 or len(source) == 0:
        raise InputError(f"alignment: needs points Nx3 in pairs, not {source.shape} and {target.shape}")
    mean_source, mean_target = source.mean(axis=0), target.mean(axis=0)
    x, y = source - mean_source, target - mean_target
    U, D, Vt = np.linalg.svd(y.T @ x / len(x))
    S = np.array([1.0, 1.0, np.sign(np.linalg.det(U) * np.linalg.det(Vt))])
    rotation = (U * S) @ Vt
    scale = 1.0
    if with_scale:
        variance = float(np.sum(x**2)) / len(x)
        if variance == 0.0:
            raise InputError("alignment: the points are all the same, which tells no scale")
        scale = float(D @ S) / variance
    return Similarity(scale, rotation, mean_target - scale * rotation @ mean_source)
