"""The loop that spreads depth, on surfaces with known answers: dense, exact, and nothing leaks over an edge."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scenes import WIDE, moved, polarization_of, view_of

from polarmap.data.codes import Origin
from polarmap.data.view import Neighbour
from polarmap.densify.options import PaperOptions
from polarmap.densify.paper.loop import densify
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import log_range_gradient
from polarmap.polarization.cues import disambiguate

UNKNOWN = np.float32(np.nan)
SURFACES = ("plane", "sphere", "cylinder")
LEFT = np.arange(WIDE.width) < 60
FLAT = np.full(WIDE.shape, 0.7, np.float32)  # a picture without edges


@lru_cache
def scene(shape: str) -> tuple[np.ndarray, np.ndarray]:
    """True depth and the gradient that exact polarization asks for."""
    truth = view_of(shape)
    cues = disambiguate(polarization_of(truth), truth.normal, WIDE)
    return truth.depth, log_range_gradient(cues.azimuth, cues.zenith, WIDE)


def seeds_at(pixels: np.ndarray, depth: np.ndarray) -> np.ndarray:
    """True depth with 0.2 % noise at some pixels."""
    noise = 1 + 0.002 * np.random.default_rng(1).standard_normal(depth.shape)
    return np.where(pixels, depth * noise, UNKNOWN).astype(np.float32)


def scattered(share: float) -> np.ndarray:
    return np.random.default_rng(0).random(WIDE.shape) < share


def error(dense, depth) -> np.ndarray:
    return np.abs(dense.depth / depth - 1)[np.isfinite(dense.depth) & np.isfinite(depth)]


def density(dense, depth) -> float:
    on_surface = np.isfinite(depth)
    return np.isfinite(dense.depth[on_surface]).mean()


@pytest.mark.parametrize("shape", SURFACES)
def test_scattered_points_fill_a_surface(shape):
    depth, gradient = scene(shape)
    dense = densify(seeds_at(scattered(0.02), depth), gradient, FLAT, [], WIDE)
    assert density(dense, depth) > 0.9
    assert error(dense, depth).mean() < 0.01
    assert np.quantile(error(dense, depth), 0.95) < 0.03


@pytest.mark.parametrize("shape", SURFACES)
def test_a_textured_strip_fills_a_surface(shape):
    """Every depth on the rest must come over tens of pixels."""
    depth, gradient = scene(shape)
    strip = np.broadcast_to((np.arange(WIDE.width) > 55) & (np.arange(WIDE.width) < 62), WIDE.shape)
    dense = densify(seeds_at(strip, depth), gradient, FLAT, [], WIDE)
    assert density(dense, depth) > 0.85
    assert error(dense, depth).mean() < 0.015


@pytest.mark.parametrize("shape", ["sphere", "cylinder"])
def test_nothing_spreads_beside_the_surface(shape):
    depth, gradient = scene(shape)
    dense = densify(seeds_at(scattered(0.05), depth), gradient, FLAT, [], WIDE)
    assert not np.isfinite(dense.depth[np.isnan(depth)]).any()


def leaks(smoothing_iterations: int) -> tuple[int, int]:
    """Pixels of the near and of the far plane that are off by over 5 %: a leak is off by over 30 %."""
    depth, gradient = scene("edge")
    options = PaperOptions(smoothing_iterations=smoothing_iterations)
    dense = densify(seeds_at(scattered(0.05), depth), gradient, FLAT, [], WIDE, options)
    assert density(dense, depth) > 0.95
    wrong = np.abs(dense.depth / depth - 1) > 0.05
    return np.count_nonzero(wrong[:, LEFT]), np.count_nonzero(wrong[:, ~LEFT])


def test_nothing_leaks_over_a_depth_edge_although_the_picture_shows_none():
    assert leaks(smoothing_iterations=0) == (0, 0)


def test_smoothing_does_not_blur_a_depth_edge():
    depth, gradient = scene("edge")
    dense = densify(depth, gradient, FLAT, [], WIDE)
    assert error(dense, depth).max() < 0.03


@pytest.mark.parametrize("shape", SURFACES)
def test_stereo_points_stay_where_they_are(shape):
    """Smoothing may mend their noise and must not spoil them."""
    depth, gradient = scene(shape)
    dense = densify(depth, gradient, FLAT, [], WIDE)
    assert np.median(error(dense, depth)) < 0.003


def test_an_edge_of_the_picture_is_not_crossed():
    depth, gradient = scene("plane")
    picture = np.where(LEFT, 0.4, 0.7) * np.ones(WIDE.shape)
    seeds = seeds_at(scattered(0.05) & LEFT, depth)
    dense = densify(seeds, gradient, picture.astype(np.float32), [], WIDE)
    known = np.isfinite(dense.depth)
    assert known[:, :59].mean() > 0.95 and not known[:, 60:].any()
    wide_open = densify(seeds, gradient, picture.astype(np.float32), [], WIDE, PaperOptions(edge=1.0))
    assert np.isfinite(wide_open.depth[:, 61:]).mean() > 0.8


def test_without_seeds_there_is_nothing():
    _, gradient = scene("plane")
    dense = densify(np.full(WIDE.shape, UNKNOWN), gradient, FLAT, [], WIDE)
    assert np.isnan(dense.depth).all() and np.isnan(dense.first).all()
    assert (dense.origin == Origin.NONE).all() and dense.added == (0,)


def test_without_a_gradient_the_seeds_remain():
    depth, gradient = scene("plane")
    seeds = seeds_at(scattered(0.02), depth)
    dense = densify(seeds, np.full_like(gradient, np.nan), FLAT, [], WIDE, PaperOptions(smoothing_iterations=0))
    np.testing.assert_allclose(dense.depth, seeds, rtol=1e-6)


def test_origin_and_distance_say_where_depth_came_from():
    depth, gradient = scene("plane")
    at = scattered(0.02)
    dense = densify(seeds_at(at, depth), gradient, FLAT, [], WIDE)
    np.testing.assert_array_equal(dense.origin == Origin.STEREO, at)
    np.testing.assert_array_equal(dense.origin == Origin.NONE, np.isnan(dense.depth))
    assert {Origin.PROPAGATED, Origin.ESTIMATED} <= set(dense.origin.ravel())
    np.testing.assert_array_equal(dense.distance == 0, at)
    spread = np.isfinite(dense.depth) & ~at
    assert (dense.distance[spread] >= 1).all() and np.isnan(dense.distance[np.isnan(dense.depth)]).all()
    assert dense.origin.dtype == np.uint8 and dense.depth.dtype == np.float32 == dense.distance.dtype


def test_it_stops_when_new_points_are_few():
    depth, gradient = scene("plane")
    seeds = seeds_at(np.broadcast_to(np.arange(WIDE.width) < 4, WIDE.shape), depth)
    short = {"max_steps": 8, "smoothing_iterations": 0}
    full = densify(seeds, gradient, FLAT, [], WIDE, PaperOptions(min_growth=0.0, max_iterations=100, **short))
    assert full.added[-1] == 0 < min(full.added[:-1])
    growth = np.array(full.added) / (np.isfinite(seeds).sum() + np.cumsum(full.added))
    stopping = int(np.argmax(growth <= 0.1))
    usual = densify(seeds, gradient, FLAT, [], WIDE, PaperOptions(max_iterations=100, **short))
    assert 2 < len(usual.added) == stopping + 1 < len(full.added)
    assert len(densify(seeds, gradient, FLAT, [], WIDE, PaperOptions(max_iterations=2, **short)).added) == 2


def test_first_is_the_depth_after_one_iteration():
    depth, gradient = scene("plane")
    seeds = seeds_at(np.broadcast_to(np.arange(WIDE.width) < 4, WIDE.shape), depth)
    whole, one = (
        densify(seeds, gradient, FLAT, [], WIDE, PaperOptions(max_steps=8, max_iterations=n)) for n in (10, 1)
    )
    np.testing.assert_array_equal(whole.first, one.depth)
    assert 0 < np.isfinite(whole.first).sum() < np.isfinite(whole.depth).sum()
    none = densify(seeds, gradient, FLAT, [], WIDE, PaperOptions(max_iterations=0))
    assert none.added == () and np.isfinite(none.depth).sum() == np.isfinite(seeds).sum()


def test_depth_that_another_view_contradicts_is_not_taken():
    depth, gradient = scene("plane")
    seeds = seeds_at(scattered(0.02), depth)
    other = depth.copy()
    other[:, ~LEFT] *= 2.0
    dense = densify(seeds, gradient, FLAT, [Neighbour(FLAT, np.eye(4), other)], WIDE)
    spread = dense.origin >= Origin.PROPAGATED
    assert spread[:, LEFT].mean() > 0.9 and not spread[:, ~LEFT].any()


def test_depth_that_another_picture_does_not_show_is_not_taken():
    depth, gradient = scene("plane")
    seeds = seeds_at(scattered(0.02), depth)
    darker = np.where(LEFT, FLAT, 0.5 * FLAT)
    dense = densify(seeds, gradient, FLAT, [Neighbour(darker, np.eye(4))], WIDE)
    spread = dense.origin >= Origin.PROPAGATED
    assert (
        spread[:, :55].mean() > 0.9 and not spread[:-1, 62:-1].any()
    )  # the last ones have no right or lower neighbour


def test_a_view_that_agrees_changes_nothing():
    depth, gradient = scene("plane")
    seeds = seeds_at(scattered(0.02) & np.isfinite(gradient[..., 0]), depth)
    alone, confirmed = (
        densify(seeds, gradient, FLAT, others, WIDE).depth
        for others in ([], [Neighbour(FLAT, np.eye(4), depth), Neighbour(FLAT, moved(0.01))])
    )
    np.testing.assert_array_equal(alone, confirmed)


def test_scale_drops_out():
    depth, gradient = scene("sphere")
    at = scattered(0.05) & np.isfinite(gradient[..., 0])
    small, large = (densify(seeds_at(at, depth * scale), gradient, FLAT, [], WIDE).depth for scale in (1.0, 40.0))
    np.testing.assert_allclose(large, 40 * small, rtol=1e-4)


def test_stereo_points_without_a_gradient_do_no_harm():
    depth, gradient = scene("plane")
    at = scattered(0.05)
    gradient = np.where(at[..., None], UNKNOWN, gradient)
    assert error(densify(seeds_at(at, depth), gradient, FLAT, [], WIDE), depth).max() < 0.1


def test_arrays_of_another_size_are_refused():
    depth, gradient = scene("plane")
    camera = PinholeCamera(WIDE.width + 1, WIDE.height, 90.0, 90.0, 60.0, 44.5)
    with pytest.raises(InputError, match="seeds"):
        densify(depth, gradient, FLAT, [], camera)
    with pytest.raises(InputError, match="gradient"):
        densify(depth, gradient[1:], FLAT, [], WIDE)
    with pytest.raises(InputError, match="image"):
        densify(depth, gradient, FLAT[1:], [], WIDE)


@pytest.mark.parametrize("view", [Neighbour(FLAT[:9], np.eye(4)), Neighbour(FLAT, np.eye(4), FLAT[:9])])
def test_other_views_of_another_size_are_refused(view):
    depth, gradient = scene("plane")
    with pytest.raises(InputError):
        densify(depth, gradient, FLAT, [view], WIDE)
