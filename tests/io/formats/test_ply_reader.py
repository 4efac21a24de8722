"""PLY files and .npy depth of other programs, and broken ones."""

from __future__ import annotations

import struct

import numpy as np
import pytest
import trimesh

from polarmap.errors import InputError
from polarmap.io.formats.depth_array import read_depth_array
from polarmap.io.formats.ply import write_ply
from polarmap.io.formats.ply_reader import read_ply

SQUARE = np.float32([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0.5]])
HEADER = "ply\nformat {} 1.0\ncomment by hand\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
FACES = "element face 2\nproperty list uchar int vertex_indices\n"
STRIPS = "element tristrips 1\nproperty list int int vertex_indices\nend_header\n3 0 1 2\n"
LABELS = "element label 1\nproperty list uchar uchar text\n"
ASCII = HEADER.format("ascii") + FACES + "end_header\n0 0 0\n1 0 0\n1 1 0\n0 1 0.5\n"


def test_our_own_files(tmp_path):
    normals = np.tile(np.float32([0, 0, 1]), (4, 1))
    write_ply(tmp_path / "a.ply", SQUARE, faces=np.array([[0, 1, 2], [0, 2, 3]]), normals=normals, grey=np.ones(4))
    ply = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(ply.points, SQUARE)
    np.testing.assert_array_equal(ply.faces, [[0, 1, 2], [0, 2, 3]])
    np.testing.assert_array_equal(ply.normals, normals)
    write_ply(tmp_path / "b.ply", SQUARE)
    assert read_ply(tmp_path / "b.ply").faces.shape == (0, 3)
    assert read_ply(tmp_path / "b.ply").normals is None


@pytest.mark.parametrize("kind", ["binary", "ascii"])
def test_further_properties_are_read_where_they_are_asked_for(tmp_path, kind):
    if kind == "binary":
        write_ply(tmp_path / "a.ply", SQUARE, properties={"label": np.uint8([0, 1, 3, 2]), "sigma": np.ones(4)})
    else:
        header = HEADER.format("ascii") + "property uchar label\nproperty float sigma\nend_header\n"
        rows = "".join(f"{x} {y} {z} {label} 1\n" for (x, y, z), label in zip(SQUARE, (0, 1, 3, 2), strict=True))
        (tmp_path / "a.ply").write_text(header + rows)
    assert read_ply(tmp_path / "a.ply").properties == {}
    found = read_ply(tmp_path / "a.ply", ("label", "grey"))
    assert set(found.properties) == {"label"} and found.properties["label"].tolist() == [0, 1, 3, 2]
    np.testing.assert_array_equal(found.points, SQUARE)


UTM = np.array([451200.0, 5212300.0, 500.25])


def test_an_offset_is_added(tmp_path, caplog):
    write_ply(tmp_path / "a.ply", SQUARE, offset=UTM)
    ply = read_ply(tmp_path / "a.ply")
    np.testing.assert_array_equal(ply.points, SQUARE + UTM)
    np.testing.assert_array_equal(ply.offset, UTM)
    write_ply(tmp_path / "b.ply", SQUARE)
    np.testing.assert_array_equal(read_ply(tmp_path / "b.ply").offset, 0.0)
    assert not caplog.records


@pytest.mark.parametrize(
    ("comment", "offset"),
    [
        ("comment offset 1 -2e3 +.5", (1.0, -2000.0, 0.5)),
        ("comment Offset: 1 2 3", (1.0, 2.0, 3.0)),
        ("comment offset 1 2 3\ncomment offset 1.0 2.0 3.0", (1.0, 2.0, 3.0)),
        ("comment offset 1 2", (0.0, 0.0, 0.0)),
        ("comment offset of the bolts 1 2 3", (0.0, 0.0, 0.0)),
        ("comment offset nan 2 3", (0.0, 0.0, 0.0)),
        ("obj_info offset 1 2 3", (0.0, 0.0, 0.0)),
    ],
)
def test_what_is_an_offset_and_what_is_not(tmp_path, comment, offset):
    (tmp_path / "a.ply").write_text(ASCII.replace("comment by hand", comment) + "3 0 1 2\n3 0 1 2\n")
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply").points, SQUARE + np.array(offset))


@pytest.mark.parametrize("kind", ["float", "double"])
def test_points_that_single_precision_has_ruined_are_said(tmp_path, caplog, kind):
    header = HEADER.format("binary_little_endian").replace("property float", f"property {kind}") + "end_header\n"
    body = (SQUARE + UTM).astype({"float": "<f4", "double": "<f8"}[kind]).tobytes()
    (tmp_path / "a.ply").write_bytes(header.encode() + body)
    points = read_ply(tmp_path / "a.ply").points
    if kind == "double":
        np.testing.assert_array_equal(points, SQUARE + UTM)
        assert not caplog.records
    else:
        assert "a.ply: its points are so far from zero that single precision has steps of 0.5 there" in caplog.text


@pytest.mark.parametrize("encoding", ["ascii", "binary"])
def test_files_of_trimesh(tmp_path, encoding):
    mesh = trimesh.creation.box()
    (tmp_path / "a.ply").write_bytes(trimesh.exchange.ply.export_ply(mesh, encoding=encoding))
    ply = read_ply(tmp_path / "a.ply")
    np.testing.assert_allclose(ply.points, mesh.vertices, atol=1e-6)
    np.testing.assert_array_equal(ply.faces, mesh.faces)


def test_polygons_become_triangles(tmp_path):
    (tmp_path / "a.ply").write_text(ASCII + "4 0 1 2 3\n3 0 1 2\n")
    np.testing.assert_array_equal(read_ply(tmp_path / "a.ply").faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])
    header = HEADER.format("binary_big_endian") + FACES + "end_header\n"
    body = SQUARE.astype(">f4").tobytes() + struct.pack(">B4iB3i", 4, 0, 1, 2, 3, 3, 0, 1, 2)
    (tmp_path / "b.ply").write_bytes(header.encode() + body)
    ply = read_ply(tmp_path / "b.ply")
    np.testing.assert_array_equal(ply.points, SQUARE)
    np.testing.assert_array_equal(ply.faces, [[0, 1, 2], [0, 2, 3], [0, 1, 2]])


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("", "not a PLY file"),
        ("ply\nformat ascii 1.0\n", "not a PLY file"),
        (ASCII.replace("format ascii 1.0\n", ""), "names no format"),
        (ASCII.replace("float x", "quaternion x"), "not understood: 'property quaternion x'"),
        (ASCII.replace("float x", "float w") + "3 0 1 2\n3 0 1 2\n", "no vertices with x, y and z"),
        (ASCII + "3 0 1 2\n", "truncated: 2 of face, only 1 are there"),
        (ASCII + "3 0 1 2\n3 0 1\n", "fewer numbers than it claims"),
        (ASCII + "3 0 1 2\n3 0 1 9\n", "names a vertex outside 0 to 3"),
        (ASCII.replace("1 1 0\n", "1 1\n") + "3 0 1 2\n3 0 1 2\n", "a vertex is malformed"),
        (ASCII.replace("1 1 0\n", "1 a 0\n") + "3 0 1 2\n3 0 1 2\n", "a vertex is malformed"),
        (
            ASCII.replace("vertex 4", "vertex 99999999999") + "3 0 1 2\n3 0 1 2\n",
            "truncated: 99999999999 of vertex in ",
        ),
        (
            ASCII.replace("property float z\n", "property float z\nproperty float w\n"),
            "has 3 numbers, its header names 4",
        ),
        (ASCII + "3 0 1 2\n3 0 x 2\n", "is no face of numbers"),
        (ASCII + "3 0 1 2\n3 0 1e300 2\n", "is no face of numbers"),
        (ASCII + "nan 0 1 2\n3 0 1 2\n", "is no face of numbers"),
        (HEADER.format("binary_little_endian") + "end_header\n123", "truncated: 4 of vertex take 48 bytes, 3 are left"),
        (ASCII.replace("by hand", "offset 1 2 3\ncomment offset 1 2 4") + "3 0 1 2\n3 0 1 2\n", "no single offset"),
        (ASCII.replace("by hand", "offset 1 2 1e300") + "3 0 1 2\n3 0 1 2\n", "absurd"),
        (HEADER.format("ascii").replace("vertex", "camera") + "end_header\n", "truncated: 4 of camera in 0 bytes"),
        (HEADER.format("ascii").replace("vertex 4", "vertex 0") + STRIPS, "'tristrips' has a surface in a form"),
        (HEADER.format("ascii") + FACES + FACES + "end_header\n", "element 'face' comes twice"),
        (HEADER.format("ascii") + LABELS + FACES + "end_header\n", "'label' before the vertices or faces"),
    ],
)
def test_broken_files_are_named(tmp_path, text, problem):
    (tmp_path / "broken.ply").write_text(text)
    with pytest.raises(InputError, match=problem) as error:
        read_ply(tmp_path / "broken.ply")
    assert "broken.ply" in str(error.value)


def test_other_elements_are_read_over_and_faces_after_them_are_not_lost(tmp_path):
    vertices = "0 0 0\n1 0 0\n0 1 0\n1 1 0\n"
    edges = "element edge 2\nproperty int vertex1\nproperty int vertex2\n"
    text = HEADER.format("ascii") + edges + FACES + LABELS + "end_header\n" + vertices
    (tmp_path / "edges.ply").write_text(text + "0 1\n1 2\n3 0 1 2\n3 1 2 3\n2 65 66\n")
    np.testing.assert_array_equal(read_ply(tmp_path / "edges.ply").faces, [[0, 1, 2], [1, 2, 3]])


def test_depth_arrays(tmp_path):
    path = tmp_path / "a.npy"
    np.save(path, np.array([[1000, 2000, 0], [1, 2, 3]], np.uint16))
    np.testing.assert_array_equal(read_depth_array(path, 1000.0)[0], np.float32([1, 2, np.nan]))
    np.save(path, np.asfortranarray([[[1.0, np.inf], [-1.0, 4.0]]]))
    np.testing.assert_array_equal(read_depth_array(path), np.float32([[1, np.nan], [np.nan, 4]]))


def test_broken_arrays_are_named(tmp_path):
    path = tmp_path / "broken.npy"
    np.save(path, np.ones((4, 5), np.float32))
    data = path.read_bytes()
    np.save(path, np.ones((4, 5, 3), np.float32))
    colour = path.read_bytes()
    np.save(path, np.array([{}, {}], object), allow_pickle=True)
    pickled = path.read_bytes()
    huge = data.replace(b"(4, 5)", b"(400000, 500000)".ljust(6))
    unclosed = data.replace(b"(4, 5)", b"(4, 5,")
    for content in (
        unclosed,
        b"",
        b"\x93NUMPY",
        data[:40],
        data[:-1],
        data + b"\0",
        colour,
        pickled,
        huge,
        b"PK" + data,
    ):
        path.write_bytes(content)
        with pytest.raises(InputError, match=r"broken\.npy"):
            read_depth_array(path)
