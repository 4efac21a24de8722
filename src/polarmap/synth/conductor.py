"""Fresnel's equations for a metal in the forward direction, by complex amplitudes.

As for dielectrics, what the package inverts elsewhere is written in another form there, so that each checks the other.
"""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit


@njit(error_model="numpy")
def conductor_reflectances(cos_theta: float, n: float, k: float) -> tuple[float, float]:
    """Power reflectances (R_s, R_p) of a metal of index n - ik seen from air, exact.

    s is the electric vector perpendicular to the plane of incidence, p the one within it.
    cos_theta: cosine of the angle θ between the normal and the viewing direction, a float or an array in (0, 1].
    """
    index = n - 1j * k
    cos_inside = np.sqrt(1.0 - (1.0 - cos_theta * cos_theta) / (index * index))
    r_s = (cos_theta - index * cos_inside) / (cos_theta + index * cos_inside)
    r_p = (index * cos_theta - cos_inside) / (index * cos_theta + cos_inside)
    return r_s.real * r_s.real + r_s.imag * r_s.imag, r_p.real * r_p.real + r_p.imag * r_p.imag
