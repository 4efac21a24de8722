"""What COLMAP reads of an export, by its own library and by the package's reader."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from export_room import CAMERA, FAR, room_keyframes, to_surface, write_room

from polarmap.export.colmap import export_colmap
from polarmap.export.samples import choose_samples
from polarmap.export.source import open_map
from polarmap.geometry.pose import inverse
from polarmap.io.formats.colmap import read_colmap_map, read_colmap_model
from polarmap.io.formats.images import read_image

POINTS = 3000


@pytest.fixture(scope="module")
def run(tmp_path_factory):
    return write_room(tmp_path_factory.mktemp("room") / "run")


@pytest.fixture(scope="module")
def written(run, tmp_path_factory):
    out = tmp_path_factory.mktemp("colmap") / "out"
    export_colmap(open_map(run), out, points=POINTS)
    return out


@pytest.fixture(scope="module")
def pycolmap():
    return pytest.importorskip("pycolmap", reason="COLMAP's own reader is not installed (pip install pycolmap)")


@pytest.mark.parametrize("model", ["sparse", "sparse/0"])
def test_pycolmap_reads_cameras_poses_and_points(pycolmap, written, model):
    found = pycolmap.Reconstruction(str(written / model))
    keyframes = {f"{k.index:06d}.png": k for k in room_keyframes()}
    (camera,) = found.cameras.values()
    assert camera.model.name == "PINHOLE" and (camera.width, camera.height) == (CAMERA.width, CAMERA.height)
    assert np.allclose(camera.params, [CAMERA.fx, CAMERA.fy, CAMERA.cx + 0.5, CAMERA.cy + 0.5])
    assert {image.name for image in found.images.values()} == set(keyframes)
    for image in found.images.values():
        T = np.vstack([image.cam_from_world().matrix(), [0, 0, 0, 1]])
        assert np.allclose(T, inverse(keyframes[image.name].T_world_camera), atol=1e-9)
    assert POINTS / 2 < len(found.points3D) <= POINTS


def test_points_are_where_their_tracks_say(pycolmap, written):
    found = pycolmap.Reconstruction(str(written / "sparse"))
    lengths = []
    for identity, point in found.points3D.items():
        lengths.append(len(point.track.elements))
        for element in point.track.elements:
            image = found.images[element.image_id]
            seen = image.points2D[element.point2D_idx]
            assert seen.point3D_id == identity
            assert np.linalg.norm(image.project_point(point.xyz) - seen.xy) < 0.5
    assert min(lengths) >= 1 and np.mean(lengths) > 2
    assert to_surface(np.array([p.xyz for p in found.points3D.values()])).max() < 1e-3


def test_points_are_seen_only_where_nothing_hides_them(written):
    model, keyframes = read_colmap_model(written / "sparse"), {k.index: k for k in room_keyframes()}
    for image in model.images:
        keyframe = keyframes[int(image.name[:6])]
        T = inverse(keyframe.T_world_camera)
        z = model.positions_of(image.point_ids) @ T[2, :3] + T[2, 3]
        u, v = np.rint(image.pixels).astype(int).T
        assert (np.abs(keyframe.depth[v, u] - z) < 0.05 * z).all()


def test_binary_and_text_are_the_same_model(written):
    binary, text = read_colmap_model(written / "sparse"), read_colmap_model(written / "sparse" / "0")
    assert np.array_equal(binary.points, text.points) and np.array_equal(binary.point_ids, text.point_ids)
    for a, b in zip(binary.images, text.images, strict=True):
        assert a.name == b.name and np.array_equal(a.T_world_camera, b.T_world_camera)
        assert np.array_equal(a.pixels, b.pixels) and np.array_equal(a.point_ids, b.point_ids)
    assert "# lengths are in metres" in (written / "sparse" / "0" / "points3D.txt").read_text()


def test_colmap_fuses_the_depth_maps(pycolmap, written, tmp_path):
    """Its fusion takes the corner of a pixel for its centre, which moves points by half a pixel, here by up to 3 cm."""
    options = {"min_num_pixels": 2}
    fused = pycolmap.stereo_fusion(str(tmp_path), str(written), input_type="geometric", options=options)
    points = np.array([point.xyz for point in fused.points3D.values()])
    assert len(points) > 5000 and np.abs(to_surface(points)).max() < 0.04


def test_pictures_and_depth_are_the_keyframes(run, written):
    keyframe = room_keyframes()[3]
    name = f"{keyframe.index:06d}.png"
    assert np.array_equal(read_image(written / "images" / name), open_map(run).picture(keyframe.index))
    depth = read_colmap_map(written / "stereo" / "depth_maps" / f"{name}.geometric.bin")
    normal = read_colmap_map(written / "stereo" / "normal_maps" / f"{name}.geometric.bin", channels=3)
    assert np.array_equal(depth, keyframe.depth) and np.array_equal(normal, keyframe.normal)


def test_points_are_even_and_no_more_than_asked(run):
    source = open_map(run)
    for most in (1, 50, 2000):
        samples = choose_samples(source, most, 0.1)
        assert most / 2 <= len(samples) <= most
    cubes = np.floor(samples.position / 0.5).astype(int)
    counts = np.unique(cubes, axis=0, return_counts=True)[1]
    assert np.percentile(counts, 90) < 3 * np.median(counts)


def test_a_far_world_is_counted_from_its_origin(written, tmp_path):
    far = write_room(tmp_path / "far", shift=FAR)
    export_colmap(open_map(far), tmp_path / "out", points=POINTS)
    near, moved = read_colmap_model(written / "sparse"), read_colmap_model(tmp_path / "out" / "sparse")
    for a, b in zip(near.images, moved.images, strict=True):
        assert np.allclose(a.T_world_camera, b.T_world_camera, atol=1e-8)
    assert np.array_equal(np.loadtxt(tmp_path / "out" / "offset.xyz"), FAR)


def test_keyframes_without_pictures_are_left_out(polarmap, tmp_path, caplog):
    run = write_room(tmp_path / "run", most=4)
    (run / "pictures" / "000010_image.jpg").unlink()
    caplog.set_level(logging.WARNING)
    export_colmap(open_map(run), tmp_path / "out", points=100)
    assert "1 keyframes have no picture" in caplog.text
    assert [image.name for image in read_colmap_model(tmp_path / "out" / "sparse").images] == [
        "000000.png", "000020.png", "000030.png",
    ]  # fmt: skip
    assert not (tmp_path / "out" / "images" / "000010.png").exists()
