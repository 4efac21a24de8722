"""What the package's own network sees of a frame: brightness, polarization and where each pixel looks.

The same few lines make the input in training (`training/`) and here.
"""

from __future__ import annotations

import numpy as np

from polarmap.prior.encoding import encode_display

CHANNELS = 6
"""Encoded intensity, its logarithm, two of polarization, the viewing ray's x and y."""

_GAMMA = 0.45
_DARK = 0.01  # of the mean intensity, added before the logarithm
_WEAK = 0.02  # degree of polarization up to which companding is linear
_COMPANDED_FULL = float(np.arcsinh(1.0 / _WEAK))


def network_input(
    intensity: np.ndarray, s1: np.ndarray | None, s2: np.ndarray | None, normalized: np.ndarray
) -> np.ndarray:
    """The network's input, float32 6×H×W.

    intensity: S0/2, linear, of any scale, float32 H×W. s1, s2: Stokes components of the same scale, or None for a
    grey image; then their channels are 0, as they are for unpolarized light. normalized: (x, y) of every pixel's
    viewing ray (`PinholeCamera.normalized`), float32 H×W×2.

    Degrees of polarization of 0.01 and 0.5 matter alike, so the degree is companded: asinh(50 ρ)/asinh(50).
    """
    channels = np.zeros((CHANNELS, *intensity.shape), np.float32)
    channels[0] = 2.0 * encode_display(intensity, _GAMMA) - 1.0
    channels[1] = _standardized_log(intensity)
    if s1 is not None and s2 is not None:
        channels[2:4] = _companded(intensity, s1, s2)
    channels[4:] = normalized.transpose(2, 0, 1)
    return channels


def _standardized_log(intensity: np.ndarray) -> np.ndarray:
    light = np.maximum(np.nan_to_num(intensity), 0.0)
    logarithm = np.log(light + np.float32(max(_DARK * float(light.mean()), 1e-12)))
    logarithm -= logarithm.mean()
    return np.clip(logarithm / (logarithm.std() + np.float32(0.1)), -4.0, 4.0)


def _companded(intensity: np.ndarray, s1: np.ndarray, s2: np.ndarray) -> np.ndarray:
    with np.errstate(divide="ignore", invalid="ignore"):
        q1, q2 = s1 / (2.0 * intensity), s2 / (2.0 * intensity)
    q = np.nan_to_num(np.stack([q1, q2]), nan=0.0, posinf=0.0, neginf=0.0)
    degree = np.hypot(q[0], q[1])
    factor = np.arcsinh(np.minimum(degree, 1.0) / _WEAK) / (_COMPANDED_FULL * np.maximum(degree, 1e-6))
    return (q * factor).astype(np.float32)
