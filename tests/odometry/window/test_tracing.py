"""Immature points are searched in frames of a rendered room whose depth is known."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, FACTORY, OPTIONS, image_of, inverse_depth_at, motion, pyramid_of, smooth_pixels

from polarmap.odometry.points import new_immature
from polarmap.odometry.window.residuals import GOOD, NONE
from polarmap.odometry.window.tracing import FOUND, GONE, MISMATCH, SETTLED, UNCLEAR, UNSEEN, refine_depths, trace
from polarmap.odometry.window.window import Window

HERE = motion(0, 0, 0, 0, 0, 0)
STEP = motion(0.03, 0.01, 0.01, 0.002, 0.004, 0.003)
LENGTH = 30.0  # pixels
PIXELS = smooth_pixels(HERE, 400)
TRUTH = inverse_depth_at(HERE, PIXELS)


def path(count: int) -> list[np.ndarray]:
    """T_camera_world, the first one step from the keyframe."""
    return [np.linalg.matrix_power(STEP, n + 1) for n in range(count)]


def new_window(pixels: np.ndarray = PIXELS, gain: float = 1.0) -> Window:
    window = Window(CAMERA, 4)
    level = pyramid_of(HERE, gain=gain).levels[0]
    window.add(0, level, HERE, np.array([np.log(gain), 0.0]))
    window.immature = new_immature(level, pixels, 0, OPTIONS.gradient_constant)
    return window


def search(window: Window, T: np.ndarray, level=None, gain: float = 1.0) -> None:
    level = pyramid_of(T, gain=gain).levels[0] if level is None else level
    trace(window.immature, level, window.projection_to(T, np.array([np.log(gain), 0.0]), 1.0), OPTIONS.huber, LENGTH)


def known(immature) -> np.ndarray:
    return np.isin(immature.status, (FOUND, SETTLED, UNCLEAR)) & np.isfinite(immature.highest)


def relative_errors(immature, truth: np.ndarray = TRUTH) -> np.ndarray:
    return np.abs(0.5 * (immature.lowest + immature.highest) / truth - 1)


def test_intervals_close_in_on_the_truth():
    window = new_window()
    immature = window.immature
    assert (immature.status == UNSEEN).all()
    widths, errors = [], []
    for number, T in enumerate(path(10)):
        search(window, T)
        if number in (0, 3, 9):
            use = known(immature)
            inside = (immature.lowest <= TRUTH * 1.01) & (immature.highest >= TRUTH * 0.99)
            assert use.mean() > 0.7
            assert inside[use].mean() > 0.9
            widths.append(np.median((immature.highest - immature.lowest)[use] / TRUTH[use]))
            errors.append(np.median(relative_errors(immature)[use]))
    assert widths[0] > 2.5 * widths[1] > 5 * widths[2]
    assert errors[0] > errors[2] and errors[2] < 0.01


@pytest.mark.parametrize(
    "T",
    [
        motion(0, 0, 0.3, 0, 0, 0),
        motion(0, -0.15, 0, 0, 0, 0.1),
        motion(-0.1, 0.1, 0, 0.1, 0, 0),
        motion(0.2, 0.2, 0, 0, 0, 1.5),  # the pattern turns with the image
    ],
)
def test_every_direction_of_motion_gives_depth(T):
    window = new_window()
    for share in (0.3, 0.6, 1.0):
        step = T.copy()
        step[:3, 3] *= share
        search(window, step)
    use = known(window.immature)
    assert use.mean() > 0.5
    assert np.median(relative_errors(window.immature)[use]) < 0.03


@pytest.mark.parametrize("gain", [0.5, 2.0])
def test_a_known_change_of_brightness_does_not_matter(gain):
    window = new_window(gain=0.8)
    for T in path(6):
        search(window, T, gain=gain)
    use = known(window.immature)
    assert use.mean() > 0.75
    assert np.median(relative_errors(window.immature)[use]) < 0.02


def test_without_parallax_nothing_is_learnt():
    window = new_window()
    search(window, motion(0, 0, 0, 0.01, -0.02, 0.05))
    assert np.isin(window.immature.status, (UNSEEN, GONE)).all()
    assert (window.immature.status == UNSEEN).mean() > 0.8
    assert np.isnan(window.immature.highest).all() and not window.immature.lowest.any()


def test_an_occluded_point_is_not_accepted_and_given_up_the_second_time():
    window = new_window()
    immature = window.immature
    for T in path(4):
        search(window, T)
    before, was_known = immature.select(np.arange(len(immature))), known(immature)
    occluder = image_of(path(5)[-1]).copy()
    hidden = PIXELS[:, 0] < CAMERA.width // 2 - 20
    occluder[:, : CAMERA.width // 2] = 0.95  # moving points stay well on their side
    level = FACTORY.make(occluder).levels[0]
    search(window, path(5)[-1], level)
    searched = hidden & was_known & (immature.status != SETTLED) & (immature.status != UNCLEAR)
    assert np.count_nonzero(searched) > 50
    assert np.isin(immature.status[searched], (MISMATCH, GONE)).all()
    np.testing.assert_array_equal(immature.lowest[searched], before.lowest[searched])
    np.testing.assert_array_equal(immature.highest[searched], before.highest[searched])
    mismatched = searched & (immature.status == MISMATCH)
    assert np.count_nonzero(mismatched) > 50
    search(window, path(5)[-1], level)
    assert (immature.status[mismatched] == GONE).all()
    lowest = immature.lowest.copy()
    search(window, path(6)[-1])
    assert (immature.status[mismatched] == GONE).all()
    np.testing.assert_array_equal(immature.lowest[mismatched], lowest[mismatched])


def test_one_mismatch_is_forgiven():
    window = new_window()
    for T in path(3):
        search(window, T)
    search(window, path(4)[-1], FACTORY.make(np.full(CAMERA.shape, 0.95, np.float32)).levels[0])
    mismatched = window.immature.status == MISMATCH
    assert np.count_nonzero(mismatched) > 100
    search(window, path(5)[-1])
    assert np.isin(window.immature.status[mismatched], (FOUND, SETTLED, UNCLEAR)).mean() > 0.9


def test_immature_points_that_leave_the_view_are_given_up():
    window = new_window()
    search(window, path(1)[0])
    turned = motion(0, 0, 0, 0, 0.35, 0) @ path(2)[-1]
    search(window, turned)
    projection = window.projection_to(turned, np.zeros(2), 1.0)
    rays = np.column_stack([PIXELS, np.ones(len(PIXELS))])
    p = rays @ projection.KRKi[0].T + TRUTH[:, None] * projection.Kt[0]
    u = p[:, 0] / p[:, 2]
    outside = (u < -5) | (u > CAMERA.width + 4)
    assert np.count_nonzero(outside) > 50
    assert (window.immature.status[outside] == GONE).all()


def test_a_repeated_pattern_lowers_the_quality():
    """Stripes across the motion, each like its neighbour, against the room's random paper."""
    u = np.arange(CAMERA.width) + np.zeros((CAMERA.height, 1))
    stripes = FACTORY.make((0.5 + 0.3 * np.sin(2 * np.pi * u / 8)).astype(np.float32)).levels[0]
    pixels = np.stack(np.meshgrid(np.arange(60, 180, 7), np.arange(20, 160, 9)), -1).reshape(-1, 2)
    window = Window(CAMERA, 4)
    window.add(0, stripes, HERE, np.zeros(2))
    window.immature = new_immature(stripes, pixels, 0, OPTIONS.gradient_constant)
    search(window, motion(0.05, 0, 0, 0, 0, 0), stripes)
    room = new_window()
    search(room, motion(0.05, 0, 0, 0, 0, 0))
    assert np.median(window.immature.quality) < 2.0 < np.median(room.immature.quality)


def test_an_edge_along_the_epipolar_line_stays_unclear():
    """Where gradients lie across the motion, a match says little of depth."""
    v = np.arange(CAMERA.height)[:, None] + np.zeros(CAMERA.width)
    level = FACTORY.make((0.5 + 0.3 * np.tanh(v - 90)).astype(np.float32)).levels[0]
    pixels = np.stack([np.arange(60, 180, 5), np.full(24, 90)], axis=1)
    window = Window(CAMERA, 4)
    window.add(0, level, HERE, np.zeros(2))
    window.immature = new_immature(level, pixels, 0, OPTIONS.gradient_constant)
    for x in (0.05, 0.08):
        search(window, motion(x, 0, 0, 0, 0, 0), level)
    certain = np.isin(window.immature.status, (FOUND, SETTLED)) & (window.immature.length < 4)
    assert not certain.any()


class TestRefinement:
    """Inverse depths over several keyframes, before points become active."""

    targets = (motion(0.12, 0.02, 0.04, 0, 0.02, 0), motion(0.2, -0.06, -0.1, 0.01, 0.03, 0.02))

    def refined(self, start, color=None, gain: float = 1.0):
        window = new_window()
        for index, T in enumerate(self.targets):
            window.add(index + 1, pyramid_of(T, gain=gain).levels[0], T, np.array([np.log(gain), 0.0]))
        immature, pairs = window.immature, window.pairs()
        return refine_depths(
            window.images, np.array([0, 1, 2]), immature.host, immature.pixel,
            immature.color if color is None else color, immature.weight, start.astype(np.float32), pairs.KRKi,
            pairs.Kt, pairs.gain, pairs.offset, np.float32(OPTIONS.huber), np.float32(OPTIONS.gradient_constant**2),
            np.float32(8 * 12.0**2),
        )  # fmt: skip

    @pytest.mark.parametrize("gain", [1.0, 0.5, 1.8])
    def test_depths_settle_on_the_truth(self, gain):
        start = TRUTH * np.random.default_rng(0).uniform(0.97, 1.03, len(TRUTH))
        depth, information, state = self.refined(start, gain=gain)
        use = np.isfinite(depth)
        assert use.mean() > 0.9
        assert np.median(np.abs(start / TRUTH - 1)) > 0.012
        assert np.median(np.abs(depth[use] / TRUTH[use] - 1)) < 0.004
        assert (information[use] > 0).all()
        assert not state[:, [0, 3]].any()  # the host, and a slot without keyframe
        assert (state[use] == GOOD).any(axis=1).all()

    def test_information_tells_how_well_a_depth_is_known(self):
        start = TRUTH * np.random.default_rng(0).uniform(0.97, 1.03, len(TRUTH))
        depth, information, _ = self.refined(start)
        order = np.argsort(np.where(np.isfinite(depth), information, np.inf))[: np.count_nonzero(np.isfinite(depth))]
        error = np.abs(depth - TRUTH)[order]
        quarter = len(order) // 4
        assert np.median(error[-quarter:]) < 0.6 * np.median(error[:quarter])

    def test_what_does_not_fit_does_not_settle(self):
        color = np.random.default_rng(0).uniform(0, 255, (len(PIXELS), 8)).astype(np.float32)
        depth, _, state = self.refined(TRUTH, color)
        assert np.isnan(depth).mean() > 0.98
        assert (state[np.isnan(depth)] == NONE).all()
