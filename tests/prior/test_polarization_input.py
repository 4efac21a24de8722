"""What the package's own network sees of a frame."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.data.polarization_image import PolarizationImage
from polarmap.prior.polarization_input import CHANNELS, network_input

RAYS = np.stack(np.meshgrid(np.linspace(-0.5, 0.5, 32), np.linspace(-0.4, 0.4, 24)), axis=-1).astype(np.float32)
LIGHT = np.random.default_rng(0).uniform(0.1, 0.9, (24, 32)).astype(np.float32)


def polarized(degree: float, angle: float) -> np.ndarray:
    s1, s2 = 2 * LIGHT * degree * np.cos(2 * angle), 2 * LIGHT * degree * np.sin(2 * angle)
    return network_input(LIGHT, s1.astype(np.float32), s2.astype(np.float32), RAYS)


def test_it_holds_brightness_and_rays():
    found = network_input(LIGHT, None, None, RAYS)
    assert (found.shape, found.dtype) == ((CHANNELS, 24, 32), np.float32)
    np.testing.assert_array_equal(found[4:], RAYS.transpose(2, 0, 1))
    np.testing.assert_array_equal(found[2:4], 0.0)
    white = np.percentile(LIGHT[::4, ::4], 99)
    np.testing.assert_allclose(found[0], 2 * np.minimum(LIGHT / white, 1.0) ** 0.45 - 1, atol=1e-5)
    assert abs(found[1].mean()) < 1e-3
    assert np.corrcoef(found[1].ravel(), np.log(LIGHT).ravel())[0, 1] > 0.999


def test_exposure_does_not_matter():
    dim = network_input(0.01 * LIGHT, 0.002 * LIGHT, -0.001 * LIGHT, RAYS)
    np.testing.assert_allclose(dim, network_input(LIGHT, 0.2 * LIGHT, -0.1 * LIGHT, RAYS), atol=1e-4)


@pytest.mark.parametrize(("degree", "companded"), [(0.0, 0.0), (0.02, 0.191384), (0.2, 0.651042), (1.0, 1.0)])
def test_weak_polarization_is_drawn_apart(degree, companded):
    """asinh(50 ρ)/asinh(50), by hand: asinh(1) = 0.881374, asinh(10) = 2.998223, asinh(50) = 4.605270."""
    found = polarized(degree, np.radians(30.0))[2:4]
    np.testing.assert_allclose(found[0], companded * 0.5, atol=1e-4)
    np.testing.assert_allclose(found[1], companded * np.sqrt(0.75), atol=1e-4)


def test_dead_pixels_are_black_and_unpolarized():
    light = LIGHT.copy()
    light[3, 4], light[5, 6] = np.nan, 0.0
    found = network_input(light, 0.3 * light, 0.1 * light, RAYS)
    assert np.isfinite(found).all()
    assert found[0, 3, 4] == found[0, 5, 6] == -1.0
    np.testing.assert_array_equal(found[2:4, [3, 5], [4, 6]], 0.0)


def test_a_grey_image_has_no_polarization_and_says_so():
    image = PolarizationImage.unpolarized(LIGHT)
    assert image.intensity is LIGHT
    assert not image.dolp.any()
    assert image.usable.all()
    assert (image.sigma_dolp == 1.0).all()
    np.testing.assert_allclose(image.sigma_aolp, np.pi / np.sqrt(12.0))
