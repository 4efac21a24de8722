"""Which immature points become active: those that are well known, as far apart as the number of points asks for."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, OPTIONS, inverse_depth_at, motion, pyramid_of, room_window, smooth_pixels

from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.points import new_immature
from polarmap.odometry.window.activation import Activator, _spread
from polarmap.odometry.window.tracing import FOUND, GONE, MISMATCH, UNCLEAR, UNSEEN
from polarmap.odometry.window.window import project

POSES = (
    motion(0, 0, 0, 0, 0, 0),
    motion(0.1, 0.02, 0.03, 0, 0.02, 0),
    motion(0.2, -0.03, -0.05, 0.01, 0.03, 0.02),
)


def window_with_immature_points(active: int = 0, count: int = 600, spread: float = 0.01):
    """Immature points of known depth in the first keyframe, seen from all; and active points in the second."""
    window = room_window(POSES, count=max(active, 10))
    window.points = window.points.select(np.flatnonzero(window.points.host == 1)[:active])
    pixels = smooth_pixels(POSES[0], count, seed=7)
    level = pyramid_of(POSES[0]).levels[0]
    window.immature = new_immature(level, pixels, 0, OPTIONS.gradient_constant)
    truth = inverse_depth_at(POSES[0], pixels)
    window.immature.lowest, window.immature.highest = (1 - spread) * truth, (1 + spread) * truth
    window.immature.length[:] = 1.0
    window.immature.status[:] = FOUND
    return window


def positions(window, points=None) -> np.ndarray:
    """Pixels of points in the newest keyframe, N×2."""
    points = window.points if points is None else points
    newest = window.newest
    projection = window.projection_to(newest.T_camera_world, newest.affine, newest.exposure)
    u, v, _ = project(points.pixel, points.inverse_depth, points.host, projection, window.camera.shape)
    return np.stack([u, v], axis=1)


def test_known_immature_points_become_points_of_their_true_depth():
    window = window_with_immature_points()
    count = Activator(OPTIONS).activate(window, set())
    points = window.points
    assert count == len(points) > 100
    truth = inverse_depth_at(POSES[0], points.pixel.astype(int))
    assert np.median(np.abs(points.inverse_depth / truth - 1)) < 0.004
    assert (points.host == 0).all() and (points.information > 0).all() and not points.good.any()
    assert not points.state[:, 0].any() and points.state[:, [1, 2]].any()


def test_an_immature_point_becomes_a_point_or_waits_but_not_both():
    window = window_with_immature_points()
    all_pixels = {tuple(p) for p in window.immature.pixel}
    Activator(OPTIONS).activate(window, set())
    active, waiting = ({tuple(p) for p in table.pixel} for table in (window.points, window.immature))
    assert active and waiting
    assert not active & waiting
    assert active | waiting <= all_pixels


def test_new_points_keep_their_distance_from_all_others():
    window = window_with_immature_points(active=150, count=900)
    before = len(window.points)
    activator = Activator(OdometryOptions(points=200))
    activator.activate(window, set())
    cells = np.floor(positions(window) / 2).astype(int)
    new = cells[before:]
    assert len(new) > 20
    distance = np.linalg.norm(new[:, None] - cells[None], axis=2)
    distance[np.arange(len(new)), before + np.arange(len(new))] = np.inf
    assert activator._spacing >= 1.2
    # refinement moves a few of them after they were chosen
    assert (distance.min(axis=1) >= activator._spacing - 1e-9).mean() > 0.9


@pytest.mark.parametrize(("active", "comparison"), [(20, "more"), (400, "fewer")])
def test_the_number_of_points_follows_what_is_wanted(active, comparison):
    """Far fewer points than wanted bring new ones closer together round by round; as many push them apart."""
    options = OdometryOptions(points=200)
    activator, counts = Activator(options), []
    for _ in range(3):
        window = window_with_immature_points(active=active, count=1000)
        counts.append(activator.activate(window, set()))
    assert counts[-1] > 1.2 * counts[0] if comparison == "more" else counts[-1] < 0.8 * counts[0]


@pytest.mark.parametrize(
    "change",
    [
        lambda c: c.status.fill(UNSEEN),
        lambda c: c.status.fill(MISMATCH),
        lambda c: c.length.fill(9.0),
        lambda c: c.quality.fill(2.0),
        lambda c: c.highest.fill(np.nan),
    ],
    ids=["unseen", "mismatch", "wide", "ambiguous", "open"],
)
def test_immature_points_that_are_not_well_known_wait(change):
    window = window_with_immature_points()
    before = len(window.immature)
    change(window.immature)
    assert Activator(OPTIONS).activate(window, set()) == 0
    assert len(window.immature) == before


def test_an_unclear_but_narrow_one_is_taken():
    window = window_with_immature_points()
    window.immature.status.fill(UNCLEAR)
    assert Activator(OPTIONS).activate(window, set()) > 100


def test_the_best_known_are_taken_first():
    window = window_with_immature_points(count=1500)
    window.immature.length = np.random.default_rng(0).uniform(0, 7, len(window.immature)).astype(np.float32)
    length = {tuple(p): v for p, v in zip(window.immature.pixel, window.immature.length, strict=True)}
    Activator(OPTIONS).activate(window, set())
    taken = np.mean([length[tuple(p)] for p in window.points.pixel])
    waiting = np.mean([length[tuple(p)] for p in window.immature.pixel])
    assert taken < 0.75 * waiting


def test_immature_points_that_are_lost_or_whose_keyframe_leaves_do_not_wait():
    window = window_with_immature_points()
    window.immature.status[::3] = GONE
    gone = {tuple(p) for p in window.immature.pixel[::3]}
    Activator(OPTIONS).activate(window, set())
    assert not gone & {tuple(p) for p in window.immature.pixel}
    assert not gone & {tuple(p) for p in window.points.pixel}
    window = window_with_immature_points()
    assert Activator(OPTIONS).activate(window, {0}) > 100
    assert len(window.immature) == 0


def test_wrong_depths_do_not_become_points():
    window = window_with_immature_points()
    for array in (window.immature.lowest, window.immature.highest):
        array *= np.float32(4.0)
    activated = Activator(OPTIONS).activate(window, set())
    right = window_with_immature_points()
    assert activated < 0.25 * Activator(OPTIONS).activate(right, set())
    assert len(window.points) == activated


def test_spreading_is_that_of_the_definition():
    rng = np.random.default_rng(0)
    u, v = rng.uniform(0, 79, 300).astype(np.float32), rng.uniform(0, 59, 300).astype(np.float32)
    for spacing in (0.0, 1.0, 1.7, 3.0):
        occupied = np.zeros((31, 41), bool)
        occupied[10, 10] = occupied[20, 30] = True
        taken = [(10, 10), (30, 20)]
        expected = []
        for x, y in zip((u / 2).astype(int), (v / 2).astype(int), strict=True):
            expected.append(all((x - a) ** 2 + (y - b) ** 2 >= spacing**2 for a, b in taken))
            if expected[-1]:
                taken.append((x, y))
        np.testing.assert_array_equal(_spread(occupied, u, v, spacing), expected)
        assert occupied.sum() == len(set(taken))


def test_projection_is_the_cameras():
    window = window_with_immature_points()
    T, pixel = POSES[2], window.immature.pixel
    depth = inverse_depth_at(POSES[0], pixel.astype(int))
    p = np.column_stack([(pixel - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy], np.ones(len(pixel))])
    q = p @ T[:3, :3].T + depth[:, None] * T[:3, 3]
    expected = q[:, :2] / q[:, 2:] * [CAMERA.fx, CAMERA.fy] + [CAMERA.cx, CAMERA.cy]
    projection = window.projection_to(T, np.zeros(2), 1.0)
    u, v, inside = project(pixel, depth, window.immature.host, projection, CAMERA.shape)
    np.testing.assert_allclose(np.stack([u, v], axis=1), expected, atol=1e-3)
    margin = (expected > 3).all(axis=1) & (expected < [CAMERA.width - 4, CAMERA.height - 4]).all(axis=1)
    np.testing.assert_array_equal(inside, margin)
    behind = project(pixel, np.full(len(pixel), 30.0), window.immature.host,
                     window.projection_to(motion(0, 0, -0.5, 0, 0, 0), np.zeros(2), 1.0), CAMERA.shape)  # fmt: skip
    assert not behind[2].any()
