"""Walks along a direction field: what they bring back, and what stops them."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import WIDE, gradient_of, log_range, plane_depth, sphere_depth

from polarmap.densify.paper.trace import trace

NORMAL = (0.4, 0.25, -1.0)
EVERY_TURN = np.radians(89.0)


def slanted(camera):
    return plane_depth(camera, NORMAL, 2.0)


SURFACES = {"plane": slanted, "sphere": sphere_depth}


def uphill_and_contour(gradient):
    uphill = gradient / np.linalg.norm(gradient, axis=-1, keepdims=True)
    return uphill.astype(np.float32), np.stack([-uphill[..., 1], uphill[..., 0]], axis=-1).astype(np.float32)


def line_of(known: dict[int, float], length: int = 12):
    """A row of pixels with some known, all walking along x; (log range, distance, direction, barrier)."""
    w = np.full((1, length), np.nan, np.float32)
    for u, value in known.items():
        w[0, u] = value
    distance = np.where(np.isnan(w), np.nan, 0.0).astype(np.float32)
    direction = np.zeros((1, length, 2), np.float32)
    direction[..., 0] = 1.0
    return w, distance, direction, np.zeros((1, length), bool)


def along(line, gradient=None, max_turn=np.pi / 6, max_steps=20):
    w, distance, direction, barrier = line
    arrivals = trace(w, distance, direction, gradient, barrier, max_turn, max_steps)
    return arrivals.log_range[0], arrivals.distance[0]


@pytest.mark.parametrize("surface", SURFACES)
def test_along_a_contour_the_log_range_stays(surface):
    depth = SURFACES[surface](WIDE)
    w, gradient = log_range(depth, WIDE), gradient_of(SURFACES[surface], WIDE)
    _, contour = uphill_and_contour(gradient)
    gentle = np.isfinite(contour[..., 0]) & (np.linalg.norm(gradient, axis=-1) < 0.02)
    seeds = np.where(np.random.default_rng(0).random(WIDE.shape) < 0.1, w, np.nan).astype(np.float32)
    seeds[~gentle] = np.nan
    contour[~gentle] = np.nan
    arrived = trace(seeds, 0 * seeds, contour, None, np.zeros(WIDE.shape, bool), np.pi / 6, 32)
    known = np.isfinite(arrived.log_range)
    assert known.sum() > 0.9 * (gentle & np.isnan(seeds)).sum()
    error = np.abs(arrived.log_range - w)[known]
    assert error.max() < 0.025 and np.median(error) < 0.004  # a pixel, and a fifth, off the steepest contour


@pytest.mark.parametrize("surface", SURFACES)
def test_uphill_the_gradient_adds_up_to_the_log_range(surface):
    depth = SURFACES[surface](WIDE)
    w, gradient = log_range(depth, WIDE), gradient_of(SURFACES[surface], WIDE).astype(np.float32)
    gradient[np.linalg.norm(gradient, axis=-1) > 0.02] = np.nan
    uphill, _ = uphill_and_contour(gradient)
    passable = np.isfinite(uphill[..., 0])
    seeds = np.where((np.random.default_rng(0).random(WIDE.shape) < 0.1) & passable, w, np.nan).astype(np.float32)
    arrived = trace(seeds, 0 * seeds, uphill, gradient, np.zeros(WIDE.shape, bool), np.pi / 6, 32)
    known = np.isfinite(arrived.log_range)
    assert known.sum() > 0.9 * (passable & np.isnan(seeds)).sum()
    assert np.abs(arrived.log_range - w)[known].max() < 0.02
    assert np.median(np.abs(arrived.log_range - w)[known]) < 0.003


def test_known_pixels_are_not_written():
    w, distance = along(line_of({0: 1.0, 6: 2.0}))
    assert np.isnan(w[[0, 6]]).all() and np.isnan(distance[[0, 6]]).all()
    assert np.isfinite(w[1:6]).all()


def test_both_ends_count_by_their_nearness():
    w, distance = along(line_of({0: 1.0, 10: 2.0}))
    for u in range(1, 10):
        expected = (1.0 / u + 2.0 / (10 - u)) / (1 / u + 1 / (10 - u))
        assert w[u] == pytest.approx(expected, rel=1e-6)
        assert distance[u] == min(u, 10 - u)
    assert w[11] == 2.0 and distance[11] == 1.0


def test_the_way_from_the_stereo_point_counts_too():
    line = line_of({0: 1.0, 4: 2.0})
    line[1][0, 4] = 6.0  # this one was spread itself, over 6 pixels
    w, distance = along(line)
    assert w[3] == pytest.approx((1.0 / 3 + 2.0 / 7) / (1 / 3 + 1 / 7))
    assert distance[3] == 3.0 and distance[5] == 7.0


def test_the_gradient_is_summed_on_the_way():
    gradient = np.zeros((1, 12, 2), np.float32)
    gradient[0, :, 0] = 0.01 * np.arange(12)
    w, _ = along(line_of({2: 1.0}), gradient)
    expected = 1.0 + 0.005 * (np.arange(12.0) ** 2 - 4)
    np.testing.assert_allclose(np.delete(w, 2), np.delete(expected, 2), rtol=1e-5)


def test_a_barrier_stops_a_walk_and_starts_none():
    line = line_of({0: 1.0, 11: 2.0})
    line[3][0, 5] = True
    w, _ = along(line)
    np.testing.assert_array_equal(w[1:5], 1.0)
    np.testing.assert_array_equal(w[6:11], 2.0)
    assert np.isnan(w[5])


def test_a_known_pixel_behind_a_barrier_gives_nothing():
    line = line_of({0: 1.0})
    line[3][0, 0] = True
    assert np.isnan(along(line)[0]).all()


def test_pixels_without_a_direction_are_not_passed():
    line = line_of({0: 1.0})
    line[2][0, 5] = np.nan
    w, _ = along(line)
    assert np.isfinite(w[1:5]).all() and np.isnan(w[5:]).all()


def test_a_walk_ends_after_its_longest_way():
    w, _ = along(line_of({0: 1.0}), max_steps=4)
    assert np.isfinite(w[1:5]).all() and np.isnan(w[5:]).all()


@pytest.mark.parametrize(("degrees", "passes"), [(25.0, True), (35.0, False), (155.0, True), (180.0, True)])
def test_a_turn_ends_a_walk_whichever_way_directions_point(degrees, passes):
    """A direction and its opposite are the same contour."""
    w = np.full((7, 12), np.nan, np.float32)
    w[:, 0] = 1.0
    direction = np.zeros((7, 12, 2), np.float32)
    direction[..., 0] = 1.0
    direction[:, 5] = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    arrived = trace(w, 0 * w, direction, None, np.zeros(w.shape, bool), np.pi / 6, 20)
    assert np.isfinite(arrived.log_range[3, 1:5]).all()
    assert np.isfinite(arrived.log_range[3, 6]) == passes


def test_a_known_pixel_whose_direction_turns_away_is_on_another_surface():
    line = line_of({0: 1.0})
    line[2][0, 0] = 0.0, 1.0
    assert np.isnan(along(line)[0]).all()


def test_a_gradient_that_is_not_known_ends_a_walk():
    line = line_of({0: 1.0, 6: 2.0})
    gradient = np.zeros((1, 12, 2), np.float32)
    gradient[0, 0] = np.nan
    w, distance = along(line, gradient)
    np.testing.assert_array_equal(w[1:6], 2.0)
    np.testing.assert_array_equal(distance[1:6], [5.0, 4.0, 3.0, 2.0, 1.0])


def test_no_direction_leads_nowhere():
    line = line_of({0: 1.0})
    line[2][:] = 0.0
    assert np.isnan(along(line)[0]).all()


def traced_by_loop(w, distance, direction, gradient, barrier, max_steps):
    """The same walks in plain Python, for fields that never turn by 90 degrees."""
    values, lengths = np.full(w.shape, np.nan), np.full(w.shape, np.nan)
    for start in np.argwhere(np.isnan(w) & ~barrier & np.isfinite(direction[..., 0])):
        ends = []
        for sign in (1.0, -1.0):
            step, at, change = sign * direction[tuple(start)], tuple(start), 0.0
            place = start[::-1].astype(np.float32)
            for taken in range(1, max_steps + 1):
                place = place + step
                to = tuple(np.floor(place[::-1] + np.float32(0.5)).astype(int))
                if min(to) < 0 or to[0] >= w.shape[0] or to[1] >= w.shape[1] or barrier[to]:
                    break
                if gradient is not None:
                    change += 0.5 * (gradient[at] + gradient[to]) @ step
                at = to
                if not np.isnan(w[at]):
                    ends.append((w[at] - change, taken + distance[at]))
                    break
                if np.isnan(direction[at]).any():
                    break
                step = direction[at] * np.sign(direction[at] @ step)
        if ends:
            value, length = np.transpose(ends)
            values[tuple(start)], lengths[tuple(start)] = np.average(value, weights=1 / length), length.min()
    return values, lengths


@pytest.mark.parametrize("integrate", [False, True])
def test_walks_agree_with_a_plain_loop(integrate):
    rng = np.random.default_rng(4)
    v, u = np.indices((24, 32))
    angle = 0.7 * np.sin(u / 6.0) + 0.5 * np.cos(v / 5.0)
    sign = rng.choice([-1.0, 1.0], angle.shape)
    direction = (sign[..., None] * np.stack([np.cos(angle), np.sin(angle)], axis=-1)).astype(np.float32)
    gradient = rng.normal(0.0, 0.01, direction.shape).astype(np.float32) if integrate else None
    w = np.where(rng.random(angle.shape) < 0.05, rng.normal(0.5, 0.1, angle.shape), np.nan).astype(np.float32)
    direction[np.isnan(w) & (rng.random(angle.shape) < 0.02)] = np.nan
    distance = rng.integers(0, 5, angle.shape).astype(np.float32)
    barrier = rng.random(angle.shape) < 0.05
    arrived = trace(w, distance, direction, gradient, barrier, EVERY_TURN, 12)
    values, lengths = traced_by_loop(w, distance, direction, gradient, barrier, 12)
    assert np.isfinite(values).sum() > 200
    np.testing.assert_allclose(arrived.log_range, values, atol=1e-5)
    np.testing.assert_allclose(arrived.distance, lengths, atol=1e-5)
