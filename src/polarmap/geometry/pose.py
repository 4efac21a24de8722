"""Rigid motions as 4×4 matrices: `T_a_b` takes points of frame b to frame a."""

from __future__ import annotations

import numpy as np
from scipy.spatial.transform import Rotation

from polarmap.errors import InputError

_MOTION_BITS = 16


def inverse(T_a_b: np.ndarray) -> np.ndarray:
    """T_b_a, float64 4×4, of a rigid motion."""
    R, t = T_a_b[:3, :3], T_a_b[:3, 3]
    T_b_a = np.eye(4)
    T_b_a[:3, :3] = R.T
    T_b_a[:3, 3] = -R.T @ t
    return T_b_a


def without_noise(T: np.ndarray) -> np.ndarray:
    """A motion with its translation rounded to sixteen bits, relative to its largest component.

    That is 1/65 000 of it at most, far below what any pose is known to, and far above what is left of the rounding of
    positions in a world with a distant origin. So the motion between two views is the same wherever that origin is.
    """
    translation = T[:3, 3]
    _, exponent = np.frexp(np.abs(translation).max())
    step = np.ldexp(1.0, int(exponent) - _MOTION_BITS)
    rounded = T.copy()
    if step > 0:
        rounded[:3, 3] = step * np.round(translation / step)
    return rounded


def orthonormalized(T: np.ndarray) -> np.ndarray:
    """The rigid motion nearest to a 4×4 matrix that is one but for rounding.

    Long products need it: `inverse` transposes, so each product of a motion with another's inverse enlarges errors.
    """
    U, _, Vt = np.linalg.svd(T[:3, :3])
    rigid = T.copy()
    rigid[:3, :3] = U @ Vt
    return rigid


def is_rigid(T: np.ndarray, tolerance: float = 1e-3) -> bool:
    """Whether an array is a finite 4×4 rotation with translation, each product of axes right to `tolerance`."""
    if T.shape != (4, 4) or not np.isfinite(T).all() or not np.allclose(T[3], (0, 0, 0, 1)):
        return False
    return is_rotation(T[:3, :3], tolerance)


def is_rotation(R: np.ndarray, tolerance: float = 1e-3) -> bool:
    """Whether a finite 3×3 matrix is a rotation, each product of axes right to `tolerance`."""
    return bool(np.abs(R.T @ R - np.eye(3)).max() <= tolerance and np.linalg.det(R) > 0)


def from_quaternion(translation: np.ndarray, quaternion_xyzw: np.ndarray) -> np.ndarray:
    """4×4 motion from a translation and a quaternion (x, y, z, w), normalized here.

    Raises InputError where a number is not finite or the quaternion is zero.
    """
    translation = np.asarray(translation, float)
    quaternion = np.asarray(quaternion_xyzw, float)
    if not (np.isfinite(translation).all() and np.isfinite(quaternion).all()):
        raise InputError("pose: translation and quaternion must be finite")
    norm = np.linalg.norm(quaternion)
    if norm < 1e-6:
        raise InputError("pose: the quaternion is zero")
    T = np.eye(4)
    T[:3, :3] = Rotation.from_quat(quaternion / norm).as_matrix()
    T[:3, 3] = translation
    return T


def to_quaternion(T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Translation (3,) and quaternion (x, y, z, w), w >= 0, of a 4×4 motion."""
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat()
    return T[:3, 3].copy(), quaternion if quaternion[3] >= 0 else -quaternion


def look_at(eye: np.ndarray, target: np.ndarray, up: np.ndarray = (0.0, 0.0, 1.0)) -> np.ndarray:
    """T_world_camera of a camera at `eye` whose z axis meets `target`, with world `up` upward in the image.

    Raises InputError where the viewing direction is parallel to `up`.
    """
    eye, target, up = (np.asarray(v, float) for v in (eye, target, up))
    z = target - eye
    x = np.cross(z, up)
    if np.linalg.norm(x) < 1e-9 * max(np.linalg.norm(z), 1.0):
        raise InputError("look_at: the viewing direction is parallel to up")
    z /= np.linalg.norm(z)
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = eye
    return T
