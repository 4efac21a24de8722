"""The local origin of far worlds, and positions that were rounded there."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.geometry.origin import local_origin, lost_precision, shifted, steps_of

UTM = np.array([451234.0, 5212345.0, 512.0])
ECEF = np.array([4194304.5, -871000.0, 4712345.0])


def test_near_worlds_keep_their_origin():
    for position in ([0.0, 0.0, 0.0], [999.0, -999.0, 3.0], [-0.7, -1.5, 1.5]):
        np.testing.assert_array_equal(local_origin(np.array(position)), 0.0)
    T = np.eye(4)
    assert shifted(T, np.zeros(3)) is T


@pytest.mark.parametrize("place", [UTM, ECEF, -UTM, [0.0, 5100.0, 0.0]])
def test_far_worlds_get_a_round_one_nearby(place):
    place = np.array(place)
    origin = local_origin(place)
    assert np.abs(place - origin).max() <= 50.0
    np.testing.assert_array_equal(origin % 100.0, 0.0)
    np.testing.assert_array_equal(origin, np.float32(origin))  # for programs that read it in single precision
    assert not (np.signbit(origin) & (origin == 0)).any()
    poses = np.tile(np.eye(4), (2, 1, 1))
    poses[:, :3, 3] = place + np.array([[0.125, 0.25, 0.5], [1.0, 2.0, 3.0]])
    moved = shifted(poses, -origin)
    np.testing.assert_array_equal(moved[:, :3, 3], poses[:, :3, 3] - origin)
    np.testing.assert_array_equal(poses[0, :3, 3], place + np.array([0.125, 0.25, 0.5]))


def test_steps_of_a_type():
    assert steps_of(np.float32([1.0, -5212345.0, np.nan])) == 0.5
    assert steps_of(np.array([5212345.0])) < 1e-9
    assert steps_of(np.empty(0)) == 0.0


def walk(count=60, seed=0):
    """A camera carried through a room, 1.5 cm from frame to frame."""
    rng = np.random.default_rng(seed)
    return np.cumsum(rng.normal(0.0, 0.015, (count, 3)), axis=0)


@pytest.mark.parametrize(
    ("rounded", "step"),
    [
        (lambda p: p, 0.0),
        (lambda p: p.astype(np.float32), 0.5),
        (lambda p: np.array([[float(f"{v:.7g}") for v in row] for row in p]), 1.0),
        (lambda p: p.round(1), 0.1),
        (lambda p: p.round(3), 0.0),
    ],
)
def test_rounded_positions_are_noticed(rounded, step):
    assert lost_precision(rounded(walk() * [1, 30, 1] + UTM).astype(float)) == pytest.approx(step)


def test_positions_that_only_look_rounded():
    assert lost_precision(walk().astype(np.float32).astype(float)) == 0.0  # near zero: no harm
    straight = np.zeros((20, 3))
    straight[:, 0] = 0.1 * np.arange(20)
    assert lost_precision(straight + UTM) == 0.0  # drawn by hand
    assert lost_precision(np.tile(UTM, (20, 1))) == 0.0  # a camera that stands
    assert lost_precision(np.empty((0, 3))) == 0.0
