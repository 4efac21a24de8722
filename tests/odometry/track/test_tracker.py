"""Alignment of frames of a rendered room to a keyframe with known depths, and what is refused."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, FACTORY, OPTIONS, image_of, inverse_depth_at, motion, pyramid_of, smooth_pixels

from polarmap.geometry.lie import se3_log
from polarmap.geometry.pose import inverse
from polarmap.odometry.local_map import LocalMap
from polarmap.odometry.records import PointArchive
from polarmap.odometry.start.direct import Start
from polarmap.odometry.start.starter import WaitingFrame
from polarmap.odometry.track.motion import FeatureMatcher, usual_motions
from polarmap.odometry.track.tracker import Tracker

HERE = motion(0, 0, 0, 0, 0, 0)
SMALL = motion(0.05, -0.03, 0.06, 0.01, -0.02, 0.015)
LARGE = motion(0.3, 0.1, 0.25, 0.06, -0.08, 0.1)
PIXELS = smooth_pixels(HERE, 600)


@pytest.fixture(scope="module")
def tracker() -> Tracker:
    return new_tracker(PIXELS)


def new_tracker(pixels: np.ndarray, reference=None) -> Tracker:
    tracker = Tracker(FACTORY.cameras, OPTIONS.huber)
    depth = inverse_depth_at(HERE, pixels)
    tracker.set_reference(reference or pyramid_of(HERE), pixels.astype(np.float32), depth, np.ones_like(depth))
    return tracker


def aligned(tracker: Tracker, pyramid, guesses=(HERE,), gain: float = 1.0, usual_rms: float = 2.0):
    return tracker.align(pyramid, list(guesses), gain, 0.0, usual_rms)


def error(found, truth) -> tuple[float, float]:
    """Position in metres, rotation in radians."""
    xi = se3_log(found.T_frame_reference @ inverse(truth))
    return float(np.linalg.norm(xi[:3])), float(np.linalg.norm(xi[3:]))


@pytest.mark.parametrize(
    "T",
    [
        HERE,
        motion(1e-4, 0, 0, 0, 0, 0),
        motion(0.03, 0, 0, 0, 0, 0),
        motion(0, 0, 0.06, 0, 0, 0),
        motion(0, 0, 0, 0.02, 0.02, 0),
        motion(0, 0, 0, 0, 0, 0.05),
        SMALL,
    ],
    ids=["none", "tiny", "sideways", "forward", "turn", "roll", "all"],
)
def test_a_small_motion_is_found_from_standstill(tracker, T):
    found = aligned(tracker, pyramid_of(T))
    position, rotation = error(found, T)
    assert position < 1.5e-3 and rotation < 6e-4
    assert found.rms < 5.0 and found.inliers > 0.95
    assert found.gain == pytest.approx(1.0, abs=0.01) and abs(found.offset) < 0.3


def test_a_large_motion_is_found_from_the_guess_that_is_near(tracker):
    """Neither standstill nor the other wrong guesses lead there."""
    near = motion(0.02, -0.02, 0.02, 0.01, 0.01, -0.01) @ LARGE
    wrong = [HERE, motion(-0.2, 0, 0, 0, 0.1, 0), motion(0, 0, -0.3, 0, 0, -0.3)]
    pyramid = pyramid_of(LARGE)
    alone = aligned(tracker, pyramid, wrong)
    assert alone is None or error(alone, LARGE)[0] > 0.02
    found = aligned(tracker, pyramid, [*wrong, near])
    position, rotation = error(found, LARGE)
    assert position < 3e-3 and rotation < 1.5e-3


def test_a_motion_that_goes_on_is_found_though_it_is_large(tracker):
    step = motion(0.1, 0.03, 0.08, 0.02, -0.03, 0.03)
    last = step @ step
    found = aligned(tracker, pyramid_of(step @ last), usual_motions(last, step))
    assert error(found, step @ last)[0] < 3e-3


def test_a_jump_is_found_by_matched_corners(tracker):
    matcher = FeatureMatcher(CAMERA)
    matcher.set_reference(pyramid_of(HERE).levels[0], PIXELS.astype(np.float32), inverse_depth_at(HERE, PIXELS))
    pyramid = pyramid_of(LARGE, noise=1.0)
    found = aligned(tracker, pyramid, matcher.motions(pyramid.levels[0]))
    assert error(found, LARGE)[0] < 4e-3


def test_no_more_guesses_are_tried_than_it_takes(tracker):
    tried = []

    def guesses():
        for T in (SMALL, HERE, LARGE):
            tried.append(T)
            yield T

    tracker.align(pyramid_of(SMALL), guesses(), 1.0, 0.0, usual_rms=5.0)
    assert len(tried) == 1
    tracker.align(pyramid_of(SMALL), guesses(), 1.0, 0.0, usual_rms=0.0)
    assert len(tried) == 4


@pytest.mark.parametrize("gain", [0.5, 0.8, 1.25, 2.0])
def test_a_change_of_exposure_is_found(tracker, gain):
    pyramid = pyramid_of(SMALL, gain=gain)
    for expected in (1.0, gain):
        found = aligned(tracker, pyramid, gain=expected)
        position, rotation = error(found, SMALL)
        assert position < 2.5e-3 and rotation < 1e-3
        assert found.gain == pytest.approx(gain, rel=0.02) and abs(found.offset) < 1.5


def test_flow_is_how_far_pixels_move(tracker):
    tracker = new_tracker(PIXELS[:: len(PIXELS) // 100])
    for T in (SMALL, motion(0, 0, 0, 0.02, -0.03, 0.02), motion(0.06, 0, 0, 0, 0, 0)):
        found = aligned(tracker, pyramid_of(T))
        points, K = tracker._points[0].astype(float), CAMERA.matrix
        rays = np.column_stack([points[:, :2], np.ones(len(points))]) @ np.linalg.inv(K).T
        for R, value in ((T[:3, :3], found.flow), (np.eye(3), found.translation_flow)):
            p = (rays @ R.T + points[:, 2:3] * T[:3, 3]) @ K.T
            expected = np.sqrt(np.mean(np.sum((p[:, :2] / p[:, 2:] - points[:, :2]) ** 2, axis=1)))
            assert value == pytest.approx(expected, rel=0.02, abs=0.05)


def test_only_points_in_view_count(tracker):
    T = motion(-1.0, 0, 0, 0, 0, 0)  # about a fifth of the image goes out of view
    found = aligned(tracker, pyramid_of(T), [T])
    points, K = tracker._points[0].astype(float), CAMERA.matrix
    p = np.column_stack([points[:, :2], np.ones(len(points))]) + points[:, 2:3] * (K @ T[:3, 3])
    u = p[:, 0] / p[:, 2]
    expected = ((u > 2) & (u < CAMERA.width - 2)).mean()
    assert 0.4 < expected < 0.95
    assert found.seen == pytest.approx(expected, abs=0.02)
    assert found.count == round(found.seen * len(points))
    assert aligned(tracker, pyramid_of(T), [motion(-20.0, 0, 0, 0, 0, 0)]) is None


def test_uncertainty_grows_with_noise_and_bounds_the_error():
    found, errors = [], []
    for noise in (1.0, 4.0):
        tracker = new_tracker(PIXELS, pyramid_of(HERE, noise=noise, seed=1))
        alignment = aligned(tracker, pyramid_of(SMALL, noise=noise, seed=2))
        K = CAMERA.matrix
        rays = np.column_stack([PIXELS, np.ones(len(PIXELS))]) @ np.linalg.inv(K).T
        pixels = []
        for T in (alignment.T_frame_reference, SMALL):
            p = (rays @ T[:3, :3].T + inverse_depth_at(HERE, PIXELS)[:, None] * T[:3, 3]) @ K.T
            pixels.append(p[:, :2] / p[:, 2:])
        errors.append(np.median(np.linalg.norm(pixels[0] - pixels[1], axis=1)))
        found.append(alignment.uncertainty)
    assert 1.5 < found[1] / found[0] < 8.0
    assert found[1] < 0.3
    assert all(e < 6 * u for e, u in zip(errors, found, strict=True)), (errors, found)


def test_uncertainty_is_infinite_where_images_say_nothing(tracker):
    blank = FACTORY.make(np.full(CAMERA.shape, 0.4, np.float32))
    found = aligned(tracker, blank)
    assert found is None or not found.uncertainty < 1.0 or found.inliers < 0.6


def test_stripes_leave_the_motion_along_them_uncertain():
    u = np.arange(CAMERA.width) + np.zeros((CAMERA.height, 1))
    stripes = FACTORY.make((0.5 + 0.3 * np.sin(u / 4)).astype(np.float32))
    pixels = np.stack(np.meshgrid(np.arange(20, 220, 7), np.arange(20, 160, 7)), -1).reshape(-1, 2)
    found = aligned(new_tracker(pixels, stripes), stripes)
    assert found is None or not found.uncertainty < 1.0


def test_wrong_depths_of_little_weight_do_not_steer():
    """Points at one pixel are averaged by weight."""
    depth = inverse_depth_at(HERE, PIXELS)
    pixels = np.concatenate([PIXELS, PIXELS]).astype(np.float32)
    tracker = Tracker(FACTORY.cameras, OPTIONS.huber)
    weights = np.concatenate([np.ones_like(depth), np.full_like(depth, 1e-3)])
    tracker.set_reference(pyramid_of(HERE), pixels, np.concatenate([depth, 5 * depth]), weights)
    assert error(aligned(tracker, pyramid_of(SMALL)), SMALL)[0] < 2e-3


class TestLocalMap:
    """A map that begins with the true motion and depths of two frames."""

    @pytest.fixture
    def local(self) -> LocalMap:
        second = motion(0.1, 0.02, 0.03, 0.0, 0.02, 0.0)
        pixels = smooth_pixels(HERE, 800)
        start = Start(second, 1.0, 0.0, pixels.astype(np.float32), inverse_depth_at(HERE, pixels))
        local = LocalMap(CAMERA, OPTIONS, FACTORY, PointArchive(), segment=0)
        frames = [WaitingFrame(n, float(n), image_of(T), 1.0) for n, T in enumerate((HERE, second))]
        records = local.begin(start, frames[0], frames[1], FACTORY.make(frames[1].image))
        assert [record.index for record in records] == [0, 1]
        local.settle([], last=True)
        return local

    def test_the_next_frame_is_tracked(self, local):
        T = motion(0.15, 0.03, 0.05, 0.0, 0.03, 0.0)
        found, problem = local.track(pyramid_of(T), 1.0)
        assert problem == ""
        record = local.take(found, 2, 2.0, 1.0)
        xi = se3_log(inverse(record.T_world_camera) @ inverse(T))
        assert np.abs(xi).max() < 0.01  # of the map's scale, which two views know by a hundredth

    def test_a_frame_with_another_exposure_is_tracked(self, local):
        T = motion(0.15, 0.03, 0.05, 0.0, 0.03, 0.0)
        for gain, exposure in ((2.0, 2.0), (0.5, 0.5), (1.6, 1.0), (0.6, 1.0)):
            found, problem = local.track(pyramid_of(T, gain=gain), exposure)
            assert problem == "", gain
            assert found.gain == pytest.approx(gain, rel=0.05)

    def test_a_large_change_of_brightness_is_believed_only_where_exposure_tells_it(self, local):
        pyramid = pyramid_of(motion(0.15, 0.03, 0.05, 0.0, 0.03, 0.0), gain=0.125)
        assert local.track(pyramid, exposure=0.125)[1] == ""
        found, problem = local.track(pyramid, exposure=1.0)
        assert found is None and "brightness" in problem

    @pytest.mark.parametrize("level", [0.0, 0.2, 1.0])
    def test_a_blank_image_is_refused(self, local, level):
        found, problem = local.track(FACTORY.make(np.full(CAMERA.shape, level, np.float32)), 1.0)
        assert found is None and problem

    def test_another_picture_is_refused(self, local):
        other = np.clip(0.25 + 0.1 * np.random.default_rng(0).standard_normal(CAMERA.shape), 0, 1).astype(np.float32)
        found, problem = local.track(FACTORY.make(other), 1.0)
        assert found is None and problem

    def test_a_view_beside_the_map_is_refused(self, local):
        found, problem = local.track(pyramid_of(motion(0, 0, 0, 0, 2.5, 0)), 1.0)
        assert found is None and problem
        assert local.track(pyramid_of(motion(0.12, 0.02, 0.04, 0, 0.02, 0)), 1.0)[1] == ""

    def test_keyframes_are_wanted_once_the_view_has_changed(self, local):
        near, far = motion(0.105, 0.02, 0.03, 0.0, 0.02, 0.0), motion(0.35, 0.05, 0.1, 0.0, 0.08, 0.0)
        assert not local.wants_keyframe(self.taken(local, near, 2))
        assert local.wants_keyframe(self.taken(local, far, 3))

    def test_a_new_keyframe_finds_more_points_where_they_are(self, local):
        for number in range(2, 8):
            T = motion(0.05 * number, 0.02 + 0.01 * number, 0.03, 0.0, 0.01 * number, 0.0)
            pyramid = pyramid_of(T)
            found, _ = local.track(pyramid, 1.0)
            frame = local.take(found, number, float(number), 1.0)
            sighting = local.sighting(frame, found, 1.0)
            local.back_end.trace(pyramid, sighting)
            if number % 2:
                record = local.begin_keyframe(frame)
                local.adopt(local.back_end.add_keyframe(pyramid, sighting, record), frame, record)
        points = local.back_end.archived().points(CAMERA)
        assert set(np.unique(points.host)) >= {0, 1, 3}
        poses = {0: HERE, 1: motion(0.1, 0.02, 0.03, 0.0, 0.02, 0.0)}
        for host, T in poses.items():
            own = points.host == host
            truth = inverse_depth_at(T, points.pixel[own].astype(int))
            ratio = points.inverse_depth[own] / truth
            scale = np.median(ratio)
            assert np.count_nonzero(own) > 60
            assert np.median(np.abs(ratio / scale - 1)) < 0.02

    def taken(self, local, T, number):
        found, _ = local.track(pyramid_of(T), 1.0)
        local.take(found, number, float(number), 1.0)
        return found
