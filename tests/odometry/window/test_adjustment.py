"""Adjustment of a window of a rendered room with known geometry: it finds back what was disturbed."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, OPTIONS, inverse_depth_at, motion, room_window

from polarmap.geometry.pose import inverse
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.window.adjustment import adjust, brightness_information
from polarmap.odometry.window.residuals import GOOD, OUTLIER, OUTSIDE, linearize

POSES = (
    motion(0, 0, 0, 0, 0, 0),
    motion(0.12, 0.02, 0.04, 0, 0.02, 0),
    motion(0.2, -0.06, -0.1, 0.01, 0.03, 0.02),
    motion(0.3, 0.06, 0.12, -0.02, 0.05, 0.0),
)
ROLLING = (  # what intrinsics need
    POSES[0],
    motion(0.25, 0.1, 0.2, 0.05, 0.02, 0.4),
    motion(-0.2, 0.2, -0.2, -0.1, 0.05, -0.5),
    motion(0.3, -0.2, 0.3, 0.1, 0.1, 0.9),
)


@pytest.fixture
def window():
    return room_window(POSES)


def scale_of(window, truth: np.ndarray) -> float:
    """Of the map against the room; images alone do not tell it."""
    return float(np.median(window.points.inverse_depth / truth))


def pose_errors(window, scale: float) -> np.ndarray:
    """Position in metres and rotation in radians of every keyframe relative to the first, N×2."""
    T0 = window.keyframes[0].T_camera_world @ inverse(POSES[0])
    errors = []
    for keyframe, truth in zip(window.keyframes, POSES, strict=True):
        T = keyframe.T_camera_world @ inverse(T0)
        T[:3, 3] *= scale
        error = T @ inverse(truth)
        errors.append((np.linalg.norm(error[:3, 3]), np.linalg.norm(error[:3, :3] - np.eye(3)) / np.sqrt(2)))
    return np.array(errors)


def disturb_poses(window, size: float = 0.01) -> None:
    rng = np.random.default_rng(0)
    for keyframe in window.keyframes[1:]:
        keyframe.step = rng.normal(size=6) * size * np.array([1, 1, 1, 0.3, 0.3, 0.3])
        keyframe.relinearize()


def disturb_depths(window, share: float = 0.05) -> None:
    factors = np.random.default_rng(1).uniform(1 - share, 1 + share, len(window.points))
    window.points.inverse_depth *= factors.astype(np.float32)


def test_the_true_state_is_kept(window):
    truth = window.points.inverse_depth.copy()
    adjusted = adjust(window, OPTIONS, 10)
    assert adjusted.rms < 3.0
    assert np.abs(scale_of(window, truth) - 1) < 0.01
    assert pose_errors(window, scale_of(window, truth)).max() < 1e-3


def test_poses_and_depths_are_found_back(window):
    truth = window.points.inverse_depth.copy()
    disturb_poses(window)
    disturb_depths(window)
    before = np.median(np.abs(window.points.inverse_depth / truth - 1))
    worst_pose = pose_errors(window, 1.0).max(axis=0)
    adjust(window, OPTIONS, 30)
    scale = scale_of(window, truth)
    after = np.median(np.abs(window.points.inverse_depth / truth / scale - 1))
    assert before > 0.02 and after < 0.004
    position, rotation = pose_errors(window, scale).max(axis=0)
    assert worst_pose[0] > 0.01 and worst_pose[1] > 0.003
    assert position < 1.5e-3 and rotation < 5e-4


@pytest.mark.parametrize("gains", [(1.0, 1.3, 0.8, 1.5), (1.0, 0.6, 1.0, 2.0)])
def test_brightness_is_found_back(gains):
    window = room_window(POSES, gains=gains)
    truth = window.points.inverse_depth.copy()
    for keyframe in window.keyframes:
        keyframe.affine = np.zeros(2)
        keyframe.relinearize()
        keyframe.threshold = 1e9
    disturb_poses(window, 0.003)
    adjust(window, OdometryOptions(affine_prior=10.0), 30)
    found = np.array([keyframe.affine[0] for keyframe in window.keyframes])
    np.testing.assert_allclose(found - found[0], np.log(gains), atol=0.01)
    assert pose_errors(window, scale_of(window, truth)).max() < 2e-3


def test_a_known_exposure_leaves_no_brightness_to_find():
    gains = (1.0, 1.6, 0.7, 1.2)
    window = room_window(POSES, gains=gains)
    for keyframe, gain in zip(window.keyframes, gains, strict=True):
        keyframe.exposure, keyframe.affine = 3.0 * gain, np.zeros(2)
        keyframe.relinearize()
    adjust(window, OPTIONS, 10)
    assert max(abs(keyframe.affine[0]) for keyframe in window.keyframes) < 0.005


def test_intrinsics_are_found_back_only_where_they_are_asked_for():
    true = np.array([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])
    wrong = true * [1.02, 0.985, 1.0, 1.0] + [0, 0, 1.5, -1.0]
    errors = {}
    for refine in (False, True):
        window = room_window(ROLLING, count=250)
        window.calibration, window.calibration_first = wrong.copy(), wrong.copy()
        options = OdometryOptions(refine_intrinsics=refine)
        for _ in range(3):
            adjust(window, options, 30)
        errors[refine] = np.abs(window.calibration - true)
    np.testing.assert_array_equal(errors[False], np.abs(wrong - true))
    assert (errors[True] < 0.35 * errors[False]).all(), errors


def test_more_iterations_leave_less_residual_and_the_first_keyframe_where_it_is():
    rms = []
    for iterations in (0, 2, 20):
        window = room_window(POSES)
        disturb_poses(window, 0.02)
        disturb_depths(window, 0.1)
        adjusted = adjust(window, OPTIONS, iterations)
        assert adjusted.iterations <= iterations + 1
        rms.append(adjusted.rms)
        np.testing.assert_allclose(window.keyframes[0].step, 0, atol=1e-4)
    assert rms[2] < rms[1] < 0.95 * rms[0]
    assert rms[2] < 0.6 * rms[0]


def test_steps_that_raise_the_energy_are_taken_back():
    """From far off the first steps overshoot; whatever the number of iterations, none leaves more energy."""
    costs = []
    for iterations in range(2, 7):
        window = room_window(POSES)
        inner = (np.abs(window.points.pixel - [CAMERA.cx, CAMERA.cy]) < [50, 32]).all(axis=1)
        window.points = window.points.select(inner)
        disturb_poses(window, 0.1)
        disturb_depths(window, 0.7)
        for keyframe in window.keyframes:
            keyframe.threshold = 1e9
        states = window.points.state.copy()
        adjust(window, OPTIONS, iterations)
        window.points.state = states
        found = linearize(window.images, window.points, window.pairs(), window.thresholds() + 1e9, OPTIONS.huber,
                          OPTIONS.gradient_constant)  # fmt: skip
        prior = sum(brightness_information(OPTIONS) @ keyframe.affine**2 for keyframe in window.keyframes)
        assert OUTSIDE not in found.state
        costs.append(found.energy + prior)
    changes = np.diff(costs)
    assert (changes <= 1e-3 * costs[0]).all()
    assert (np.abs(changes) < 1e-6 * costs[0]).any()  # a step was taken back
    assert costs[-1] < 0.96 * costs[0]


def test_a_wrong_point_is_dropped_and_harms_nothing(window):
    truth = window.points.inverse_depth.copy()
    wrong = np.zeros(len(truth), bool)
    wrong[::10] = True
    window.points.color[wrong] = np.random.default_rng(0).uniform(0, 255, (np.count_nonzero(wrong), 8))
    disturb_poses(window, 0.003)
    adjust(window, OPTIONS, 20)
    good = (window.points.state == GOOD).any(axis=1)
    assert good[wrong].mean() < 0.3 and good[~wrong].mean() > 0.9
    assert OUTLIER not in window.points.state
    assert pose_errors(window, scale_of(window, truth)).max() < 2e-3
    np.testing.assert_array_equal(window.points.good, (window.points.state == GOOD).sum(axis=1))


def test_a_prior_holds_the_state_where_it_says(window):
    """A prior of much information on the newest keyframe wins over the images."""
    offset = np.array([0.02, 0, 0, 0, 0, 0])
    newest = window.newest
    start = 4 + 8 * newest.slot
    window.prior_H[start : start + 6, start : start + 6] += 1e12 * np.eye(6)
    window.prior_b[start : start + 6] = -1e12 * offset
    adjust(window, OPTIONS, 30)
    np.testing.assert_allclose(newest.step, offset, atol=1e-4)


def test_more_views_and_stronger_gradients_know_a_depth_better(window):
    disturb_depths(window, 0.03)
    truth = np.concatenate(
        [
            inverse_depth_at(POSES[k.index], window.points.pixel[window.points.host == k.slot].astype(int))
            for k in window.keyframes
        ]
    )
    adjust(window, OPTIONS, 20)
    error = np.abs(window.points.inverse_depth / scale_of(window, truth) - truth)
    order = np.argsort(window.points.information)
    worst, best = order[: len(order) // 4], order[-len(order) // 4 :]
    assert np.median(error[best]) < 0.5 * np.median(error[worst])
