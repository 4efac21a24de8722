"""The mesh as glTF, read by trimesh and by the format's own rules."""

from __future__ import annotations

import json
import struct

import numpy as np
import pytest
import trimesh
from command_line import refused
from export_room import FAR, write_room
from run_samples import sample_map

from polarmap.export.scene import export_glb
from polarmap.export.source import open_map

UP = np.array([0.0, 0.0, 1.0])


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_room(tmp_path_factory.mktemp("room") / "run", most=2)


def parts(path) -> tuple[dict, bytes]:
    """The JSON and the buffer, with what the specification demands of header and chunks."""
    data = path.read_bytes()
    magic, version, length = struct.unpack_from("<4sII", data)
    assert (magic, version, length) == (b"glTF", 2, len(data))
    size, kind = struct.unpack_from("<I4s", data, 12)
    assert kind == b"JSON" and size % 4 == 0
    rest, kind = struct.unpack_from("<I4s", data, 20 + size)
    assert kind == b"BIN\0" and rest % 4 == 0 and 28 + size + rest == len(data)
    return json.loads(data[20 : 20 + size]), data[28 + size :]


def test_trimesh_reads_the_mesh_with_up_as_y(run, tmp_path):
    export_glb(open_map(run), tmp_path / "a.glb", UP)
    scene = trimesh.load(tmp_path / "a.glb", force="scene")
    (node,) = scene.graph.nodes_geometry
    T, name = scene.graph[node]
    mesh, expected = scene.geometry[name], sample_map().mesh
    assert np.allclose(mesh.vertices, expected.vertices) and np.array_equal(mesh.faces, expected.faces)
    assert np.allclose(mesh.vertex_normals, expected.normals)
    assert np.allclose(T[:3, :3] @ UP, [0, 1, 0]) and np.isclose(np.linalg.det(T[:3, :3]), 1.0)
    assert np.allclose(T[:3, 3], 0.0)


def test_every_array_is_within_the_buffer_and_aligned(run, tmp_path):
    export_glb(open_map(run), tmp_path / "a.glb", UP)
    document, buffer = parts(tmp_path / "a.glb")
    assert document["buffers"] == [{"byteLength": len(buffer)}]
    for view in document["bufferViews"]:
        assert view["byteOffset"] % 4 == 0 and view["byteOffset"] + view["byteLength"] <= len(buffer)
    primitive = document["meshes"][0]["primitives"][0]
    position = document["accessors"][primitive["attributes"]["POSITION"]]
    assert position["min"] == [-1, -1, 2] and position["max"] == [1, 1, 2]
    assert document["accessors"][primitive["indices"]]["count"] == 6
    colour = document["accessors"][primitive["attributes"]["COLOR_0"]]
    assert colour["normalized"] and colour["componentType"] == 5121 and colour["type"] == "VEC4"
    assert document["asset"]["extras"]["unit"] == "metres"


@pytest.mark.parametrize(("colour", "expected"), [("grey", (255, 255, 255)), ("normal", (55, 0, 55))])
def test_colours(run, tmp_path, colour, expected):
    """All have the same grey, which is white then; all normals are downward, -z."""
    export_glb(open_map(run), tmp_path / "a.glb", UP, colour=colour)
    document, buffer = parts(tmp_path / "a.glb")
    index = document["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"]
    view = document["bufferViews"][document["accessors"][index]["bufferView"]]
    values = np.frombuffer(buffer, np.uint8, view["byteLength"], view["byteOffset"]).reshape(-1, 4)
    assert (values == [*expected, 255]).all()


def test_a_far_world_keeps_its_digits(tmp_path):
    run = write_room(tmp_path / "far", shift=FAR, most=2)
    export_glb(open_map(run), tmp_path / "a.glb", UP)
    document, _ = parts(tmp_path / "a.glb")
    assert document["asset"]["extras"]["offset"] == FAR.tolist()
    mesh = next(iter(trimesh.load(tmp_path / "a.glb", force="scene").geometry.values()))
    assert np.array_equal(mesh.vertices, sample_map().mesh.vertices)


def test_a_run_without_a_mesh_says_what_to_do(polarmap, tmp_path):
    run = write_room(tmp_path / "run", finished=False, most=2)
    ended = polarmap("export", run, "--to", "glb", "-o", tmp_path / "a.glb", "--up", 0, 0, 1)
    assert ended.status == 2 and "mesh.ply" in ended.err and "'ply'" in ended.err
    assert not (tmp_path / "a.glb").exists()


def test_a_mesh_alone_is_enough_if_up_is_said(polarmap, tmp_path):
    run = write_room(tmp_path / "run", most=2)
    for path in (run / "keyframes").iterdir():
        path.unlink()
    refused(polarmap("export", run, "--to", "glb", "-o", tmp_path / "a.glb"), "no keyframes", "--up")
    assert polarmap("export", run, "--to", "glb", "-o", tmp_path / "a.glb", "--up", 0, -1, 0).status == 0
    document, _ = parts(tmp_path / "a.glb")
    assert np.allclose(np.reshape(document["nodes"][0]["matrix"], (4, 4)).T @ [0, -1, 0, 1], [0, 1, 0, 1])


def test_a_name_that_is_no_glb_is_refused(polarmap, run, tmp_path):
    refused(polarmap("export", run, "--to", "glb", "-o", tmp_path / "a.obj"), "a.obj", ".glb")
