"""Figures of depth and trajectories, by hand and against evo."""

from __future__ import annotations

import json

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.alignment import align_poses
from polarmap.evaluation.metrics import (
    depth_metrics,
    error_statistics,
    relative_pose_error,
    sigma_metrics,
    trajectory_metrics,
)
from polarmap.evaluation.trajectories import compare_trajectories

NAN = float("nan")


def test_shares_by_hand():
    truth = np.array([[1.0, 1.0, 1.0, 1.0, 1.0, 1.0, NAN, 1.0]])
    depth = np.array([[1.009, 1.019, 0.951, 1.3, 1.6, 3.0, 1.0, NAN]])
    m = depth_metrics(depth, truth)
    assert (m.points, m.compared) == (7, 6)
    assert (m.within_1, m.within, m.within_5) == (1 / 8, 2 / 8, 3 / 8)  # of all pixels
    assert (m.delta1, m.delta2, m.delta3) == (3 / 6, 4 / 6, 5 / 6)  # of the compared: 1.25, 1.5625, 1.953
    exact = depth_metrics(truth, truth)
    assert (exact.within_1, exact.within, exact.within_5) == (7 / 8,) * 3


def test_a_true_depth_of_zero_counts_as_none():
    m = depth_metrics(np.array([[1.0, 2.0]]), np.array([[0.0, 1.0]]))
    assert (m.points, m.compared, m.abs_rel, m.rmse, m.within_5) == (2, 1, 1.0, 1.0, 0.0)


def test_no_overlap_is_nan_and_one_point_is_enough():
    nothing = depth_metrics(np.array([[1.0, NAN]]), np.array([[NAN, 1.0]]))
    assert (nothing.points, nothing.compared, nothing.density, nothing.within) == (1, 0, 0.5, 0.0)
    assert np.isnan([nothing.abs_rel, nothing.rmse, nothing.delta1, nothing.delta3]).all()
    one = depth_metrics(np.array([[2.0]]), np.array([[1.0]]))
    assert (one.abs_rel, one.rmse, one.delta1, one.delta3, one.density) == (1.0, 1.0, 0.0, 0.0, 1.0)


def test_statistics_by_hand():
    s = error_statistics(np.array([1.0, 2.0, 6.0]))
    assert (s.rmse, s.mean, s.median, s.max) == (np.sqrt(41 / 3), 3.0, 2.0, 6.0)
    assert np.isnan([error_statistics(np.empty(0)).rmse, error_statistics(np.empty(0)).max]).all()


def straight(count, step=1.0, turn=0.0):
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 2, 3] = step * np.arange(count)
    poses[:, :3, :3] = Rotation.from_rotvec(np.outer(turn * np.arange(count), [0, 0, 1])).as_matrix()
    return poses


def test_relative_errors_by_hand():
    e = relative_pose_error(straight(5, 1.1, turn=0.01), straight(5))
    assert (e.step, e.pairs) == (1, 4)
    assert (e.translation.rmse, e.translation.max) == pytest.approx((0.1, 0.1))
    assert (e.rotation.mean, e.rotation.median) == pytest.approx((np.degrees(0.01),) * 2)
    assert relative_pose_error(straight(5, 1.1), straight(5), scale=1 / 1.1).translation.max == pytest.approx(0)
    assert relative_pose_error(straight(5, 1.1), straight(5), step=4).translation.mean == pytest.approx(0.4)
    assert relative_pose_error(straight(1), straight(1)) is None
    half_turn = relative_pose_error(straight(2, turn=np.pi), straight(2))
    assert half_turn.rotation.max == pytest.approx(180.0)


def random_walk(seed, count=40):
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.from_rotvec(np.cumsum(0.05 * rng.normal(size=(count, 3)), axis=0)).as_matrix()
    poses[:, :3, 3] = np.cumsum(0.1 * rng.normal(size=(count, 3)), axis=0)
    return poses


def noisy(poses, seed, scale=1.0):
    """The same path in another world and unit, with errors."""
    rng = np.random.default_rng(seed)
    world = np.eye(4)
    world[:3, :3] = Rotation.from_rotvec([0.3, -1.0, 0.4]).as_matrix()
    world[:3, 3] = [3.0, 1.0, -2.0]
    moved = world @ poses
    moved[:, :3, 3] = scale * moved[:, :3, 3] + 0.02 * rng.normal(size=(len(poses), 3))
    moved[:, :3, :3] = moved[:, :3, :3] @ Rotation.from_rotvec(0.02 * rng.normal(size=(len(poses), 3))).as_matrix()
    return moved


@pytest.mark.parametrize("scale", [1.0, 0.37])
def test_the_same_numbers_as_evo(scale):
    metrics = pytest.importorskip("evo.core.metrics", reason="evo is not installed")
    from evo.core.trajectory import PoseTrajectory3D

    truth, times = random_walk(1), 0.1 * np.arange(40)
    run = noisy(truth, 2, scale)
    ours = compare_trajectories(Trajectory(times, run), Trajectory(times, truth))

    def evo_statistics(relation, correct_scale=False, align=True, step=None, all_pairs=False):
        reference = PoseTrajectory3D(poses_se3=list(truth), timestamps=times)
        estimate = PoseTrajectory3D(poses_se3=list(run), timestamps=times)
        if align:
            estimate.align(reference, correct_scale=correct_scale)
        if step is None:
            metric = metrics.APE(relation)
        else:
            metric = metrics.RPE(relation, step, metrics.Unit.frames, all_pairs=all_pairs)
        metric.process_data((reference, estimate))
        found = metric.get_all_statistics()
        return [found[name] for name in ("rmse", "mean", "median", "max")]

    def figures(s):
        return [s.rmse, s.mean, s.median, s.max]

    part, angle = metrics.PoseRelation.translation_part, metrics.PoseRelation.rotation_angle_deg
    assert ours.unaligned == pytest.approx(evo_statistics(part, align=False)[0], rel=1e-9)
    assert figures(ours.ate_rigid) == pytest.approx(evo_statistics(part), rel=1e-7)
    assert figures(ours.ate_similar) == pytest.approx(evo_statistics(part, True), rel=1e-7)
    assert figures(ours.rpe.translation) == pytest.approx(evo_statistics(part, step=1), rel=1e-7)
    assert figures(ours.rpe.rotation) == pytest.approx(evo_statistics(angle, step=1), rel=1e-6)
    assert figures(ours.rpe_similar.translation) == pytest.approx(evo_statistics(part, True, step=1), rel=1e-7)
    apart = relative_pose_error(run, truth, step=5)
    assert figures(apart.translation) == pytest.approx(evo_statistics(part, step=5, all_pairs=True), rel=1e-7)
    assert apart.pairs == 35


def test_a_trajectory_at_rest_has_no_similarity():
    still = np.tile(np.eye(4), (4, 1, 1))
    m = compare_trajectories(Trajectory(np.arange(4.0), still), Trajectory(np.arange(4.0), straight(4)))
    assert np.isnan([m.similar, m.scale, m.ate_similar.max]).all()
    assert m.rpe_similar is None
    assert (m.rpe.pairs, m.rpe.translation.mean) == (3, 1.0)
    one = trajectory_metrics(np.ones((1, 3)), np.zeros((1, 3)))
    assert (one.ate_rigid.max, one.unaligned) == pytest.approx((0.0, np.sqrt(3)))


def test_no_error_is_given_from_two_poses():
    truth = Trajectory(np.arange(36.0), straight(36))
    run = Trajectory(np.arange(36) / 30, straight(36))
    m = compare_trajectories(run, truth)
    assert (m.poses, m.of) == (2, 36)  # those at 0 and 1 s
    assert np.isnan([m.unaligned, m.rigid, m.similar, m.scale]).all()
    assert m.rpe is m.rpe_similar is m.ate_rigid is m.ate_similar is None


def test_true_poses_at_rest_give_no_scale():
    still = np.tile(np.eye(4), (4, 1, 1))
    m = compare_trajectories(Trajectory(np.arange(4.0), straight(4)), Trajectory(np.arange(4.0), still))
    assert np.isnan([m.similar, m.scale]).all() and m.rpe_similar is None


def test_worlds_are_aligned_by_orientations_even_along_a_line():
    truth = straight(6)
    found = align_poses(noisy(truth, 3, scale=0.5), truth, scale=2.0)
    rotation = Rotation.from_rotvec([0.3, -1.0, 0.4]).inv().as_matrix()
    assert np.degrees(Rotation.from_matrix(found.rotation.T @ rotation).magnitude()) < 2.0
    exact = align_poses(truth, truth)
    np.testing.assert_allclose(exact.apply(np.eye(3)), np.eye(3), atol=1e-12)
    with pytest.raises(InputError, match="in pairs"):
        align_poses(truth[:0], truth[:0])


def test_older_evaluations_lack_the_new_figures():
    from polarmap.evaluation.records import _JSON

    old = {"points": 1, "density": 1, "compared": 1, "abs_rel": 0, "rmse": 0, "delta1": 1, "within": 1}
    normals = {"compared": 0, "median": None, "below_11": None, "below_22": None, "below_30": None}
    content = {
        "run": "a", "sequence": "b", "scale": {"factor": 1, "reason": ""}, "depth": old, "by_origin": {}, "stages": {},
        "normals": normals, "normal_truth": "", "trajectory": None, "without_truth": 0, "keyframes": [],
        "curve": {"confidence": [], "density": [], "abs_rel": []},
    }  # fmt: skip
    evaluation = _JSON.validate_json(json.dumps(content))
    assert np.isnan(evaluation.depth.within_1)
    assert (evaluation.format, evaluation.map) == ("polarmap", None)


def test_sigma_is_honest_where_two_thirds_of_the_errors_are_below_it():
    rng = np.random.default_rng(0)
    truth, sigma = rng.uniform(1.0, 5.0, (200, 300)), rng.uniform(0.005, 0.1, (200, 300))
    depth = truth * np.exp(sigma * rng.standard_normal(truth.shape))
    truth[:10], depth[10:20], sigma[20:30] = 0.0, np.nan, np.nan
    metrics = sigma_metrics(depth, sigma, truth)
    assert metrics.compared == 170 * 300
    assert metrics.within_one == pytest.approx(0.683, abs=0.01)
    assert metrics.within_two == pytest.approx(0.954, abs=0.01)


def test_sigma_counts_pixel_by_pixel():
    truth = np.full((1, 4), 2.0)
    depth = truth * np.exp([[0.0, 0.015, -0.025, 0.1]])
    metrics = sigma_metrics(depth, np.full((1, 4), 0.01), truth)
    assert (metrics.within_one, metrics.within_two) == (0.25, 0.5)
    nothing = sigma_metrics(np.full((1, 4), np.nan), truth, truth)
    assert nothing.compared == 0 and np.isnan(nothing.within_one) and np.isnan(nothing.within_two)
