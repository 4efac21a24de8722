"""The direct start on a rendered room: motion and depths from two frames, or the reason why not."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, FACTORY, OPTIONS, inverse_depth_at, motion, pyramid_of, smooth_pixels

from polarmap.geometry.pose import inverse
from polarmap.odometry.start.direct import DirectStarter

HERE = motion(0, 0, 0, 0, 0, 0)
PARALLAX = 2.0  # pixels


@pytest.fixture
def starter() -> DirectStarter:
    starter = DirectStarter(FACTORY.cameras, OPTIONS)
    assert starter.begin(pyramid_of(HERE))
    return starter


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Between two vectors, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def check(start, truth: np.ndarray, depth_error: float = 0.05, direction_error: float = 4.0) -> None:
    """Depths, rotation, the translation's direction, and its length in units of the depths."""
    true_depth = inverse_depth_at(HERE, start.pixels.astype(int))
    scale = np.median(start.inverse_depth / true_depth)
    assert np.median(np.abs(start.inverse_depth / true_depth / scale - 1)) < depth_error
    T = start.T_second_first
    assert np.abs(T[:3, :3] @ truth[:3, :3].T - np.eye(3)).max() < 0.01
    assert angle(T[:3, 3], truth[:3, 3]) < direction_error
    assert np.linalg.norm(T[:3, 3]) * scale == pytest.approx(np.linalg.norm(truth[:3, 3]), rel=2 * depth_error)
    assert 0.5 < np.median(start.inverse_depth) < 2.0


@pytest.mark.parametrize(
    "step",
    [motion(0.03, 0.004, 0.01, 0, 0.002, 0.002), motion(-0.005, 0.03, -0.01, 0.003, 0, -0.003)],
    ids=["sideways", "down"],
)
def test_slow_motion_starts_a_map_once_there_is_parallax(starter, step):
    waited = 0
    for n in range(1, 16):
        T = np.linalg.matrix_power(step, n)
        start = starter.add(pyramid_of(T), PARALLAX)
        if start is not None:
            break
        assert "too little parallax" in starter.reason or "told apart" in starter.reason
        waited += 1
    assert start is not None and 1 <= waited < 14
    check(start, T, depth_error=0.1, direction_error=8.0)


def test_rotation_alone_does_not_start_a_map(starter):
    for n in range(1, 6):
        assert starter.add(pyramid_of(motion(0, 0, 0, 0, 0.01 * n, 0.01 * n)), PARALLAX) is None
        assert "too little parallax" in starter.reason


@pytest.mark.parametrize(
    ("T", "gain"),
    [
        (motion(0.15, 0.03, 0.05, 0.01, 0.03, 0.02), 0.6),
        (motion(0.15, 0.03, 0.05, 0.01, 0.03, 0.02), 1.6),
        (motion(0.03, -0.04, -0.4, 0.01, 0.01, 0.02), 1.0),
    ],
)
def test_refinement_finds_depth_everywhere_from_a_few(starter, T, gain):
    """The two-view start gives a motion that is about right, and depths of a few corners."""
    pixels = smooth_pixels(HERE, 80)
    rng = np.random.default_rng(0)
    depth = 2.0 * inverse_depth_at(HERE, pixels) * rng.uniform(0.8, 1.2, len(pixels)).astype(np.float32)
    guess = motion(0.004, -0.004, 0.002, 0.002, -0.002, 0.001) @ T
    guess[:3, 3] /= 2.0
    start = starter.refine(pyramid_of(T, gain=gain, noise=0.5), guess, pixels, depth)
    assert start is not None, starter.reason
    assert len(start.pixels) > 300
    usual = 50.0  # grey values; gain and offset stand in for each other a little
    assert start.gain * usual + start.offset == pytest.approx(gain * usual, rel=0.03)
    check(start, T, depth_error=0.015, direction_error=1.0)


def test_frames_that_do_not_fit_are_refused_with_the_reason(starter):
    noise = np.random.default_rng(0).random(CAMERA.shape, dtype=np.float32)
    assert starter.add(FACTORY.make(noise), PARALLAX) is None
    assert "do not fit" in starter.reason
    pixels = smooth_pixels(HERE, 80)
    assert (
        starter.refine(FACTORY.make(noise), motion(0.1, 0, 0, 0, 0, 0), pixels, inverse_depth_at(HERE, pixels)) is None
    )
    assert "do not fit" in starter.reason


@pytest.mark.parametrize("level", [0.0, 0.5])
def test_a_blank_first_frame_is_refused(level):
    starter = DirectStarter(FACTORY.cameras, OPTIONS)
    assert not starter.begin(FACTORY.make(np.full(CAMERA.shape, level, np.float32)))
    assert "too little contrast" in starter.reason


def test_a_failed_frame_does_not_spoil_the_next(starter):
    fresh = DirectStarter(FACTORY.cameras, OPTIONS)
    fresh.begin(pyramid_of(HERE))
    assert starter.add(pyramid_of(motion(0, 0, 0, 0, 1.2, 0)), PARALLAX) is None
    T = motion(0.12, 0.01, 0.03, 0, 0.005, 0.005)
    start, expected = (s.add(pyramid_of(T), 0.5 * PARALLAX) for s in (starter, fresh))
    assert start is not None, starter.reason
    check(start, T, depth_error=0.1, direction_error=8.0)
    assert start.inverse_depth.shape == expected.inverse_depth.shape
    assert np.median(np.abs(start.inverse_depth - expected.inverse_depth)) < 1e-4


def test_pixels_that_the_lens_does_not_show_give_no_points():
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    valid = np.hypot(u - CAMERA.cx, v - CAMERA.cy) < 85
    starter = DirectStarter(FACTORY.cameras, OPTIONS, valid=valid)
    assert starter.begin(pyramid_of(HERE))
    T = motion(0.15, 0.03, 0.05, 0.01, 0.03, 0.02)
    pixels = smooth_pixels(HERE, 80)
    start = starter.refine(pyramid_of(T), T, pixels, inverse_depth_at(HERE, pixels))
    assert start is not None, starter.reason
    assert np.hypot(*(start.pixels - [CAMERA.cx, CAMERA.cy]).T).max() < 81


def test_a_start_the_other_way_round_is_the_inverse():
    """The room does not care which of two frames comes first."""
    T = motion(0.15, 0.03, 0.05, 0.01, 0.03, 0.02)
    starter = DirectStarter(FACTORY.cameras, OPTIONS)
    assert starter.begin(pyramid_of(T))
    pixels = smooth_pixels(T, 80)
    back = inverse(T)
    start = starter.refine(pyramid_of(HERE), back, pixels, inverse_depth_at(T, pixels))
    assert start is not None, starter.reason
    true_depth = inverse_depth_at(T, start.pixels.astype(int))
    scale = np.median(start.inverse_depth / true_depth)
    assert angle(start.T_second_first[:3, 3], back[:3, 3]) < 4.0
    assert np.linalg.norm(start.T_second_first[:3, 3]) * scale == pytest.approx(np.linalg.norm(T[:3, 3]), rel=0.1)
