"""Degree of polarization against zenith angle, and its inverses, for a smooth dielectric.

θ is the angle between the surface normal and the direction to the camera, η the refractive index.
Sources: the paper's equations (5) and (6); Atkinson and Hancock, IEEE TIP 2006.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from polarmap.errors import InputError

_TABLE_SIZE = 4096


def diffuse_dolp(zenith: np.ndarray, eta: float = 1.5) -> np.ndarray:
    """Equation (5): ρ of light that was refracted out of the surface; zenith in radians, any shape."""
    s2 = np.sin(zenith) ** 2
    denominator = 4 * np.cos(zenith) * np.sqrt(eta**2 - s2) - (eta + 1 / eta) ** 2 * s2 + 2 * eta**2 + 2
    return (eta - 1 / eta) ** 2 * s2 / denominator


def specular_dolp(zenith: np.ndarray, eta: float = 1.5) -> np.ndarray:
    """Equation (6): ρ of light mirrored at the surface; 1 at the Brewster angle atan η."""
    s2 = np.sin(zenith) ** 2
    numerator = 2 * s2 * np.cos(zenith) * np.sqrt(eta**2 - s2)
    return numerator / (eta**2 - s2 - eta**2 * s2 + 2 * s2**2)


def diffuse_zenith(dolp: np.ndarray, eta: float = 1.5) -> np.ndarray:
    """Zenith in radians of a diffuse pixel, the closed-form inverse of equation (5).

    With t = cos²θ, moving the root of (5) to one side and squaring leaves a quadratic
    (A² - 16ρ²) t² - (2A(A-B) + 16ρ²(η²-1)) t + (A-B)² = 0, where A = (η-1/η)² + ρ(η+1/η)² and
    B = ρ(2η²+2); its smaller root is the solution. ρ above the largest possible value gives π/2.
    """
    _check(eta)
    rho = np.clip(np.asarray(dolp, np.float64), 0.0, diffuse_dolp(np.pi / 2, eta))
    A = (eta - 1 / eta) ** 2 + rho * (eta + 1 / eta) ** 2
    AB = A - rho * (2 * eta**2 + 2)
    a = A**2 - 16 * rho**2
    half_b = A * AB + 8 * rho**2 * (eta**2 - 1)
    root = np.sqrt(np.maximum(half_b**2 - a * AB**2, 0.0))
    t = AB**2 / np.maximum(half_b + root, 1e-300)
    return np.arccos(np.sqrt(np.clip(t, 0.0, 1.0))).astype(np.float32)


def specular_zeniths(dolp: np.ndarray, eta: float = 1.5) -> tuple[np.ndarray, np.ndarray]:
    """Both zeniths in radians of a specular pixel: (below, above) the Brewster angle.

    Equation (6) is monotone on either side of atan η and is inverted there by a table of 4096 angles, whose
    error is below 1e-3 rad except within 0.02 of ρ = 1, where the two roots meet.
    """
    below, above = _specular_tables(eta)
    rho = np.clip(np.asarray(dolp, np.float64), 0.0, 1.0)
    return tuple(np.interp(rho, table[0], table[1]).astype(np.float32) for table in (below, above))


@lru_cache(maxsize=16)
def _specular_tables(eta: float) -> tuple[np.ndarray, np.ndarray]:
    _check(eta)
    brewster = np.arctan(eta)
    below = np.linspace(0.0, brewster, _TABLE_SIZE)
    above = np.linspace(np.pi / 2, brewster, _TABLE_SIZE)
    return tuple(np.stack([specular_dolp(angles, eta), angles]) for angles in (below, above))


def _check(eta: float) -> None:
    if not 1.0 < eta < 10.0:
        raise InputError(f"refractive index {eta} is not between 1 and 10; dielectrics have 1.3 to 1.8")
