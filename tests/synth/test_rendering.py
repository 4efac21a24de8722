"""Paths, sequences in memory and as files, and what the built-in room is like."""

from __future__ import annotations

import cv2
import numpy as np
import pytest

from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.images import read_image
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.synth import DEFAULT_CAMERA, Sensor, built_in_scene, handheld_path, render_sequence
from polarmap.synth.recording import DEPTH_SCALE, write_sequence

SMALL = PinholeCamera(width=80, height=60, fx=60.0, fy=60.0, cx=39.5, cy=29.5)


def frames_of(name: str, count: int, camera=SMALL, sensor=None, supersample=1):
    built_in = built_in_scene(name)
    timestamps, poses = built_in.path(frames=count)
    return list(render_sequence(built_in.scene, camera, timestamps, poses, sensor, supersample))


def test_a_path_starts_as_asked_and_keeps_its_step():
    timestamps, poses = handheld_path((0.0, 0.0, 1.5), (0.0, 3.0, 1.0), frames=200, step=0.04, frame_rate=20.0)
    np.testing.assert_allclose(np.diff(timestamps), 0.05)
    np.testing.assert_allclose(poses[0, :3, 3], [0.0, 0.0, 1.5])
    steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
    np.testing.assert_allclose(steps, 0.04, rtol=0.03)
    assert np.abs(poses[:, :3, 3] - poses[0, :3, 3]).max() < 3.0


def test_a_path_is_smooth_and_made_of_rotations():
    _, poses = handheld_path((0.0, 0.0, 1.5), (0.0, 3.0, 1.0), frames=100)
    R = poses[:, :3, :3]
    np.testing.assert_allclose(R @ R.transpose(0, 2, 1), np.broadcast_to(np.eye(3), R.shape), atol=1e-12)
    turn = np.arccos(np.clip((np.einsum("nij,nij->n", R[1:], R[:-1]) - 1) / 2, -1, 1))
    assert np.radians(0.05) < np.median(turn) and turn.max() < np.radians(3)
    bend = np.linalg.norm(np.diff(poses[:, :3, 3], n=2, axis=0), axis=1)
    assert np.median(bend) < 0.004 and bend.max() < 0.015  # of steps of 0.04


def test_a_path_depends_on_its_seed_and_nothing_else():
    one, again, other = (handheld_path((0, 0, 1), (0, 2, 1), seed=seed)[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one - other).max() > 0.01


@pytest.mark.parametrize("wrong", [{"frames": 0}, {"step": 0.0}, {"frame_rate": -1.0}])
def test_impossible_paths_are_refused(wrong):
    with pytest.raises(InputError, match="path"):
        handheld_path((0, 0, 1), (0, 2, 1), **wrong)


def test_a_sequence_is_deterministic_and_its_truth_fits_its_mosaic():
    sensor = Sensor(noise=None, bit_depth=16)
    first, again = (frames_of("room", 2, sensor=sensor) for _ in range(2))
    np.testing.assert_array_equal(first[1].mosaic, again[1].mosaic)
    assert [frame.index for frame in first] == [0, 1]
    assert first[0].mosaic.shape == (120, 160)
    mean = first[0].mosaic.reshape(60, 2, 80, 2).mean(axis=(1, 3)) / 65535
    np.testing.assert_allclose(mean, first[0].truth.stokes[0] / 2, atol=1e-4)


def test_a_sub_pixel_sequence_samples_the_scene_at_full_resolution():
    shared, own = (
        frames_of("room", 1, sensor=Sensor(noise=None, bit_depth=16, sub_pixel=sub_pixel))[0]
        for sub_pixel in (False, True)
    )
    assert own.mosaic.shape == shared.mosaic.shape
    difference = np.abs(own.mosaic.astype(float) - shared.mosaic) / 65535
    assert 1e-5 < np.median(difference) < 0.01  # the same picture, half a pixel aside
    np.testing.assert_array_equal(own.truth.depth, shared.truth.depth)


def test_timestamps_and_poses_must_match():
    with pytest.raises(InputError, match="2 timestamps for 1 poses"):
        render_sequence(built_in_scene("plane").scene, SMALL, np.arange(2.0), np.eye(4)[None])


def test_the_room_is_mostly_bare_weakly_polarized_and_well_exposed():
    materials = built_in_scene("room").scene.materials
    textured = [i for i, material in enumerate(materials) if material.texture]
    for frame in frames_of("room", 3, DEFAULT_CAMERA.scaled(0.25)):
        stokes = frame.truth.stokes
        dolp = np.hypot(stokes[1], stokes[2]) / stokes[0]
        assert (frame.mosaic == 255).mean() < 0.01
        assert 0.2 < np.median(stokes[0]) / 2 < 0.6
        assert 0.01 < np.median(dolp) < 0.05 and 0.25 < (dolp > 0.05).mean() < 0.5
        assert 0.2 < np.percentile(dolp, 99) < 0.6
        assert 0.25 < np.isin(frame.truth.material, textured).mean() < 0.5
        assert 0.2 < (frame.truth.reflection == 2).mean() < 0.6
        assert np.isfinite(frame.truth.depth).all()


def test_a_written_sequence_reads_back(tmp_path):
    sensor = Sensor(bit_depth=12)
    frames = frames_of("sphere", 3, sensor=sensor)
    write_sequence(tmp_path / "sequence", frames, SMALL, sensor)
    camera_file = read_camera_file(tmp_path / "sequence" / "camera.yaml")
    assert camera_file.camera == SMALL
    assert (camera_file.layout, camera_file.angle_direction) == (sensor.layout, sensor.angle_direction)
    assert (camera_file.bit_depth, camera_file.noise) == (12, sensor.noise)
    trajectory = read_trajectory(tmp_path / "sequence" / "groundtruth.txt")
    np.testing.assert_allclose(trajectory.poses, [frame.T_world_camera for frame in frames], atol=1e-9)
    times = np.loadtxt(tmp_path / "sequence" / "timestamps.txt")
    np.testing.assert_array_equal(times, [frame.timestamp for frame in frames])
    for frame in frames:
        name = f"{frame.index:06d}.png"
        np.testing.assert_array_equal(read_image(tmp_path / "sequence" / "raw" / name), frame.mosaic)
        depth = read_depth_png(tmp_path / "sequence" / "depth" / name, DEPTH_SCALE)
        np.testing.assert_allclose(depth, frame.truth.depth, atol=0.51 / DEPTH_SCALE)


def test_written_normals_decode(tmp_path):
    (frame,) = frames_of("sphere", 1)
    write_sequence(tmp_path, [frame], SMALL, Sensor())
    rgb = cv2.imread(str(tmp_path / "normal" / "000000.png"), cv2.IMREAD_UNCHANGED)[..., ::-1]
    known = rgb.any(axis=-1)
    np.testing.assert_array_equal(known, np.isfinite(frame.truth.depth))
    np.testing.assert_allclose(rgb[known] / 32767.5 - 1.0, frame.truth.normal[known], atol=2e-5)


def test_depth_beyond_sixteen_bits_is_written_as_none(tmp_path):
    scene = built_in_scene("plane").scene
    back = np.eye(4)
    back[2, 3] = -12.0
    frames = list(render_sequence(scene, SMALL, np.zeros(1), back[None], supersample=1))
    write_sequence(tmp_path, frames, SMALL, Sensor())
    depth = read_depth_png(tmp_path / "depth" / "000000.png", DEPTH_SCALE)
    far = frames[0].truth.depth > 65535 / DEPTH_SCALE
    assert far.any() and not far.all()
    np.testing.assert_array_equal(np.isnan(depth), far)


def test_a_folder_that_cannot_be_made_is_one_clear_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(PolarmapError, match="cannot be created"):
        write_sequence(tmp_path / "file", [], SMALL, Sensor())
