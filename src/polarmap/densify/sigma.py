"""How uncertain depth is that is carried away from a stereo point."""

from __future__ import annotations

import numpy as np

LEAST_SIGMA = np.float32(0.003)
_DRIFT = np.float32(1.0)  # error of log depth per image diagonal from the nearest point


def extrapolation_sigma(distance: np.ndarray) -> np.ndarray:
    """Relative standard deviation of depth by its distance in pixels from the nearest stereo point, float32 H×W."""
    return np.hypot(LEAST_SIGMA, _DRIFT / np.float32(np.hypot(*distance.shape)) * distance).astype(np.float32)
