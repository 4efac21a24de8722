"""The built-in scenes: paths in free space, what the pictures are like, recordings, motion blur."""

from __future__ import annotations

import math
from itertools import pairwise

import numpy as np
import pytest

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.recording.sequence import open_sequence
from polarmap.synth import DEFAULT_CAMERA, Sensor, built_in_scene, handheld_path, render, render_sequence
from polarmap.synth.path import Loop
from polarmap.synth.raycast import closest_hit, is_blocked, pack
from polarmap.synth.scene_recording import depth_scale_of, pinhole, record_scene
from polarmap.synth.scenes import SCENES
from polarmap.synth.shutter import shutter_poses

WHOLE = ("bare-room", "corridor", "table", "street")
SMALL = DEFAULT_CAMERA.scaled(0.2)
TINY = PinholeCamera(width=60, height=44, fx=45.0, fy=45.0, cx=29.5, cy=21.5)


@pytest.mark.parametrize("name", WHOLE)
def test_a_path_of_thousands_of_frames_stays_in_free_space(name):
    built_in = built_in_scene(name)
    packed = pack(built_in.scene, np.eye(4))
    rng = np.random.default_rng(0)
    directions = rng.normal(size=(40, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    for seed in range(2):
        _, poses = built_in.path(frames=3000, seed=seed)
        eyes = poses[::15, :3, 3]
        for a, b in pairwise(eyes):
            assert not is_blocked(packed, tuple(a), tuple(b - a), 1.0)  # never through a surface
        nearest = min(closest_hit(packed, tuple(e), tuple(d), math.inf)[1] for e in eyes for d in directions)
        assert nearest > 0.2
        assert np.linalg.norm(np.ptp(eyes, axis=0)) > 0.8


@pytest.mark.parametrize("name", WHOLE)
def test_the_view_along_a_path_has_something_near_and_far_in_it(name):
    built_in = built_in_scene(name)
    _, poses = built_in.path(frames=2000, seed=1)
    for pose in poses[::400]:
        depth = render(built_in.scene, SMALL, pose).depth
        assert np.nanmin(depth) > 0.3 and np.isfinite(depth).mean() > 0.85
        assert np.nanpercentile(depth, 90) > 1.5 * np.nanpercentile(depth, 5)
        assert np.nanmax(depth) < 65535 / built_in.depth_scale  # what a depth file holds


@pytest.mark.parametrize(("name", "most"), [("bare-room", 0.05), ("corridor", 0.07), ("table", 0.05), ("street", 0.07)])
def test_scenes_are_mostly_bare_weakly_polarized_and_well_exposed(name, most):
    built_in = built_in_scene(name)
    materials = built_in.scene.materials
    textured = [i for i, material in enumerate(materials) if material.texture]
    _, poses = built_in.path(frames=200)
    for pose in poses[::66]:
        view = render(built_in.scene, SMALL, pose, 2)
        dolp = np.hypot(view.stokes[1], view.stokes[2]) / view.stokes[0]
        assert 0.008 < np.median(dolp) < most
        assert 0.15 < np.percentile(dolp, 99) < 0.95  # glass and lacquer
        assert 0.02 < np.isin(view.material, textured).mean() < 0.4
        assert 0.1 < np.median(view.stokes[0]) / 2 < 0.6 and (view.stokes[0] > 2.0).mean() < 0.04
        assert 0.05 < (view.reflection == 2).mean() < 0.6
    assert len({material.eta for material in materials}) >= 3 and len({material.gloss for material in materials}) >= 4


def test_a_loop_is_as_wide_and_deep_as_it_says():
    for loop in (Loop(), Loop(sideways=0.3, forward=2.6, sway=0.01), Loop(sideways=2.0, forward=0.2, sway=0.01)):
        _, poses = handheld_path((0, 0, 0), (0, 9, 0), frames=2000, step=0.03, loop=loop)
        x, y = np.ptp(poses[:, 0, 3]), np.ptp(poses[:, 1, 3])
        assert x == pytest.approx(2 * loop.sideways, abs=0.16) and y == pytest.approx(2 * loop.forward, abs=0.16)
        steps = np.linalg.norm(np.diff(poses[:, :3, 3], axis=0), axis=1)
        assert np.median(steps) == pytest.approx(0.03, rel=0.01)
        assert steps.min() > 0.02 and steps.max() < 0.0301  # a chord of a tight turn is shorter than its arc


def test_a_target_that_follows_keeps_the_gaze_parallel():
    loop = Loop(gaze_drift=0.0, follow=1.0)
    _, poses = handheld_path((0, 0, 0), (0, 3, 0), frames=50, loop=loop)
    np.testing.assert_allclose(poses[:, :3, 2], np.tile([0.0, 1.0, 0.0], (50, 1)), atol=1e-9)


def test_a_loop_needs_half_axes():
    with pytest.raises(InputError, match="half axes"):
        Loop(sideways=0.0)


def frames_with(shutter: float, exposures: int = 8):
    built_in = built_in_scene("table")
    times, poses = built_in.path(frames=3, step=0.05)
    sensor = Sensor(bit_depth=16, noise=None, shutter=shutter)
    return list(render_sequence(built_in.scene, TINY, times, poses, sensor, 1, exposures)), poses


def test_motion_blur_is_the_mean_over_the_open_shutter():
    (_, sharp, _), _ = frames_with(0.0)
    (_, blurred, _), poses = frames_with(0.5, exposures=4)
    scene, sensor = built_in_scene("table").scene, Sensor(bit_depth=16, noise=None)
    views = [render(scene, TINY, pose).stokes for pose in shutter_poses(poses, 1, 0.5, 4)]
    np.testing.assert_array_equal(blurred.mosaic, sensor.capture(np.mean(views, axis=0)))
    assert np.abs(blurred.mosaic.astype(float) - sharp.mosaic).mean() > 100
    np.testing.assert_array_equal(blurred.truth.depth, sharp.truth.depth)
    np.testing.assert_array_equal(blurred.truth.stokes, sharp.truth.stokes)


def test_one_moment_of_the_shutter_is_its_middle():
    one, _ = frames_with(1.0, exposures=1)
    sharp, _ = frames_with(0.0)
    for a, b in zip(one, sharp, strict=True):
        np.testing.assert_array_equal(a.mosaic, b.mosaic)


def test_a_recorded_scene_reads_back_and_is_the_same_for_the_same_seeds(tmp_path):
    camera = pinhole(48, 36, 70.0)
    for name, seed in (("a", 1), ("b", 1), ("c", 2)):
        record_scene(tmp_path / name, "street", 2, camera, Sensor(seed=seed), path_seed=seed, supersample=1)
    sequence = open_sequence(tmp_path / "a")
    assert len(sequence) == 2 and sequence.camera_file.camera == camera
    assert sequence.camera_file.depth_scale == 1000.0
    depth = read_depth_png(tmp_path / "a" / "depth" / "000000.png", 1000.0)
    assert np.nanmax(depth) > 13.2
    a, b, c = ((tmp_path / name / "raw" / "000001.png").read_bytes() for name in "abc")
    assert a == b != c


def test_cameras_out_of_range_are_refused():
    camera = pinhole(640, 480, math.degrees(2 * math.atan(2 / 3)))
    assert (camera.cx, camera.cy) == (319.5, 239.5) and camera.fx == pytest.approx(480.0)
    for wrong in ((0, 480, 60.0), (640, 100000, 60.0), (640, 480, 180.0), (640, 480, math.nan)):
        with pytest.raises(InputError, match=r"image size|field of view"):
            pinhole(*wrong)


def test_the_scale_of_depth_files_leaves_room():
    assert depth_scale_of(np.array([3.0, np.nan])) == 5000.0
    assert depth_scale_of(np.array([20.0])) == 1000.0
    assert depth_scale_of(np.array([np.nan])) == 5000.0
    assert depth_scale_of(np.array([1e6])) == 200.0


def test_all_scenes_are_described():
    for name, (_, description) in SCENES.items():
        assert description, name
        assert built_in_scene(name).scene.primitives
