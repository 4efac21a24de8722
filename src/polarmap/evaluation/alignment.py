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


def align_poses(poses: np.ndarray, truth: np.ndarray, scale: float = 1.0) -> Similarity:
    """The similarity of a given scale that takes a trajectory's world to the true one, T_world_camera N×4×4 both.

    R is the rotation nearest to Σ R_true R_runᵀ, t = mean(t_true) - scale R mean(t_run). Positions alone leave R
    open where the camera moves along a line, and know it badly where it moves little; orientations do not.
    Raises InputError where there is no pose.
    """
    if len(poses) == 0 or poses.shape != truth.shape:
        raise InputError(f"alignment: needs poses in pairs, not {poses.shape} and {truth.shape}")
    U, _, Vt = np.linalg.svd(np.einsum("nij,nkj->ik", truth[:, :3, :3], poses[:, :3, :3]))
    rotation = (U * [1.0, 1.0, np.sign(np.linalg.det(U @ Vt))]) @ Vt
    means = poses[:, :3, 3].mean(axis=0), truth[:, :3, 3].mean(axis=0)
    return Similarity(scale, rotation, means[1] - scale * rotation @ means[0])
