"""Figures of merit against hand-made truth."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from rich.console import Console
from run_samples import CAMERA, pose_at, sample_keyframe, true_depth, write_run, write_sequence
from scipy.spatial.transform import Rotation

from polarmap.data.keyframe import Stages
from polarmap.errors import InputError
from polarmap.evaluation.alignment import umeyama
from polarmap.evaluation.evaluate_run import evaluate_run
from polarmap.evaluation.metrics import (
    ConfidenceHistogram,
    depth_metrics,
    mean_metrics,
    normal_metrics,
    trajectory_metrics,
)
from polarmap.evaluation.records import read_evaluation, write_evaluation
from polarmap.evaluation.truth import truth_of
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_depth
from polarmap.io.formats.normal_png import read_normal_png
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import open_sequence
from polarmap.io.run_folder.folder import tum_line
from polarmap.report.evaluation_tables import evaluation_tables
from polarmap.synth.recording import encode_normals

NAN = float("nan")


def test_depth_metrics_by_hand():
    truth = np.float32([[1.0, 2.0, 4.0, 5.0], [2.0, NAN, 2.0, 2.0]])
    depth = np.float32([[1.01, 2.0, 3.0, NAN], [3.0, 7.0, NAN, NAN]])
    m = depth_metrics(depth, truth)
    assert (m.points, m.density, m.compared) == (5, 5 / 8, 4)
    assert m.abs_rel == pytest.approx((0.01 + 0 + 0.25 + 0.5) / 4, rel=1e-5)
    assert m.rmse == pytest.approx(np.sqrt((0.01**2 + 0 + 1 + 1) / 4), rel=1e-5)
    assert m.delta1 == 2 / 4  # 4/3 and 3/2 are too far
    assert m.within == 2 / 8  # of all pixels


def test_nothing_to_compare_is_nan_and_not_zero():
    nothing = np.full((4, 4), NAN, np.float32)
    m = depth_metrics(nothing, np.ones((4, 4), np.float32))
    assert (m.points, m.density, m.within) == (0, 0.0, 0.0)
    assert np.isnan([m.abs_rel, m.rmse, m.delta1]).all()
    full = depth_metrics(np.full((4, 4), 1.5), np.ones((4, 4)))
    mean = mean_metrics([m, full])
    assert (mean.abs_rel, mean.density, mean.points) == (0.5, 0.5, 8)  # AbsRel of those that have any
    assert np.isnan(mean_metrics([m, m]).abs_rel)


def test_normal_metrics_by_hand():
    angles = np.radians([0.0, 10.0, 20.0, 25.0, 60.0])
    normal = np.stack([np.sin(angles), 0 * angles, -np.cos(angles)], axis=-1)[None].astype(np.float32)
    truth = np.broadcast_to(np.float32([0, 0, -1]), normal.shape).copy()
    normal[0, 0], truth[0, 4] = NAN, NAN
    m = normal_metrics(normal, truth)
    assert m.compared == 3
    assert m.median == pytest.approx(20, abs=1e-3)
    assert (m.below_11, m.below_22, m.below_30) == pytest.approx((1 / 3, 2 / 3, 1))


@given(
    st.lists(st.floats(-5, 5), min_size=9, max_size=9),
    st.floats(0.05, 20),
    st.booleans(),
)
@settings(max_examples=50, deadline=None)
def test_umeyama_finds_the_similarity(numbers, scale, with_scale):
    points = np.random.default_rng(1).normal(size=(12, 3))
    R = Rotation.from_rotvec(numbers[:3]).as_matrix()
    scale = scale if with_scale else 1.0
    moved = scale * points @ R.T + numbers[3:6]
    found = umeyama(points, moved, with_scale)
    assert found.scale == pytest.approx(scale)
    np.testing.assert_allclose(found.rotation, R, atol=1e-9)
    np.testing.assert_allclose(found.apply(points), moved, atol=1e-8)


def test_umeyama_never_reflects():
    points = np.random.default_rng(1).normal(size=(12, 3))
    found = umeyama(points, points * [1, -1, 1])
    assert np.linalg.det(found.rotation) == pytest.approx(1)
    assert np.abs(found.apply(points) - points * [1, -1, 1]).max() > 0.1


def test_umeyama_refuses_what_tells_nothing():
    with pytest.raises(InputError, match="tells no scale"):
        umeyama(np.ones((3, 3)), np.ones((3, 3)))
    with pytest.raises(InputError, match="in pairs"):
        umeyama(np.ones((3, 3)), np.ones((4, 3)))
    np.testing.assert_allclose(umeyama(np.ones((1, 3)), np.zeros((1, 3)), False).apply(np.ones((1, 3))), 0)


def test_trajectory_errors():
    truth = np.random.default_rng(1).normal(size=(20, 3))
    R = Rotation.from_rotvec([0.3, -0.2, 0.5]).as_matrix()
    m = trajectory_metrics(0.5 * truth @ R.T + [1, 2, 3], truth)
    assert m.similar == pytest.approx(0, abs=1e-9)
    assert m.scale == pytest.approx(2)
    assert m.unaligned > m.rigid > 0.3
    shifted = trajectory_metrics(truth + np.array([0.3, 0, 0.4]), truth)
    assert (shifted.unaligned, shifted.rigid) == pytest.approx((0.5, 0), abs=1e-9)
    still = trajectory_metrics(np.ones((3, 3)), np.ones((3, 3)))
    assert still.rigid == 0
    assert np.isnan(still.scale)


def test_the_curve_takes_the_most_confident_first():
    truth = np.full((10, 10), 2.0, np.float32)
    depth = truth.copy()
    depth[5:8] *= 1.1
    depth[8:] = NAN
    confidence = np.repeat(np.float32([0.9] * 5 + [0.2] * 3 + [0.0] * 2)[:, None], 10, axis=1)
    histogram = ConfidenceHistogram()
    histogram.add(depth, confidence, truth)
    histogram.add(depth, confidence, np.full_like(truth, NAN))  # counts for density only
    curve = histogram.curve()
    assert curve.confidence == pytest.approx((0.9, 0.2), abs=0.011)
    assert curve.density == pytest.approx((0.5, 0.8))
    assert curve.abs_rel == pytest.approx((0.0, 0.1 * 3 / 8), abs=1e-6)


def run_with_errors(out, indices=(0, 1, 3), **options):
    """Stereo is 1 % too far, what is propagated 10 %, what is estimated 50 %; every stage before had no estimates."""
    factor = np.repeat(np.float32([1.01, 1.1, 1.5]), 16)[:, None]
    keyframes = []
    for i in indices:
        depth = factor * np.nan_to_num(true_depth(i), nan=2.0)
        first = np.where(np.arange(48)[:, None] < 32, depth, np.float32(NAN))
        stereo = np.where(np.arange(48)[:, None] < 16, depth, np.float32(NAN))
        keyframes.append(sample_keyframe(i, depth, stages=Stages(stereo, stereo, first)))
    return write_run(out, keyframes, stages=True, **options)


def test_a_run_with_known_errors(tmp_path):
    evaluation = evaluate_run(run_with_errors(tmp_path / "out"), truth_of(write_sequence(tmp_path / "seq")))
    assert evaluation.depth.abs_rel == pytest.approx((0.01 + 0.1 + 0.5) / 3, abs=1e-4)
    assert (evaluation.depth.density, evaluation.depth.compared) == (1.0, 48 * 62)
    assert evaluation.depth.within == pytest.approx(62 / 64 / 3)
    assert evaluation.depth.delta1 == pytest.approx(2 / 3)
    for name, error in (("stereo", 0.01), ("propagated", 0.1), ("estimated", 0.5)):
        assert evaluation.by_origin[name].abs_rel == pytest.approx(error, abs=1e-4)
        assert evaluation.by_origin[name].density == pytest.approx(1 / 3)
    assert list(evaluation.stages) == ["stereo", "inliers", "first", "final"]
    assert evaluation.stages["first"].density == pytest.approx(2 / 3)
    assert evaluation.stages["first"].abs_rel == pytest.approx(0.055, abs=1e-4)
    assert evaluation.stages["final"] == evaluation.depth
    assert [k.index for k in evaluation.keyframes] == [0, 1, 3]
    assert (evaluation.trajectory.poses, evaluation.trajectory.unaligned) == (3, pytest.approx(0, abs=1e-12))
    assert evaluation.scale.factor == 1
    assert evaluation.curve.density[-1] == pytest.approx(1.0)
    assert evaluation.without_truth == 0


def test_normals_are_compared_with_those_of_the_true_depth(tmp_path):
    depth = true_depth(1)
    normal = normals_from_depth(depth, CAMERA)
    tilt = Rotation.from_rotvec([0, 0, np.radians(40)]).as_matrix().astype(np.float32)
    out = write_run(tmp_path / "out", [sample_keyframe(1, depth, normal=normal @ tilt.T)])
    evaluation = evaluate_run(out, truth_of(write_sequence(tmp_path / "seq")))
    expected = np.degrees(np.arccos(np.einsum("hwc,hwc->hw", normal, normal @ tilt.T)))
    assert evaluation.normals.median == pytest.approx(np.nanmedian(expected), abs=0.2)
    assert evaluation.normal_truth == "the true depth"


def write_normals(sequence, normal, index=1):
    (sequence.path / "normal").mkdir(exist_ok=True)
    path = sequence.path / "normal" / f"{index:06d}.png"
    cv2.imwrite(str(path), encode_normals(normal)[..., ::-1])
    return path


def test_true_normals_come_from_their_pictures_if_there_are_any(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    rng = np.random.default_rng(0)
    normal = rng.normal(size=(*CAMERA.shape, 3)).astype(np.float32)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    normal[:8] = NAN
    path = write_normals(sequence, normal)
    np.testing.assert_allclose(read_normal_png(path, (64, 48)), normal, atol=5e-5)
    out = write_run(tmp_path / "out", [sample_keyframe(1, true_depth(1), normal=normal)])
    evaluation = evaluate_run(out, truth_of(sequence))
    assert evaluation.normals.median < 0.05
    assert evaluation.normals.compared == 40 * 64
    assert evaluation.normal_truth == "normal/NAME.png"


def test_malformed_normal_pictures_are_named(tmp_path):
    path = write_normals(write_sequence(tmp_path / "seq"), np.ones((*CAMERA.shape, 3), np.float32))
    data = path.read_bytes()
    cv2.imwrite(str(tmp_path / "grey.png"), np.zeros(CAMERA.shape, np.uint16))
    for broken in (b"", data[:60], data[:-40], b"GIF" + data, (tmp_path / "grey.png").read_bytes()):
        path.write_bytes(broken)
        with pytest.raises(InputError, match=r"000001\.png"):
            read_normal_png(path, (64, 48))


def test_odometry_is_scaled_by_its_trajectory(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    small = [sample_keyframe(i, np.float32(0.25) * true_depth(i)) for i in range(4)]
    evaluation = evaluate_run(write_run(tmp_path / "odometry", small, scale=0.25, poses="odometry"), truth_of(sequence))
    assert evaluation.scale.factor == pytest.approx(4)
    assert "Sim(3)" in evaluation.scale.reason
    assert evaluation.depth.abs_rel < 1e-4
    given = evaluate_run(write_run(tmp_path / "given", small, scale=0.25), truth_of(sequence))
    assert given.scale.factor == 1
    assert given.depth.abs_rel == pytest.approx(0.75, abs=1e-4)
    assert given.trajectory.scale == pytest.approx(4)


def test_odometry_without_true_poses_cannot_be_scaled(tmp_path):
    out = write_run(tmp_path / "out", [sample_keyframe(0, true_depth(0))], poses="odometry")
    with pytest.raises(InputError, match=r"groundtruth\.txt.*to scale a run with odometry"):
        evaluate_run(out, truth_of(write_sequence(tmp_path / "seq", poses=False)))
    with pytest.raises(InputError, match="moving camera"):  # a single pose
        evaluate_run(out, truth_of(write_sequence(tmp_path / "seq2")))


def test_given_poses_need_no_true_ones(tmp_path):
    out = write_run(tmp_path / "out", [sample_keyframe(0, true_depth(0))])
    evaluation = evaluate_run(out, truth_of(write_sequence(tmp_path / "seq", poses=False)))
    assert evaluation.trajectory is None
    assert evaluation.depth.abs_rel < 1e-4


def test_missing_truth_is_said(tmp_path):
    out = run_with_errors(tmp_path / "out")
    sequence = write_sequence(tmp_path / "seq")
    (sequence.path / "depth" / "000001.png").unlink()
    evaluation = evaluate_run(out, truth_of(sequence))
    assert evaluation.without_truth == 1
    assert [k.index for k in evaluation.keyframes] == [0, 3]
    with pytest.raises(InputError, match=r"no true depth \(depth/NAME\.png\) for any of the 3 keyframes"):
        evaluate_run(out, truth_of(write_sequence(tmp_path / "bare", depth=False)))


def test_another_sequence_is_refused(tmp_path):
    out = run_with_errors(tmp_path / "out")
    with pytest.raises(InputError, match=r"short: is not the sequence of this run: it has no frame 3"):
        evaluate_run(out, truth_of(write_sequence(tmp_path / "short", count=3)))
    later = write_sequence(tmp_path / "later")
    times = (later.path / "timestamps.txt").read_text().split()
    (later.path / "timestamps.txt").write_text("\n".join(str(float(t) + 1) for t in times))
    with pytest.raises(InputError, match=r"its frame 0 is of 1\.0 s, not of 0\.0 s"):
        evaluate_run(out, truth_of(open_sequence(later.path)))
    other = write_sequence(tmp_path / "other")
    camera = PinholeCamera(64, 48, 61.0, 60.0, 31.5, 23.5)
    write_camera_file(other.path / "camera.yaml", replace(other.camera_file, camera=camera))
    with pytest.raises(InputError, match="its camera file has another size"):
        evaluate_run(out, truth_of(open_sequence(other.path)))


def test_an_evaluation_is_json_for_machines(tmp_path):
    nothing = sample_keyframe(1, np.full(CAMERA.shape, NAN, np.float32))
    evaluation = evaluate_run(write_run(tmp_path / "out", [nothing]), truth_of(write_sequence(tmp_path / "seq")))
    write_evaluation(tmp_path / "evaluation.json", evaluation)
    values = json.loads((tmp_path / "evaluation.json").read_text(), parse_constant=lambda name: pytest.fail(name))
    assert values["depth"]["abs_rel"] is None
    assert values["depth"]["density"] == 0
    found = read_evaluation(tmp_path / "evaluation.json")
    assert np.isnan(found.depth.abs_rel)
    assert found.keyframes[0].index == 1
    run = evaluate_run(run_with_errors(tmp_path / "errors"), truth_of(write_sequence(tmp_path / "seq2")))
    write_evaluation(tmp_path / "evaluation.json", run)
    again = read_evaluation(tmp_path / "evaluation.json")
    assert again.keyframes[0].depth == run.keyframes[0].depth
    write_evaluation(tmp_path / "again.json", again)
    assert (tmp_path / "again.json").read_bytes() == (tmp_path / "evaluation.json").read_bytes()


@pytest.mark.parametrize("text", ["", "[]", '{"run": 1}'])
def test_a_malformed_evaluation_is_named(tmp_path, text):
    (tmp_path / "evaluation.json").write_text(text)
    with pytest.raises(InputError, match=r"evaluation\.json: not an? (evaluation|JSON file)"):
        read_evaluation(tmp_path / "evaluation.json")


def test_tables_say_all_of_it(tmp_path):
    evaluation = evaluate_run(run_with_errors(tmp_path / "out"), truth_of(write_sequence(tmp_path / "seq")))
    console = Console(width=120)
    with console.capture() as capture:
        console.print(evaluation_tables(evaluation, per_keyframe=True))
    text = " ".join(capture.get().split())
    for expected in (
        "Depth by keyframe", "mean over 3 keyframes", "propagated", "0.1000", "first step of densification", "66.7 %",
        "Normals", "ATE rmse", "Scale: none: the poses were given", "the true depth",
    ):  # fmt: skip
        assert expected in text


@pytest.mark.parametrize(
    ("true_times", "said", "figure"),
    [
        ((0, 2), "2 of 3 poses have a true pose at their time; no error is given from fewer than 3", None),
        ((0, 2, 3, 9), "", 0.0),
    ],
)
def test_few_true_poses_are_said(tmp_path, true_times, said, figure):
    sequence = write_sequence(tmp_path / "seq")
    keyframes = [sample_keyframe(i, true_depth(i), T_world_camera=pose_at(i)) for i in (0, 2, 3)]
    run = write_run(tmp_path / "out", keyframes)
    times = sorted(k.timestamp for k in keyframes)
    lines = [tum_line(times[(0, 2, 3).index(i)] if i < 9 else 99.0, pose_at(min(i, 3))) for i in true_times]
    (sequence.path / "groundtruth.txt").write_text("# timestamp [s] tx ty tz qx qy qz qw\n" + "".join(lines))
    evaluation = evaluate_run(run, truth_of(sequence))
    console = Console(width=120)
    with console.capture() as capture:
        console.print(evaluation_tables(evaluation))
    text = " ".join(capture.get().split())
    assert f"{evaluation.trajectory.poses} of 3" in text and said in text
    assert ("have a true pose at their time" in text) == bool(said)
    write_evaluation(tmp_path / "figures.json", evaluation)
    found = json.loads((tmp_path / "figures.json").read_text())["trajectory"]
    assert (found["poses"], found["of"]) == (min(len(true_times), 3), 3)
    assert found["similar"] == (None if figure is None else pytest.approx(figure, abs=1e-9))
    assert read_evaluation(tmp_path / "figures.json").trajectory.of == 3


def test_poses_are_matched_by_time(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    keyframes = [sample_keyframe(i, true_depth(i), T_world_camera=pose_at(i)) for i in (0, 2, 3)]
    evaluation = evaluate_run(write_run(tmp_path / "out", keyframes), truth_of(sequence))
    assert (evaluation.trajectory.poses, evaluation.trajectory.of) == (3, 3)
    assert evaluation.trajectory.unaligned == pytest.approx(0, abs=1e-12)
