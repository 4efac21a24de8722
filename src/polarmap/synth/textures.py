"""Solid textures, evaluated at a point of the object frame."""

from __future__ import annotations

import math

import numpy as np

from polarmap.jit import njit
from polarmap.synth.scene import Pattern

# Keeps cell borders off the round coordinates at which flat faces lie, where rounding would make them flicker.
_OFFSET = 0.3183
_OCTAVE_GAIN = 0.75
# How far a picture moves along its rows and columns per metre across it.
_SLANT = (0.8, 0.6)


@njit(error_model="numpy")
def modulation(pattern: int, size: float, octaves: int, seed: int, point: tuple[float, float, float]) -> float:
    """Value m in [-1, 1] of a texture (see `Texture`) at a point in metres of the object frame."""
    x, y, z = point[0] / size + _OFFSET, point[1] / size + _OFFSET, point[2] / size + _OFFSET
    if pattern == Pattern.CHECKER:
        return _alternate(math.floor(x) + math.floor(y) + math.floor(z))
    if pattern == Pattern.STRIPES:
        return _alternate(math.floor((point[0] + point[1] + point[2]) / (size * math.sqrt(3.0)) + _OFFSET))
    if pattern == Pattern.NOISE:
        return _octave_noise(x, y, z, octaves, seed)
    return 0.0


@njit(error_model="numpy")
def image_modulation(image: np.ndarray, size: float, point: tuple[float, float, float]) -> float:
    """Value of a picture (H×W in [-1, 1]) that is `size` metres high, bilinear, at a point of the object frame."""
    height, width = image.shape
    scale = (height - 1) / size
    u = _reflected((point[0] + _SLANT[0] * point[2]) * scale, width - 1)
    v = _reflected((point[1] + _SLANT[1] * point[2]) * scale, height - 1)
    i, j = min(int(v), height - 2), min(int(u), width - 2)
    tu, tv = u - j, v - i
    upper = image[i, j] + tu * (image[i, j + 1] - image[i, j])
    lower = image[i + 1, j] + tu * (image[i + 1, j + 1] - image[i + 1, j])
    return upper + tv * (lower - upper)


@njit(error_model="numpy")
def _reflected(x: float, last: int) -> float:
    """x folded into [0, last], there and back."""
    x = abs(x) % (2.0 * last)
    return x if x <= last else 2.0 * last - x


@njit
def _alternate(cell: int) -> float:
    return 1.0 if cell % 2 == 0 else -1.0


@njit(error_model="numpy")
def _octave_noise(x: float, y: float, z: float, octaves: int, seed: int) -> float:
    """Octaves of value noise at constant variance: their sum over the root of the sum of squared amplitudes."""
    total, power, amplitude, frequency = 0.0, 0.0, 1.0, 1.0
    for octave in range(octaves):
        total += amplitude * _value_noise(x * frequency, y * frequency, z * frequency, seed + octave)
        power += amplitude * amplitude
        amplitude *= _OCTAVE_GAIN
        frequency *= 2.0
    return min(1.0, max(-1.0, total / math.sqrt(power)))


@njit
def _value_noise(x: float, y: float, z: float, seed: int) -> float:
    """Random values on the integer lattice, smoothly interpolated."""
    ix, iy, iz = math.floor(x), math.floor(y), math.floor(z)
    tx, ty, tz = _smoothstep(x - ix), _smoothstep(y - iy), _smoothstep(z - iz)
    low = _interpolated_in_plane(ix, iy, iz, tx, ty, seed)
    high = _interpolated_in_plane(ix, iy, iz + 1, tx, ty, seed)
    return low + tz * (high - low)


@njit
def _interpolated_in_plane(ix: int, iy: int, iz: int, tx: float, ty: float, seed: int) -> float:
    a, b = _lattice_value(ix, iy, iz, seed), _lattice_value(ix + 1, iy, iz, seed)
    c, d = _lattice_value(ix, iy + 1, iz, seed), _lattice_value(ix + 1, iy + 1, iz, seed)
    top, bottom = a + tx * (b - a), c + tx * (d - c)
    return top + ty * (bottom - top)


@njit
def _smoothstep(t: float) -> float:
    return t * t * (3.0 - 2.0 * t)


@njit
def _lattice_value(ix: int, iy: int, iz: int, seed: int) -> float:
    """Pseudo-random value in [-1, 1] of a lattice point: a multiplicative integer hash."""
    h = (ix * 1619 + iy * 31337 + iz * 6971 + seed * 1013904223) & 0x7FFFFFFF
    h = ((h ^ (h >> 15)) * 739982445) & 0x7FFFFFFF
    h = ((h ^ (h >> 12)) * 695872825) & 0x7FFFFFFF
    h ^= h >> 15
    return h / 1073741823.5 - 1.0
