"""Fresnel's equations against textbook numbers and the paper's equations (5) and (6)."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.synth.dielectric import fresnel_reflectances, fresnel_transmittances

ANGLES = np.radians(np.arange(0.0, 90.0, 0.5))
INDICES = [1.33, 1.5, 1.8]


def test_glass_reflects_four_percent_at_normal_incidence():
    assert fresnel_reflectances(1.0, 1.5) == pytest.approx((0.04, 0.04))


def test_glass_at_sixty_degrees():
    r_s, r_p = fresnel_reflectances(0.5, 1.5)
    assert r_s == pytest.approx(0.1766, abs=1e-4)
    assert r_p == pytest.approx(0.0018, abs=1e-4)


@pytest.mark.parametrize("eta", INDICES)
def test_nothing_is_reflected_in_the_plane_of_incidence_at_brewsters_angle(eta):
    r_s, r_p = fresnel_reflectances(np.cos(np.arctan(eta)), eta)
    assert r_p == pytest.approx(0.0, abs=1e-15)
    assert r_s == pytest.approx(((eta**2 - 1) / (eta**2 + 1)) ** 2)


@pytest.mark.parametrize("eta", INDICES)
def test_light_is_either_reflected_or_transmitted(eta):
    cosines = np.cos(ANGLES)
    for reflected, transmitted in zip(
        fresnel_reflectances(cosines, eta), fresnel_transmittances(cosines, eta), strict=True
    ):
        np.testing.assert_allclose(reflected + transmitted, 1.0, rtol=1e-12)


@pytest.mark.parametrize("eta", INDICES)
def test_transmitted_light_is_polarized_as_equation_5_says(eta):
    t_s, t_p = fresnel_transmittances(np.cos(ANGLES), eta)
    squared_sine = np.sin(ANGLES) ** 2
    expected = (
        (eta - 1 / eta) ** 2
        * squared_sine
        / (4 * np.cos(ANGLES) * np.sqrt(eta**2 - squared_sine) - (eta + 1 / eta) ** 2 * squared_sine + 2 * eta**2 + 2)
    )
    np.testing.assert_allclose((t_p - t_s) / (t_p + t_s), expected, atol=1e-12)


@pytest.mark.parametrize("eta", INDICES)
def test_reflected_light_is_polarized_as_equation_6_says(eta):
    r_s, r_p = fresnel_reflectances(np.cos(ANGLES), eta)
    squared_sine = np.sin(ANGLES) ** 2
    expected = (
        2 * squared_sine * np.cos(ANGLES) * np.sqrt(eta**2 - squared_sine)
        / (eta**2 - squared_sine - eta**2 * squared_sine + 2 * squared_sine**2)
    )  # fmt: skip
    np.testing.assert_allclose((r_s - r_p) / (r_s + r_p), expected, atol=1e-12)
