"""Linear sensor values made to look like the pictures that networks know, and that eyes see."""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import njit

_WHITE_PERCENTILE = 99.0
_STRIDE = 4  # a sixteenth of the pixels tells the percentile


def encode_display(intensity: np.ndarray, gamma: float) -> np.ndarray:
    """(I / white)^gamma in [0, 1] with white the 99th percentile of I, float32 H×W.

    intensity: linear, float32 H×W. NaN counts as black. gamma: 0.45 is close to sRGB; 0.5 makes shot noise uniform.
    """
    some = np.nan_to_num(intensity[::_STRIDE, ::_STRIDE], nan=0.0, posinf=0.0, neginf=0.0)
    white = np.percentile(some, _WHITE_PERCENTILE)
    share = np.empty(intensity.shape, np.float32)
    _shares_of_white(intensity, np.float32(1.0 / max(white, 1e-6)), share)
    return np.sqrt(share) if gamma == 0.5 else share ** np.float32(gamma)


@njit(parallel=True)
def _shares_of_white(intensity, scale, share):
    """In [0, 1], 0 for what is not finite."""
    zero, one = np.float32(0.0), np.float32(1.0)
    for v in prange(intensity.shape[0]):
        line, out = intensity[v], share[v]
        for u in range(line.size):
            value = np.float32(line[u] * scale) if abs(line[u]) < np.inf else zero
            out[u] = min(max(value, zero), one)
