"""Stokes parameters, their noise, and degenerate pixels."""

from __future__ import annotations

import warnings

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.data.sensor import SensorNoise
from polarmap.errors import InputError
from polarmap.sensing.stokes import (
    MAX_SIGMA_AOLP,
    MAX_SIGMA_DOLP,
    consistency_residual,
    debias_dolp,
    polarization_image,
)

ANGLES = np.radians([0.0, 45.0, 90.0, 135.0])
NOISE = SensorNoise(full_well=8000.0, read_noise=4.0)


def channels_of(intensity, dolp, aolp, shape=(1, 1)):
    values = intensity * (1 + dolp * np.cos(2 * (ANGLES - aolp)))
    return np.broadcast_to(values[:, None, None], (4, *shape)).astype(np.float32)


def angle_difference(a, b):
    return np.abs((a - b + np.pi / 2) % np.pi - np.pi / 2)


@settings(deadline=None, max_examples=200)
@given(st.floats(0.01, 0.5), st.floats(0.01, 1.0), st.floats(-10.0, 10.0))
def test_what_the_polarizers_pass_gives_back_intensity_dolp_and_aolp(intensity, dolp, aolp):
    image = polarization_image(channels_of(intensity, dolp, aolp), NOISE)
    assert image.intensity[0, 0] == pytest.approx(intensity, rel=1e-5)
    assert image.dolp[0, 0] == pytest.approx(dolp, abs=1e-5)
    assert angle_difference(image.aolp[0, 0], aolp) < 1e-4
    assert 0 <= image.aolp[0, 0] < np.pi


def test_an_angle_just_below_zero_wraps_to_below_pi():
    for s2 in (-1e-30, -0.0, 1e-30):
        channels = np.array([0.6, s2, 0.2, 0.0], np.float32)[:, None, None]
        assert 0 <= polarization_image(channels, NOISE).aolp[0, 0] < np.pi


def jacobian(intensities, step=1e-5):
    """Central differences of ρ and φ by the four intensities, 2×4."""

    def rho_phi(i):
        s0, s1, s2 = i.sum() / 2, i[0] - i[2], i[1] - i[3]
        return np.array([np.hypot(s1, s2) / s0, 0.5 * np.arctan2(s2, s1)])

    steps = step * np.eye(4)
    return np.stack([(rho_phi(intensities + d) - rho_phi(intensities - d)) / (2 * step) for d in steps], 1)


@pytest.mark.parametrize(("dolp", "aolp"), [(0.05, 0.3), (0.4, 1.2), (0.95, 2.6)])
@pytest.mark.parametrize(("bit_depth", "gain"), [(8, 1.0), (12, 0.39)])
def test_sigmas_are_the_first_order_propagation(dolp, aolp, bit_depth, gain):
    channels = channels_of(0.3, dolp, aolp)
    image = polarization_image(channels, NOISE, bit_depth, noise_gain=gain)
    intensities = channels[:, 0, 0].astype(float)
    variances = gain * NOISE.variance(intensities, bit_depth)
    expected = np.sqrt(jacobian(intensities) ** 2 @ variances)
    np.testing.assert_allclose([image.sigma_dolp[0, 0], image.sigma_aolp[0, 0]], expected, rtol=2e-3)


@pytest.mark.parametrize(("dolp", "aolp"), [(0.1, 0.2), (0.3, 1.0), (0.8, 2.2)])
def test_sigmas_are_the_scatter_of_noisy_measurements(dolp, aolp):
    clean = channels_of(0.25, dolp, aolp, shape=(200, 200))
    scatter = np.random.default_rng(0).standard_normal(clean.shape) * np.sqrt(NOISE.variance(clean))
    image = polarization_image(clean + scatter, NOISE)
    assert image.dolp.std() == pytest.approx(image.sigma_dolp.mean(), rel=0.03)
    turned = angle_difference(image.aolp, aolp)
    assert np.sqrt((turned**2).mean()) == pytest.approx(image.sigma_aolp.mean(), rel=0.05)


def test_unpolarized_light_has_an_angle_of_which_nothing_is_known():
    clean = np.full((4, 100, 100), 0.25, np.float32)
    noisy = clean + np.random.default_rng(0).standard_normal(clean.shape) * np.sqrt(NOISE.variance(clean))
    image = polarization_image(noisy, NOISE)
    assert np.sqrt(np.mean((image.aolp - np.pi / 2) ** 2)) == pytest.approx(MAX_SIGMA_AOLP, rel=0.03)
    assert polarization_image(clean, NOISE).sigma_aolp == pytest.approx(MAX_SIGMA_AOLP)
    assert (image.sigma_aolp <= np.float32(MAX_SIGMA_AOLP)).all()


@pytest.mark.parametrize("pixel", [(0, 0, 0, 0), (-0.1, 0, 0, 0.05), (np.nan, 0.2, 0.3, 0.2), (np.nan,) * 4])
def test_black_and_missing_pixels_are_dark_and_finite(pixel):
    channels = np.array(pixel, np.float32)[:, None, None] * np.ones((4, 2, 3), np.float32)
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        image = polarization_image(channels, NOISE)
    assert image.underexposed.all()
    assert not image.saturated.any()
    assert not image.usable.any()
    for value, expected in (
        (image.intensity, 0.0),
        (image.dolp, 0.0),
        (image.aolp, 0.0),
        (image.sigma_dolp, MAX_SIGMA_DOLP),
        (image.sigma_aolp, MAX_SIGMA_AOLP),
    ):
        np.testing.assert_allclose(value, expected, rtol=1e-6)


def test_dolp_over_one_is_kept_and_not_usable():
    image = polarization_image(np.array([0.5, 0.25, -0.02, 0.2], np.float32)[:, None, None], NOISE)
    assert image.dolp[0, 0] > 1
    assert not image.usable[0, 0]


def test_exposure_masks():
    channels = np.stack([channels_of(i, 0.0, 0.0)[:, 0, 0] for i in (0.0005, 0.02, 0.5)], axis=1)[:, None]
    channels[2, 0, 2] = 254 / 255
    image = polarization_image(np.ascontiguousarray(channels), NOISE, bit_depth=8)
    np.testing.assert_array_equal(image.underexposed, [[True, False, False]])
    np.testing.assert_array_equal(image.saturated, [[False, False, True]])
    known = np.array([[True, False, False]])
    given = polarization_image(np.ascontiguousarray(channels), NOISE, bit_depth=8, saturated=known)
    np.testing.assert_array_equal(given.saturated, known)


def test_consistency_residual():
    ideal = channels_of(0.3, 0.5, 0.7, shape=(2, 2)).copy()
    assert consistency_residual(ideal).max() < 1e-6
    ideal[0] += 0.06
    np.testing.assert_allclose(consistency_residual(ideal), 0.06 / 0.63, rtol=1e-5)
    assert np.isnan(consistency_residual(np.zeros((4, 2, 2), np.float32))).all()


def test_debiasing_takes_the_noise_out_of_a_weak_dolp():
    for true in (0.01, 0.02, 0.05):
        clean = channels_of(0.25, true, 0.4, shape=(200, 200))
        noisy = clean + np.random.default_rng(1).standard_normal(clean.shape) * np.sqrt(NOISE.variance(clean))
        image = polarization_image(noisy, NOISE)
        debiased = debias_dolp(image.dolp, image.sigma_dolp)
        assert (debiased >= 0).all()
        assert abs(debiased.mean() - true) < 0.7 * abs(image.dolp.mean() - true)
    assert debias_dolp(np.zeros(1), np.zeros(1)) == 0


def test_channels_of_another_shape_are_refused():
    with pytest.raises(InputError, match="4xHxW"):
        polarization_image(np.zeros((3, 4, 4), np.float32), NOISE)
