"""What densification takes from other views, and what every method of it gives."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

LEAST_SIGMA = np.float32(0.003)
_DRIFT = np.float32(1.0)  # error of log depth per image diagonal from the nearest point


@dataclass(frozen=True)
class OtherView:
    """Another posed view, to validate against.

    image: sqrt(intensity), float32 H×W. T_other_this: 4×4. depth: float32 H×W with NaN, or None if not known.
    """

    image: np.ndarray
    T_other_this: np.ndarray
    depth: np.ndarray | None = None


def extrapolation_sigma(distance: np.ndarray) -> np.ndarray:
    """Relative standard deviation of depth by its distance in pixels from the nearest stereo point, float32 H×W."""
    return np.hypot(LEAST_SIGMA, _DRIFT / np.float32(np.hypot(*distance.shape)) * distance).astype(np.float32)
