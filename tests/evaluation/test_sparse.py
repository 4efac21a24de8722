"""Odometry's points as depth, on points that are known."""

from __future__ import annotations

import numpy as np
import pytest
from rich.console import Console
from run_samples import CAMERA, PERIOD, pose_at, true_depth, write_sequence

from polarmap.data.odometry import OdometryResult, SparsePoints
from polarmap.data.trajectory import PosedFrame
from polarmap.errors import InputError
from polarmap.evaluation.reconstruction import world_points
from polarmap.evaluation.sparse import WINDOW, evaluate_sparse
from polarmap.evaluation.truth import truth_of
from polarmap.report.odometry_tables import odometry_tables

SCALE = 0.5  # the unit of odometry's world


def result_of(hosts, error=1.0, keyframes=(0, 2, 3), std=0.1):
    """Points of each host's own true depth, every 50th pixel, `error` times too far; four frames."""
    frames = tuple(PosedFrame(i, i * PERIOD, 0, pose_at(i, SCALE), i in keyframes) for i in range(4))
    positions, owners = [np.empty((0, 3))], [np.empty(0, int)]
    for host in hosts:
        points = world_points(SCALE * error * true_depth(host), CAMERA, pose_at(host, SCALE))
        points = points[np.isfinite(points).all(axis=1)][::50]
        positions.append(points)
        owners.append(np.full(len(points), host))
    position, host = np.concatenate(positions), np.concatenate(owners)
    n = len(position)
    zeros, ints = np.zeros(n, np.float32), np.zeros(n, np.int64)
    points = SparsePoints(position, zeros + 1, zeros + std, host, np.zeros((n, 2), np.float32), zeros, ints)
    return OdometryResult(frames, points, (), {})


def test_own_points_are_exact(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    found = evaluate_sparse(result_of((0, 2, 3), error=1.1), truth_of(sequence), window=1)
    assert list(found.keyframes) == [0, 2, 3]
    count = -(-48 * 62 // 50)
    assert [m.points for m in found.keyframes.values()] == [count] * 3
    assert found.depth.points == count
    assert found.depth.abs_rel == pytest.approx(0.1, abs=1e-4)
    assert found.left_out == 0


def test_points_of_the_window_are_projected(tmp_path):
    truth, result = truth_of(write_sequence(tmp_path / "seq")), result_of((0,))
    for window, seen in ((1, [True, False, False]), (2, [True, True, False]), (WINDOW, [True, True, True])):
        keyframes = evaluate_sparse(result, truth, window=window).keyframes
        assert [m.points > 0 for m in keyframes.values()] == seen


def test_points_that_may_be_anywhere_do_not_count(tmp_path):
    found = evaluate_sparse(result_of((0, 2, 3), std=0.11), truth_of(write_sequence(tmp_path / "seq")))
    assert (found.depth.points, np.isnan(found.depth.abs_rel)) == (0, True)


def test_what_has_no_truth_is_left_out(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    (sequence.path / "depth" / "000002.png").unlink()
    found = evaluate_sparse(result_of((0, 2, 3)), truth_of(sequence), indices={2, 3})
    assert (list(found.keyframes), found.left_out) == ([3], 1)
    with pytest.raises(InputError, match="no keyframe of odometry has a true depth"):
        evaluate_sparse(result_of((0,)), truth_of(write_sequence(tmp_path / "bare", poses=False)))
    with pytest.raises(InputError, match="at least one keyframe"):
        evaluate_sparse(result_of((0,)), truth_of(sequence), window=0)


def test_the_table_of_odometry_shows_them(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    result = result_of((0, 2, 3), error=1.1)
    console = Console(width=100)
    with console.capture() as capture:
        console.print(
            odometry_tables(result, sequence.truth_trajectory(), evaluate_sparse(result, truth_of(sequence), window=1))
        )
    text = capture.get()
    for expected in ("Depth of points, 3 keyframes", "0.1000", "points per image", "60"):
        assert expected in text
