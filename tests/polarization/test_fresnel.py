"""Degree of polarization against zenith: the equations against Fresnel's coefficients, the inverses by round trip."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.errors import InputError
from polarmap.polarization.fresnel import diffuse_dolp, diffuse_zenith, specular_dolp, specular_zeniths
from polarmap.synth.dielectric import fresnel_reflectances, fresnel_transmittances

dielectric = st.floats(1.3, 1.8)
ZENITHS = np.linspace(0.0, np.pi / 2 - 1e-3, 500)


@pytest.mark.parametrize("eta", [1.3, 1.5, 1.8])
def test_the_equations_are_contrasts_of_fresnels_coefficients(eta):
    t_s, t_p = fresnel_transmittances(np.cos(ZENITHS), eta)
    r_s, r_p = fresnel_reflectances(np.cos(ZENITHS), eta)
    np.testing.assert_allclose(diffuse_dolp(ZENITHS, eta), (t_p - t_s) / (t_p + t_s), atol=1e-12)
    np.testing.assert_allclose(specular_dolp(ZENITHS, eta), (r_s - r_p) / (r_s + r_p), atol=1e-12)


@settings(deadline=None, max_examples=200)
@given(zenith=st.floats(0.0, np.pi / 2), eta=dielectric)
def test_the_diffuse_zenith_comes_back(zenith, eta):
    assert diffuse_zenith(diffuse_dolp(zenith, eta), eta) == pytest.approx(zenith, abs=3e-4)


@settings(deadline=None, max_examples=200)
@given(share=st.floats(0.0, 1.0), eta=dielectric)
def test_both_specular_zeniths_come_back(share, eta):
    brewster = np.arctan(eta)
    below, above = share * brewster, np.pi / 2 - share * (np.pi / 2 - brewster)
    for zenith, side in ((below, 0), (above, 1)):
        rho = specular_dolp(zenith, eta)
        tolerance = 1e-3 if rho < 0.98 else 0.02  # where the roots meet, ρ is flat
        assert specular_zeniths(rho, eta)[side] == pytest.approx(zenith, abs=tolerance)


@given(rho=st.floats(0.0, 1.0), eta=dielectric)
def test_the_specular_roots_lie_on_either_side_of_the_brewster_angle(rho, eta):
    below, above = specular_zeniths(rho, eta)
    assert 0.0 <= below <= np.arctan(eta) + 1e-6 <= above + 2e-6 <= np.pi / 2 + 1e-5


@pytest.mark.parametrize("eta", [1.3, 1.5, 1.8])
def test_mirrored_light_is_fully_polarized_at_the_brewster_angle(eta):
    assert specular_dolp(np.arctan(eta), eta) == pytest.approx(1.0)
    np.testing.assert_allclose(specular_zeniths(1.0, eta), np.arctan(eta), atol=1e-6)


def test_degrees_out_of_range_take_the_nearest_angle():
    most = diffuse_dolp(np.pi / 2)
    assert most == pytest.approx(0.3846, abs=1e-4)
    np.testing.assert_allclose(diffuse_zenith([-0.1, 0.0, most, most + 0.1, 2.0]), [0, 0, *3 * [np.pi / 2]], atol=1e-3)
    below, above = specular_zeniths(np.array([-0.1, 1.5]))
    np.testing.assert_allclose(below, [0.0, np.arctan(1.5)], atol=1e-6)
    np.testing.assert_allclose(above, [np.pi / 2, np.arctan(1.5)], atol=1e-6)


def test_zeniths_keep_the_shape_and_come_as_float32():
    rho = np.random.default_rng(0).random((3, 4, 5), np.float32)
    for zenith in (diffuse_zenith(rho), *specular_zeniths(rho)):
        assert zenith.shape == rho.shape and zenith.dtype == np.float32


@pytest.mark.parametrize("eta", [1.0, 0.5, 10.0, np.nan, np.inf])
def test_what_is_no_dielectric_is_refused(eta):
    for zenith_of in (diffuse_zenith, specular_zeniths):
        with pytest.raises(InputError, match="refractive index"):
            zenith_of(0.1, eta)
