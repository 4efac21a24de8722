"""What densification takes from other views, and what every method of it gives."""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import numpy as np

LEAST_SIGMA = np.float32(0.003)
_DRIFT = np.float32(1.0)  # error of log depth per image diagonal from the nearest point


class Origin(IntEnum):
    """Where a pixel's depth comes from.

    STEREO: a stereo point, which the depth agrees with. PROPAGATED: a walk along contours, or a plane that stereo
    points elsewhere lie on. ESTIMATED: a walk across contours, or the free surface.
    """

    NONE = 0
    STEREO = 1
    PROPAGATED = 2
    ESTIMATED = 3


@dataclass(frozen=True)
class OtherView:
    """Another posed view, to validate against.

    image: sqrt(intensity), float32 H×W. T_other_this: 4×4. depth: float32 H×W with NaN, or None if not known.
    """

    image: np.ndarray
    T_other_this: np.ndarray
    depth: np.ndarray | None = None


@dataclass(frozen=True)
class Expected:
    """What is guessed of a view from its picture, such as a network's depth and normals, with standard deviations.

    depth: float32 H×W z, positive. sigma_depth: float32 H×W, relative to it. normal: float32 H×W×3, unit vectors toward
    the camera. sigma_normal: float32 H×W, of its angle in radians. mirrored: bool H×W, where points are behind what is
    expected as what is seen in a mirror is; None where that is not known.
    """

    depth: np.ndarray
    sigma_depth: np.ndarray
    normal: np.ndarray
    sigma_normal: np.ndarray
    mirrored: np.ndarray | None = None


@dataclass(frozen=True)
class DenseDepth:
    """Dense depth of a view, arrays H×W, NaN where there is none.

    depth: float32 z. normal: float32 H×W×3, unit vectors toward the camera. sigma: float32, standard deviation of the
    depth as a share of it. origin: uint8, an `Origin`.
    distance: float32 pixels from the nearest stereo point that it is carried from.
    first: depth after the first step: iteration 1 of the paper's loop, or the free surface before there are planes.
    added: new points of each iteration of the paper's loop, the one step of the other method.
    """

    depth: np.ndarray
    normal: np.ndarray
    sigma: np.ndarray
    origin: np.ndarray
    distance: np.ndarray
    first: np.ndarray
    added: tuple[int, ...]


def extrapolation_sigma(distance: np.ndarray) -> np.ndarray:
    """Relative standard deviation of depth by its distance in pixels from the nearest stereo point, float32 H×W."""
    return np.hypot(LEAST_SIGMA, _DRIFT / np.float32(np.hypot(*distance.shape)) * distance).astype(np.float32)
