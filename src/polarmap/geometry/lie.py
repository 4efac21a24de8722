"""SE(3) as a Lie group: increments xi = (translation, rotation vector), applied from the left: exp(xi) T."""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit


def skew(w: np.ndarray) -> np.ndarray:
    """The matrix of the cross product: skew(w) @ p = w × p."""
    return np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])


def se3_exp(xi: np.ndarray) -> np.ndarray:
    """The motion of an increment (6,), float64 4×4, by the closed form of Rodrigues."""
    return exponential(np.ascontiguousarray(xi, np.float64))


@njit
def exponential(xi):
    """As `se3_exp`, for kernels: xi float64 (6,)."""
    x, y, z = xi[3], xi[4], xi[5]
    square = x * x + y * y + z * z
    angle = np.sqrt(square)
    if angle < 1e-4:
        sine, cosine, cubic = 1.0 - square / 6.0, 0.5 - square / 24.0, 1.0 / 6.0 - square / 120.0
    else:
        sine = np.sin(angle) / angle
        cosine = (1.0 - np.cos(angle)) / square
        cubic = (1.0 - sine) / square
    W = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    T = np.eye(4)
    for i in range(3):
        T[i, 3] = xi[i]
        for k in range(3):
            squared = xi[3 + i] * xi[3 + k] - (square if i == k else 0.0)  # of W
            T[i, k] += sine * W[i, k] + cosine * squared
            T[i, 3] += (cosine * W[i, k] + cubic * squared) * xi[k]
    return T


def se3_log(T: np.ndarray) -> np.ndarray:
    """The increment (6,) of a rigid motion whose rotation is below π: se3_exp(se3_log(T)) = T."""
    R = T[:3, :3]
    axis = 0.5 * np.array([R[2, 1] - R[1, 2], R[0, 2] - R[2, 0], R[1, 0] - R[0, 1]])
    sine = float(np.sqrt(axis @ axis))
    angle = np.arctan2(sine, 0.5 * (np.trace(R) - 1.0))
    w = axis * (angle / sine if sine > 1e-9 else 1.0)
    V = _translation_jacobian(w)
    return np.concatenate([np.linalg.solve(V, T[:3, 3]), w])


def adjoint(T: np.ndarray) -> np.ndarray:
    """Ad(T), ...×6×6, of motions ...×4×4: T exp(xi) = exp(Ad(T) xi) T."""
    R, t = T[..., :3, :3], T[..., :3, 3]
    Ad = np.zeros((*T.shape[:-2], 6, 6))
    Ad[..., :3, :3] = Ad[..., 3:, 3:] = R
    Ad[..., :3, 3:] = np.cross(t[..., :, None], R, axis=-2)
    return Ad


def _translation_jacobian(w: np.ndarray) -> np.ndarray:
    """V with t = V rho, column by column from the exponential itself."""
    columns = [se3_exp(np.concatenate([e, w]))[:3, 3] for e in np.eye(3)]
    return np.stack(columns, axis=1)
