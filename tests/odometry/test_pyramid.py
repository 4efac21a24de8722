"""Pyramids against plain NumPy, and their cameras against a projection."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.pyramid import PyramidFactory, level_cameras, sample

CAMERA = PinholeCamera(width=213, height=150, fx=190.0, fy=185.0, cx=105.3, cy=76.1)


def image_of(seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).random(CAMERA.shape, dtype=np.float32)


def halved(image: np.ndarray) -> np.ndarray:
    height, width = image.shape[0] // 2, image.shape[1] // 2
    return image[: 2 * height, : 2 * width].reshape(height, 2, width, 2).mean(axis=(1, 3))


def test_levels_are_means_of_four_pixels():
    pyramid = PyramidFactory(CAMERA).make(image_of())
    expected = 255.0 * image_of().astype(float)
    assert pyramid.shape == CAMERA.shape
    assert [level.shape for level in pyramid.levels] == [(150, 213, 3), (75, 106, 3)]
    for level in pyramid.levels:
        np.testing.assert_allclose(level[..., 0], expected, atol=1e-4)
        expected = halved(expected)


def test_gradients_are_central_differences_and_zero_at_the_border():
    for level in PyramidFactory(CAMERA).make(image_of()).levels:
        intensity = level[..., 0].astype(float)
        inner = np.s_[1:-1, 1:-1]
        np.testing.assert_allclose(level[..., 1][inner], np.gradient(intensity, axis=1)[inner], atol=1e-4)
        np.testing.assert_allclose(level[..., 2][inner], np.gradient(intensity, axis=0)[inner], atol=1e-4)
        border = np.ones(intensity.shape, bool)
        border[inner] = False
        assert not level[border, 1:].any()


def test_memory_that_was_given_back_keeps_nothing():
    factory = PyramidFactory(CAMERA)
    first = factory.make(image_of(0))
    factory.give_back(first)
    again = factory.make(image_of(1))
    assert again is first
    for found, expected in zip(again.levels, PyramidFactory(CAMERA).make(image_of(1)).levels, strict=True):
        np.testing.assert_array_equal(found, expected)
    assert factory.make(image_of(2)) is not again


def test_levels_cameras_see_the_same_place_under_a_pixel():
    """A coarse pixel's centre is the middle of the four fine ones that it is the mean of."""
    fine, coarse = level_cameras(CAMERA)
    u, v = 37.0, 21.0
    middle = (2 * u + 0.5 - fine.cx) / fine.fx, (2 * v + 0.5 - fine.cy) / fine.fy
    np.testing.assert_allclose(((u - coarse.cx) / coarse.fx, (v - coarse.cy) / coarse.fy), middle, rtol=1e-12)


@pytest.mark.parametrize(("size", "levels"), [((640, 480), 4), ((320, 240), 3), ((160, 120), 2), ((99, 99), 1)])
def test_the_coarsest_level_is_not_too_small(size, levels):
    camera = PinholeCamera(*size, 100.0, 100.0, size[0] / 2, size[1] / 2)
    cameras = level_cameras(camera)
    assert len(cameras) == levels
    assert min(cameras[-1].shape) >= min(50, *camera.shape)
    for pyramid_level, own in zip(PyramidFactory(camera).make(np.zeros(camera.shape, np.float32)).levels, cameras,
                                  strict=True):  # fmt: skip
        assert pyramid_level.shape[:2] == own.shape


def test_samples_are_bilinear():
    levels = np.stack([PyramidFactory(CAMERA).make(image_of(seed)).levels[0] for seed in (0, 1)])
    rng = np.random.default_rng(2)
    for u, v in [(3.0, 5.0), *rng.uniform([0, 0], [CAMERA.width - 1.01, CAMERA.height - 1.01], (50, 2))]:
        found = sample(levels, 1, np.float32(u), np.float32(v))
        expected = [map_coordinates(levels[1, ..., c].astype(float), [[v], [u]], order=1)[0] for c in range(3)]
        np.testing.assert_allclose(found, expected, atol=0.02)  # u has 24 bits


def test_sixteen_bits_give_the_same_pyramid():
    image = image_of()
    packed = np.rint(np.clip(image, 0, 1) * 65535).astype(np.uint16)
    factory = PyramidFactory(CAMERA)
    for found, expected in zip(factory.make(packed).levels, factory.make(image).levels, strict=True):
        np.testing.assert_allclose(found, expected, atol=0.01)
