"""Similarities of space: rigid motions with a scale, as `T_world_camera` of a camera whose own unit of length differs.

A monocular camera measures lengths in a unit of its own, which drifts; a loop that closes corrects poses by
similarities, of which rigid motions are those of scale 1 (Strasdat, Montiel, Davison, "Scale drift-aware large scale
monocular SLAM", RSS 2010, section III).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry import pose


@dataclass(frozen=True, eq=False)
class Sim3:
    """x -> scale · rotation · x + translation, which takes points of frame b to frame a as `T_a_b` does.

    scale: lengths of frame a per length of frame b, positive. rotation: float64 3×3. translation: float64 (3,), in
    lengths of frame a. Raises InputError where they are not finite, the scale is not positive or the rotation is none.
    """

    scale: float
    rotation: np.ndarray
    translation: np.ndarray

    def __post_init__(self) -> None:
        if not (np.isfinite(self.scale) and self.scale > 0):
            raise InputError(f"similarity: the scale must be positive and finite, not {self.scale}")
        if self.rotation.shape != (3, 3) or self.translation.shape != (3,) or not pose.is_rigid(self.rigid):
            raise InputError("similarity: needs a rotation 3x3 and a finite translation of three numbers")

    @classmethod
    def from_matrix(cls, T_a_b: np.ndarray) -> Sim3:
        """The similarity of scale 1 that a rigid 4×4 motion is. Raises InputError where it is not rigid."""
        if not pose.is_rigid(T_a_b):
            raise InputError("similarity: needs a rigid 4x4 motion")
        rigid = np.array(T_a_b, float)
        return cls(1.0, rigid[:3, :3], rigid[:3, 3])

    @property
    def rigid(self) -> np.ndarray:
        """Its rotation and translation without its scale, float64 4×4: at scale 1, the motion it was made from."""
        return _homogeneous(self.rotation, self.translation)

    @property
    def matrix(self) -> np.ndarray:
        """The whole similarity as a matrix of homogeneous points, float64 4×4: (scale · rotation, translation)."""
        return _homogeneous(self.scale * self.rotation, self.translation)

    def __matmul__(self, other: Sim3) -> Sim3:
        """`self` after `other`, S_a_c = S_a_b @ S_b_c; at scales of 1, the product of their 4×4 motions."""
        other_rigid = other.rigid
        rotation = (self.rigid @ other_rigid)[:3, :3]
        return Sim3(self.scale * other.scale, rotation, (self.matrix @ other_rigid)[:3, 3])

    def inverse(self) -> Sim3:
        """S_b_a, which undoes it: x -> (1/scale) · rotationᵀ · (x - translation)."""
        back = pose.inverse(self.rigid)
        return Sim3(1.0 / self.scale, back[:3, :3], back[:3, 3] / self.scale)

    def relative(self, other: Sim3) -> Sim3:
        """S_a_b of two similarities to the same frame, S_w_a (this one) and S_w_b (the other): S_w_a⁻¹ @ S_w_b."""
        return self.inverse() @ other

    def apply(self, points: np.ndarray) -> np.ndarray:
        """The points N×3 of frame b, in frame a."""
        return self.scale * points @ self.rotation.T + self.translation


def _homogeneous(linear: np.ndarray, translation: np.ndarray) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, :3] = linear
    matrix[:3, 3] = translation
    return matrix
