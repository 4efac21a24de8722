"""The built-in scenes: paths in free space, what the pictures are like, recordings, motion blur."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from polarmap.errors import InputError
from polarmap.evaluation.regions import is_curved, near_steps
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.recording.sequence import open_sequence
from polarmap.synth import DEFAULT_CAMERA, Sensor, built_in_scene, handheld_path, render, render_sequence
from polarmap.synth.path import Arc, Loop, arc_path
from polarmap.synth.raycast import closest_hit, is_blocked, pack
from polarmap.synth.scene_recording import depth_scale_of, pinhole, record_scene
from polarmap.synth.scenes import MATTE, SCENES
from polarmap.synth.scenes.objects import turned
from polarmap.synth.shutter import shutter_poses

WHOLE = ("bare-room", "corridor", "table", "things", "street")
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
        assert np.linalg.norm(np.ptp(eyes, axis=0)) > 1.5 * built_in.loop.sideways


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


SURROUNDINGS = ("wall", "floor", "print", "table cloth", "newspaper")
LENGTHS = {"hand-held": 200, "arc": 21}  # frames: about the loop, and from one end of the arc to the other


@pytest.mark.parametrize("kind", LENGTHS)
def test_the_things_are_curved_glossy_mostly_bare_and_in_sight(kind):
    built_in = built_in_scene("things")
    camera = pinhole(480, 360, built_in.fov_of(kind))
    materials = built_in.scene.materials
    bare = [i for i, material in enumerate(materials) if material.texture is None]
    things = [i for i, material in enumerate(materials) if material.name not in SURROUNDINGS]
    metals = [i for i, material in enumerate(materials) if material.is_metal]
    seen = set()
    _, poses = built_in.path(frames=LENGTHS[kind], kind=kind)
    for pose in poses[:: LENGTHS[kind] // 5]:
        view = render(built_in.scene, camera, pose)
        curved = is_curved(view.normal) & ~near_steps(view.depth)
        dolp = np.hypot(view.stokes[1], view.stokes[2]) / view.stokes[0]
        on_things = np.isin(view.material, things)
        assert 0.03 < curved.mean() < 0.5 and on_things[curved].mean() > 0.9
        assert np.isin(view.material, bare)[curved].mean() > 0.5  # where stereo sees nothing
        assert 0.1 < np.isin(view.material, bare).mean() < 0.8 and on_things.mean() > 0.1
        assert np.percentile(dolp[on_things], 90) > 0.1 and np.median(dolp[on_things]) < 0.15
        assert 0.1 < np.median(view.stokes[0]) / 2 < 0.6 and (view.stokes[0] > 2.0).mean() < 0.04
        assert np.isfinite(view.depth).all() and view.depth.max() < 65535 / built_in.depth_scale
        seen |= set(np.unique(view.material).tolist())
    assert seen >= set(things) and len(things) >= 12 and len(metals) == 2


def test_views_on_the_arc_stay_in_free_space_and_look_at_the_things_from_all_of_it():
    built_in = built_in_scene("things")
    arc, packed = built_in.arc, pack(built_in.scene, np.eye(4))
    axis_x, axis_y = arc.target[:2]
    radius = np.linalg.norm(np.subtract(arc.eye, arc.target)[:2])
    camera = pinhole(640, 480, arc.fov)
    for seed in range(3):
        _, poses = built_in.path(frames=300, seed=seed, kind="arc")
        eyes = poses[:, :3, 3]
        for a, b in pairwise(eyes):
            assert not is_blocked(packed, tuple(a), tuple(b - a), 1.0)
        x, y = eyes[:, 0] - axis_x, eyes[:, 1] - axis_y
        np.testing.assert_allclose(np.hypot(x, y), radius, atol=6 * arc.sway)
        assert np.degrees(np.ptp(np.arctan2(x, -y))) == pytest.approx(arc.angle, abs=5.0)
        towards = np.array([inverse(pose)[:3] @ [*arc.target, 1.0] for pose in poses])
        pixels = towards[:, :2] / towards[:, 2:] * camera.fx
        assert (towards[:, 2] > 0.5).all() and np.abs(pixels).max() < 120  # all near the middle of the image
        steps = np.linalg.norm(np.diff(eyes, axis=0), axis=1)
        assert np.median(steps) == pytest.approx(arc.step, rel=0.1)


ARC = Arc(eye=(0.0, -2.0, 1.0), target=(0.0, 0.0, 0.5), angle=60.0, step=math.pi / 15)  # 6 degrees a frame


def test_an_arc_goes_from_left_to_right_and_back():
    _, poses = arc_path(replace(ARC, sway=0.0, gaze_drift=0.0), frames=21)
    x, y, z = poses[:, :3, 3].T
    np.testing.assert_allclose(np.degrees(np.arctan2(x, -y)), [*range(-30, 31, 6), *range(24, -31, -6)], atol=1e-9)
    np.testing.assert_allclose(z, 1.0)
    towards = np.array([inverse(pose)[:3] @ [*ARC.target, 1.0] for pose in poses])
    np.testing.assert_allclose(towards, np.tile([0.0, 0.0, math.hypot(2.0, 0.5)], (21, 1)), atol=1e-9)


def test_an_arc_is_the_same_for_the_same_seed():
    one, again, other = (arc_path(ARC, frames=5, seed=seed)[1] for seed in (1, 1, 2))
    np.testing.assert_array_equal(one, again)
    assert np.abs(one[1:] - other[1:]).max() > 1e-3


@pytest.mark.parametrize(
    ("wrong", "words"),
    [({"angle": 0.0}, "angle"), ({"angle": 400.0}, "angle"), ({"eye": (0.0, 0.0, 3.0)}, "straight above")],
)
def test_an_arc_without_extent_is_refused(wrong, words):
    with pytest.raises(InputError, match=words):
        arc_path(replace(ARC, **wrong))
    with pytest.raises(InputError, match="arc: step"):
        arc_path(ARC, step=1e20)


def test_only_scenes_with_room_for_it_have_an_arc():
    with pytest.raises(InputError, match="no arc"):
        built_in_scene("corridor").path(kind="arc")


def test_a_turned_thing_has_the_outline_that_it_was_given():
    outline = ((0.0, 0.0), (0.02, 0.05), (0.06, 0.05), (0.1, 0.02), (0.12, 0.03))
    parts = turned(MATTE, (0.3, 0.1, 0.7), outline)
    middles = np.array([part.T_world_object[:3, 3] for part in parts])
    np.testing.assert_allclose(middles[:, :2], np.tile([0.3, 0.1], (len(parts), 1)))
    halves = np.array([part.height / 2 for part in parts])
    heights = np.concatenate([middles[:, 2] - halves, middles[-1:, 2] + halves[-1:]]) - 0.7
    radii = [*(part.bottom for part in parts), parts[-1].top]
    np.testing.assert_allclose(np.interp([h for h, _ in outline], heights, radii), [r for _, r in outline], atol=1e-6)
    for below, above in pairwise(parts):
        assert below.top == pytest.approx(above.bottom)
    sphere = turned(MATTE, (0.0, 0.0, 0.0), [(h, math.sqrt(h * (0.2 - h))) for h in np.linspace(0.0, 0.2, 9)])
    for part in sphere:
        h = part.T_world_object[2, 3]
        assert part.middle == pytest.approx(math.sqrt(h * (0.2 - h)), rel=0.02)


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
