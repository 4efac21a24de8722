"""A data set of nerfstudio, read as nerfstudio describes it."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import trimesh
from export_room import FAR, room_keyframes, to_surface, write_room

from polarmap.export.nerfstudio import export_nerfstudio
from polarmap.export.source import open_map
from polarmap.io.formats.ply_reader import read_ply


@pytest.fixture(scope="module")
def written(tmp_path_factory):
    folder = tmp_path_factory.mktemp("ns")
    export_nerfstudio(open_map(write_room(folder / "run")), folder / "out", points=2000)
    return folder / "out"


def surface_points(out, frame, transforms) -> np.ndarray:
    """World points of a frame's depth, by nerfstudio's conventions alone: y up, z back, the pixel's centre at 0.5."""
    values = cv2.imread(str(out / frame["depth_file_path"]), cv2.IMREAD_UNCHANGED)
    assert values.dtype == np.uint16
    rows, columns = np.nonzero(values)
    z = values[rows, columns] * transforms["depth_unit_scale_factor"]
    x = (columns + 0.5 - transforms["cx"]) / transforms["fl_x"]
    y = (rows + 0.5 - transforms["cy"]) / transforms["fl_y"]
    camera = np.stack([x * z, -y * z, -z, np.ones_like(z)])
    return (np.array(frame["transform_matrix"]) @ camera)[:3].T


def test_depth_lies_on_the_room(written):
    transforms = json.loads((written / "transforms.json").read_text())
    assert transforms["depth_unit_scale_factor"] == 0.001
    assert len(transforms["frames"]) == len(room_keyframes())
    for frame in transforms["frames"]:
        points = surface_points(written, frame, transforms)
        assert len(points) > 10_000 and to_surface(points).max() < 2e-3
        picture = cv2.imread(str(written / frame["file_path"]), cv2.IMREAD_UNCHANGED)
        assert picture.shape == (transforms["h"], transforms["w"])


def test_points_to_begin_from_lie_on_the_room(written):
    transforms = json.loads((written / "transforms.json").read_text())
    cloud = trimesh.load(written / transforms["ply_file_path"])
    assert 1000 < len(cloud.vertices) <= 2000 and to_surface(np.array(cloud.vertices)).max() < 1e-3
    assert cloud.colors.shape == (len(cloud.vertices), 4)


def test_a_small_world_has_finer_depth(tmp_path, monkeypatch):
    run = write_room(tmp_path / "run", most=2, poses="odometry")
    text = json.loads((run / "results.json").read_text())
    for keyframe in text["keyframes"]:
        keyframe["median_depth"] *= 0.01  # as if the unit of odometry were 100 m
    (run / "results.json").write_text(json.dumps(text))
    unit = export_nerfstudio(open_map(run), tmp_path / "out", points=100)
    transforms = json.loads((tmp_path / "out" / "transforms.json").read_text())
    assert unit == transforms["depth_unit_scale_factor"] < 1e-5
    assert "units of odometry" in transforms["comment"]


def test_a_far_world_has_its_offset_beside_it(written, tmp_path):
    far = write_room(tmp_path / "far", shift=FAR, most=2)
    export_nerfstudio(open_map(far), tmp_path / "out", points=100)
    near, moved = (json.loads((out / "transforms.json").read_text()) for out in (written, tmp_path / "out"))
    for a, b in zip(near["frames"], moved["frames"], strict=False):
        assert np.allclose(a["transform_matrix"], b["transform_matrix"], atol=1e-8)
    assert np.array_equal(np.loadtxt(tmp_path / "out" / "offset.xyz"), FAR)
    assert np.array_equal(read_ply(tmp_path / "out" / "points.ply").offset, FAR)
