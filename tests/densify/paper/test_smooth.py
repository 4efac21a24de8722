"""Total variation smoothing against a plain NumPy version and by its properties."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.densify.paper.smooth import edge_weights, smooth_total_variation


def forward_differences(z, max_step=np.inf):
    """Along u and v, 0 where either pixel is unknown or outside, or they differ by more than `max_step`."""
    gu, gv = np.zeros_like(z), np.zeros_like(z)
    gu[:, :-1], gv[:-1] = np.diff(z, axis=1), np.diff(z, axis=0)
    return np.where(np.abs(gu) <= max_step, gu, 0.0), np.where(np.abs(gv) <= max_step, gv, 0.0)


def energy(z, start, weights, strength) -> float:
    gu, gv = forward_differences(z)
    return 0.5 * np.nansum((z - start) ** 2) + strength * np.sum(weights * np.hypot(gu, gv))


def smoothed_by_numpy(start, weights, strength, iterations, max_step=np.inf):
    """z = z0 + div p, p projected to |p| <= λτ after each step along ∇z."""
    p, q, z = np.zeros_like(start), np.zeros_like(start), start.copy()
    for _ in range(iterations):
        gu, gv = forward_differences(z, max_step)
        p, q = p + 0.25 * gu, q + 0.25 * gv
        excess = np.maximum(1.0, np.hypot(p, q) / np.maximum(strength * weights, 1e-12))
        p, q = p / excess, q / excess
        divergence = p + q
        divergence[:, 1:] -= p[:, :-1]
        divergence[1:] -= q[:-1]
        z = start + divergence
    return z


@pytest.fixture(scope="module")
def noisy():
    """A step, noise, holes, and weights."""
    rng = np.random.default_rng(0)
    z = np.where(np.arange(40) < 22, 0.2, 0.9) + 0.1 * rng.standard_normal((30, 40))
    z[rng.random(z.shape) < 0.2] = np.nan
    return z.astype(np.float32), rng.uniform(0.2, 1.0, z.shape).astype(np.float32)


@pytest.mark.parametrize("strength", [0.05, 0.3, 5.0])
@pytest.mark.parametrize("iterations", [1, 3, 20])
def test_it_agrees_with_plain_numpy(noisy, strength, iterations):
    z, weights = noisy
    expected = smoothed_by_numpy(z.astype(float), weights, strength, iterations)
    np.testing.assert_allclose(smooth_total_variation(z, weights, strength, iterations), expected, atol=2e-6)


@pytest.mark.parametrize("max_step", [0.05, 0.2, 0.6])
def test_it_agrees_with_plain_numpy_where_steps_are_left_alone(noisy, max_step):
    z, weights = noisy
    expected = smoothed_by_numpy(z.astype(float), weights, 0.3, 3, max_step)
    np.testing.assert_allclose(smooth_total_variation(z, weights, 0.3, 3, max_step), expected, atol=2e-6)


def test_a_step_over_the_limit_is_an_edge():
    z = (np.where(np.arange(40) < 20, 0.0, 0.5) * np.ones((30, 1))).astype(np.float32)
    np.testing.assert_array_equal(smooth_total_variation(z, np.ones_like(z), 0.3, 10, max_step=0.4), z)
    assert np.abs(smooth_total_variation(z, np.ones_like(z), 0.3, 10, max_step=0.6) - z).max() > 0.05


def test_the_energy_falls_to_its_minimum(noisy):
    z, weights = noisy
    energies = [energy(smooth_total_variation(z, weights, 0.1, n), z, weights, 0.1) for n in (0, 3, 10, 50, 200)]
    least = energy(smoothed_by_numpy(z.astype(float), weights, 0.1, 3000), z, weights, 0.1)
    assert all(np.diff(energies) < 0)
    assert energies[-1] == pytest.approx(least, rel=5e-3) and least < 0.6 * energies[0]


def test_holes_stay_and_nothing_crosses_them(noisy):
    z, weights = noisy
    np.testing.assert_array_equal(np.isnan(smooth_total_variation(z, weights)), np.isnan(z))
    parted = np.full((10, 21), 0.2, np.float32)
    parted[:, 10], parted[:, 11:] = np.nan, 0.9
    np.testing.assert_array_equal(smooth_total_variation(parted, np.ones_like(parted), 0.3, 50), parted)


def test_a_constant_stays_and_the_mean_is_kept(noisy):
    z, weights = noisy
    constant = np.full_like(z, 1.25)
    np.testing.assert_array_equal(smooth_total_variation(constant, weights), constant)
    assert np.nanmean(smooth_total_variation(z, weights, 0.3, 30)) == pytest.approx(np.nanmean(z), abs=1e-6)


def test_without_strength_or_iterations_nothing_changes(noisy):
    z, weights = noisy
    np.testing.assert_array_equal(smooth_total_variation(z, weights, 0.3, 0), z)
    np.testing.assert_allclose(smooth_total_variation(z, weights, 0.0, 5), z, atol=1e-6)


def test_noise_goes_and_a_strong_step_stays():
    rng = np.random.default_rng(1)
    clean = np.where(np.arange(60) < 30, 0.0, 1.0) * np.ones((40, 1))
    noisy = (clean + 0.05 * rng.standard_normal(clean.shape)).astype(np.float32)
    smooth = smooth_total_variation(noisy, np.ones_like(noisy), 0.1, 200)
    assert np.abs(smooth - clean)[:, 5:25].std() < 0.02
    assert smooth[:, 30].mean() - smooth[:, 29].mean() > 0.8


def test_a_picture_edge_keeps_a_depth_step(noisy):
    z = (np.where(np.arange(40) < 20, 0.0, 0.5) * np.ones((30, 1))).astype(np.float32)
    picture = np.where(np.arange(40) < 20, 0.1, 0.9) * np.ones((30, 1), np.float32)
    moved = [
        np.abs(smooth_total_variation(z, edge_weights(image, 30.0), 0.3, 50) - z).max()
        for image in (picture, np.full_like(picture, 0.5))
    ]
    assert moved[0] < 1e-3 < 0.02 < moved[1]


def test_edge_weights_fall_with_the_pictures_gradient():
    picture = np.zeros((6, 8), np.float32)
    picture[3:, 4:] = 0.4
    weights = edge_weights(picture, zeta=3.0)
    assert weights.dtype == np.float32
    assert weights[0, 0] == 1.0 and weights[5, 6] == 1.0
    assert weights[4, 3] == pytest.approx(np.exp(-1.2)) and weights[2, 5] == pytest.approx(np.exp(-1.2))
    assert weights[2, 3] == 1.0  # forward differences


def test_edge_weights_turn_with_the_picture():
    picture = np.random.default_rng(0).random((9, 9), np.float32)
    np.testing.assert_allclose(edge_weights(picture.T), edge_weights(picture).T, rtol=1e-6)
