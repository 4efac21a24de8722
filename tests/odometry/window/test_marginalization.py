"""Variables that leave: what remains must know as much as if they had stayed."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import OPTIONS, motion, room_window

from polarmap.geometry.lie import adjoint
from polarmap.odometry.window.adjustment import _solve, total_prior
from polarmap.odometry.window.marginalization import eliminate, marginalize_keyframe, marginalize_points
from polarmap.odometry.window.residuals import CALIBRATION, FRAME, NONE, linearize

POSES = (
    motion(0, 0, 0, 0, 0, 0),
    motion(0.12, 0.0, 0.02, 0, 0.02, 0),
    motion(0.2, 0.05, -0.05, 0.01, 0.03, 0.01),
    motion(0.3, -0.04, 0.05, -0.02, 0.05, 0.0),
)
NEVER = 1e20  # energy of an outlier


def quadratic(size: int, seed: int, rank: int | None = None):
    """H and b of residuals A x + c, which need not determine x."""
    rng = np.random.default_rng(seed)
    A, c = rng.normal(size=(rank or 2 * size, size)) * np.geomspace(1e-3, 1e3, size), rng.normal(size=rank or 2 * size)
    return A.T @ A, A.T @ c


def slots(*numbers: int) -> np.ndarray:
    return np.concatenate([np.arange(FRAME) + CALIBRATION + FRAME * n for n in numbers])


def displaced_window():
    """A window whose state is away from its first estimate and from the truth, brightness too."""
    window = room_window(POSES, count=60)
    rng = np.random.default_rng(1)
    for keyframe in window.keyframes:
        keyframe.affine_first = rng.normal(size=2) * [0.02, 0.3]
        keyframe.affine = keyframe.affine_first + rng.normal(size=2) * [0.02, 0.3]
        if keyframe.slot:
            keyframe.step = rng.normal(size=6) * 2e-3
    window.points.inverse_depth *= rng.uniform(0.98, 1.02, len(window.points)).astype(np.float32)
    keep_known(window)
    return window


def keep_known(window) -> None:
    """Drop the points that no residual in view says anything of."""
    window.points = window.points.select(evaluated(window).depth_hessian > 1.0)


def whole_system(window):
    """Normal equations, float64, of all keyframes' variables and then all inverse depths, the prior included."""
    found = evaluated(window)
    prior_H, prior_b = total_prior(window, OPTIONS)
    frames = slots(*(k.slot for k in window.keyframes))
    coupling = found.coupling[:, frames].astype(float)
    H = np.block([[(found.H + prior_H)[np.ix_(frames, frames)], coupling.T], [coupling, np.diag(found.depth_hessian)]])
    return H, np.concatenate([(found.b + prior_b)[frames], found.depth_gradient.astype(float)]), frames


def evaluated(window, points=None):
    thresholds = np.full(window.capacity, NEVER, np.float32)
    points = window.points if points is None else points
    return linearize(window.images, points, window.pairs(), thresholds, OPTIONS.huber, OPTIONS.gradient_constant)


def solved(H: np.ndarray, b: np.ndarray) -> np.ndarray:
    scale = 1 / np.sqrt(np.diag(H))
    return -scale * np.linalg.solve(H * np.outer(scale, scale), b * scale)


def without_residuals_in(window, slot: int) -> None:
    """Points of other keyframes are not compared with this one any more, as when it is marginalized."""
    window.points.state[window.points.host != slot, slot] = NONE
    keep_known(window)


@pytest.mark.parametrize("gone", [[0], [3, 4, 5], [9, 0, 5, 7]])
def test_eliminating_variables_keeps_the_solution_of_the_others(gone):
    H, b = quadratic(10, seed=len(gone))
    kept = np.setdiff1d(np.arange(10), gone)
    H_new, b_new = eliminate(H, b, np.array(gone))
    np.testing.assert_allclose(solved(H_new[np.ix_(kept, kept)], b_new[kept]), solved(H, b)[kept], rtol=1e-6)
    assert not H_new[gone].any() and not H_new[:, gone].any() and not b_new[gone].any()
    np.testing.assert_array_equal(H_new, H_new.T)


def test_eliminating_one_by_one_is_eliminating_together():
    H, b = quadratic(10, seed=3)
    together = eliminate(H, b, np.array([1, 2, 6]))
    one_by_one = H, b
    for variable in (6, 1, 2):
        one_by_one = eliminate(*one_by_one, np.array([variable]))
    for found, expected in zip(one_by_one, together, strict=True):
        np.testing.assert_allclose(found, expected, rtol=1e-5, atol=1e-9 * np.abs(expected).max())


def test_eliminating_what_is_unknown_adds_no_knowledge():
    """Variables that nothing determines leave without a trace, and nothing turns negative."""
    H, b = quadratic(10, seed=4, rank=6)
    H[8:], H[:, 8:], b[8:] = 0.0, 0.0, 0.0
    np.testing.assert_allclose(eliminate(H, b, np.array([8, 9]))[0], H, rtol=1e-9)
    H_new, _ = eliminate(H, b, np.array([0, 1]))
    scale = 1 / np.sqrt(np.maximum(np.diag(H_new), 1e-9))
    assert np.linalg.eigvalsh(H_new * np.outer(scale, scale)).min() > -1e-6


def test_a_keyframe_that_left_is_as_good_as_one_that_stayed():
    """The next step of the remaining keyframes and depths is that of the whole system."""
    window = displaced_window()
    window.prior_H[slots(1)[0], slots(1)[0]] += 1e6  # the scale
    without_residuals_in(window, 0)
    H, b, frames = whole_system(window)
    whole = solved(H, b)
    own = window.points.host == 0
    marginal, window.points = window.points.select(own), window.points.select(~own)
    marginalize_points(window, marginal, OPTIONS)
    marginalize_keyframe(window, window.keyframes[0], OPTIONS)
    assert [k.slot for k in window.keyframes] == [1, 2, 3]
    assert not window.prior_H[slots(0)].any()

    H, b, remaining = whole_system(window)
    step = solved(H, b)
    expected = np.concatenate([whole[: len(frames)][np.isin(frames, remaining)], whole[len(frames) :][~own]])
    np.testing.assert_allclose(step, expected, rtol=2e-3, atol=2e-3 * np.abs(expected).mean())
    reduced = _solve(window, evaluated(window), OPTIONS, damping=0.0)
    np.testing.assert_allclose(reduced[remaining], expected[: len(remaining)], rtol=5e-3, atol=1e-6)


def test_the_priors_gradient_is_that_of_the_points_where_they_left():
    window = displaced_window()
    marginal = window.points.select(window.points.host == 1)
    system = evaluated(window, marginal)
    before_H, before_b = total_prior(window, OPTIONS)
    marginalize_points(window, marginal, OPTIONS)
    after_H, after_b = total_prior(window, OPTIONS)
    scale = np.sqrt(np.maximum(np.diag(system.H), 1e-9))
    np.testing.assert_allclose((after_b - before_b) / scale, (system.b - system.b_schur) / scale, atol=1e-3)
    np.testing.assert_allclose(after_H - before_H, system.H - system.H_schur, rtol=1e-9, atol=1e-3)


def test_the_priors_gradient_follows_the_state():
    window = displaced_window()
    marginalize_points(window, window.points.select(window.points.host == 1), OPTIONS)
    H, before = total_prior(window, OPTIONS)
    xi, affine, calibration = np.array([0.01, -0.02, 0.01, 0.005, 0.002, -0.01]), np.array([0.1, -0.4]), 0.5
    window.keyframes[2].step = window.keyframes[2].step + xi
    window.keyframes[2].affine = window.keyframes[2].affine + affine
    window.calibration = window.calibration + calibration
    change = np.zeros(len(before))
    change[slots(2)] = np.concatenate([xi, affine])
    change[:CALIBRATION] = calibration
    expected = before + H @ change
    np.testing.assert_allclose(total_prior(window, OPTIONS)[1], expected, rtol=1e-9, atol=1e-9 * np.abs(expected).max())


def test_what_images_do_not_determine_stays_undetermined_in_the_prior():
    """Common motion and scale, though points leave at one state and later ones at another."""
    window = displaced_window()
    window.prior_H[:] = 0.0
    for host in (0, 1):
        marginalize_points(window, window.points.select(window.points.host == host), OPTIONS)
        for keyframe in window.keyframes:
            keyframe.step = keyframe.step + np.array([0.01, 0.02, -0.02, 0.003, -0.01, 0.004]) * (keyframe.slot + 1)
    free = np.zeros((len(window.prior_b), 7))
    for keyframe in window.keyframes:
        at = CALIBRATION + FRAME * keyframe.slot
        free[at : at + 6, :6] = adjoint(keyframe.T_first)
        free[at : at + 3, 6] = keyframe.T_first[:3, 3]
    scale = np.sqrt(np.maximum(np.diag(window.prior_H), 1e-9))
    assert np.abs(window.prior_H @ free / scale[:, None]).max() < 2e-4 * np.abs(scale[:, None] * free).max()


def test_a_brightness_that_left_keeps_its_prior():
    """A keyframe without residuals but for brightness passes on nothing; its gradient there was its own."""
    window = displaced_window()
    window.points = window.points.select(np.zeros(len(window.points), bool))
    keyframe = window.keyframes[0]
    neighbour = slots(1)[6:]
    own = slots(0)[6:]
    link = 1e6  # the two brightnesses are known to be equal
    for i, j, sign in [(own, own, 1), (neighbour, neighbour, 1), (own, neighbour, -1), (neighbour, own, -1)]:
        window.prior_H[i, j] += sign * link
    H, b, frames = whole_system(window)
    whole = solved(H + 1e-9 * np.eye(len(H)), b)
    marginalize_keyframe(window, keyframe, OPTIONS)
    H, b, remaining = whole_system(window)
    found = solved(H + 1e-9 * np.eye(len(H)), b)
    at = np.searchsorted(remaining, neighbour)
    np.testing.assert_allclose(found[at], whole[np.isin(frames, remaining)][at], rtol=1e-4)


def test_no_points_change_nothing():
    window = displaced_window()
    before = window.prior_H.copy(), window.prior_b.copy()
    marginalize_points(window, window.points.select(np.zeros(len(window.points), bool)), OPTIONS)
    np.testing.assert_array_equal(window.prior_H, before[0])
    np.testing.assert_array_equal(window.prior_b, before[1])
