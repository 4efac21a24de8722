"""COLMAP's files, written byte by byte, and broken ones."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from import_samples import colmap_map_bytes, write_colmap_model
from scipy.spatial.transform import Rotation

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.colmap import read_colmap_map, read_colmap_model

CAMERA = PinholeCamera(640, 480, 500.0, 510.0, 319.5, 239.5)
POINTS = np.array([[0.5, -1.0, 2.0], [1.0, 2.0, 3.0]])


def turned_pose():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.1, -0.4, 0.3]).as_matrix()
    T[:3, 3] = [1.0, 2.0, -3.0]
    return T


def test_a_depth_map_is_read_row_by_row(tmp_path):
    path = tmp_path / "a.png.geometric.bin"
    path.write_bytes(b"3&2&1&" + struct.pack("<6f", 1, 2, 3, 4, 0, -1))
    np.testing.assert_array_equal(read_colmap_map(path), np.float32([[1, 2, 3], [4, np.nan, np.nan]]))


def test_normals_come_channel_by_channel(tmp_path):
    path = tmp_path / "a.png.geometric.bin"
    path.write_bytes(b"2&1&3&" + struct.pack("<6f", 1, 2, 3, 4, 5, 6))
    np.testing.assert_array_equal(read_colmap_map(path, channels=3), np.float32([[[1, 3, 5], [2, 4, 6]]]))
    normal = np.arange(24, dtype=np.float32).reshape(2, 4, 3)
    path.write_bytes(colmap_map_bytes(normal))
    np.testing.assert_array_equal(read_colmap_map(path, channels=3), normal)


@pytest.mark.parametrize(
    ("data", "problem"),
    [
        (b"", "malformed in its header"),
        (b"3&2&1", "malformed in its header"),
        (b"3&-2&1&", "malformed in its header"),
        (b"3&2&3&" + bytes(72), "3 channels, expected 1"),
        (b"99999&99999&1&", "claims 99999x99999 pixels"),
        (b"3&2&1&" + bytes(23), "truncated in its 3x2 values: 24 bytes expected, 23 left"),
        (b"3&2&1&" + bytes(25), "1 bytes more than its header says"),
        (b"0&2&1&", "malformed in its header"),
    ],
)
def test_a_broken_map_is_named(tmp_path, data, problem):
    path = tmp_path / "broken.bin"
    path.write_bytes(data)
    with pytest.raises(InputError, match=problem) as error:
        read_colmap_map(path)
    assert "broken.bin" in str(error.value)


@pytest.mark.parametrize("binary", [True, False])
def test_a_model_in_both_formats(tmp_path, binary):
    poses = {"a b.png": turned_pose(), "sub/000001.png": np.eye(4)}
    write_colmap_model(tmp_path, CAMERA, poses, POINTS, binary)
    model = read_colmap_model(tmp_path)
    assert [image.name for image in model.images] == list(poses)
    assert model.cameras[7].pinhole == CAMERA  # half a pixel less than in the file
    assert not model.cameras[7].distorted
    image = model.images[0]
    np.testing.assert_allclose(image.T_world_camera, turned_pose(), atol=1e-12)
    np.testing.assert_array_equal(image.point_ids, [11, 12])  # without the one that is no point
    np.testing.assert_array_equal(image.pixels, [[-0.5, -0.5], [0.5, 1.5]])
    np.testing.assert_array_equal(model.points, POINTS)
    np.testing.assert_array_equal(model.positions_of(np.array([12, 99])), [POINTS[1], [np.nan] * 3])


def test_a_model_without_points(tmp_path):
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, binary=False)
    (tmp_path / "points3D.txt").unlink()
    model = read_colmap_model(tmp_path)
    assert len(model.points) == len(model.images[0].pixels) == 0
    assert np.isnan(model.positions_of(np.array([1]))).all()


@pytest.mark.parametrize(
    ("model", "expected", "distorted"),
    [
        ((0, "SIMPLE_PINHOLE", [400.0, 320.0, 240.0]), (400.0, 400.0, 319.5, 239.5), False),
        ((2, "SIMPLE_RADIAL", [400.0, 320.0, 240.0, 0.1]), (400.0, 400.0, 319.5, 239.5), True),
        ((2, "SIMPLE_RADIAL", [400.0, 320.0, 240.0, 0.0]), (400.0, 400.0, 319.5, 239.5), False),
        ((4, "OPENCV", [400.0, 401.0, 320.0, 240.0, 0, 0, 0, 1e-3]), (400.0, 401.0, 319.5, 239.5), True),
        ((5, "OPENCV_FISHEYE", [400.0, 401.0, 320.0, 240.0, 0, 0, 0, 0]), (400.0, 401.0, 319.5, 239.5), True),
    ],
)
@pytest.mark.parametrize("binary", [True, False])
def test_camera_models(tmp_path, model, expected, distorted, binary):
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, binary=binary, model=model)
    camera = read_colmap_model(tmp_path).cameras[7]
    assert camera.pinhole == PinholeCamera(640, 480, *expected)
    assert camera.distorted is distorted


@pytest.mark.parametrize("name", ["cameras.bin", "images.bin", "points3D.bin"])
def test_truncated_files_are_named(tmp_path, name):
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, POINTS)
    data = (tmp_path / name).read_bytes()
    for size in (0, 4, 9, len(data) // 2, len(data) - 1):
        (tmp_path / name).write_bytes(data[:size])
        with pytest.raises(InputError, match=name.replace(".", r"\.")):
            read_colmap_model(tmp_path)
    (tmp_path / name).write_bytes(data + b"\0")
    with pytest.raises(InputError, match="more than its header says"):
        read_colmap_model(tmp_path)


def test_a_huge_count_takes_no_memory(tmp_path):
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, POINTS)
    (tmp_path / "points3D.bin").write_bytes(struct.pack("<Q", 1 << 60) + bytes(100))
    with pytest.raises(InputError, match="claims 1152921504606846976 points"):
        read_colmap_model(tmp_path)


def test_what_is_wrong_in_binary_files(tmp_path):
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, model=(99, "?", [1.0] * 4))
    with pytest.raises(InputError, match="camera 7 is of model 99"):
        read_colmap_model(tmp_path)
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, model=(1, "", [float("nan")] * 4))
    with pytest.raises(InputError, match=r"cameras\.bin: camera 7: .*finite"):
        read_colmap_model(tmp_path)
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)})
    (tmp_path / "cameras.bin").write_bytes(struct.pack("<Q", 0))
    with pytest.raises(InputError, match=r"a\.png is of camera 7, which cameras\.bin lacks"):
        read_colmap_model(tmp_path)


@pytest.mark.parametrize(
    ("name", "text", "problem"),
    [
        ("cameras.txt", "7 PINHOLE 640 480 1 2 3\n", "line 1: 3 parameters of PINHOLE, expected 4"),
        ("cameras.txt", "7 LENS 640 480 1\n", "MODEL one of"),
        ("cameras.txt", "7 PINHOLE 640 x 1 2 3 4\n", "line 1: 'x' is no whole number"),
        ("cameras.txt", "7 PINHOLE 640 480 1 2 nan 4\n", "not all are finite numbers"),
        ("images.txt", "# a\n1 1 0 0 0 0 0 0 7\n\n", "line 2: expected IMAGE_ID QW"),
        ("images.txt", "1 0 0 0 0 0 0 0 7 a.png\n\n", "the quaternion is zero"),
        ("images.txt", "1 1 0 0 0 1e300 0 0 7 a.png\n\n", "numbers that are none or too large"),
        ("images.txt", "1 1 0 0 0 0 0 0 7 a.png\n1 2\n", "line 2: 2 X Y POINT3D_ID, expected 0"),
        ("points3D.txt", "1 2 3\n", "line 1: expected POINT3D_ID"),
        ("points3D.txt", "1 a 3 4 0 0 0 0.5\n", "line 1: coordinates: not all are finite"),
    ],
)
def test_what_is_wrong_in_text_files(tmp_path, name, text, problem):
    write_colmap_model(tmp_path, CAMERA, {"a.png": np.eye(4)}, POINTS, binary=False)
    (tmp_path / name).write_text(text)
    with pytest.raises(InputError, match=problem) as error:
        read_colmap_model(tmp_path)
    assert name in str(error.value)


def test_no_model_is_said(tmp_path):
    with pytest.raises(InputError, match="no COLMAP model in it"):
        read_colmap_model(tmp_path)
