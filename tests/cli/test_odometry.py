"""`polarmap odometry`, and `polarmap run` without poses, as a user meets them."""

from __future__ import annotations

import json
import shutil

import numpy as np
import pytest
import trimesh
from command_line import refused
from fake_odometry import FakeOdometry

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import open_sequence
from polarmap.io.run_folder.folder import read_results
from polarmap.pipeline.poses import found
from polarmap.synth.recording import write_sequence
from polarmap.synth.rendering import render_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor

CAMERA = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
FRAMES = 16
SCALE = 2.5  # metres a unit of odometry


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of sixteen frames of the room, with its truth."""
    folder = tmp_path_factory.mktemp("recorded")
    room = built_in_scene("room")
    frames = render_sequence(room.scene, CAMERA, *room.path(FRAMES, step=0.06), Sensor())
    write_sequence(folder, frames, CAMERA, Sensor())
    return folder


@pytest.fixture
def sequence(recorded, tmp_path):
    """A copy to damage."""
    return shutil.copytree(recorded, tmp_path / "sequence")


@pytest.fixture
def odometry(monkeypatch, recorded):
    """Have the command line use odometry that knows the truth, with these habits."""

    def use(kind=FakeOdometry, **habits):
        truth = dict(enumerate(read_trajectory(recorded / "groundtruth.txt").poses))
        monkeypatch.setattr(found, "make_odometry", lambda *arguments: kind(truth, scale=SCALE, **habits))

    use()
    return use


def true_positions(recorded, first, indices):
    """Positions in the world of the camera of frame `first`, in units of odometry."""
    truth = read_trajectory(recorded / "groundtruth.txt").poses
    return np.array([(inverse(truth[first]) @ truth[i])[:3, 3] / SCALE for i in indices])


@pytest.mark.parametrize("format", ["tum", "kitti", "euroc"])
def test_the_trajectory_is_written(polarmap, odometry, recorded, tmp_path, format):
    out = tmp_path / "poses.txt"
    status, printed, _ = polarmap("odometry", recorded, "--out", out, "--format", format)
    assert status == 0 and "15 of 16 frames tracked" in printed and "parallax" in printed and "12.0 ms" not in printed
    found = read_trajectory(out, format)
    indices = [0, *range(2, FRAMES)]
    np.testing.assert_allclose(found.poses[:, :3, 3], true_positions(recorded, 0, indices), atol=1e-9)
    if format != "kitti":
        np.testing.assert_allclose(found.timestamps, open_sequence(recorded).timestamps[indices], atol=1e-8)


def test_keyframes_points_and_error(polarmap, odometry, recorded, tmp_path):
    out, keyframes, points = (tmp_path / name for name in ("poses.txt", "keyframes.txt", "points.ply"))
    more = ("--keyframes", keyframes, "--points", points, "--truth", recorded / "groundtruth.txt")
    status, printed, _ = polarmap("odometry", recorded, "--out", out, *more)
    assert status == 0 and "0.0000 m" in printed and f"{SCALE:.4f}" in printed
    assert len(read_trajectory(keyframes)) == 6
    header = points.read_bytes()[:600].decode("latin-1")
    assert "element vertex 12" in header and "property float inverse_depth_std" in header and "uchar red" in header
    np.testing.assert_array_equal(trimesh.load(points).vertices, np.arange(36.0).reshape(12, 3))
    for path in (out, keyframes, points):
        assert f"written: {path}" in printed


def test_points_as_arrays(polarmap, odometry, recorded, tmp_path):
    assert polarmap("odometry", recorded, "--out", tmp_path / "a.txt", "--points", tmp_path / "a.npz")[0] == 0
    with np.load(tmp_path / "a.npz", allow_pickle=False) as arrays:
        assert arrays["position"].shape == (12, 3) and arrays["host"].tolist()[:4] == [0, 0, 2, 2]


def test_segments_have_files_of_their_own(polarmap, odometry, recorded, tmp_path):
    odometry(lost={4})
    out = tmp_path / "poses.txt"
    status, printed, _ = polarmap("odometry", recorded, "--out", out, "--points", tmp_path / "points.ply")
    assert status == 0 and "too few points are seen again" in printed
    assert len(read_trajectory(out)) == 10 and len(read_trajectory(tmp_path / "poses_segment0.txt")) == 3
    assert len(trimesh.load(tmp_path / "points.ply").vertices) > len(
        trimesh.load(tmp_path / "points_segment0.ply").vertices
    )


def test_existing_files_are_replaced_only_if_told_to(polarmap, odometry, recorded, tmp_path):
    out = tmp_path / "poses.txt"
    out.write_text("mine")
    refused(polarmap("odometry", recorded, "--out", out), out, "--force")
    assert out.read_text() == "mine"
    odometry(lost={4})
    assert polarmap("odometry", recorded, "--out", out, "--force")[0] == 0
    odometry()
    refused(polarmap("odometry", recorded, "--out", out), "--force")
    (tmp_path / "poses_segmented.txt").write_text("mine")
    assert polarmap("odometry", recorded, "--out", out, "--force")[0] == 0
    assert sorted(path.name for path in tmp_path.iterdir()) == ["poses.txt", "poses_segmented.txt"]


def test_bad_outputs_are_refused_before_any_work(polarmap, odometry, recorded, tmp_path):
    odometry(kind=lambda *_, **__: pytest.fail("odometry was begun"))
    out = tmp_path / "poses.txt"
    refused(polarmap("odometry", recorded, "--out", tmp_path / "nowhere" / "poses.txt"), "nowhere")
    refused(polarmap("odometry", recorded, "--out", tmp_path), tmp_path, "is a folder")
    refused(polarmap("odometry", recorded, "--out", out, "--points", tmp_path / "points.las"), "points.las", ".ply")
    refused(polarmap("odometry", recorded, "--out", out, "--keyframes", out), "poses.txt", "twice")
    assert not list(tmp_path.iterdir())


def test_a_sequence_without_times_is_refused(polarmap, odometry, sequence):
    (sequence / "timestamps.txt").unlink()
    refused(polarmap("odometry", sequence, "--out", sequence.parent / "poses.txt"), "timestamps.txt", "frame_rate")
    refused(polarmap("run", sequence, "--out", sequence.parent / "out"), "timestamps.txt", "frame_rate")
    assert not (sequence.parent / "out").exists()


def test_nothing_tracked_is_an_error(polarmap, odometry, recorded, tmp_path):
    odometry(lost=range(FRAMES))
    result = polarmap("odometry", recorded, "--out", tmp_path / "poses.txt")
    refused(result, "no frame could be tracked: too few points are seen again", status=1)
    assert not list(tmp_path.iterdir())
    refused(polarmap("run", recorded, "--out", tmp_path / "out"), "no frame could be tracked", status=1)
    results = read_results(tmp_path / "out")
    assert (results.status, results.frames, results.posed) == ("failed", FRAMES, 0)


def test_a_bad_frame_keeps_what_was_tracked(polarmap, odometry, sequence):
    broken = sequence / "raw" / "000010.png"
    broken.write_bytes(broken.read_bytes()[:-2000])
    out = sequence.parent / "poses.txt"
    refused(polarmap("odometry", sequence, "--out", out), "000010.png")
    assert len(read_trajectory(out)) == 9


class Interrupting(FakeOdometry):
    """The user presses Ctrl-C at frame 10."""

    def process(self, grey, timestamp, index, exposure=None):
        if index == 10:
            raise KeyboardInterrupt
        return super().process(grey, timestamp, index, exposure)


def test_ctrl_c_keeps_what_was_tracked(polarmap, odometry, recorded, tmp_path):
    odometry(kind=Interrupting)
    out = tmp_path / "poses.txt"
    refused(polarmap("odometry", recorded, "--out", out), "interrupted", out, status=130)
    assert len(read_trajectory(out)) == 9


def test_ctrl_c_keeps_what_was_mapped(polarmap, odometry, recorded, tmp_path):
    odometry(kind=Interrupting)
    refused(polarmap("run", recorded, "--out", tmp_path / "out"), "interrupted", status=130)
    results = read_results(tmp_path / "out")
    assert results.status == "interrupted" and len(results.keyframes) >= 3
    assert len(read_trajectory(tmp_path / "out" / "trajectory.txt")) == results.posed == 9


def test_a_recording_is_mapped_and_judged_without_poses(polarmap, odometry, recorded, tmp_path):
    odometry(error=(0.01, 0.0, 0.0))
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    status, _, _ = polarmap("run", recorded, "--out", out, "--set", "fusion.min_faces=0")
    assert status == 0
    results = read_results(out)
    assert (results.status, results.poses, results.pose_source) == ("complete", "odometry", "")
    assert (results.frames, results.posed) == (FRAMES, FRAMES - 1)
    assert [(s.segment, s.posed) for s in results.segments] == [(0, FRAMES - 1)]
    assert (out / "mesh.ply").stat().st_size > 0 and not list(out.glob("*_segment*"))
    status, printed, _ = polarmap("eval", out, recorded, "--json", figures)
    assert status == 0 and "Sim(3)" in printed
    evaluated = json.loads(figures.read_text())
    assert evaluated["scale"]["factor"] == pytest.approx(SCALE, rel=0.05)
    assert evaluated["depth"]["abs_rel"] < 0.1 and evaluated["depth"]["density"] > 0.5


def test_keyframe_files_hold_final_poses(polarmap, odometry, recorded, tmp_path):
    odometry(error=(0.05, 0.0, 0.0))
    out = tmp_path / "out"
    assert polarmap("run", recorded, "--out", out)[0] == 0
    trajectory, keyframes = read_trajectory(out / "trajectory.txt"), read_trajectory(out / "keyframes.txt")
    for timestamp, pose in zip(keyframes.timestamps, keyframes.poses, strict=True):
        np.testing.assert_allclose(trajectory.at(timestamp), pose, atol=1e-9)
    for summary, pose in zip(read_results(out).keyframes, keyframes.poses, strict=True):
        with np.load(out / "keyframes" / f"{summary.index:06d}.npz", allow_pickle=False) as arrays:
            np.testing.assert_allclose(arrays["T_world_camera"], pose, atol=1e-9)
            assert np.isfinite(arrays["depth"]).any()


def test_segments_are_mapped_and_judged_each_by_itself(polarmap, odometry, recorded, tmp_path):
    odometry(lost={6})
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    assert polarmap("run", recorded, "--out", out, "--set", "fusion.min_faces=0")[0] == 0
    results = read_results(out)
    assert results.segment == 1 and [s.segment for s in results.segments] == [1, 0]
    assert [s.posed for s in results.segments] == [8, 5]
    assert {k.segment for k in results.keyframes} == {0, 1}
    for name in ("trajectory", "keyframes"):
        lengths = [len(read_trajectory(out / f"{name}{suffix}.txt")) for suffix in ("", "_segment0")]
        assert lengths == [getattr(s, {"trajectory": "posed"}.get(name, name)) for s in results.segments]
    assert (out / "mesh.ply").exists() and (out / "mesh_segment0.ply").exists()
    assert not list(out.glob("*_segment1*"))
    assert "2 segments" in " ".join((out / "report.html").read_text().split())
    status, printed, _ = polarmap("eval", out, recorded, "--json", figures)
    assert status == 0 and "segment" in printed
    evaluated = json.loads(figures.read_text())
    assert [s["scale"]["factor"] for s in evaluated["segments"]] == pytest.approx([SCALE, SCALE])
    assert evaluated["without_scale"] == 0 and len(evaluated["keyframes"]) == len(results.keyframes)
    assert evaluated["depth"]["abs_rel"] < 0.1


def test_a_segment_too_short_for_a_scale_is_left_out(polarmap, odometry, recorded, tmp_path):
    odometry(lost={3})
    out, figures = tmp_path / "out", tmp_path / "figures.json"
    assert polarmap("run", recorded, "--out", out)[0] == 0
    counts = {s.segment: s.keyframes for s in read_results(out).segments}
    status, printed, _ = polarmap("eval", out, recorded, "--json", figures)
    assert status == 0 and "too short to find their scale" in " ".join(printed.split())
    evaluated = json.loads(figures.read_text())
    assert evaluated["without_scale"] == counts[0] and len(evaluated["keyframes"]) == counts[1]


def test_force_removes_the_segments_of_an_earlier_run(polarmap, odometry, recorded, tmp_path):
    odometry(lost={6})
    out = tmp_path / "out"
    assert polarmap("run", recorded, "--out", out)[0] == 0
    assert list(out.glob("*_segment0*"))
    odometry()
    assert polarmap("run", recorded, "--out", out, "--force")[0] == 0
    assert not list(out.glob("*_segment*"))
