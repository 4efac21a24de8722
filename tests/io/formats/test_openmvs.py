"""OpenMVS's depth maps, written byte by byte, and broken ones."""

from __future__ import annotations

import struct

import numpy as np
import pytest
from import_samples import dmap_bytes
from scipy.spatial.transform import Rotation

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.openmvs import read_dmap, read_dmap_header

CAMERA = PinholeCamera(4, 3, 5.0, 6.0, 1.6, 1.1)
DEPTH = np.arange(12, dtype=np.float32).reshape(3, 4)


def pose():
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec([0.3, 0.2, -0.4]).as_matrix()
    T[:3, 3] = [1.0, -2.0, 0.5]
    return T


def test_a_depth_map_with_all_of_it(tmp_path):
    path = tmp_path / "depth0000.dmap"
    normal = np.random.default_rng(0).normal(size=(3, 4, 3)).astype(np.float32)
    path.write_bytes(dmap_bytes("undistorted/a.png", DEPTH, CAMERA.matrix, pose(), normal=normal, confidence=DEPTH))
    found = read_dmap(path)
    assert found.image_name == "undistorted/a.png"
    assert found.camera == CAMERA
    np.testing.assert_allclose(found.T_world_camera, pose(), atol=1e-12)
    assert np.isnan(found.depth[0, 0])  # 0 is none
    np.testing.assert_array_equal(found.depth.ravel()[1:], DEPTH.ravel()[1:])
    np.testing.assert_array_equal(found.normal, normal)


def test_intrinsics_of_the_image_are_scaled_to_the_depth_map(tmp_path):
    path = tmp_path / "a.dmap"
    K = PinholeCamera(16, 12, 20.0, 20.0, 7.5, 5.5).matrix
    path.write_bytes(dmap_bytes("a", DEPTH, K, pose(), image_size=(16, 12)))
    assert read_dmap_header(path).camera == PinholeCamera(4, 3, 5.0, 5.0, 1.5, 1.0)
    path.write_bytes(dmap_bytes("a", DEPTH, CAMERA.matrix, pose(), image_size=(16, 12)))
    assert read_dmap_header(path).camera == CAMERA  # already the depth map's


def test_the_packed_kind(tmp_path):
    path = tmp_path / "a.dmap"
    data = dmap_bytes("a.png", DEPTH, CAMERA.matrix, pose())
    camera_and_name = data[28 : -4 * 12]
    codes = np.zeros((12, 2), np.int16)
    codes[:5] = [(32767, 0), (0, 0), (-32767, 32767), (-16384, -16384), (-32768, -32768)]
    codes[5] = (32767, 32767)
    header = b"D2" + struct.pack("<Bb4I3f", 1 + 2 + 4, -2, 4, 3, 4, 3, 0.1, 3.0, 1.0)
    maps = DEPTH.astype("<f2").tobytes() + codes.tobytes() + bytes(12)
    path.write_bytes(header + camera_and_name + maps)
    found = read_dmap(path)
    np.testing.assert_array_equal(found.depth.ravel()[1:], DEPTH.ravel()[1:] / 4)
    assert (found.image_name, found.camera) == ("a.png", CAMERA)
    normal = found.normal.reshape(-1, 3)
    diagonal = np.sqrt(0.5)
    np.testing.assert_allclose(normal[:2], [[1, 0, 0], [0, 0, 1]], atol=1e-6)
    np.testing.assert_allclose(normal[2], [0, 0, -1], atol=1e-6)  # a corner of the square
    np.testing.assert_allclose(normal[3], [-diagonal, -diagonal, 0], atol=1e-4)
    np.testing.assert_array_equal(normal[4], [0, 0, 0])
    np.testing.assert_allclose(normal[5], [0, 0, -1], atol=1e-6)
    path.write_bytes(path.read_bytes()[:-1])
    with pytest.raises(InputError, match="truncated in its confidence"):
        read_dmap(path)


def test_every_truncation_is_named(tmp_path):
    path = tmp_path / "short.dmap"
    data = dmap_bytes("a.png", DEPTH, CAMERA.matrix, pose(), normal=np.ones((3, 4, 3), np.float32))
    read_dmap_whole = [size for size in range(len(data)) if not _fails(path, data[:size])]
    assert read_dmap_whole == []
    assert not _fails(path, data)


def _fails(path, data) -> bool:
    path.write_bytes(data)
    try:
        read_dmap(path)
    except InputError as error:
        assert "short.dmap" in str(error)
        return True
    return False


def test_what_is_no_depth_map_is_said(tmp_path):
    path = tmp_path / "a.dmap"
    data = dmap_bytes("a.png", DEPTH, CAMERA.matrix, pose())
    broken = {
        "begins with DR or D2": b"XX" + data[2:],
        "holds no depth": data[:2] + b"\2" + data[3:],
        "claims a depth map of 4294967295x3": data[:12] + b"\xff" * 4 + data[16:],
        "no rigid motion": dmap_bytes("a.png", DEPTH, CAMERA.matrix, 2.0 * pose()),
        "its pose is no rigid motion": dmap_bytes("a.png", DEPTH, CAMERA.matrix, 1e300 * pose()),
        "focal lengths must be positive": dmap_bytes("a.png", DEPTH, -CAMERA.matrix, pose()),
    }
    for problem, content in broken.items():
        path.write_bytes(content)
        with pytest.raises(InputError, match=problem):
            read_dmap(path)
