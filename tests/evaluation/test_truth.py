"""What is true of a sequence, from its files and from arrays alone."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from run_samples import CAMERA, PERIOD, pose_at, true_depth, write_sequence

from polarmap.data.codes import Origin
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.alignment import Similarity
from polarmap.evaluation.evaluate_import import evaluate_import
from polarmap.evaluation.evaluate_run import evaluate_keyframes
from polarmap.evaluation.imported import ImportedDepth, ImportedFrame, ImportedRun
from polarmap.evaluation.metrics import ConfidenceHistogram
from polarmap.evaluation.reconstruction import Reconstruction, RunDepth, measure_map, measure_walls
from polarmap.evaluation.truth import TrueFrame, Truth, truth_of
from polarmap.geometry.surface import normals_from_depth
from polarmap.io.run_folder.keyframe_file import KeyframeResult

NOWHERE = Path("no such folder")
POSES = Trajectory(PERIOD * np.arange(4), np.array([pose_at(i) for i in range(4)]))


def wall(index):
    """A wall at z = 2.5 m of the world."""
    return np.full(CAMERA.shape, 2.5 - pose_at(index)[2, 3], np.float32)


def truth_from_arrays(depth, count=4, trajectory=POSES):
    frames = tuple(TrueFrame(i, i * PERIOD, lambda i=i: depth(i)) for i in range(count))
    return Truth("arrays", CAMERA, frames, lambda: trajectory)


def test_files_and_arrays_say_the_same(tmp_path):
    read, made = truth_of(write_sequence(tmp_path / "seq")), truth_from_arrays(true_depth)
    assert list(read.poses) == list(made.poses) == [0, 1, 2, 3]
    for i in range(4):
        np.testing.assert_allclose(read.poses[i], made.poses[i], atol=1e-12)
        np.testing.assert_allclose(read.depth(i), made.depth(i), atol=1e-4)
        np.testing.assert_array_equal(made.image(i).normal, normals_from_depth(true_depth(i), CAMERA))
    assert read.normal_source == made.normal_source


def test_nothing_is_read_before_it_is_asked_for(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    (sequence.path / "groundtruth.txt").write_text("no trajectory")
    (sequence.path / "depth" / "000001.png").write_bytes(b"no picture")
    (sequence.path / "depth" / "000002.png").unlink()
    truth = truth_of(sequence)
    assert truth.depth(0) is not None and truth.image(2) is None
    for ask, name in ((lambda: truth.trajectory, "groundtruth"), (lambda: truth.image(1), "000001")):
        with pytest.raises(InputError, match=name):
            ask()
    with pytest.raises(InputError, match="no frame has the index 9"):
        truth.depth(9)


def test_poses_are_read_once():
    asked = []
    truth = Truth("arrays", CAMERA, (TrueFrame(0, 0.0),), lambda: asked.append(1) or POSES)
    assert truth.poses and truth.trajectory is truth.trajectory
    assert len(asked) == 1


def test_without_times_no_frame_has_a_pose():
    frames = (TrueFrame(0, 0.0), TrueFrame(1, float("nan")))
    assert Truth("arrays", CAMERA, frames, lambda: POSES).poses == {}


def test_results_in_memory_are_evaluated_without_any_file():
    frames = tuple(
        ImportedFrame(i, NOWHERE, lambda i=i: ImportedDepth(np.float32(0.505) * true_depth(i))) for i in range(3)
    )
    poses = POSES.poses.copy()
    poses[:, :3, 3] *= 0.5
    run = ImportedRun(NOWHERE, "colmap", frames, trajectory=Trajectory(POSES.timestamps, poses))
    evaluation = evaluate_import(run, truth_from_arrays(true_depth))
    assert evaluation.sequence == "arrays"
    assert evaluation.scale.factor == pytest.approx(2)
    assert evaluation.depth.abs_rel == pytest.approx(0.01, abs=1e-5)
    assert evaluation.depth.density == pytest.approx(62 / 64)


def keyframe_from_arrays(index, factor):
    """A keyframe whose depth is `factor` times the true one, all of it stereo."""
    depth = np.float32(factor) * true_depth(index)
    images = dict.fromkeys(("azimuth", "zenith", "sigma", "confidence"), np.ones(CAMERA.shape, np.float32))
    codes = dict.fromkeys(("label", "origin"), np.full(CAMERA.shape, Origin.STEREO, np.uint8))
    normal = normals_from_depth(true_depth(index), CAMERA)
    return KeyframeResult(index, index * PERIOD, pose_at(index), CAMERA, depth, normal, stages={}, **images, **codes)


def test_keyframes_in_memory_are_evaluated_without_any_file():
    truth, histogram = truth_from_arrays(true_depth, count=2), ConfidenceHistogram()
    keyframes = [keyframe_from_arrays(i, 0.51) for i in range(2)]
    first, nothing = (
        [*evaluate_keyframes(keyframes, truth, factor_of, histogram)]
        for factor_of in ({0: 2.0}.get, lambda index: None)
    )
    assert [(row.index, row.normals.median) for row in first] == [(0, pytest.approx(0.0, abs=0.1))]
    assert first[0].depth.abs_rel == first[0].by_origin["stereo"].abs_rel == pytest.approx(0.02, abs=1e-5)
    assert nothing == []
    assert histogram.curve().abs_rel[-1] == pytest.approx(0.02, abs=1e-5)
    with pytest.raises(InputError, match="is not the sequence of this run: it has no frame 3"):
        next(evaluate_keyframes([keyframe_from_arrays(3, 1.0)], truth, lambda index: 1.0, histogram))


def test_surface_and_walls_in_memory_are_measured_without_any_file():
    truth = truth_from_arrays(wall)
    identity = Similarity(1.0, np.eye(3), np.zeros(3))
    near = Reconstruction(
        NOWHERE, lambda: (RunDepth(i, wall(i) + np.float32(0.03), pose_at(i)) for i in range(4)), None, identity
    )
    surface = measure_map(near, truth, thresholds=(0.02, 0.05))
    assert (surface.source, surface.precision, surface.recall) == ("depth maps", (0.0, 1.0), (0.0, 1.0))
    walls = measure_walls(near, truth)
    assert (walls.found_in, len(walls.walls)) == ("the true depth", 1)
    assert dict(zip(walls.thresholds, walls.of_truth, strict=True))[0.02] == 0.0
    assert walls.of_truth[-1] == walls.within[0] == 1.0
