"""The kernels of alignment against plain NumPy and finite differences."""

from __future__ import annotations

import numpy as np
import pytest
from odometry_scenes import CAMERA, inverse_depth_at, motion, pyramid_of, smooth_pixels
from scipy.ndimage import map_coordinates

from polarmap.geometry.lie import se3_exp
from polarmap.odometry.track.descent import CUTOFF, TERMS, at, descend, normal_equations, projection, residuals

HERE = motion(0, 0, 0, 0, 0, 0)
THERE = motion(0.04, -0.02, 0.05, 0.01, -0.015, 0.01)
K = CAMERA.matrix
HUBER = np.float32(9.0)
LOG_GAIN, OFFSET = 0.05, 1.5
LEVEL = pyramid_of(THERE, noise=1.0).levels[0]


@pytest.fixture(scope="module")
def points() -> np.ndarray:
    """Pixels of the reference, inverse depths, intensities; some do not fit, are beside the frame or behind it."""
    pixels = smooth_pixels(HERE, 700)
    depth = inverse_depth_at(HERE, pixels)
    depth[::40] *= 3.0
    depth[5], depth[6] = -60.0, 200.0
    color = pyramid_of(HERE).levels[0][pixels[:, 1], pixels[:, 0], 0]
    color[::50] += 100.0
    return np.column_stack([pixels, depth, color]).astype(np.float32)


def plain(points: np.ndarray, T: np.ndarray, log_gain: float, offset: float, cutoff: float):
    """Rows w, J (8), r of the residuals below the cutoff, the energy, points in view, and those above the cutoff."""
    u, v, d, color = points.T.astype(float)
    rays = np.stack([(u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1], np.ones_like(u)])
    p = T[:3, :3] @ rays + d * T[:3, 3:]
    x, y, z = p[0] / p[2], p[1] / p[2], d / p[2]
    pu, pv = K[0, 0] * x + K[0, 2], K[1, 1] * y + K[1, 2]
    inside = (p[2] > 0) & (pu > 2) & (pu < CAMERA.width - 2) & (pv > 2) & (pv < CAMERA.height - 2)
    value, gx, gy = (map_coordinates(LEVEL[..., c], [pv, pu], order=1, mode="nearest") for c in range(3))
    expected = np.exp(log_gain) * color
    r = value - expected - offset
    good = inside & (np.abs(r) <= cutoff)
    w = np.minimum(1.0, HUBER / np.maximum(np.abs(r), 1e-9))
    gx, gy = gx * K[0, 0], gy * K[1, 1]
    J = np.stack([
        gx * z, gy * z, -z * (gx * x + gy * y), -gx * x * y - gy * (1 + y * y), gx * (1 + x * x) + gy * x * y,
        gy * x - gx * y, -expected, -np.ones_like(r),
    ])  # fmt: skip
    energy = (w * r * r * (2 - w))[good].sum() + HUBER * (2 * cutoff - HUBER) * (inside & ~good).sum()
    return w[good], J[:, good], r[good], energy, int(inside.sum()), int((inside & ~good).sum())


@pytest.mark.parametrize("cutoff", [CUTOFF, 4.0])
@pytest.mark.parametrize("T", [motion(0.3, 0.1, 0.2, 0.02, -0.05, 0.04), THERE], ids=["far", "near"])
def test_residuals_and_sums_are_those_of_the_definition(points, T, cutoff):
    terms = np.empty((TERMS, len(points)), np.float32)
    n, energy, seen, above = residuals(LEVEL, points, K, T, LOG_GAIN, OFFSET, HUBER, np.float32(cutoff), terms)
    w, J, r, expected_energy, expected_seen, expected_above = plain(points, T, LOG_GAIN, OFFSET, cutoff)
    assert (n, seen, above) == (len(w), expected_seen, expected_above)
    assert n > 30 and above > 0 and seen < len(points)
    assert energy == pytest.approx(expected_energy, rel=1e-4)
    np.testing.assert_allclose(terms[6, :n], r, atol=2e-3)
    work = np.empty((2, 9, 256), np.float32)
    sums = normal_equations(terms, n, work[0], work[1])
    rows = np.concatenate([J, r[None]])
    expected = (w * rows) @ rows.T
    scale = np.sqrt(np.outer(np.diag(expected), np.diag(expected)))
    assert (np.abs(sums - expected) < 1e-3 * scale).all()
    np.testing.assert_array_equal(sums, sums.T)


@pytest.mark.parametrize("count", [0, 1, 255, 256, 257, 513])
def test_sums_of_any_number_of_residuals(count):
    terms = np.random.default_rng(count).normal(size=(TERMS, max(count, 1))).astype(np.float32)
    work = np.full((2, 9, 256), np.nan, np.float32)
    sums = normal_equations(terms, count, work[0], work[1])
    r, w = terms[6, :count].astype(float), terms[7, :count].astype(float)
    assert sums[8, 8] == pytest.approx((w * r * r).sum(), rel=1e-4, abs=1e-4)
    assert sums[7, 7] == pytest.approx(w.sum(), rel=1e-4, abs=1e-4)


def ramp() -> np.ndarray:
    """A level of constant gradients, on which bilinear interpolation is exact."""
    v, u = np.mgrid[: CAMERA.height, : CAMERA.width]
    return np.stack([90 + 0.4 * u - 0.3 * v, np.full(u.shape, 0.4), np.full(u.shape, -0.3)], axis=2).astype(np.float32)


@pytest.mark.parametrize("variable", range(8))
def test_the_gradient_is_the_energys_change(points, variable):
    """Below the cutoff, and where residuals count by their square."""
    inner = points[(points[:, 2] > 0) & (points[:, 2] < 1.0)]
    inner = inner[(np.abs(inner[:, 0] - 120) < 60) & (np.abs(inner[:, 1] - 90) < 45)]
    terms, work = np.empty((TERMS, len(points)), np.float32), np.empty((2, 9, 256), np.float32)
    step = (1e-3, 1e-3, 1e-3, 5e-4, 5e-4, 5e-4, 1e-2, 0.2)[variable]
    wide = np.float32(1e3)

    def at_change(size: float):
        change = np.zeros(8)
        change[variable] = size
        T = se3_exp(change[:6]) @ THERE
        return residuals(ramp(), inner, K, T, LOG_GAIN + change[6], OFFSET + change[7], wide, wide, terms)

    change = (at_change(step)[1] - at_change(-step)[1]) / (2 * step)
    n, *_ = at_change(0.0)
    sums = normal_equations(terms, n, work[0], work[1])
    assert n == len(inner) > 20
    scale = 0.01 * np.sqrt(sums[variable, variable] * sums[8, 8])
    assert change == pytest.approx(2 * sums[variable, 8], rel=0.01, abs=scale)


def test_projection_is_that_of_the_camera():
    KRKi, Kt = projection(K, THERE)
    np.testing.assert_allclose(KRKi, K @ THERE[:3, :3] @ np.linalg.inv(K), rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(Kt, K @ THERE[:3, 3], rtol=1e-6)


def test_descent_ends_where_no_step_gains(points):
    """Started from its end it stays there, and `at` says the same of it."""
    terms = np.empty((TERMS, len(points)), np.float32)
    start = (LEVEL, points, K)
    T, gain, offset, cost, seen, saturated, sums, cutoff = descend(*start, HERE, 0.0, 0.0, HUBER, 50, 2e-5, terms)
    assert cutoff == CUTOFF
    again = descend(*start, T, gain, offset, HUBER, 50, 2e-5, terms)
    assert np.abs(again[0] - T).max() < 1e-4 and again[3] <= cost
    same = at(*start, T, gain, offset, HUBER, terms)
    assert same[0] == pytest.approx(cost, rel=1e-9) and same[1] == seen and same[2] == saturated
    np.testing.assert_allclose(same[3], sums, rtol=1e-9)


def test_a_cutoff_that_nearly_all_exceed_is_widened(points):
    brighter = points.copy()
    brighter[:, 3] += 60.0
    terms = np.empty((TERMS, len(points)), np.float32)
    *_, cutoff = descend(LEVEL, brighter, K, THERE, 0.0, 0.0, HUBER, 10, 2e-5, terms)
    assert cutoff > CUTOFF


def test_too_few_points_in_view_end_it_at_once(points):
    terms = np.empty((TERMS, len(points)), np.float32)
    away = motion(-40.0, 0, 0, 0, 0, 0)
    T, *_, seen, _, _, _ = descend(LEVEL, points, K, away, 0.0, 0.0, HUBER, 10, 2e-5, terms)
    assert seen < 20
    np.testing.assert_array_equal(T, away)
