"""Stokes parameters of channels whose polarizers were measured, and what sensor noise does to them.

The intensities are I = M S, with M of `PolarizerCalibration`; S is the least-squares solution P I, P being M's
pseudo-inverse (Tyo et al., Applied Optics 2006). For ideal polarizers P holds the factors of `sensing.stokes`.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.sensor import AngleDirection, SensorNoise
from polarmap.jit import FAST_MATH, njit
from polarmap.sensing.stokes import MAX_SIGMA_AOLP, MAX_SIGMA_DOLP, UNDEREXPOSED_SNR, half_angle


class CalibratedStokes:
    """Stokes parameters from the four channels of a calibrated camera.

    Channels are float32 4×H×W in the order 0, 45, 90, 135 degrees clockwise, shares of full scale, as they were
    measured, NaN where outside the view.
    """

    def __init__(self, calibration: PolarizerCalibration, direction: AngleDirection) -> None:
        measurement = calibration.measurement_matrix(direction)
        self._analysis = np.linalg.pinv(measurement)
        self._unseen = np.linalg.svd(measurement)[0][:, 3]

    def image(
        self, channels: np.ndarray, noise: SensorNoise, bit_depth: int, noise_gain: float, saturated: np.ndarray
    ) -> PolarizationImage:
        """As `stokes.polarization_image`; first-order propagation of the channels' own variances through P."""
        channels = np.ascontiguousarray(channels, np.float32)
        read_variance = float(noise.variance(np.float32(0.0), bit_depth))
        values, underexposed = _stokes(
            channels, self._analysis.astype(np.float32), noise_gain / noise.full_well, noise_gain * read_variance
        )
        intensity, dolp, aolp, sigma_dolp, sigma_aolp = values
        return PolarizationImage(intensity, dolp, aolp, sigma_dolp, sigma_aolp, saturated, underexposed)

    def intensity(self, channels: np.ndarray) -> np.ndarray:
        """S0/2, float32 H×W, 0 where it is not positive or outside the view."""
        half_s0 = np.tensordot(self._half_s0, channels, axes=1)
        return np.where(half_s0 > 0, half_s0, np.float32(0.0))

    def residual(self, channels: np.ndarray) -> np.ndarray:
        """As `stokes.consistency_residual`: twice what no light can cause, as a share of S0, float32 H×W."""
        s0 = 2.0 * np.tensordot(self._half_s0, channels, axes=1)
        unseen = 2.0 * np.abs(np.tensordot(self._unseen.astype(np.float32), channels, axes=1))
        return np.divide(unseen, s0, out=np.full_like(s0, np.nan), where=s0 > 0)

    @property
    def _half_s0(self) -> np.ndarray:
        return (0.5 * self._analysis[0]).astype(np.float32)


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _stokes(channels, analysis, shot_variance, read_variance):
    """As `stokes._stokes`, with ∂S/∂I = analysis, float32 3×4, in place of the ideal factors."""
    _, height, width = channels.shape
    out = np.empty((5, height, width), np.float32)
    underexposed = np.empty((height, width), np.bool_)
    shot, read = np.float32(shot_variance), np.float32(read_variance)
    half, one, zero, tiny = np.float32(0.5), np.float32(1.0), np.float32(0.0), np.float32(1e-12)
    most_dolp, most_aolp = np.float32(MAX_SIGMA_DOLP), np.float32(MAX_SIGMA_AOLP)
    least_snr = np.float32(UNDEREXPOSED_SNR)
    for y in prange(height):
        for x in range(width):
            s0, s1, s2 = zero, zero, zero
            for k in range(4):
                value = channels[k, y, x]
                s0 += analysis[0, k] * value
                s1 += analysis[1, k] * value
                s2 += analysis[2, k] * value
            lit = s0 > zero
            per_s0 = one / s0 if lit else zero
            length = np.sqrt(s1 * s1 + s2 * s2)
            per_length = one / max(length, tiny)
            cos = s1 * per_length if length > tiny else one
            sin = s2 * per_length if length > tiny else zero
            dolp = length * per_s0
            along, across, whole = zero, zero, zero
            for k in range(4):
                variance = read + shot * max(channels[k, y, x], zero)
                along += (cos * analysis[1, k] + sin * analysis[2, k] - dolp * analysis[0, k]) ** 2 * variance
                across += (cos * analysis[2, k] - sin * analysis[1, k]) ** 2 * variance
                whole += analysis[0, k] ** 2 * variance
            sigma_dolp = np.sqrt(along) * per_s0
            sigma_aolp = half * np.sqrt(across) * per_length
            out[0, y, x] = half * s0 if lit else zero
            out[1, y, x] = dolp if lit else zero
            out[2, y, x] = half_angle(s2, s1) if lit else zero
            out[3, y, x] = min(sigma_dolp, most_dolp) if lit else most_dolp
            out[4, y, x] = min(sigma_aolp, most_aolp) if lit else most_aolp
            underexposed[y, x] = not s0 >= least_snr * np.sqrt(whole)
    return out, underexposed
