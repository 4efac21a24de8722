"""What a run leaves in its folder, however it ends."""

from __future__ import annotations

import io
import json
import os
import resource
import time
import zipfile
from contextlib import contextmanager
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from run_samples import CAMERA, pose_at, sample_keyframe, sample_map, true_depth, write_run, write_sequence

from polarmap.errors import InputError, PolarmapError
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.images import read_header
from polarmap.io.formats.ply_reader import read_ply
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.run_folder.folder import append_line, prepare_output, read_keyframes, read_results
from polarmap.io.run_folder.keyframe_file import read_keyframe, replace_pose, write_keyframe
from polarmap.pipeline.config import Config, read_config
from polarmap.report.run_writer import RunWriter


def two_keyframes():
    return [sample_keyframe(i, true_depth(i)) for i in (0, 3)]


@contextmanager
def largest_file(size):
    """As on a full disk, no file may grow beyond `size` bytes."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def files_in(folder):
    return sorted(str(path.relative_to(folder)) for path in folder.rglob("*") if path.is_file())


def test_a_complete_run_has_everything(tmp_path):
    config = Config().with_settings(["paper.max_steps=40"])
    with RunWriter(tmp_path / "out", config, CAMERA, sequence="room", command="polarmap run room") as writer:
        for index in range(4):
            writer.add_frame(0.1 * index, None if index == 1 else pose_at(index))
        for keyframe in two_keyframes():
            writer.add_keyframe(keyframe)
        writer.add_map(sample_map())

    out = tmp_path / "out"
    top = ["cloud.ply", "config.yaml", "keyframes.txt", "mesh.ply", "report.html", "results.json", "trajectory.txt"]
    kinds = [
        "aolp.jpg",
        "confidence.jpg",
        "depth.jpg",
        "dolp.jpg",
        "image.jpg",
        "label.png",
        "normal.jpg",
        "origin.png",
        "polarnormal.jpg",
    ]
    pictures = [f"pictures/{i:06d}_{kind}" for i in (0, 3) for kind in kinds]
    arrays = [
        f"{folder}/{i:06d}.{suffix}" for folder, suffix in (("keyframes", "npz"), ("depth", "png")) for i in (0, 3)
    ]
    assert files_in(out) == sorted([*top, *arrays, *pictures, "pictures/map_outside.jpg", "pictures/map_top.jpg"])
    assert read_config(out / "config.yaml") == config
    assert len(trimesh.load(out / "mesh.ply").faces) == 2

    results = read_results(out)
    assert (results.status, results.reason, results.sequence) == ("complete", None, "room")
    assert (results.frames, results.posed, len(results.keyframes)) == (4, 3, 2)
    first = results.keyframes[0]
    assert first.points == 48 * 62 == first.stereo + first.propagated + first.estimated
    assert first.density == pytest.approx(62 / 64)
    assert (first.diffuse, first.specular) == (0, 48 * 64)
    assert first.diffuse_weights.zenith == 0.25
    assert results.milliseconds["stereo"].model_dump() == {"median": 101.5, "total": 203.0}
    assert results.milliseconds["mesh"].model_dump() == {"median": None, "total": 12.0}
    assert results.map.faces == 2
    assert {"python", "numpy", "numba"} <= set(results.versions)


def test_poses_are_read_back_to_the_last_digit(tmp_path):
    T = pose_at(3)
    T[:3, 3] = [1 / 3, -2e-7 / 3, 1e5 / 7]
    with RunWriter(tmp_path, Config(), CAMERA) as writer:
        writer.add_frame(1700000000.123456, T)
        writer.add_keyframe(sample_keyframe(3, true_depth(3), T_world_camera=T))
    for name, timestamp in (("trajectory.txt", 1700000000.123456), ("keyframes.txt", 3 * 0.1)):
        trajectory = read_trajectory(tmp_path / name, "tum")
        assert trajectory.timestamps.tolist() == [timestamp]
        np.testing.assert_array_equal(trajectory.poses[0], T)


def test_keyframe_files_open_in_numpy_without_pickle(tmp_path):
    keyframe = sample_keyframe(3, true_depth(3))
    write_keyframe(tmp_path / "000003.npz", keyframe)
    with np.load(tmp_path / "000003.npz", allow_pickle=False) as arrays:
        assert {name: (a.dtype.name, a.shape) for name, a in arrays.items()} == {
            **dict.fromkeys(("depth", "azimuth", "zenith", "sigma", "confidence"), ("float32", (48, 64))),
            **dict.fromkeys(("label", "origin"), ("uint8", (48, 64))),
            "normal": ("float32", (48, 64, 3)),
            "K": ("float64", (3, 3)),
            "T_world_camera": ("float64", (4, 4)),
            "timestamp": ("float64", ()),
        }
        np.testing.assert_array_equal(arrays["depth"], keyframe.depth)


def test_a_keyframe_is_read_back(tmp_path):
    keyframe = sample_keyframe(3, true_depth(3))
    write_keyframe(tmp_path / "000003.npz", keyframe, stages=True)
    found = read_keyframe(tmp_path / "000003.npz")
    assert (found.index, found.timestamp, found.camera) == (3, keyframe.timestamp, CAMERA)
    for name in ("T_world_camera", "depth", "normal", "azimuth", "zenith", "label", "origin", "sigma", "confidence"):
        np.testing.assert_array_equal(getattr(found, name), getattr(keyframe, name))
    for name in ("stereo", "inliers", "first"):
        np.testing.assert_array_equal(found.stages[name], getattr(keyframe.stages, name))


def test_a_keyframe_gets_another_pose_and_nothing_else(tmp_path):
    keyframe, path = sample_keyframe(3, true_depth(3)), tmp_path / "000003.npz"
    write_keyframe(path, keyframe, stages=True)
    before = np.load(path)
    replace_pose(path, pose_at(7))
    after = np.load(path, allow_pickle=False)
    assert before.files == after.files
    np.testing.assert_array_equal(read_keyframe(path).T_world_camera, pose_at(7))
    for name in set(before.files) - {"T_world_camera"}:
        np.testing.assert_array_equal(before[name], after[name])


def test_a_pose_for_what_is_no_keyframe_is_refused(tmp_path):
    (tmp_path / "000003.npz").write_bytes(b"PK\x03\x04 cut short")
    with pytest.raises(InputError, match=r"000003\.npz: not a readable keyframe file"):
        replace_pose(tmp_path / "000003.npz", pose_at(7))


def test_depth_pictures_share_one_scale_and_say_what_is_too_far(tmp_path):
    nothing = np.full(CAMERA.shape, np.nan, np.float32)
    far = true_depth(3)
    far[0, 10:15] = 1e4
    write_run(tmp_path, [sample_keyframe(0, nothing), sample_keyframe(1, true_depth(1)), sample_keyframe(3, far)])
    results = read_results(tmp_path)
    assert results.depth_scale == 5000.0  # 13.1 m is four times the depth and more
    assert [k.beyond_png for k in results.keyframes] == [0, 0, 5]
    assert np.isnan(read_depth_png(tmp_path / "depth" / "000000.png", results.depth_scale)).all()
    depth = read_depth_png(tmp_path / "depth" / "000003.png", results.depth_scale)
    assert np.isnan(depth[0, 10:15]).all()
    np.testing.assert_allclose(depth[1:], far[1:], atol=0.5001 / 5000)
    assert read_header(tmp_path / "depth" / "000003.png").bits == 16
    assert results.picture_ranges.nearest < 1.9
    assert 2.3 < results.picture_ranges.farthest < 10


@pytest.mark.parametrize("error", [KeyboardInterrupt(), InputError("raw/000004.png: truncated")])
def test_an_interrupted_run_is_valid(tmp_path, error):
    with pytest.raises(type(error)), RunWriter(tmp_path, Config(), CAMERA) as writer:
        writer.add_frame(0.0, pose_at(0))
        writer.add_keyframe(two_keyframes()[0])
        raise error
    results = read_results(tmp_path)
    assert results.status == "interrupted"
    assert results.reason == (str(error) or "KeyboardInterrupt")
    assert [k.index for k in read_keyframes(tmp_path)] == [0]
    assert len(read_trajectory(tmp_path / "trajectory.txt")) == 1
    assert "interrupted" in (tmp_path / "report.html").read_text()


def test_a_run_that_never_gave_a_map_is_not_complete(tmp_path):
    with RunWriter(tmp_path, Config(), CAMERA):
        pass
    assert read_results(tmp_path).status == "interrupted"
    assert (tmp_path / "report.html").exists()


def test_what_is_done_is_there_while_the_run_goes_on(tmp_path):
    with RunWriter(tmp_path, Config(), CAMERA) as writer:
        assert read_results(tmp_path).status == "running"
        writer.add_keyframe(two_keyframes()[0])
        deadline = time.monotonic() + 20
        while not read_results(tmp_path).keyframes and time.monotonic() < deadline:
            time.sleep(0.01)
        assert [k.index for k in read_results(tmp_path).keyframes] == [0]
        assert [k.index for k in read_keyframes(tmp_path)] == [0]


def test_a_full_disk_keeps_what_was_written(tmp_path, caplog):
    first, second = two_keyframes()
    writer = RunWriter(tmp_path, Config(), CAMERA)
    writer.add_keyframe(first)
    while not read_results(tmp_path).keyframes:
        time.sleep(0.01)
    with largest_file(50_000), pytest.raises(PolarmapError, match=r"000003.npz: cannot be written") as caught, writer:
        writer.add_keyframe(second)
        writer.add_map(sample_map())
    assert not isinstance(caught.value, InputError)
    assert "report.html: cannot be written" in caplog.text
    results = read_results(tmp_path)
    assert results.status == "interrupted"
    assert "000003.npz" in results.reason
    assert [k.index for k in read_keyframes(tmp_path)] == [k.index for k in results.keyframes] == [0]
    assert len(read_trajectory(tmp_path / "keyframes.txt")) == 1
    assert not [name for name in files_in(tmp_path) if name.endswith(".part")]


def test_a_failed_keyframe_ends_the_run_at_the_next_one(tmp_path):
    first, second = two_keyframes()
    with pytest.raises(PolarmapError, match=r"000000\.npz"), RunWriter(tmp_path, Config(), CAMERA) as writer:
        (tmp_path / "keyframes" / "000000.npz").mkdir()
        writer.add_keyframe(first)
        for _ in range(10):
            time.sleep(0.05)
            writer.add_keyframe(second)
        pytest.fail("no call reported the failure")


def test_a_line_is_appended_whole_or_not_at_all(tmp_path):
    path = tmp_path / "trajectory.txt"
    append_line(path, "1 2 3\n")
    with largest_file(10), pytest.raises(PolarmapError, match=r"trajectory\.txt: cannot be written"):
        append_line(path, "4 5 6 7 8 9\n")
    append_line(path, "4 5\n")
    assert path.read_text() == "1 2 3\n4 5\n"


def test_a_run_is_not_overwritten_without_force(tmp_path):
    write_run(tmp_path, two_keyframes())
    before = {name: (tmp_path / name).read_bytes() for name in files_in(tmp_path)}
    with pytest.raises(InputError, match=r"not empty.*--force"):
        RunWriter(tmp_path, Config(), CAMERA)
    assert {name: (tmp_path / name).read_bytes() for name in files_in(tmp_path)} == before


def test_force_replaces_the_run_and_nothing_else(tmp_path):
    write_run(tmp_path, two_keyframes())
    mine = ["notes.txt", "keyframes/readme.md", "depth/000000_mine.png", "pictures/holiday.jpg", "depth/000000.png.bak"]
    for name in mine:
        (tmp_path / name).write_text("mine")
    with RunWriter(tmp_path, Config(), CAMERA, force=True) as writer:
        writer.add_keyframe(sample_keyframe(5, true_depth(5)))
    assert [k.index for k in read_keyframes(tmp_path)] == [5]
    assert not (tmp_path / "mesh.ply").exists()
    assert not (tmp_path / "pictures" / "000000_depth.jpg").exists()
    assert all((tmp_path / name).read_text() == "mine" for name in mine)


def test_a_far_map_is_written_with_its_offset(tmp_path, monkeypatch):
    """Poses stay in their world; mesh and cloud are counted from the origin, which stands beside and in them."""
    origin = np.array([451200.0, 5212300.0, 500.0])
    T = pose_at(3)
    T[:3, 3] += origin + 1 / 3
    seen = {}
    monkeypatch.setattr("polarmap.report.run_writer.render_map", lambda mesh, poses: seen.update(poses=poses) or {})
    with RunWriter(tmp_path, Config(), CAMERA) as writer:
        writer.add_frame(0.3, T)
        writer.add_keyframe(sample_keyframe(3, true_depth(3), T_world_camera=T))
        writer.add_map(replace(sample_map(), origin=origin, left_out=17))
    for name in ("trajectory.txt", "keyframes.txt"):
        np.testing.assert_array_equal(read_trajectory(tmp_path / name).poses[0], T)
    assert (tmp_path / "offset.xyz").read_text() == "451200.0 5212300.0 500.0\n"
    for name in ("mesh.ply", "cloud.ply"):
        np.testing.assert_array_equal(trimesh.load(tmp_path / name, process=False).vertices, sample_map().mesh.vertices)
        np.testing.assert_array_equal(read_ply(tmp_path / name).points, sample_map().mesh.vertices + origin)
    assert read_results(tmp_path).map.origin == tuple(origin)
    assert read_results(tmp_path).map.left_out == 17
    assert "451200.0, 5212300.0, 500.0" in (tmp_path / "report.html").read_text()
    np.testing.assert_allclose(seen["poses"][0, :3, 3], pose_at(3)[:3, 3] + 1 / 3, atol=1e-8)
    write_run(tmp_path, two_keyframes(), force=True)
    assert not (tmp_path / "offset.xyz").exists()
    assert read_results(tmp_path).map.origin == (0.0, 0.0, 0.0)


def test_force_spares_files_that_no_run_wrote(tmp_path):
    (tmp_path / "depth").mkdir()
    (tmp_path / "depth" / "000000.png").write_text("somebody's depth")
    with pytest.raises(InputError, match=r"000000\.png: is in the way"):
        prepare_output(tmp_path, force=True)
    assert files_in(tmp_path) == ["depth/000000.png"]


def test_a_sequence_is_never_an_output_folder(tmp_path):
    sequence = write_sequence(tmp_path / "seq")
    before = files_in(sequence.path)
    with pytest.raises(InputError, match="is a sequence"):
        prepare_output(sequence.path, force=True)
    assert files_in(sequence.path) == before


def test_force_in_a_folder_with_unrelated_files(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    prepare_output(tmp_path, force=True)
    assert (tmp_path / "notes.txt").read_text() == "mine"


def test_an_unwritable_output_is_bad_input(tmp_path, monkeypatch):
    (tmp_path / "taken").write_text("")
    for out in (tmp_path / "taken", tmp_path / "taken" / "out"):
        with pytest.raises(InputError, match=r"taken.*cannot be used for output"):
            prepare_output(out)
    monkeypatch.setattr(os, "access", lambda path, mode: False)
    with pytest.raises(InputError, match="may not be written to"):
        prepare_output(tmp_path / "locked")


def stored(**arrays):
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    return buffer.getvalue()


def good_arrays(tmp_path):
    write_keyframe(tmp_path / "000001.npz", sample_keyframe(1, true_depth(1)), stages=True)
    with np.load(tmp_path / "000001.npz") as arrays:
        return dict(arrays)


@pytest.mark.parametrize(
    ("name", "value", "message"),
    [
        ("depth", np.array([[{}]], object), "'depth' is object"),
        ("depth", np.ones((48, 64)), "'depth' is float64"),
        ("depth", np.ones((48, 64, 1), np.float32), "expected float32 NxN"),
        ("depth", np.asfortranarray(np.ones((48, 64), np.float32)), "'depth' is float32"),
        ("depth", np.full((48, 64), -1, np.float32), "values that are no depth"),
        ("depth", np.full((48, 64), np.inf, np.float32), "values that are no depth"),
        ("stereo", np.zeros((48, 64), np.float32), "stereo has values that are no depth"),
        ("normal", np.ones((48, 64), np.float32), "expected float32 48x64x3"),
        ("label", np.full((48, 64), 4, np.uint8), "label has codes above 3"),
        ("origin", np.full((48, 64), 4, np.uint8), "origin has codes above 3"),
        ("confidence", np.full((48, 64), np.nan, np.float32), "confidence is not in"),
        ("K", np.zeros((3, 3)), "focal lengths must be positive"),
        ("T_world_camera", np.full((4, 4), np.nan), "no rigid motion"),
        ("T_world_camera", np.diag([-1.0, 1.0, 1.0, 1.0]), "no rigid motion"),
        ("timestamp", np.zeros(2), "expected float64 scalar"),
        ("origin", None, "lacks the array 'origin'"),
    ],
)
def test_a_malformed_keyframe_is_named(tmp_path, name, value, message):
    arrays = good_arrays(tmp_path) | {name: value}
    (tmp_path / "000001.npz").write_bytes(stored(**{k: v for k, v in arrays.items() if v is not None}))
    with pytest.raises(InputError, match=f"000001.npz: .*{message}"):
        read_keyframe(tmp_path / "000001.npz")


def test_a_keyframe_that_claims_too_much_takes_no_memory(tmp_path):
    header = io.BytesIO()
    np.lib.format.write_array_header_1_0(header, {"descr": "<f4", "fortran_order": False, "shape": (1 << 20, 1 << 20)})
    with zipfile.ZipFile(tmp_path / "000001.npz", "w") as archive:
        archive.writestr("depth.npy", header.getvalue())
    with pytest.raises(InputError, match="more than an image may have"):
        read_keyframe(tmp_path / "000001.npz")


def test_a_broken_keyframe_file_is_named(tmp_path):
    path = tmp_path / "000001.npz"
    write_keyframe(path, sample_keyframe(1, true_depth(1)))
    data = path.read_bytes()
    for broken in (b"", b"PK", data[:-30], data[: len(data) // 2], data.replace(b"\x93NUMPY", b"\x93PICKL")):
        path.write_bytes(broken)
        with pytest.raises(InputError, match=r"000001\.npz: "):
            read_keyframe(path)
    flipped = bytearray(data)
    flipped[2000] ^= 1
    path.write_bytes(flipped)
    with pytest.raises(InputError, match=r"000001\.npz: .*CRC"):
        read_keyframe(path)
    with pytest.raises(InputError, match="named by its frame's index"):
        read_keyframe(tmp_path / "first.npz")


def test_a_folder_without_a_run_is_named(tmp_path):
    with pytest.raises(InputError, match=r"no results\.json"):
        read_results(tmp_path)
    with pytest.raises(InputError, match="no keyframes"):
        read_keyframes(tmp_path)


@pytest.mark.parametrize("change", [{"poses": "guessed"}, {"keyframes": 3}, {"depth_scale": -1}, None])
def test_malformed_results_are_named(tmp_path, change):
    write_run(tmp_path, two_keyframes())
    path = tmp_path / "results.json"
    path.write_text("{" if change is None else json.dumps(json.loads(path.read_text()) | change))
    expected = "not a JSON file" if change is None else rf"not the results of a run \({next(iter(change))}"
    with pytest.raises(InputError, match=rf"results\.json: {expected}"):
        read_results(tmp_path)
