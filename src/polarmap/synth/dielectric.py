"""Fresnel's equations in the forward direction: what a smooth dielectric reflects and lets through.

Source: Fresnel's amplitude coefficients for light that goes from a medium of index n1 to one of index n2,
squared and scaled to power. The inverse, from a degree of polarization back to an angle, is elsewhere and shares
no code with this, so that each checks the other.
"""

from __future__ import annotations

import numpy as np

from polarmap.jit import njit


@njit(error_model="numpy")
def fresnel_reflectances(cos_theta: float, eta: float) -> tuple[float, float]:
    """Power reflectances (R_s, R_p) of a dielectric of relative index `eta` seen from outside.

    s is the electric vector perpendicular to the plane of incidence, p the one within it.
    cos_theta: cosine of the angle θ between the normal and the viewing direction, a float or an array in (0, 1].
    """
    cos_inside = np.sqrt(1.0 - (1.0 - cos_theta * cos_theta) / (eta * eta))
    r_s = (cos_theta - eta * cos_inside) / (cos_theta + eta * cos_inside)
    r_p = (eta * cos_theta - cos_inside) / (eta * cos_theta + cos_inside)
    return r_s * r_s, r_p * r_p


@njit(error_model="numpy")
def fresnel_transmittances(cos_theta: float, eta: float) -> tuple[float, float]:
    """Power transmittances (T_s, T_p) of light that leaves the dielectric under θ, measured outside.

    Light goes from index `eta` to 1: t_s = 2 n1 c1/(n1 c1 + n2 c2), t_p = 2 n1 c1/(n2 c1 + n1 c2), and the power
    is t² n2 c2/(n1 c1), with c1 the cosine inside and c2 = cos θ. Argument as in `fresnel_reflectances`.
    """
    cos_inside = np.sqrt(1.0 - (1.0 - cos_theta * cos_theta) / (eta * eta))
    t_s = 2.0 * eta * cos_inside / (eta * cos_inside + cos_theta)
    t_p = 2.0 * eta * cos_inside / (cos_inside + eta * cos_theta)
    power = cos_theta / (eta * cos_inside)
    return t_s * t_s * power, t_p * t_p * power
