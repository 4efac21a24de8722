"""What every method of densification gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


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
