"""Lumpy normals of rendered glossy things, put right by the angle of polarization."""

from __future__ import annotations

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scenes import TYPICAL, WIDE, polarization_of, view_of

from polarmap.densify.surfaces.polarized_normals import turned_normals

EVERYWHERE = np.ones(WIDE.shape, bool)


def lumpy(normal: np.ndarray, degrees: float, seed: int = 0) -> np.ndarray:
    """Normals turned by smooth random angles, as stereo's depth makes them."""
    rng = np.random.default_rng(seed)
    noise = cv2.GaussianBlur(rng.standard_normal(normal.shape), (0, 0), 2.0)
    noise *= np.radians(degrees) / noise.std()
    turned = normal + noise
    return (turned / np.linalg.norm(turned, axis=-1, keepdims=True)).astype(np.float32)


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
