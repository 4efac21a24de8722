"""PLY files as others read them."""

from __future__ import annotations

import resource

import numpy as np
import pytest
import trimesh

from polarmap.errors import InputError, PolarmapError
from polarmap.io.formats.ply import write_ply

VERTICES = np.array([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, -1e6]], np.float32)
NORMALS = np.array([[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, -1]], np.float32)
GREY = np.array([0.0, 0.5, 1.0, 2.0], np.float32)
FACES = np.array([[0, 1, 2], [0, 3, 1]], np.int32)


def test_mesh_is_read_back(tmp_path):
    write_ply(tmp_path / "mesh.ply", VERTICES, faces=FACES, normals=NORMALS, grey=GREY)
    mesh = trimesh.load(tmp_path / "mesh.ply", process=False)
    assert np.array_equal(mesh.vertices, VERTICES)
    assert np.array_equal(mesh.faces, FACES)
    assert np.array_equal(mesh.vertex_normals, NORMALS)
    assert np.array_equal(mesh.visual.vertex_colors[:, :3], np.repeat([[0], [128], [255], [255]], 3, axis=1))


def test_cloud_is_read_back(tmp_path):
    write_ply(tmp_path / "cloud.ply", VERTICES, normals=NORMALS, grey=GREY)
    cloud = trimesh.load(tmp_path / "cloud.ply")
    assert isinstance(cloud, trimesh.PointCloud)
    assert np.array_equal(cloud.vertices, VERTICES)
    assert cloud.colors[:, 0].tolist() == [0, 128, 255, 255]


def test_bytes_are_as_the_format_says(tmp_path):
    write_ply(tmp_path / "a.ply", VERTICES[:1], normals=NORMALS[:1], grey=[np.nan])
    header, body = (tmp_path / "a.ply").read_bytes().split(b"end_header\n")
    assert header.decode().splitlines() == [
        "ply",
        "format binary_little_endian 1.0",
        "element vertex 1",
        *(f"property float {name}" for name in ("x", "y", "z", "nx", "ny", "nz")),
        *(f"property uchar {name}" for name in ("red", "green", "blue")),
    ]
    assert body == np.array([0, 0, 0, 0, 0, 1], "<f4").tobytes() + bytes(3)


def test_an_offset_is_a_comment_that_others_read_over(tmp_path):
    write_ply(tmp_path / "far.ply", VERTICES, faces=FACES, offset=np.array([451200.0, 5212300.25, 500.0]))
    assert b"\ncomment offset 451200.0 5212300.25 500.0\n" in (tmp_path / "far.ply").read_bytes()
    assert np.array_equal(trimesh.load(tmp_path / "far.ply", process=False).vertices, VERTICES)
    write_ply(tmp_path / "near.ply", VERTICES, offset=np.zeros(3))
    assert b"comment" not in (tmp_path / "near.ply").read_bytes()


def test_nothing_is_written_too(tmp_path):
    write_ply(tmp_path / "empty.ply", np.zeros((0, 3)), faces=np.zeros((0, 3), int), grey=np.zeros(0))
    assert b"element vertex 0\n" in (tmp_path / "empty.ply").read_bytes()
    assert b"element face 0\n" in (tmp_path / "empty.ply").read_bytes()


def test_further_properties_are_read_back(tmp_path):
    deviation = np.array([0.5, 0.25, 0.0, np.inf], np.float32)
    write_ply(tmp_path / "cloud.ply", VERTICES, grey=GREY, properties={"deviation": deviation})
    data = trimesh.load(tmp_path / "cloud.ply").metadata["_ply_raw"]["vertex"]["data"]
    assert np.array_equal(np.ravel(data["deviation"]), deviation)


@pytest.mark.parametrize(
    ("arrays", "message"),
    [
        ({"points": np.zeros((4, 2))}, "points must be"),
        ({"normals": np.zeros((3, 3))}, "normals must be"),
        ({"grey": np.zeros((4, 3))}, "grey must be"),
        ({"properties": {"deviation": np.zeros(3)}}, "deviation must be"),
        ({"faces": np.zeros((2, 4), int)}, "faces must be"),
        ({"faces": np.array([[0, 1, 4]])}, "outside 0 to 3"),
        ({"faces": np.array([[0, 1, -1]])}, "outside 0 to 3"),
    ],
)
def test_arrays_that_do_not_fit_are_refused(tmp_path, arrays, message):
    with pytest.raises(InputError, match=f"a.ply: .*{message}"):
        write_ply(tmp_path / "a.ply", **({"points": VERTICES} | arrays))
    assert list(tmp_path.iterdir()) == []


def test_a_full_disk_leaves_the_old_file(tmp_path):
    write_ply(tmp_path / "mesh.ply", VERTICES)
    before = (tmp_path / "mesh.ply").read_bytes()
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (4096, hard))
    try:
        with pytest.raises(PolarmapError, match=r"mesh\.ply: cannot be written") as caught:
            write_ply(tmp_path / "mesh.ply", np.zeros((10_000, 3)))
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    assert not isinstance(caught.value, InputError)
    assert (tmp_path / "mesh.ply").read_bytes() == before
    assert [p.name for p in tmp_path.iterdir()] == ["mesh.ply"]


def test_whole_numbers_and_comments_are_kept(tmp_path):
    label, frame = np.uint8([0, 1, 3, 2]), np.int32([7, 1 << 25, (1 << 25) + 1, 0])  # no single precision holds these
    write_ply(
        tmp_path / "a.ply",
        VERTICES[[0, 1, 2, 0]],
        properties={"label": label, "frame": frame, "sigma": np.full(4, 0.1)},
        comments=["label: a kind", "lengths are in metres"],
    )
    raw = trimesh.load(tmp_path / "a.ply").metadata["_ply_raw"]["vertex"]["data"]
    assert raw["label"].tolist() == label.tolist() and raw["frame"].tolist() == frame.tolist()
    assert raw["sigma"].dtype == np.float32
    assert b"\ncomment label: a kind\ncomment lengths are in metres\n" in (tmp_path / "a.ply").read_bytes()
