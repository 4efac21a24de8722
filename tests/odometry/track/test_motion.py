"""Guesses of a frame's motion: from the frames before, and from matched corners."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from odometry_scenes import CAMERA, FACTORY, inverse_depth_at, motion, pyramid_of, smooth_pixels

from polarmap.geometry.lie import se3_log
from polarmap.geometry.pose import inverse
from polarmap.odometry.track.motion import FeatureMatcher, usual_motions

HERE = motion(0, 0, 0, 0, 0, 0)


def test_the_first_guesses_go_on_go_twice_as_fast_and_stop():
    step = motion(0.1, 0.02, -0.05, 0.03, -0.02, 0.05)
    before = motion(0.3, 0.1, 0.0, 0.0, 0.2, 0.1)
    last = step @ before
    onward, twice, still, reference, *turns = usual_motions(last, before)
    np.testing.assert_allclose(onward, step @ step @ before, atol=1e-12)
    np.testing.assert_allclose(twice, step @ step @ step @ before, atol=1e-12)
    np.testing.assert_array_equal(still, last)
    np.testing.assert_array_equal(reference, np.eye(4))
    increments = np.array([se3_log(T @ inverse(onward)) for T in turns])
    assert np.abs(increments[:, :3]).max() < 1e-12
    sizes = np.linalg.norm(increments[:, 3:], axis=1)
    assert (np.diff(sizes) > -1e-9).all() and sizes[0] > 0.01
    for size in np.unique(sizes.round(6)):
        of_size = increments[np.abs(sizes - size) < 1e-6, 3:] / size
        expected = np.concatenate([np.eye(3), -np.eye(3)])
        assert {tuple(row) for row in of_size.round(6) + 0.0} == {tuple(row) for row in expected + 0.0}


@pytest.fixture(scope="module")
def matcher():
    matcher = FeatureMatcher(CAMERA)
    pixels = smooth_pixels(HERE, 600)
    matcher.set_reference(pyramid_of(HERE).levels[0], pixels.astype(np.float32), inverse_depth_at(HERE, pixels))
    return matcher


@pytest.mark.parametrize(
    "T",
    [HERE, motion(0.1, 0, 0.1, 0, 0.05, 0), motion(0.25, -0.1, 0.2, 0.08, -0.12, 0.1), motion(0, 0, 0, 0, 0, 0.8)],
    ids=["none", "small", "large", "roll"],
)
def test_matched_corners_give_the_motion(matcher, T):
    guesses = list(matcher.motions(pyramid_of(T, gain=1.3, noise=0.5).levels[0]))
    errors = [np.abs(se3_log(guess @ inverse(T))) for guess in guesses]
    best = min(errors, key=np.max)
    assert best[:3].max() < 0.04 and best[3:].max() < 0.015


def test_an_unrelated_or_blank_image_gives_no_motion(matcher):
    blank = FACTORY.make(np.full(CAMERA.shape, 0.5, np.float32))
    assert list(matcher.motions(blank.levels[0])) == []
    noise = cv2.GaussianBlur(np.random.default_rng(0).random(CAMERA.shape, dtype=np.float32), (0, 0), 2.0)
    for guess in matcher.motions(FACTORY.make(noise).levels[0]):
        assert np.isfinite(guess).all()


def test_without_a_reference_or_with_few_points_there_are_no_guesses():
    level = pyramid_of(HERE).levels[0]
    assert list(FeatureMatcher(CAMERA).motions(level)) == []
    matcher = FeatureMatcher(CAMERA)
    matcher.set_reference(level, np.full((5, 2), 50.0, np.float32), np.ones(5, np.float32))
    assert list(matcher.motions(level)) == []
