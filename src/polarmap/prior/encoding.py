"""Linear sensor values made to look like the pictures that networks know, and that eyes see."""

from __future__ import annotations

import numpy as np

_WHITE_PERCENTILE = 99.0
_STRIDE = 4  # a sixteenth of the pixels tells the percentile


def encode_display(intensity: np.ndarray, gamma: float) -> np.ndarray:
    """(I / white)^gamma in [0, 1] with white the 99th percentile of I, float32 H×W.

    intensity: linear, float32 H×W. NaN counts as black. gamma: 0.45 is close to sRGB; 0.5 makes shot noise uniform.
    """
    clean = np.nan_to_num(intensity, nan=0.0, posinf=0.0, neginf=0.0)
    white = np.percentile(clean[::_STRIDE, ::_STRIDE], _WHITE_PERCENTILE)
    share = np.clip(clean / np.float32(max(white, 1e-6)), 0.0, 1.0)
    encoded = np.sqrt(share) if gamma == 0.5 else share ** np.float32(gamma)
    return encoded.astype(np.float32, copy=False)
