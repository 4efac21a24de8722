"""Points with what is known of each, and where exports may be written."""

from __future__ import annotations

import json

import numpy as np
import pytest
import trimesh
from command_line import refused
from export_room import FAR, SIGMA, room_keyframes, to_surface, write_room

from polarmap.export.cloud import export_cloud
from polarmap.export.source import open_map
from polarmap.io.formats.ply_reader import read_ply

FURTHER = ("sigma", "confidence", "label", "keyframe", "red")


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_room(tmp_path_factory.mktemp("room") / "run")


def test_each_point_has_its_numbers(run, tmp_path):
    count = export_cloud(open_map(run), tmp_path / "a.ply", points=5000)
    cloud = read_ply(tmp_path / "a.ply", FURTHER)
    assert 2500 < count == len(cloud.points) <= 5000
    assert to_surface(cloud.points).max() < 1e-3 and not len(cloud.faces)
    assert np.allclose(np.linalg.norm(cloud.normals, axis=1), 1.0, atol=1e-5)
    keyframes = {k.index: k for k in room_keyframes()}
    for name in FURTHER[:4]:
        assert len(cloud.properties[name]) == count
    for i in range(0, count, 97):
        keyframe = keyframes[int(cloud.properties["keyframe"][i])]
        R, t = keyframe.T_world_camera[:3, :3], keyframe.T_world_camera[:3, 3]
        z = (cloud.points[i] - t) @ R[:, 2]
        assert cloud.properties["sigma"][i] == pytest.approx(SIGMA * z, rel=1e-4)
        assert cloud.properties["label"][i] == keyframe.label[0, 0]
        assert cloud.normals[i] @ (cloud.points[i] - t) < 0
    assert cloud.properties["confidence"] == pytest.approx(1 / (1 + SIGMA / 0.01), rel=1e-6)


def test_trimesh_reads_it_and_the_header_explains(run, tmp_path):
    export_cloud(open_map(run), tmp_path / "a.ply", points=500)
    cloud = trimesh.load(tmp_path / "a.ply")
    assert np.allclose(cloud.vertices, read_ply(tmp_path / "a.ply").points)
    raw = cloud.metadata["_ply_raw"]["vertex"]["data"]
    assert raw["label"].dtype == np.uint8 and raw["keyframe"].dtype == np.int32 and raw["sigma"].dtype == np.float32
    header = (tmp_path / "a.ply").read_bytes().split(b"end_header")[0].decode()
    assert "format binary_little_endian 1.0" in header
    assert "comment lengths are in metres\n" in header and "comment label: kind of reflection" in header


def test_odometry_and_far_worlds_say_so_once(polarmap, tmp_path):
    run = write_room(tmp_path / "run", most=2, poses="odometry")
    ended = polarmap("export", run, "--to", "ply", "-o", tmp_path / "a.ply", "--points", 100)
    assert ended.status == 0 and ended.out.count("units of odometry") == 1
    assert (tmp_path / "a.ply").read_bytes().count(b"units of odometry") == 1
    far = write_room(tmp_path / "far", shift=FAR, most=2)
    ended = polarmap("export", far, "--to", "ply", "-o", tmp_path / "b.ply", "--points", 100)
    assert "counted from 451200 5.2123e+06 500" in ended.out or "counted from 451200.0 5212300.0 500.0" in ended.out
    cloud = read_ply(tmp_path / "b.ply")
    assert np.array_equal(cloud.offset, FAR) and to_surface(cloud.points - FAR).max() < 1e-3


def test_an_interrupted_run_far_away_is_counted_from_its_first_pose(tmp_path):
    run = write_room(tmp_path / "run", shift=FAR, finished=False, most=2)
    export_cloud(open_map(run), tmp_path / "a.ply", points=100)
    assert np.array_equal(read_ply(tmp_path / "a.ply").offset, FAR)


def test_only_what_is_sure_enough(run, tmp_path, polarmap):
    confidence = 1 / (1 + SIGMA / 0.01)
    ended = polarmap("export", run, "--to", "ply", "-o", tmp_path / "a.ply", "--min-confidence", confidence + 0.01)
    refused(ended, "no point", "--min-confidence")
    assert not (tmp_path / "a.ply").exists()


def test_files_are_replaced_only_when_asked(run, tmp_path, polarmap):
    out = tmp_path / "a.ply"
    out.write_bytes(b"mine")
    refused(polarmap("export", run, "--to", "ply", "-o", out), "exists", "--force")
    assert out.read_bytes() == b"mine"
    assert polarmap("export", run, "--to", "ply", "-o", out, "--points", 50, "--force").status == 0
    assert len(read_ply(out).points) <= 50
    refused(polarmap("export", run, "--to", "ply", "-o", tmp_path / "none" / "a.ply"), "no folder")
    refused(polarmap("export", run, "--to", "ply", "-o", tmp_path), ".ply")


def test_folders_are_replaced_only_when_asked(run, tmp_path, polarmap):
    out = tmp_path / "out"
    again = ("export", run, "--to", "nerfstudio", "-o", out, "--points", 50)
    assert polarmap(*again).status == 0
    (out / "mine.txt").write_text("mine")
    (out / "images" / "999990.png").write_bytes(b"left over")
    refused(polarmap(*again), "not empty", "--force")
    assert polarmap(*again, "--force").status == 0
    assert (out / "mine.txt").read_text() == "mine" and not (out / "images" / "999990.png").exists()
    (out / "transforms.json").unlink()  # as if it had been killed
    assert polarmap(*again, "--force").status == 0
    (out / "export.json").unlink()
    refused(polarmap(*again, "--force"), "in the way")
    assert json.loads((out / "transforms.json").read_text())["frames"]


def test_each_segment_is_exported_by_itself(polarmap, tmp_path):
    run = write_room(tmp_path / "run", most=3)
    results = json.loads((run / "results.json").read_text())
    results["keyframes"][1]["segment"] = 1
    (run / "results.json").write_text(json.dumps(results))
    for options, expected in (([], {0, 20}), (["--segment", 1], {10})):
        ended = polarmap("export", run, "--to", "ply", "-o", tmp_path / "a.ply", "--force", *options)
        assert ended.status == 0
        assert set(read_ply(tmp_path / "a.ply", ("keyframe",)).properties["keyframe"]) == expected
    ended = polarmap("export", run, "--to", "glb", "-o", tmp_path / "a.glb", "--segment", 1)
    refused(ended, "mesh_segment1.ply")


def test_what_is_no_run_is_refused(polarmap, run, tmp_path):
    refused(polarmap("export", tmp_path, "--to", "ply", "-o", tmp_path / "a.ply"), "results.json")
    refused(polarmap("export", run, "--to", "ply", "-o", tmp_path / "a.ply", "--segment", 3), "no segment 3", "0")
    empty = write_room(tmp_path / "empty", finished=False, most=0)
    ended = polarmap("export", empty, "--to", "ply", "-o", tmp_path / "a.ply")
    assert ended.status == 2 and "no keyframes" in ended.err


def test_a_broken_keyframe_is_named(polarmap, tmp_path):
    run = write_room(tmp_path / "run", most=2)
    path = run / "keyframes" / "000010.npz"
    path.write_bytes(path.read_bytes()[:1000])
    refused(polarmap("export", run, "--to", "ply", "-o", tmp_path / "a.ply"), path)
