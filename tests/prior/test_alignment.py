"""Alignment of relative inverse depth: exact under outliers, and honest about useless input."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.errors import InputError
from polarmap.prior.alignment import Verdict, align
from polarmap.prior.options import PriorOptions

SHAPE = (60, 80)


def relative_depth(seed: int = 0) -> np.ndarray:
    """A smooth random relative inverse depth with values from 0 to 1."""
    rng = np.random.default_rng(seed)
    y, x = np.mgrid[0:1:60j, 0:1:80j]
    waves = sum(
        rng.normal() * np.sin(rng.uniform(1, 6) * x + rng.uniform(1, 6) * y + rng.uniform(0, 6)) for _ in range(6)
    )
    return ((waves - waves.min()) / np.ptp(waves)).astype(np.float32)


def points_of(inverse_depth: np.ndarray, share: float = 0.2, seed: int = 1) -> np.ndarray:
    known = np.random.default_rng(seed).random(inverse_depth.shape) < share
    return np.where(known, 1.0 / inverse_depth, np.nan).astype(np.float32)


def with_outliers(points: np.ndarray, share: float, seed: int = 2) -> np.ndarray:
    rng = np.random.default_rng(seed)
    wrong = np.isfinite(points) & (rng.random(points.shape) < share)
    low, high = np.nanmin(points), np.nanmax(points)
    return np.where(wrong, rng.uniform(low, high, points.shape), points).astype(np.float32)


@pytest.mark.parametrize("outliers", [0.0, 0.3, 0.4])
def test_scale_and_offset_are_found_among_outliers(outliers):
    d = relative_depth()
    points = with_outliers(points_of(0.8 * d + 0.2), outliers)
    found = align(d, points, options=PriorOptions(min_rank_correlation=0.2))
    assert found.accepted, str(found)
    assert found.scale == pytest.approx(0.8, rel=0.03)
    assert found.offset == pytest.approx(0.2, rel=0.03)


@settings(max_examples=30, deadline=None)
@given(
    magnitude=st.floats(1e-3, 1e5),
    shift=st.floats(-10, 10),
    scale=st.floats(0.05, 5),
    offset=st.floats(0.05, 2),
)
def test_any_units_of_the_network_give_the_same_depth(magnitude, shift, scale, offset):
    d = relative_depth()
    truth = scale * d + offset
    relative = (magnitude * (d + shift)).astype(np.float32)
    found = align(relative, points_of(truth))
    assert found.accepted
    np.testing.assert_allclose(found.apply(relative), truth, rtol=5e-3)


def test_the_figures_say_how_good_the_fit_is():
    d = relative_depth()
    rng = np.random.default_rng(3)
    noisy = points_of((0.8 * d + 0.2) * np.exp(0.05 * rng.standard_normal(SHAPE)))
    found = align(d, noisy)
    assert found.residual == pytest.approx(0.6745 * 0.05, rel=0.15)  # the median of a Gaussian's absolute value
    assert 0.95 < found.rank_correlation < 1.0
    assert found.n_anchors == np.isfinite(noisy).sum()
    assert str(found).startswith("accepted (rank correlation 0.9")


@pytest.mark.parametrize(
    ("relative", "verdict"),
    [
        (np.full(SHAPE, 0.3, np.float32), Verdict.CONSTANT),
        (-relative_depth(), Verdict.INVERTED),
        (np.where(np.arange(80) < 45, np.nan, relative_depth()), Verdict.NOT_FINITE),
        (np.where(np.arange(80) < 45, np.inf, relative_depth()), Verdict.NOT_FINITE),
        (np.random.default_rng(7).random(SHAPE, np.float32), Verdict.POOR_FIT),
    ],
)
def test_a_useless_prior_is_rejected(relative, verdict):
    found = align(relative, points_of(0.8 * relative_depth() + 0.2))
    assert found.verdict is verdict
    assert not found.accepted
    assert verdict.value in str(found)


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf])
def test_pixels_without_depth_have_no_say(nothing):
    d = relative_depth()
    points = points_of(0.8 * d + 0.2)
    points[:20] *= 5.0
    relative = np.where(np.arange(60)[:, None] < 20, np.float32(nothing), d)
    found = align(relative, points)
    assert found.accepted and found.n_anchors == np.isfinite(points[20:]).sum()
    assert found.scale == pytest.approx(0.8, rel=1e-3)


def test_a_network_must_gain_at_points_held_out():
    found = align(relative_depth(), points_of(0.8 * relative_depth() + 0.2))
    assert found.judged(0.02, 0.03, 0.05).accepted
    rejected = found.judged(0.029, 0.03, 0.05)
    assert rejected.verdict is Verdict.NO_GAIN
    assert str(rejected).startswith("no better than the points (") and "held out 2.9 % against 3.0 %" in str(rejected)
    assert found.judged(np.nan, np.nan, 0.05).verdict is Verdict.TOO_FEW_ANCHORS


def test_too_few_anchors_are_said_to_be():
    points = np.full(SHAPE, np.nan, np.float32)
    points.ravel()[:: SHAPE[1] * 2] = 2.0
    found = align(relative_depth(), points)
    assert (found.verdict, found.n_anchors) == (Verdict.TOO_FEW_ANCHORS, 30)
    assert align(relative_depth(), np.full(SHAPE, np.nan, np.float32)).verdict is Verdict.TOO_FEW_ANCHORS


def test_a_flat_scene_says_nothing_about_the_order_of_depths():
    assert align(relative_depth(), np.full(SHAPE, 2.0, np.float32)).verdict is Verdict.POOR_FIT


def test_aligned_inverse_depth_is_positive():
    d = relative_depth()
    points = np.where(d > 0.5, 1.0 / (d - 0.4), np.nan).astype(np.float32)  # half of the image would be behind
    aligned = align(d, points)
    inverse_depth = aligned.apply(d)
    assert inverse_depth.min() > 0
    assert 2 * np.nanmax(points) < 1 / inverse_depth.min() < 8 * np.nanmax(points)


def test_points_without_confidence_have_no_say():
    d = relative_depth()
    points = points_of(0.8 * d + 0.2)
    wrong = np.isfinite(points) & (np.arange(SHAPE[1]) < 50)
    confidence = np.where(wrong, 0.0, 1.0).astype(np.float32)
    found = align(d, np.where(wrong, 0.5, points).astype(np.float32), confidence)
    assert found.scale == pytest.approx(0.8, rel=1e-3)


def test_anchors_are_spread_over_the_image_and_deterministic():
    d = np.kron(relative_depth(), np.ones((4, 4), np.float32))
    truth = 0.8 * d + 0.2
    points = np.full(d.shape, np.nan, np.float32)
    points[:, :40] = 1.0 / (1.3 * truth[:, :40])  # a dense corner, off by 30 %, must not outvote the rest
    points[::3, 40::3] = 1.0 / truth[::3, 40::3]
    first, second = align(d, points), align(d, points)
    assert first == second
    assert first.n_anchors == 2000
    assert first.scale == pytest.approx(0.8, rel=0.05)


def test_shapes_must_fit():
    with pytest.raises(InputError, match="differ in shape"):
        align(relative_depth(), np.ones((3, 4), np.float32))
    with pytest.raises(InputError, match="confidence"):
        align(relative_depth(), points_of(relative_depth() + 1), np.ones((3, 4), np.float32))
