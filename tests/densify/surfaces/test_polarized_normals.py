"""Lumpy normals of rendered glossy things, put right by the angle of polarization and by those that are expected."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import TYPICAL, WIDE, polarization_of, turned, view_of

from polarmap.densify.surfaces.polarized_normals import turned_normals
from polarmap.synth import Rendering

EVERYWHERE = np.ones(WIDE.shape, bool)


def lumpy(normal: np.ndarray, degrees: float, seed: int = 0) -> np.ndarray:
    """Normals turned by smooth random angles, as stereo's depth makes them."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.standard_normal(normal.shape), (0, 0), 2.0)
    noise *= np.radians(degrees) / noise.std()
    return unit(normal + noise).astype(np.float32)


def error(normal: np.ndarray, truth: np.ndarray, where: np.ndarray) -> float:
    """Median angle in degrees."""
    cosine = np.einsum("hwc,hwc->hw", normal, truth)[where]
    return float(np.degrees(np.median(np.arccos(np.clip(cosine, -1.0, 1.0)))))


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
@pytest.mark.parametrize("material", ["glass", "plastic"])
def test_lumpy_normals_of_glossy_things_become_better(shape, material):
    truth = view_of(shape, material)
    image = polarization_of(truth, TYPICAL, seed=1)
    start = lumpy(truth.normal, 15.0)
    found = turned_normals(start, EVERYWHERE, image, WIDE)
    clear = (image.dolp > 0.1) & np.isfinite(truth.normal).all(axis=-1)
    assert error(found, truth.normal, clear) < 0.9 * error(start, truth.normal, clear)
    np.testing.assert_allclose(np.linalg.norm(found[clear], axis=-1), 1.0, atol=1e-5)


def test_normals_that_agree_with_each_other_stay():
    truth = view_of("sphere", "plastic")
    image = polarization_of(truth, TYPICAL, seed=1)
    found = turned_normals(truth.normal, EVERYWHERE, image, WIDE)
    known = np.isfinite(truth.normal).all(axis=-1)
    assert error(found, truth.normal, known) < 1.5


def test_what_is_planar_unpolarized_or_unknown_is_left_alone():
    truth = view_of("sphere", "plastic")
    image = polarization_of(truth, TYPICAL, seed=1)
    start = lumpy(truth.normal, 15.0)
    start[:40] = np.nan
    left = np.indices(WIDE.shape)[1] < 60
    found = turned_normals(start, left, image, WIDE)
    np.testing.assert_array_equal(found[:, 60:], start[:, 60:])
    np.testing.assert_array_equal(found[:40], start[:40])
    assert not np.array_equal(found, start, equal_nan=True)
    dull = replace(image, dolp=np.zeros_like(image.dolp))
    np.testing.assert_array_equal(turned_normals(start, EVERYWHERE, dull, WIDE), start)


def expected_of(truth: np.ndarray, degrees: float = 0.0) -> np.ndarray:
    """As a network expects normals: everywhere, and smoothly wrong."""
    filled = np.where(np.isfinite(truth), truth, np.float32([0.0, 0.0, -1.0]))
    return lumpy(filled, degrees, seed=3) if degrees else filled.astype(np.float32)


def clearly_polarized(truth: Rendering) -> np.ndarray:
    """Not at a contour, where smoothed light is its surroundings' in part, bool H×W."""
    clear = (polarization_of(truth).dolp > 0.06) & np.isfinite(truth.normal).all(axis=-1)
    return cv2.erode(clear.astype(np.uint8), np.ones((3, 3), np.uint8)) > 0


def test_expected_normals_guide_where_light_says_nothing():
    """Of a matte thing, and by four equal channels; what is planar or unknown stays."""
    truth = view_of("sphere", "matte")
    start = lumpy(truth.normal, 15.0)
    start[:40] = np.nan
    left = np.indices(WIDE.shape)[1] < 60
    dull = polarization_of(truth, TYPICAL, seed=1)
    dull = replace(dull, dolp=np.zeros_like(dull.dolp))
    for image in (None, dull):
        found = turned_normals(start, left, image, WIDE, expected_of(truth.normal))
        assert found.dtype == np.float32
        known = np.isfinite(start).all(axis=-1)
        assert error(found, truth.normal, known & left) < 0.75 * error(start, truth.normal, known & left)
        np.testing.assert_allclose(np.linalg.norm(found[known], axis=-1), 1.0, atol=1e-5)
        np.testing.assert_array_equal(found[:, 60:], start[:, 60:])
        np.testing.assert_array_equal(found[:40], start[:40])


def test_without_light_it_is_the_mean_of_smoothed_and_expected_normals_by_how_lumpy_they_are():
    """As NumPy has it, at the shares of the smoothed normals' and of the guide's weight, of every second pixel."""
    start, expected = lumpy(bulge(), 12.0), lumpy(bulge(), 20.0, seed=3)
    coarse = unit(blurred(start[::2, ::2], 1.5))
    differences = ((start[::2, ::2] - coarse) ** 2).sum(axis=-1)
    smooth, spread = (np.kron(part, np.ones((2, 2, 1)))[: WIDE.height, : WIDE.width]
                      for part in (coarse, blurred(differences, 2.0)[..., None]))  # fmt: skip
    spread = spread[..., 0]
    share = (spread / (spread + 0.05**2))[..., None]
    assert share.min() < 0.85 < share.max()
    guide = unit((1.0 - 0.4 * share) * smooth + 0.4 * share * expected)
    wanted = unit(share * guide + (1.0 - share) * start)
    np.testing.assert_allclose(turned_normals(start, EVERYWHERE, None, WIDE, expected), wanted, atol=1e-4)


def bulge() -> np.ndarray:
    """Normals of something gently curved that fills the picture, float32 H×W×3."""
    x, y = np.meshgrid(np.linspace(-0.5, 0.5, WIDE.width), np.linspace(-0.4, 0.4, WIDE.height))
    return unit(np.stack([x, y, -np.ones(WIDE.shape)], axis=-1)).astype(np.float32)


def blurred(image: np.ndarray, sigma: float) -> np.ndarray:
    return cv2.GaussianBlur(image.astype(float), (0, 0), sigma)


def unit(vectors: np.ndarray) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def test_without_light_and_expectation_normals_stay():
    start = lumpy(view_of("sphere", "plastic").normal, 15.0)
    np.testing.assert_array_equal(turned_normals(start, EVERYWHERE, None, WIDE), start)


@pytest.mark.parametrize("shape, material", [("sphere", "glass"), ("sphere", "plastic"), ("cylinder", "glass")])
def test_expected_normals_and_polarization_are_better_than_either(shape, material):
    truth = view_of(shape, material)
    image = polarization_of(truth, TYPICAL, seed=1)
    start, expected = lumpy(truth.normal, 20.0), expected_of(truth.normal, 8.0)
    clear = clearly_polarized(truth)
    both, light, guess = (
        error(turned_normals(start, EVERYWHERE, *given), truth.normal, clear)
        for given in ((image, WIDE, expected), (image, WIDE), (None, WIDE, expected))
    )
    assert both < 0.9 * light and both < 0.7 * guess


@pytest.mark.parametrize("material", ["glass", "plastic"])
def test_where_light_is_clear_it_says_the_direction_and_what_is_expected_the_zenith(material):
    """What is expected is turned about the line of sight: by 20 degrees, which light puts right again."""
    truth = view_of("sphere", material)
    image = polarization_of(truth, TYPICAL, seed=1)
    start, right = lumpy(truth.normal, 25.0), expected_of(truth.normal)
    aside = unit(right @ turned((0.0, 0.0, np.radians(20.0)))[:3, :3].T).astype(np.float32)
    clear = clearly_polarized(truth)
    assert np.count_nonzero(clear) > 100
    apart = [
        error(*(turned_normals(start, EVERYWHERE, light, WIDE, expected) for expected in (right, aside)), clear)
        for light in (image, None)
    ]
    assert apart[0] < 0.5 * apart[1]


def test_normals_that_agree_with_each_other_do_not_follow_what_is_expected():
    wrong = unit(bulge() @ turned((0.5, 0.3, 0.0))[:3, :3].T).astype(np.float32)
    found, start = turned_normals(bulge(), EVERYWHERE, None, WIDE, wrong), lumpy(bulge(), 15.0)
    assert error(found, bulge(), EVERYWHERE) < 0.5
    assert error(turned_normals(start, EVERYWHERE, None, WIDE, wrong), bulge(), EVERYWHERE) > 5.0
