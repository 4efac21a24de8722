"""A posed picture, which is what stereo, densification and the map are made of."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.cells import cell_minima
from polarmap.geometry.pose import inverse, without_noise
from polarmap.geometry.sim3 import Sim3

SEEN_BLOCK = 3  # pixels, side of the blocks that a witness keeps one depth of
_AGREEMENT = np.float32(0.03)  # relative difference of depth, up to which stereo and the dense map say the same


@dataclass(frozen=True, eq=False)
class View:
    """A picture with its pose, and as far as it was mapped its depth.

    T_world_camera: float64 4×4; the world may be any that all views share. given: whether the pose comes from outside
    and stays. scale: by which lengths have grown, in its world, since it came.
    stereo: the depth that stereo defends. depth: after densification; both float32 H×W z with NaN, None before it is
    mapped. planes: (α, β, γ) float64 N×3 with α X + β Y + γ Z = 1 in the camera's frame, which hold a good part of the
    view; None where that is not known. known: z of points in it, float32 N, as whoever found its pose knows them; None
    where there are none.
    """

    image: PolarizationImage
    T_world_camera: np.ndarray
    index: int = 0
    timestamp: float = float("nan")
    given: bool = False
    scale: float = 1.0
    stereo: np.ndarray | None = None
    depth: np.ndarray | None = None
    planes: np.ndarray | None = None
    known: np.ndarray | None = None

    def motion_to(self, other: View) -> np.ndarray:
        """T_other_this, float64 4×4."""
        return relative_motion(self.T_world_camera, other.T_world_camera, self.given and other.given)

    @cached_property
    def witness(self) -> Witness | None:
        """What the view surely sees: stereo depth that the dense one agrees with; None before the view is mapped."""
        if self.stereo is None or self.depth is None:
            return None
        sure = np.abs(self.stereo - self.depth) < _AGREEMENT * self.depth
        nearest = cell_minima(np.where(sure, self.stereo, np.float32(np.inf)), SEEN_BLOCK)
        nearest[np.isinf(nearest)] = np.nan
        return Witness(nearest, self.T_world_camera, self.index, self.given, self.scale)

    def neighbour(self, other: View) -> Neighbour:
        """The other view as this one sees it."""
        return Neighbour(other.image.stable, self.motion_to(other), other.stereo)

    def moved(self, pose: Sim3) -> View:
        """The same view at another T_world_camera; what is known of its depth grows with the pose's scale."""
        growth = pose.scale / self.scale
        moved = replace(self, T_world_camera=pose.rigid, scale=pose.scale)
        if growth == 1.0:
            return moved
        return replace(
            moved,
            stereo=None if self.stereo is None else np.float32(growth) * self.stereo,
            depth=None if self.depth is None else np.float32(growth) * self.depth,
            planes=None if self.planes is None else self.planes / growth,
            known=None if self.known is None else np.float32(growth) * self.known,
        )


@dataclass(frozen=True, eq=False)
class Neighbour:
    """Another view, to validate depth against.

    image: √intensity, float32 H×W. T_other_this: float64 4×4. depth: float32 H×W z with NaN, None where not known.
    """

    image: np.ndarray
    T_other_this: np.ndarray
    depth: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class Witness:
    """Points that a view surely sees, and from where: nothing stands between.

    nearest: the least z of the points in each block of `SEEN_BLOCK`² pixels, float32, NaN where there is none.
    T_world_camera, index, given, scale: as the view's.
    """

    nearest: np.ndarray
    T_world_camera: np.ndarray
    index: int = 0
    given: bool = False
    scale: float = 1.0

    def moved(self, pose: Sim3) -> Witness:
        """The same at another T_world_camera, as `View.moved`."""
        growth = pose.scale / self.scale
        nearest = self.nearest if growth == 1.0 else np.float32(growth) * self.nearest
        return replace(self, nearest=nearest, T_world_camera=pose.rigid, scale=pose.scale)

    def sighting(self, view: View) -> Sighting:
        """As the view sees it."""
        return Sighting(
            self.nearest, relative_motion(view.T_world_camera, self.T_world_camera, view.given and self.given)
        )


@dataclass(frozen=True, eq=False)
class Sighting:
    """`Witness.nearest` of another camera of the same kind, and T_other_this, float64 4×4."""

    nearest: np.ndarray
    T_other_this: np.ndarray


def relative_motion(T_world_this: np.ndarray, T_world_other: np.ndarray, given: bool) -> np.ndarray:
    """T_other_this, float64 4×4; free of the rounding of a distant origin where both poses are given."""
    motion = inverse(T_world_other) @ T_world_this
    return without_noise(motion) if given else motion
