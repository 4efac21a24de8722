"""Stokes parameters, degree and angle of linear polarization, and what sensor noise does to them.

With the intensities I behind polarizers at 0, 45, 90 and 135 degrees, S0 = ½ (I0 + I45 + I90 + I135),
S1 = I0 - I90 and S2 = I45 - I135; DoLP ρ = √(S1² + S2²) / S0 and AoLP φ = ½ atan2(S2, S1).
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import SensorNoise
from polarmap.errors import InputError
from polarmap.jit import FAST_MATH, njit

MAX_SIGMA_AOLP = np.pi / np.sqrt(12.0)  # of an angle spread evenly over [0, π)
MAX_SIGMA_DOLP = 1.0
UNDEREXPOSED_SNR = 10.0  # S0 below this many of its standard deviations: σ(ρ) is above 0.14


def polarization_image(
    channels: np.ndarray,
    noise: SensorNoise,
    bit_depth: int = 16,
    noise_gain: float = 1.0,
    saturated: np.ndarray | None = None,
) -> PolarizationImage:
    """Intensity, DoLP and AoLP with their standard deviations, from four channels.

    channels: float32 4×H×W in the order 0, 45, 90, 135 degrees, as shares of full scale, NaN where outside
        the view.
    noise, bit_depth: the sensor's, for the variance of each channel.
    noise_gain: what demosaicing multiplied that variance by.
    saturated: bool H×W if known from the raw data, which is better than what can be seen here: a channel at
        most one code below full scale.

    The standard deviations are first-order propagation of four independent channel variances,
    σ²(f) = Σ (∂f/∂I)² σ²(I), with ∂ρ/∂I = (±cos 2φ - ρ/2)/S0 for 0 and 90 degrees and likewise with sin 2φ
    for 45 and 135. They are capped at MAX_SIGMA_DOLP and MAX_SIGMA_AOLP. Where S0 is not positive, and
    outside the view, intensity and DoLP are 0, both deviations at their caps, and `underexposed` is set.
    Raises InputError where the shape is not 4×H×W.
    """
    if channels.ndim != 3 or channels.shape[0] != 4:
        raise InputError(f"channels: shape {channels.shape} is not 4xHxW")
    channels = np.ascontiguousarray(channels, np.float32)
    if saturated is None:
        saturated = (channels >= saturation_level(bit_depth)).any(axis=0)
    read_variance = float(noise.variance(np.float32(0.0), bit_depth))
    values, underexposed = _stokes(channels, noise_gain / noise.full_well, noise_gain * read_variance)
    return PolarizationImage(*values, saturated=saturated, underexposed=underexposed)


def mean_intensity(channels: np.ndarray) -> np.ndarray:
    """S0/2 of four channels as in `polarization_image`: float32 H×W, 0 where black or outside the view."""
    return _mean_intensity(np.ascontiguousarray(channels, np.float32))


def saturation_level(bit_depth: int) -> float:
    """Share of full scale from which a pixel counts as clipped: one code below the highest."""
    return 1.0 - 1.0 / (2**bit_depth - 1)


def consistency_residual(channels: np.ndarray) -> np.ndarray:
    """|(I0 + I90) - (I45 + I135)| / S0, float32 H×W: 0 for an ideal sensor, NaN where S0 is not positive.

    Both pairs measure S0. They disagree where a channel clips, where the four pixels see different points,
    and where the sensor's extinction ratios or gains differ.
    """
    first, second = channels[0] + channels[2], channels[1] + channels[3]
    s0 = 0.5 * (first + second)
    return np.divide(np.abs(first - second), s0, out=np.full_like(s0, np.nan), where=s0 > 0)


def debias_dolp(dolp: np.ndarray, sigma: np.ndarray) -> np.ndarray:
    """DoLP less the bias that noise gives it, never below 0; same shape, float32.

    Noise lengthens the vector (S1, S2), so a weak ρ reads too high: unpolarized light has mean ρ = 1.25 σ.
    This is the modified asymptotic estimator, ρ - σ² (1 - exp(-ρ²/σ²)) / (2ρ) (Plaszczynski et al., MNRAS
    439, 2014, equation 37), which for ρ >> σ is that of Wardle and Kronberg (1974), √(ρ² - σ²).
    """
    dolp, sigma = np.asarray(dolp, np.float32), np.maximum(sigma, np.float32(1e-9))
    ratio = dolp / sigma
    safe = np.maximum(dolp, np.float32(1e-9))
    return np.maximum(dolp + sigma**2 * np.expm1(-(ratio**2)) / (2 * safe), 0.0).astype(np.float32)


@njit(parallel=True)
def _mean_intensity(channels):
    _, height, width = channels.shape
    out = np.empty((height, width), np.float32)
    quarter, zero = np.float32(0.25), np.float32(0.0)
    for y in prange(height):
        for x in range(width):
            total = (channels[0, y, x] + channels[1, y, x]) + (channels[2, y, x] + channels[3, y, x])
            out[y, x] = quarter * total if total > zero else zero  # not where black, nor where NaN
    return out


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _stokes(channels, shot_variance, read_variance):
    """intensity, dolp, aolp, sigma_dolp, sigma_aolp as float32 5×H×W, and underexposed as bool H×W.

    Free of branches and calls, so that it compiles to vector instructions.
    """
    _, height, width = channels.shape
    out = np.empty((5, height, width), np.float32)
    underexposed = np.empty((height, width), np.bool_)
    shot, read = np.float32(shot_variance), np.float32(read_variance)
    half, one, zero, tiny = np.float32(0.5), np.float32(1.0), np.float32(0.0), np.float32(1e-12)
    most_dolp, most_aolp = np.float32(MAX_SIGMA_DOLP), np.float32(MAX_SIGMA_AOLP)
    least_snr = np.float32(UNDEREXPOSED_SNR)
    for y in prange(height):
        for x in range(width):
            i0, i45, i90, i135 = channels[0, y, x], channels[1, y, x], channels[2, y, x], channels[3, y, x]
            s0, s1, s2 = half * ((i0 + i45) + (i90 + i135)), i0 - i90, i45 - i135
            lit = s0 > zero  # not where black, nor where NaN
            per_s0 = one / s0 if lit else zero
            length = np.sqrt(s1 * s1 + s2 * s2)
            per_length = one / max(length, tiny)
            cos = s1 * per_length if length > tiny else one
            sin = s2 * per_length if length > tiny else zero
            dolp = length * per_s0
            v0, v45 = read + shot * max(i0, zero), read + shot * max(i45, zero)
            v90, v135 = read + shot * max(i90, zero), read + shot * max(i135, zero)
            drop = half * dolp
            variance_dolp = (cos - drop) ** 2 * v0 + (cos + drop) ** 2 * v90
            variance_dolp += (sin - drop) ** 2 * v45 + (sin + drop) ** 2 * v135
            sigma_dolp = np.sqrt(variance_dolp) * per_s0
            variance_across = sin * sin * (v0 + v90) + cos * cos * (v45 + v135)
            sigma_aolp = half * np.sqrt(variance_across) * per_length
            sigma_s0 = half * np.sqrt(v0 + v45 + v90 + v135)
            out[0, y, x] = half * s0 if lit else zero
            out[1, y, x] = dolp if lit else zero
            out[2, y, x] = half_angle(s2, s1) if lit else zero
            out[3, y, x] = min(sigma_dolp, most_dolp) if lit else most_dolp
            out[4, y, x] = min(sigma_aolp, most_aolp) if lit else most_aolp
            underexposed[y, x] = not s0 >= least_snr * sigma_s0
    return out, underexposed


# atan a / a as a polynomial in a² for |a| <= 1, error 2e-8 (Abramowitz and Stegun, 4.4.49)
_ATAN = (-0.3333314528, 0.1999355085, -0.1420889944, 0.1065626393, -0.0752896400, 0.0429096138, -0.0161657367)
_ATAN = tuple(np.float32(a) for a in (*_ATAN, 0.0028662257))


@njit(inline="always", error_model="numpy")
def half_angle(y, x):
    """½ atan2(y, x), brought to [0, π), float32."""
    one, half_pi, pi = np.float32(1.0), np.float32(0.5 * np.pi), np.float32(np.pi)
    far, near = max(abs(x), abs(y)), min(abs(x), abs(y))
    a = near / max(far, np.float32(1e-30))
    t = a * a
    c = _ATAN
    series = c[0] + t * (c[1] + t * (c[2] + t * (c[3] + t * (c[4] + t * (c[5] + t * (c[6] + t * c[7]))))))
    angle = a * (one + t * series)
    angle = half_pi - angle if abs(y) > abs(x) else angle
    angle = pi - angle if x < 0 else angle
    half = np.float32(0.5) * (-angle if y < 0 else angle)
    half = half + pi if half < 0 else half
    return half if half < pi else np.float32(0.0)
