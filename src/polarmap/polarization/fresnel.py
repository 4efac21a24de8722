"""Degree of polarization against zenith angle, and its inverses, for smooth dielectrics and metals.

θ is the angle between the surface normal and the direction to the camera, η the refractive index of a dielectric,
n - ik that of a metal. Sources: the paper's equations (5) and (6); Atkinson and Hancock, IEEE TIP 2006; for metals
Born and Wolf, Principles of Optics, section 14.2 (reflection from an absorbing medium).
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


def metal_reflectances(zenith: np.ndarray, n: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Power reflectances (R_s, R_p) of a metal of index n - ik; zenith in radians, any shape.

    With (a - ib)² = (n - ik)² - sin²θ and t = sinθ tanθ,
    R_s = ((a - cosθ)² + b²) / ((a + cosθ)² + b²) and R_p = R_s ((a - t)² + b²) / ((a + t)² + b²).
    """
    a, b2, t = _metal_terms(zenith, n, k)
    r_s = ((a - np.cos(zenith)) ** 2 + b2) / ((a + np.cos(zenith)) ** 2 + b2)
    return r_s, r_s * ((a - t) ** 2 + b2) / ((a + t) ** 2 + b2)


def metal_dolp(zenith: np.ndarray, n: float, k: float) -> np.ndarray:
    """ρ of light mirrored by a metal of index n - ik, (R_s - R_p)/(R_s + R_p) = 2at / (a² + b² + t²).

    a, b, t as in `metal_reflectances`. It rises to its largest value, below 1, at the pseudo-Brewster angle, 70 to 83°
    for the metals of `polarization.metals`, and falls to 0 at grazing view.
    """
    a, b2, t = _metal_terms(zenith, n, k)
    return 2.0 * a * t / (a * a + b2 + t * t)


def metal_zeniths(dolp: np.ndarray, n: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    """Both zeniths in radians of a metal's pixel: (below, above) its pseudo-Brewster angle.

    `metal_dolp` is monotone on either side and is inverted there by tables of 4096 angles. ρ above the largest
    possible value gives the pseudo-Brewster angle. Raises InputError where n and k are no metal's.
    """
    tables = _metal_tables(n, k)
    rho = np.maximum(np.asarray(dolp, np.float64), 0.0)
    return tuple(np.interp(rho, table[0], table[1]).astype(np.float32) for table in tables)


def pseudo_brewster_angle(n: float, k: float) -> float:
    """Where `metal_dolp` is largest, in radians."""
    low, high = 0.0, np.pi / 2 - 1e-9
    for _ in range(6):
        angles = np.linspace(low, high, 101)
        best = int(np.argmax(metal_dolp(angles, n, k)))
        low, high = angles[max(best - 1, 0)], angles[min(best + 1, 100)]
    return float(0.5 * (low + high))


def _metal_terms(zenith, n, k):
    """a, b² and t = sinθ tanθ, see `metal_reflectances`; t is finite at π/2, where cosθ is not quite 0."""
    s2 = np.sin(zenith) ** 2
    real = n * n - k * k - s2
    modulus = np.hypot(real, 2.0 * n * k)  # a² + b²
    a2 = 0.5 * (modulus + real) if n > k else 2.0 * (n * k) ** 2 / (modulus - real)  # without cancellation
    return np.sqrt(a2), modulus - a2, s2 / np.maximum(np.cos(zenith), 1e-12)


@lru_cache(maxsize=64)
def _metal_tables(n: float, k: float) -> tuple[np.ndarray, np.ndarray]:
    _check_metal(n, k)
    top = pseudo_brewster_angle(n, k)
    below, above = np.linspace(0.0, top, _TABLE_SIZE), np.linspace(np.pi / 2, top, _TABLE_SIZE)
    return tuple(np.stack([metal_dolp(angles, n, k), angles]) for angles in (below, above))


def _check_metal(n: float, k: float) -> None:
    """InputError where n - ik is no metal's index."""
    if not (0.0 < n < 20.0 and 1.0 <= k < 20.0):
        raise InputError(f"refractive index {n} - {k}i is no metal's; n must be over 0 and k at least 1, both below 20")


@lru_cache(maxsize=64)
def _specular_tables(eta: float) -> tuple[np.ndarray, np.ndarray]:
    _check(eta)
    brewster = np.arctan(eta)
    below = np.linspace(0.0, brewster, _TABLE_SIZE)
    above = np.linspace(np.pi / 2, brewster, _TABLE_SIZE)
    return tuple(np.stack([specular_dolp(angles, eta), angles]) for angles in (below, above))


def _check(eta: float) -> None:
    if not 1.0 < eta < 10.0:
        raise InputError(f"refractive index {eta} is not between 1 and 10; dielectrics have 1.3 to 1.8")
