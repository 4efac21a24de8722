"""Other programs' results measured as a run's own."""

from __future__ import annotations

import json
import re
from dataclasses import astuple, replace

import cv2
import numpy as np
import pytest
from command_line import refused
from import_samples import colmap_map_bytes, dmap_bytes, write_colmap_model
from rich.console import Console
from run_samples import (
    CAMERA,
    DEPTH_SCALE,
    PERIOD,
    pose_at,
    sample_keyframe,
    sample_map,
    true_depth,
    write_run,
    write_sequence,
)
from scipy.spatial.transform import Rotation

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.evaluate_import import evaluate_import
from polarmap.evaluation.evaluate_run import evaluate_run
from polarmap.evaluation.imported import detect_format, import_run
from polarmap.evaluation.measure import evaluate_results
from polarmap.evaluation.reconstruction import world_points
from polarmap.evaluation.records import read_evaluation, write_evaluation
from polarmap.evaluation.resampling import on_camera, project_points
from polarmap.evaluation.truth import truth_of
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.origin import local_origin, shifted
from polarmap.geometry.surface import normals_from_depth
from polarmap.io.formats.depth_png import write_depth_png
from polarmap.io.formats.openmvs import read_dmap_header
from polarmap.io.formats.ply import write_ply
from polarmap.io.formats.trajectory import write_trajectory
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import open_sequence
from polarmap.pipeline.config import Config
from polarmap.report.evaluation_tables import evaluation_tables
from polarmap.report.run_writer import RunWriter

NAN = np.float32(np.nan)


@pytest.fixture
def sequence(tmp_path):
    return write_sequence(tmp_path / "seq")


def other_world(pose, scale):
    """The pose in a world that is turned and moved, and in another unit."""
    world = np.eye(4)
    world[:3, :3] = Rotation.from_rotvec([0.2, -0.5, 0.1]).as_matrix()
    world[:3, 3] = [1.0, 2.0, 3.0]
    moved = world @ pose
    moved[:3, 3] *= scale
    return moved


def wall_depth(index):
    """A wall at z = 2.5 m of the world, to the fifth of a millimetre, as the truth of `wall_sequence`."""
    return np.full(CAMERA.shape, 2.5 - pose_at(index)[2, 3], np.float32)


@pytest.fixture
def wall_sequence(sequence):
    for i in range(4):
        write_depth_png(sequence.path / "depth" / f"{i:06d}.png", wall_depth(i), DEPTH_SCALE)
    return sequence


def write_dense_colmap(folder, indices=(0, 1, 3), scale=1.0, camera=CAMERA, factor=1.0):
    """A dense workspace with depth 1 % too far, in a world and unit of its own."""
    names = {i: f"{i:06d}.png" for i in indices}
    write_colmap_model(folder / "sparse", camera, {names[i]: other_world(pose_at(i), scale) for i in indices})
    (folder / "stereo" / "depth_maps").mkdir(parents=True)
    for i in indices:
        depth = np.float32(1.01 * scale * factor) * true_depth(i)
        (folder / "stereo" / "depth_maps" / f"{names[i]}.geometric.bin").write_bytes(colmap_map_bytes(depth))
    return folder


def write_openmvs(folder, indices=(0, 1, 2), scale=1.0):
    folder.mkdir()
    for i in indices:
        normal = normals_from_depth(true_depth(i), CAMERA)
        data = dmap_bytes(
            f"images/{i:06d}.png",
            np.float32(1.01 * scale) * true_depth(i),
            CAMERA.matrix,
            other_world(pose_at(i), scale),
            normal=np.nan_to_num(normal),
        )
        (folder / f"depth{i:04d}.dmap").write_bytes(data)
    return folder


def test_colmap_is_scaled_by_its_trajectory(tmp_path, sequence):
    folder = write_dense_colmap(tmp_path / "dense", scale=0.25)
    run = import_run(folder, sequence)
    assert (run.format, [frame.index for frame in run.frames], run.sparse) == ("colmap", [0, 1, 3], False)
    np.testing.assert_allclose(run.depth(1), 0.25 * 1.01 * true_depth(1), rtol=1e-6)
    assert run.depth(2) is None
    evaluation = evaluate_import(run, truth_of(sequence))
    assert evaluation.scale.factor == pytest.approx(4)
    assert evaluation.depth.abs_rel == pytest.approx(0.01, abs=1e-4)
    assert evaluation.depth.density == pytest.approx(62 / 64)
    assert evaluation.trajectory.similar == pytest.approx(0, abs=1e-9)
    assert [k.index for k in evaluation.keyframes] == [0, 1, 3]
    assert evaluation.normals.compared == 0
    assert evaluation.format == "colmap"


def test_the_same_depth_gives_the_same_figures_as_a_run(tmp_path, sequence):
    keyframes = [sample_keyframe(i, np.float32(1.01) * true_depth(i)) for i in (0, 1, 3)]
    own = evaluate_results(write_run(tmp_path / "out", keyframes), sequence)
    other = evaluate_results(write_dense_colmap(tmp_path / "dense"), sequence)
    for name in ("abs_rel", "rmse", "density", "points", "within", "within_1", "delta1"):
        assert getattr(other.depth, name) == pytest.approx(getattr(own.depth, name), rel=1e-5)
    assert own == evaluate_run(tmp_path / "out", truth_of(sequence))


def test_rules_for_the_scale(tmp_path, sequence):
    run = import_run(write_dense_colmap(tmp_path / "dense", scale=0.25, factor=2.0), sequence)
    assert evaluate_import(run, truth_of(sequence), "as-is").depth.abs_rel == pytest.approx(1 - 0.505, abs=1e-4)
    assert evaluate_import(run, truth_of(sequence), "trajectory").depth.abs_rel == pytest.approx(1.02, abs=1e-4)
    median = evaluate_import(run, truth_of(sequence), "median")
    assert median.scale.factor == pytest.approx(1 / 0.505, rel=1e-3)
    assert "median" in median.scale.reason
    assert median.depth.abs_rel < 1e-3
    with pytest.raises(InputError, match="scale 'guess' is not one of"):
        evaluate_import(run, truth_of(sequence), "guess")
    bare = write_sequence(tmp_path / "bare", poses=False)
    assert evaluate_import(run, truth_of(bare)).scale.factor == 1.0
    with pytest.raises(InputError, match="no scale by trajectory: it needs 3 poses"):
        evaluate_import(run, truth_of(bare), "trajectory")


def test_frames_can_be_chosen(tmp_path, sequence):
    run = import_run(write_dense_colmap(tmp_path / "dense"), sequence)
    assert [k.index for k in evaluate_import(run, truth_of(sequence), indices={1, 2}).keyframes] == [1]
    with pytest.raises(InputError, match="none of the frames that are to be compared"):
        evaluate_import(run, truth_of(sequence), indices={2})


def test_openmvs_with_its_normals(tmp_path, sequence):
    evaluation = evaluate_results(write_openmvs(tmp_path / "mvs", scale=3.0), sequence)
    assert evaluation.format == "openmvs"
    assert evaluation.scale.factor == pytest.approx(1 / 3)
    assert evaluation.depth.abs_rel == pytest.approx(0.01, abs=1e-4)
    assert evaluation.normals.median < 0.1
    assert evaluation.normals.compared > 2500


def test_colmap_normals_are_turned_toward_the_camera(tmp_path, sequence):
    folder = write_dense_colmap(tmp_path / "dense", indices=(0,))
    normals = -normals_from_depth(true_depth(0), CAMERA)
    (folder / "stereo" / "normal_maps").mkdir()
    path = folder / "stereo" / "normal_maps" / "000000.png.geometric.bin"
    path.write_bytes(colmap_map_bytes(normals))
    assert evaluate_results(folder, sequence).normals.median < 0.1
    path.write_bytes(colmap_map_bytes(normals[:24, :32]))
    with pytest.raises(InputError, match=r"000000\.png\.geometric\.bin: is not as large as"):
        evaluate_results(folder, sequence)


def test_a_sparse_model_is_depth_at_its_points(tmp_path, sequence):
    T = other_world(pose_at(0), 0.5)
    points = world_points(np.float32(0.5) * true_depth(0), CAMERA, T)
    points = points[np.isfinite(points).all(axis=1)][::37]
    poses = {f"{i:06d}.png": other_world(pose_at(i), 0.5) for i in range(4)}
    write_colmap_model(tmp_path / "sfm", CAMERA, poses, points, binary=False)
    run = import_run(tmp_path / "sfm", sequence)
    assert run.sparse
    m = evaluate_import(run, truth_of(sequence)).keyframes[0].depth
    assert m.points == len(points)
    assert m.abs_rel < 1e-4


@pytest.mark.parametrize("binary", [True, False])
def test_of_several_models_the_largest_is_taken(tmp_path, sequence, caplog, binary):
    for number, count in enumerate((1, 4, 2)):
        poses = {f"{i:06d}.png": pose_at(i) for i in range(count)}
        write_colmap_model(tmp_path / "sfm" / "sparse" / str(number), CAMERA, poses, np.ones((1, 3)), binary=binary)
    for path in (tmp_path / "sfm", tmp_path / "sfm" / "sparse"):
        caplog.clear()
        assert sorted(import_run(path, sequence).poses) == [0, 1, 2, 3]
        assert "sparse/1: the model with most images is taken, 4 (1 in 0, 2 in 2)" in caplog.text


def test_of_several_dense_workspaces_the_largest_is_taken(tmp_path, sequence, caplog):
    write_dense_colmap(tmp_path / "project" / "dense" / "0", indices=(0,))
    write_dense_colmap(tmp_path / "project" / "dense" / "1", indices=(0, 1, 3))
    write_colmap_model(tmp_path / "project" / "sparse" / "0", CAMERA, {"000000.png": pose_at(0)})
    run = import_run(tmp_path / "project", sequence)
    assert [frame.index for frame in run.frames] == [0, 1, 3] and not run.sparse
    assert "dense/1: the model with most images is taken, 3 (1 in 0)" in caplog.text


def test_a_folder_of_two_kinds_of_results_says_which_is_read(tmp_path, sequence, caplog):
    folder = write_openmvs(tmp_path / "mvs")
    np.save(folder / "000000.npy", true_depth(0))
    assert import_run(folder, sequence).format == "openmvs"
    assert "is read as openmvs; it also holds depth-npy (choose with --format)" in caplog.text


def test_points_are_projected_nearest_first():
    camera = PinholeCamera(4, 3, 2.0, 2.0, 1.0, 1.0)
    points = np.array([[0, 0, 2.0], [0, 0, 1.0], [1.0, 0, 2.0], [0, 0, -1.0], [99.0, 0, 1.0]])
    depth = project_points(points, camera, np.eye(4))
    expected = np.full((3, 4), np.nan, np.float32)
    expected[1, 1], expected[1, 2] = 1.0, 2.0
    np.testing.assert_array_equal(depth, expected)


def test_depth_pngs_of_any_size(tmp_path, sequence):
    folder = tmp_path / "net"
    folder.mkdir()
    for i in range(2):
        depth = np.float32(0.5) * true_depth(i)
        write_depth_png(folder / f"depth_{i:06d}.png", np.kron(depth, np.ones((2, 2), np.float32)), 1000.0)
    write_depth_png(folder / "depth_000099.png", true_depth(0), 1000.0)
    run = import_run(folder, sequence, depth_scale=1000.0)
    assert (run.format, run.unmatched) == ("depth-png", ("depth_000099.png",))
    np.testing.assert_allclose(run.depth(0), 0.5 * true_depth(0), atol=6e-4)
    evaluation = evaluate_import(run, truth_of(sequence), "median")
    assert evaluation.depth.abs_rel < 1e-3
    assert evaluate_import(run, truth_of(sequence)).depth.abs_rel == pytest.approx(0.5, abs=1e-3)
    assert import_run(folder, sequence).depth(0)[0, 10] == pytest.approx(0.2 * run.depth(0)[0, 10])  # 5000 a metre


def test_depth_arrays_with_poses(tmp_path, sequence):
    (tmp_path / "net" / "depth").mkdir(parents=True)
    for i in range(4):
        np.save(tmp_path / "net" / "depth" / f"{i}.npy", 2.0 * true_depth(i))
    times = PERIOD * np.arange(4)
    poses = np.array([other_world(pose_at(i), 2.0) for i in range(4)])
    write_trajectory(tmp_path / "net" / "trajectory.txt", Trajectory(times, poses))
    evaluation = evaluate_results(tmp_path / "net", sequence, with_map=True, thresholds=(0.02, 0.05))
    assert evaluation.format == "depth-npy"
    assert evaluation.scale.factor == pytest.approx(0.5)
    assert evaluation.depth.abs_rel < 1e-4
    assert evaluation.map.source == "depth maps"
    assert evaluation.map.precision[0] > 0.99
    assert evaluation.map.recall[0] > 0.99


def test_a_cloud_alone(tmp_path, sequence):
    points = np.concatenate([world_points(true_depth(i), CAMERA, pose_at(i)) for i in range(4)])
    points = points[np.isfinite(points).all(axis=1)]
    write_ply(tmp_path / "fused.ply", points + np.array([0, 0, 0.03]))
    with pytest.raises(InputError, match="points alone have no depth"):
        evaluate_results(tmp_path / "fused.ply", sequence)
    evaluation = evaluate_results(tmp_path / "fused.ply", sequence, with_map=True, thresholds=(0.01, 0.05))
    assert (evaluation.format, evaluation.keyframes) == ("ply", ())
    assert evaluation.map.precision == pytest.approx((0.0, 1.0), abs=0.05)
    assert evaluation.map.frames == 4
    (tmp_path / "cloud").mkdir()
    world = np.array([other_world(pose_at(i), 2.0) for i in range(4)])
    write_trajectory(tmp_path / "cloud" / "trajectory.txt", Trajectory(PERIOD * np.arange(4), world))
    local = 2.0 * points @ other_world(np.eye(4), 1.0)[:3, :3].T + 2.0 * other_world(np.eye(4), 1.0)[:3, 3]
    write_ply(tmp_path / "cloud" / "fused.ply", local)
    aligned = evaluate_results(tmp_path / "cloud", sequence, with_map=True, thresholds=(0.02,))
    assert (aligned.format, aligned.scale.factor) == ("ply", pytest.approx(0.5))
    assert (aligned.map.precision, aligned.map.recall) == ((1.0,), (1.0,))
    console = Console(width=100)
    with console.capture() as capture:
        console.print(evaluation_tables(evaluation))
    assert "Depth" not in capture.get()
    assert "F-score" in capture.get()


def test_a_trajectory_alone(tmp_path, sequence):
    poses = np.array([other_world(pose_at(i), 2.0) for i in range(4)])
    write_trajectory(tmp_path / "slam.txt", Trajectory(PERIOD * np.arange(4), poses))
    evaluation = evaluate_results(tmp_path / "slam.txt", sequence)
    assert evaluation.keyframes == ()
    assert evaluation.trajectory.similar == pytest.approx(0, abs=1e-9)
    assert evaluation.trajectory.scale == pytest.approx(0.5)
    assert evaluation.trajectory.rpe_similar.rotation.max == pytest.approx(0, abs=1e-5)
    with pytest.raises(InputError, match="no true pose"):
        evaluate_results(tmp_path / "slam.txt", write_sequence(tmp_path / "bare", poses=False))


def test_the_map_of_a_run(tmp_path, wall_sequence):
    keyframes = [sample_keyframe(i, wall_depth(i)) for i in range(4)]
    out = write_run(tmp_path / "out", keyframes)
    evaluation = evaluate_results(out, wall_sequence, with_map=True, thresholds=(0.05, 0.51))
    assert evaluation.map.source == "mesh.ply"  # a square at z = 2, half a metre before the wall
    assert (evaluation.map.frames, evaluation.map.precision[0], evaluation.map.recall[0]) == (4, 0.0, 0.0)
    assert evaluation.map.recall[1] > 0.5
    assert evaluation.map.completeness.median == pytest.approx(0.5, abs=0.01)
    (out / "mesh.ply").unlink()
    (out / "cloud.ply").unlink()
    depth_maps = evaluate_results(out, wall_sequence, with_map=True, thresholds=(0.05,))
    assert depth_maps.map.source == "depth maps"
    assert (depth_maps.map.precision, depth_maps.map.recall) == ((1.0,), (1.0,))


@pytest.mark.parametrize("scale", [1.0, 0.25])
def test_walls_of_a_run_in_its_own_unit(tmp_path, wall_sequence, scale):
    """The upper half is right, the lower one 8 cm too far."""
    keyframes = []
    for i in range(4):
        depth = wall_depth(i)
        depth[24:] += np.float32(0.08)
        depth[:, :32] = np.nan
        keyframes.append(sample_keyframe(i, np.float32(scale) * depth, T_world_camera=pose_at(i, scale)))
    poses = "given" if scale == 1.0 else "odometry"
    out = write_run(tmp_path / "out", keyframes, scale=scale, poses=poses)
    walls = evaluate_results(out, wall_sequence, with_walls=True).walls
    assert (walls.found_in, len(walls.walls)) == ("the true depth", 1)
    assert walls.walls[0].pixels == 4 * 48 * 64
    assert walls.walls[0].points == 4 * 48 * 32
    of_truth = dict(zip(walls.thresholds, walls.of_truth, strict=True))
    assert (of_truth[0.005], of_truth[0.05], of_truth[0.1]) == (0.5, 0.5, 1.0)
    assert walls.of_all[-1] == 0.5
    assert walls.within[-1] == 1.0


UTM = np.array([451234.0, 5212345.0, 512.0])


def moved_sequence(sequence, shift):
    """The sequence's true poses as they are in a world with another origin."""
    truth = sequence.truth_trajectory()
    moved = Trajectory(truth.timestamps, shifted(truth.poses, shift))
    write_trajectory(sequence.path / "groundtruth.txt", moved)
    return open_sequence(sequence.path)


def run_in_another_place(out, shift):
    """A run of the wall whose mesh is counted from a local origin, and whose depth has errors of centimetres."""
    rng, origin = np.random.default_rng(0), local_origin(pose_at(0)[:3, 3] + shift)
    points = wall_depth(0).ravel()[0] + 0.03 * rng.standard_normal(9)
    vertices = np.stack([*(a.ravel() for a in np.meshgrid([-1.0, 0, 1], [-1.0, 0, 1])), points], axis=1)
    faces = np.array([[a, a + 1, a + 4] for a in (0, 1, 3, 4)] + [[a, a + 4, a + 3] for a in (0, 1, 3, 4)])
    mesh = replace(sample_map().mesh, vertices=np.float32(vertices + (shift - origin)), faces=faces)
    mesh = replace(mesh, normals=np.zeros((9, 3), np.float32), grey=np.zeros(9, np.float32))
    result = replace(sample_map(), mesh=mesh, cloud=None, origin=origin)
    with RunWriter(out, Config(), CAMERA) as writer:
        for i in range(4):
            T = shifted(pose_at(i), shift)
            depth = wall_depth(i) + rng.normal(0, 0.02, CAMERA.shape).astype(np.float32)
            writer.add_frame(PERIOD * i, T)
            writer.add_keyframe(sample_keyframe(i, depth, T_world_camera=T))
        writer.add_map(result)
    return out


def figures_of(evaluation):
    """All figures of map, walls and trajectory; the walls' own planes left out, which are in the true world."""
    walls = evaluation.walls
    return [
        *(getattr(evaluation.map, name) for name in ("precision", "recall", "fscore")),
        *(astuple(part) for part in (evaluation.map.accuracy, evaluation.map.completeness)),
        walls.within, walls.of_all, walls.of_truth,
        (evaluation.depth.abs_rel, evaluation.trajectory.rigid, evaluation.trajectory.scale),
        (len(walls.walls), evaluation.map.points, evaluation.map.true_points),
    ]  # fmt: skip


@pytest.mark.parametrize("shift", [(0, 5100, 0), (0, 5300.7, 0), tuple(UTM), (4194304.5, -871000, 4712345)])
def test_figures_are_the_same_anywhere(tmp_path, wall_sequence, shift):
    """Of a run's mesh, and of the same depth as another program's."""
    shift, thresholds, expected = np.array(shift, float), (0.01, 0.02, 0.05), {}
    measure = {"with_map": True, "with_walls": True, "thresholds": thresholds}
    expected["run"] = evaluate_results(run_in_another_place(tmp_path / "near", np.zeros(3)), wall_sequence, **measure)
    (tmp_path / "near" / "mesh.ply").unlink()
    expected["maps"] = evaluate_results(tmp_path / "near", wall_sequence, **measure)
    sequence = moved_sequence(wall_sequence, shift)
    out = run_in_another_place(tmp_path / "far", shift)
    assert 0.1 < expected["run"].map.fscore[0] < 0.9
    found = {"run": evaluate_results(out, sequence, **measure)}
    mesh = (out / "mesh.ply").read_bytes()
    (out / "mesh.ply").write_bytes(re.sub(rb"comment offset[^\n]*\n", b"", mesh))  # as saved by another program
    found["mesh without comment"] = evaluate_results(out, sequence, **measure)
    (out / "mesh.ply").unlink()
    found["maps"] = evaluate_results(out, sequence, **measure)
    for kind, evaluation in found.items():
        near = expected["maps" if kind == "maps" else "run"]
        for ours, theirs in zip(figures_of(evaluation), figures_of(near), strict=True):
            assert ours == pytest.approx(theirs, abs=1e-4, nan_ok=True), kind
        wall, near_wall = evaluation.walls.walls[0], near.walls.walls[0]
        normal = np.array(wall.normal)
        sign = np.sign(normal @ near_wall.normal)
        assert wall.offset == pytest.approx(sign * near_wall.offset + normal @ shift, abs=1e-3)


def test_a_cloud_in_double_precision_far_away(tmp_path, wall_sequence, caplog):
    """Points of another program in UTM metres; in single precision the figures mean nothing, which is said."""
    points = np.concatenate([world_points(wall_depth(i), CAMERA, pose_at(i)) for i in range(4)])
    points += np.random.default_rng(0).normal(0, [0, 0, 0.02], points.shape)
    write_ply(tmp_path / "near.ply", points)
    near = evaluate_results(tmp_path / "near.ply", wall_sequence, with_map=True, with_walls=True)
    sequence = moved_sequence(wall_sequence, UTM)
    for kind in ("f8", "f4"):
        header = f"ply\nformat binary_little_endian 1.0\nelement vertex {len(points)}\n"
        header += "".join(f"property float{8 * int(kind[1])} {axis}\n" for axis in "xyz") + "end_header\n"
        (tmp_path / "far.ply").write_bytes(header.encode() + (points + UTM).astype(f"<{kind}").tobytes())
        far = evaluate_results(tmp_path / "far.ply", sequence, with_map=True, with_walls=True)
        if kind == "f8":
            assert far.map.fscore == pytest.approx(near.map.fscore, abs=1e-4)
            assert far.map.points == pytest.approx(near.map.points, rel=1e-3)
            assert not caplog.records
    assert "single precision has steps of 0.5" in caplog.text


def test_openmvs_far_away_with_rotations_of_few_digits(tmp_path, wall_sequence):
    """A rotation with seven digits moves a camera 5000 km away by metres if it is taken for its own inverse."""
    T = other_world(pose_at(0), 1.0)
    T[:3, 3] += UTM
    rounded = T.copy()
    rounded[:3, :3] = T[:3, :3].astype(np.float32)
    (tmp_path / "a.dmap").write_bytes(dmap_bytes("000000.png", wall_depth(0), CAMERA.matrix, rounded))
    np.testing.assert_array_equal(read_dmap_header(tmp_path / "a.dmap").T_world_camera[:3, 3], T[:3, 3])


def test_rounded_poses_are_said(tmp_path, sequence, caplog):
    rng = np.random.default_rng(0)
    poses = np.tile(np.eye(4), (30, 1, 1))
    poses[:, :3, 3] = UTM + np.cumsum(rng.normal(0, 0.05, (30, 3)), axis=0)
    write_trajectory(tmp_path / "good.txt", Trajectory(0.01 * np.arange(30), poses))
    evaluate_results(tmp_path / "good.txt", sequence)
    assert not caplog.records
    poses[:, :3, 3] = poses[:, :3, 3].astype(np.float32)
    write_trajectory(tmp_path / "bad.txt", Trajectory(0.01 * np.arange(30), poses))
    evaluate_results(tmp_path / "bad.txt", sequence)
    assert "bad.txt: its positions are whole multiples of 0.0312 along an axis" in caplog.text


def test_walls_without_true_depth_are_found_in_the_points(tmp_path):
    bare = write_sequence(tmp_path / "bare", depth=False)
    x, y = np.meshgrid(np.arange(0, 2, 0.02), np.arange(0, 1, 0.02))
    wall = np.stack([x.ravel(), y.ravel(), 2 + 0 * x.ravel()], axis=1)
    write_ply(tmp_path / "a.ply", wall)
    evaluation = evaluate_results(tmp_path / "a.ply", bare, with_walls=True)
    walls = evaluation.walls
    write_evaluation(tmp_path / "a.json", evaluation)  # what was not measured is null there, and NaN here
    found = read_evaluation(tmp_path / "a.json")
    assert np.isnan([found.depth.density, found.depth.abs_rel, found.walls.of_all[0]]).all()
    assert found.walls.within == walls.within
    assert (walls.found_in, len(walls.walls), walls.within[0]) == ("the points", 1, 1.0)


def test_another_camera_is_refused_and_a_scaled_one_resampled(tmp_path, sequence):
    values = np.arange(48 * 64, dtype=np.float32).reshape(48, 64)
    np.testing.assert_array_equal(on_camera(tmp_path, values, CAMERA, CAMERA), values)
    half = PinholeCamera(32, 24, 30.0, 30.0, 15.5, 11.5)
    smaller = on_camera(tmp_path, values, CAMERA, half)
    assert smaller.shape == (24, 32)
    assert smaller[3, 5] == values[7, 11]  # 2 · (5 - 15.5) + 31.5 = 10.5, and halves go up
    cropped = PinholeCamera(40, 40, 60.0, 60.0, 21.5, 20.5)
    shown = on_camera(tmp_path, values[3:43, 10:50], cropped, CAMERA)
    np.testing.assert_array_equal(shown[3:43, 10:50], values[3:43, 10:50])
    assert np.isnan(shown[2]).all()
    assert np.isnan(shown[:, 50]).all()
    for fx, cx in ((90.0, 31.5), (60.0, 131.5)):
        with pytest.raises(InputError, match="another camera"):
            on_camera(tmp_path, values, PinholeCamera(64, 48, fx, 60.0, cx, 23.5), CAMERA)


def test_distorted_colmap_cameras_are_refused(tmp_path, sequence):
    folder = write_dense_colmap(tmp_path / "dense", indices=(0,))
    model = (2, "SIMPLE_RADIAL", [60.0, 32.0, 24.0, 0.1])
    write_colmap_model(folder / "sparse", CAMERA, {"000000.png": pose_at(0)}, model=model)
    with pytest.raises(InputError, match=r"of a distorted camera .*image_undistorter"):
        evaluate_results(folder, sequence)


def test_formats_are_detected(tmp_path, sequence):
    assert detect_format(write_run(tmp_path / "out", [sample_keyframe(0, true_depth(0))])) == "polarmap"
    assert detect_format(write_dense_colmap(tmp_path / "dense")) == "colmap"
    assert detect_format(tmp_path / "dense" / "stereo" / "depth_maps") == "colmap"
    assert detect_format(write_openmvs(tmp_path / "mvs")) == "openmvs"
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="no results of another program that are known here"):
        detect_format(tmp_path / "empty")
    with pytest.raises(InputError, match="no such file or folder"):
        detect_format(tmp_path / "missing")


def test_what_is_wrong_is_said(tmp_path, sequence):
    folder = write_dense_colmap(tmp_path / "dense")
    with pytest.raises(InputError, match=r"no \*\.dmap in it"):
        import_run(folder, sequence, "openmvs")
    with pytest.raises(InputError, match="format 'mvs' is not one of colmap"):
        import_run(folder, sequence, "mvs")
    with pytest.raises(InputError, match="must be positive"):
        import_run(folder, sequence, depth_scale=-1.0)
    with pytest.raises(InputError, match="scale follows from its poses"):
        out = write_run(tmp_path / "out", [sample_keyframe(0, true_depth(0))])
        evaluate_results(out, sequence, scale="median")
    for name in ("a", "b"):
        (tmp_path / name).mkdir()
    np.save(tmp_path / "a" / "picture.npy", np.ones((48, 64), np.float32))
    with pytest.raises(InputError, match=r"none of its names, such as 'picture\.npy', is that of a frame"):
        import_run(tmp_path / "a", sequence)
    for name in ("1.npy", "x_1.npy"):
        np.save(tmp_path / "b" / name, np.ones((48, 64), np.float32))
    with pytest.raises(InputError, match=r"are both of frame 1"):
        import_run(tmp_path / "b", sequence)
    np.save(tmp_path / "b" / "1.npy", np.ones((48, 48), np.float32))
    (tmp_path / "b" / "x_1.npy").unlink()
    with pytest.raises(InputError, match=r"1\.npy: depth of 48x48 pixels, which is no scaled image of 64x48"):
        evaluate_results(tmp_path / "b", sequence)


def test_a_sequence_without_a_scale_asks_for_one(tmp_path, sequence):
    write_camera_file(sequence.path / "camera.yaml", replace(sequence.camera_file, depth_scale=None))
    (tmp_path / "net").mkdir()
    cv2.imwrite(str(tmp_path / "net" / "000000.png"), np.ones((48, 64), np.uint16))
    with pytest.raises(InputError, match="--depth-scale"):
        import_run(tmp_path / "net", open_sequence(sequence.path))


def test_the_command_line(polarmap, monkeypatch, tmp_path, wall_sequence):
    sequence, folder = wall_sequence, write_openmvs(tmp_path / "mvs", scale=3.0)
    arguments = ("eval", folder, sequence.path, "--map", "--threshold", 0.05, "--walls")
    json_file = tmp_path / "a.json"
    monkeypatch.setenv("COLUMNS", "120")
    ended = polarmap(*arguments, "--json", json_file)
    assert ended.status == 0, ended.err
    for expected in ("mean over 3 keyframes", "1.25³", "Map (depth maps)", "0.05 m", "F-score", "true plane", "Sim(3)"):
        assert expected in ended.out
    values = json.loads(json_file.read_text())
    assert values["format"] == "openmvs"
    assert values["map"]["thresholds"] == [0.05]
    assert len(read_evaluation(json_file).walls.walls) == 1
    truncated = folder / "depth0001.dmap"
    truncated.write_bytes(truncated.read_bytes()[:-4000])
    refused(polarmap(*arguments), truncated)
