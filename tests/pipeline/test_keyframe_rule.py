"""DSO's keyframe rule on motions whose flow is known."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import TEXTURED, moved, pixel_rays, stereo_views, turned

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.odometry.keyframe_rule import ViewChange
from polarmap.pipeline.keyframe_rule import sample_points, view_change
from polarmap.pipeline.options import KeyframeOptions
from polarmap.synth import scenes

CAMERA = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
GREY = np.full(CAMERA.shape, 0.4, np.float32)
WALL = sample_points(np.full(CAMERA.shape, 2.0, np.float32), CAMERA)
STILL = np.eye(4)


def change(T_image_keyframe, image=GREY, points=WALL, keyframe_image=GREY):
    return view_change(keyframe_image, image, T_image_keyframe, CAMERA, points)


def test_nothing_changes_where_nothing_moves():
    assert change(STILL) == ViewChange(flow=0.0, translation_flow=pytest.approx(0.0, abs=1e-9), brightness=0.0)


def test_a_shift_before_a_wall_moves_every_point_alike():
    """0.1 m at 2 m is 6 pixels."""
    found = change(moved(-0.1))
    assert found.flow == pytest.approx(6.0) and found.translation_flow == pytest.approx(6.0)


def test_a_pure_turn_has_no_flow_without_rotation():
    found = change(turned((0.0, 0.05, 0.0)))
    assert found.flow == pytest.approx(120 * np.tan(0.05), rel=0.15)
    assert found.translation_flow == pytest.approx(0.0, abs=1e-6)


def test_a_roll_turns_pixels_about_the_centre():
    found = change(turned((0.0, 0.0, 0.1)))
    assert 2.0 < found.flow < 10.0 and found.translation_flow < 1e-6


def test_a_turn_that_undoes_the_shift_leaves_its_translation():
    T = turned((0.0, 0.05, 0.0)) @ moved(-0.1)
    assert change(T).flow < 1.0
    assert change(T).translation_flow == pytest.approx(6.0, rel=0.01)


def test_flow_is_the_root_mean_square_of_the_shorter_nine_tenths():
    depth = np.random.default_rng(0).uniform(1.0, 4.0, CAMERA.shape).astype(np.float32)
    points = sample_points(depth, CAMERA)
    shift, u = 120 * 0.05 / points[:, 2], 79.5 + 120 * points[:, 0] / points[:, 2]
    lengths = np.sort(shift[u >= shift])
    expected = np.sqrt(np.mean(lengths[: int(0.9 * lengths.size)] ** 2))
    found = change(moved(-0.05), points=points)
    assert found.flow == pytest.approx(expected, rel=0.01) and expected < 0.97 * np.sqrt(np.mean(lengths**2))


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_brightness_is_the_logarithm_of_the_ratio(factor):
    found = change(STILL, image=GREY * factor)
    assert found.brightness == pytest.approx(np.log(2.0), rel=1e-4)
    assert found.flow == 0.0


def test_brightness_is_compared_where_the_points_went():
    ramp = np.broadcast_to(np.exp(np.arange(160) / 100), CAMERA.shape).astype(np.float32) / 10
    assert change(moved(-0.1), image=ramp, keyframe_image=np.roll(ramp, 0)).brightness == pytest.approx(0.06, abs=0.01)
    shifted = ramp * np.float32(np.exp(0.06))  # the picture that moved by 6 pixels with the points
    assert change(moved(-0.1), image=shifted, keyframe_image=ramp).brightness < 0.01


def test_darkness_that_stays_is_no_change():
    assert change(STILL, image=0 * GREY, keyframe_image=0 * GREY).brightness == 0.0


def test_the_rule_is_dsos():
    found = ViewChange(flow=10.0, translation_flow=15.0, brightness=0.05)
    vga = PinholeCamera(640, 480, 500.0, 500.0, 320.0, 240.0)
    assert found.score(vga, KeyframeOptions()) == pytest.approx(0.02 * 10 + 0.04 * 15 + 2 * 0.05)
    options = KeyframeOptions(flow_weight=0.0, translation_weight=0.1, brightness_weight=1.0)
    assert found.score(vga, options) == pytest.approx(1.55)


def test_the_rule_does_not_depend_on_the_resolution():
    scores = []
    for factor in (1.0, 2.0):
        camera = CAMERA.scaled(factor)
        points = sample_points(np.full(camera.shape, 2.0, np.float32), camera)
        grey = np.full(camera.shape, 0.4, np.float32)
        scores.append(view_change(grey, grey, moved(-0.1), camera, points).score(camera, KeyframeOptions()))
    assert scores[0] == pytest.approx(scores[1], rel=1e-3)
    assert scores[0] == pytest.approx(0.06 * 24)  # 6 of 160 pixels are 24 of 640


def test_views_that_share_too_little_give_none():
    assert change(turned((0.0, 1.5, 0.0))) is None
    assert change(turned((0.0, np.pi, 0.0))) is None


def test_few_points_do_not_count_as_known_depth():
    """A bare picture without depth has nothing to follow: only what the rotation does is known."""
    assert change(STILL, points=WALL[:5]).flow == 0.0
    assert change(STILL, points=None).flow == 0.0


def test_a_bare_picture_that_only_turns_moves_as_its_rotation_says():
    bare = change(turned((0.0, 0.05, 0.0)), points=None)
    assert bare.flow == pytest.approx(change(turned((0.0, 0.05, 0.0))).flow, rel=0.1)
    assert bare.translation_flow == pytest.approx(0.0, abs=1e-6)
    assert change(turned((0.0, 1.5, 0.0)), points=None) is None


@pytest.mark.parametrize("points", [None, np.empty((0, 3))])
def test_without_depth_corners_are_followed(points):
    """As far as tracking goes: the flow of a textured plane to a tenth."""
    T_world_image = turned((0.0, 0.02, 0.01), (0.08, 0.02, 0.0))
    truth, (first, second) = stereo_views(scenes.plane(TEXTURED), CAMERA, [STILL, T_world_image])
    T = inverse(T_world_image)
    known = sample_points(truth.depth, CAMERA)
    expected = view_change(first.image.intensity, second.image.intensity, T, CAMERA, known)
    tracked = view_change(first.image.intensity, second.image.intensity, T, CAMERA, points)
    assert tracked.flow == pytest.approx(expected.flow, rel=0.1)
    assert tracked.translation_flow == pytest.approx(expected.translation_flow, rel=0.1)
    assert tracked.brightness < 0.1
    assert expected.flow > 1.5 and abs(expected.flow - expected.translation_flow) > 0.5


def test_sampled_points_are_those_of_the_depth_map():
    depth = np.full(CAMERA.shape, np.nan, np.float32)
    depth[3:5, 10:40] = 1.5
    points = sample_points(depth, CAMERA)
    np.testing.assert_allclose(points, (pixel_rays(CAMERA) * 1.5)[3:5, 10:40].reshape(-1, 3), atol=1e-6)
    assert 600 <= len(WALL) < 1200 and np.ptp(WALL[:, 1]) > 1.9
    assert sample_points(np.full(CAMERA.shape, np.nan, np.float32), CAMERA).shape == (0, 3)


def test_negative_weights_are_refused():
    with pytest.raises(InputError, match="flow_weight"):
        KeyframeOptions(flow_weight=-0.1)
