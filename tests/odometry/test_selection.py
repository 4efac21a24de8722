"""Where points are chosen: spread over the image, on what stands out, within the lens's view."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, FACTORY, motion, pyramid_of

from polarmap.odometry.selection import PointSelector, _pick, _region_thresholds

HEIGHT, WIDTH = CAMERA.shape
THRESHOLD = 7.0


@pytest.fixture(scope="module")
def room():
    return pyramid_of(motion(0, 0, 0, 0, 0, 0))


def noise_pyramid(strength: float, seed: int = 0):
    image = 0.5 + strength * (np.random.default_rng(seed).random(CAMERA.shape) - 0.5)
    return FACTORY.make(image.astype(np.float32))


def magnitude(pyramid) -> np.ndarray:
    return np.linalg.norm(pyramid.levels[0][..., 1:].astype(float), axis=-1)


def settled(pyramid, count: int, **arguments) -> np.ndarray:
    """What is chosen once the spacing has followed the image."""
    selector = PointSelector(THRESHOLD, **arguments)
    for _ in range(3):
        pixels = selector.select(pyramid, count)
    return pixels


def reference_thresholds(pyramid, block: int = 32) -> np.ndarray:
    """Whole-number medians of the gradient in 32×32 regions, with `THRESHOLD` added, averaged over 3×3 regions."""
    g = np.minimum(np.floor(magnitude(pyramid)), 63)
    rows, columns = -(-HEIGHT // block), -(-WIDTH // block)
    regions = [g[y * block : (y + 1) * block, x * block : (x + 1) * block] for y in range(rows) for x in range(columns)]
    medians = [np.sort(region, axis=None)[(region.size - 1) // 2] for region in regions]
    padded = np.pad(np.reshape(medians, (rows, columns)) + THRESHOLD, 1, mode="edge")
    return np.mean([padded[y : y + rows, x : x + columns] for y in range(3) for x in range(3)], axis=0)


def test_thresholds_are_smoothed_medians(room):
    for pyramid in (room, noise_pyramid(0.6), noise_pyramid(0.05)):
        found = _region_thresholds(pyramid.levels[0], THRESHOLD)
        np.testing.assert_allclose(found, reference_thresholds(pyramid), rtol=1e-5)


@pytest.mark.parametrize("count", [200, 600, 1500])
def test_about_as_many_as_asked_for(room, count):
    assert 0.75 * count <= len(settled(room, count)) <= 1.25 * count


def test_never_many_more_than_asked_for_even_at_first():
    pyramid = noise_pyramid(0.9)
    for count in range(100, 2000, 100):
        assert len(PointSelector(THRESHOLD).select(pyramid, count)) <= 1.1 * count


def test_pixels_are_different_and_away_from_the_border(room):
    pixels = settled(room, 600)
    assert pixels.dtype == np.int32
    assert len(np.unique(pixels, axis=0)) == len(pixels)
    assert (pixels >= 4).all() and (pixels < [WIDTH - 4, HEIGHT - 4]).all()
    order = pixels[:, 1] * WIDTH + pixels[:, 0]
    assert (np.diff(order) > 0).all()


def test_points_spread_over_the_whole_image():
    """One half has ten times the contrast of the other, but the latter gets its share."""
    image = 0.5 + 0.9 * (np.random.default_rng(0).random(CAMERA.shape) - 0.5)
    image[:, : WIDTH // 2] = 0.5 + (image[:, : WIDTH // 2] - 0.5) / 4
    pixels = settled(FACTORY.make(image.astype(np.float32)), 400)
    cells = np.histogram2d(pixels[:, 1], pixels[:, 0], bins=(6, 8), range=((0, HEIGHT), (0, WIDTH)))[0]
    assert cells.min() >= 0.25 * cells.mean() and cells.max() <= 2.0 * cells.mean()


def test_chosen_pixels_stand_out_of_their_region(room):
    pixels = settled(room, 400)
    thresholds = reference_thresholds(room)[pixels[:, 1] // 32, pixels[:, 0] // 32]
    gradient = magnitude(room)[pixels[:, 1], pixels[:, 0]]
    assert (gradient > 0.75**2 * thresholds - 1e-3).all()
    assert (gradient > thresholds).mean() > 0.5
    assert np.median(gradient) > 2 * np.median(magnitude(room))


def test_a_strong_gradient_does_not_stand_out_among_its_like():
    """Left nothing, right slopes of 8 grey values a pixel everywhere: 7 more than that are asked for there."""
    u = np.arange(WIDTH) + np.zeros((HEIGHT, 1))
    image = 0.3 + np.where(u < 96, 0.0, 8 / 255 * np.abs(u % 12 - 6))
    pixels = PointSelector(THRESHOLD).select(FACTORY.make(image.astype(np.float32)), 100)
    assert len(pixels) and (pixels[:, 0] < 128).all()


@pytest.mark.parametrize(("step", "size"), [(18, 16), (12, 16), (9, 32), (6, None)])
def test_where_nothing_stands_out_larger_blocks_ask_for_less(step, size):
    """Dots 16 pixels apart, their gradient half their height: 7, 0.75 of it, 0.75² of it in blocks of 8, 16, 32."""
    image = np.full(CAMERA.shape, 0.3, np.float32)
    image[12::16, 12::16] += step / 255
    level, mask = FACTORY.make(image).levels[0], np.zeros(CAMERA.shape, bool)
    found = _pick(level, _region_thresholds(level, THRESHOLD), 8, 0, mask)
    expected = 0 if size is None else -(-(HEIGHT - 4) // size) * -(-(WIDTH - 4) // size)
    assert found == mask.sum() == expected


def test_edges_of_every_direction_are_chosen():
    """Where strong vertical and weaker horizontal edges cross, both are taken."""
    u, v = np.meshgrid(np.arange(WIDTH), np.arange(HEIGHT))
    image = 0.5 + 0.2 * np.sign(np.sin(u / 3.0)) * (v % 24 < 12) + 0.15 * np.sign(np.sin(v / 3.0)) * (v % 24 >= 12)
    pyramid = FACTORY.make(image.astype(np.float32))
    pixels = settled(pyramid, 500)
    gx, gy = np.abs(pyramid.levels[0][pixels[:, 1], pixels[:, 0], 1:].T)
    assert 0.2 < (gx > gy).mean() < 0.8


@pytest.mark.parametrize("level", [0.0, 0.5, 1.0])
def test_nothing_stands_out_of_a_blank_image(level):
    assert len(PointSelector(THRESHOLD).select(FACTORY.make(np.full(CAMERA.shape, level, np.float32)), 500)) == 0


def test_only_what_the_lens_shows_is_chosen(room):
    v, u = np.mgrid[:HEIGHT, :WIDTH]
    valid = np.hypot(u - WIDTH / 2, v - HEIGHT / 2) < 80
    pixels = settled(room, 300, valid=valid)
    assert len(pixels) > 100
    distance = np.hypot(pixels[:, 0] - WIDTH / 2, pixels[:, 1] - HEIGHT / 2)
    assert distance.max() < 76
    everywhere = settled(room, 300, valid=np.ones_like(valid))
    np.testing.assert_array_equal(everywhere, settled(room, 300))


def test_choices_depend_on_the_seed_and_the_number_of_the_image_alone(room):
    np.testing.assert_array_equal(settled(room, 300, seed=5), settled(room, 300, seed=5))
    assert not np.array_equal(settled(room, 300, seed=5), settled(room, 300, seed=6))
