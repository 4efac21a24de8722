"""Planes from points: exact ones among noise and outliers, in order of their support, and none where there is none."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import pixel_rays, plane_depth

from polarmap.densify.surfaces.dominant_planes import dominant_planes, solve_symmetric
from polarmap.densify.surfaces.planes import evaluate_planes
from polarmap.geometry.camera import PinholeCamera

SHAPE = (72, 96)
V, U = np.indices(SHAPE)
TOLERANCE = 0.01
PLANES = np.array([[0.5, 0.002, 0.001], [0.8, -0.003, 0.0005], [0.3, 0.0, -0.002]])
OFF_CENTRE = PinholeCamera(width=96, height=72, fx=80.0, fy=76.0, cx=20.3, cy=61.0)
UNKNOWN = np.float32(np.nan)


def inverse_depths(planes: np.ndarray) -> np.ndarray:
    """q₀ + q_u (u - c_u) + q_v (v - c_v), float64 N×H×W."""
    return np.stack([q + qu * (U - 47.5) + qv * (V - 35.5) for q, qu, qv in planes])


def three_planes(noise: float = 0.0, outliers: float = 0.0, seed: int = 0) -> np.ndarray:
    """Columns of the three planes, in shares of 20, 50 and 30 %; the outliers lie anywhere."""
    rng = np.random.default_rng(seed)
    first, second, third = inverse_depths(PLANES)
    q = np.where(U < 19, first, np.where(U < 67, second, third))
    q = q * (1.0 + noise * rng.standard_normal(SHAPE))
    wrong = rng.random(SHAPE) < outliers
    return np.where(wrong, rng.uniform(0.1, 2.0, SHAPE), q).astype(np.float32)


def largest_error(found: np.ndarray, true: np.ndarray) -> float:
    """Relative, over all of the image where the true inverse depth is well over 0."""
    a, b = evaluate_planes(found[None], SHAPE)[0], inverse_depths(true[None])[0]
    return float(np.abs(a / b - 1.0)[b > 0.2].max())


def test_exact_planes_are_found_exactly_and_those_with_most_points_first():
    planes, counts = dominant_planes(three_planes(), TOLERANCE, most=8, least_share=0.05)
    assert planes.shape == (3, 3) and planes.dtype == np.float64
    for found, true in zip(planes, PLANES[[1, 2, 0]], strict=True):
        assert largest_error(found, true) < 5e-4  # points of others, where planes nearly meet, still pull a little
    areas = np.array([48, 29, 19]) * SHAPE[0]
    assert (np.abs(counts - areas) <= 0.05 * areas).all()  # where two planes meet either explains the points


def test_noise_and_outliers_do_not_hide_planes():
    q = three_planes(noise=0.003, outliers=0.3)
    planes, counts = dominant_planes(q, TOLERANCE, most=8, least_share=0.05)
    assert len(planes) == 3
    for found, true in zip(planes, PLANES[[1, 2, 0]], strict=True):
        assert largest_error(found, true) < 0.002
    assert (np.diff(counts) <= 0).all() and 0.66 < counts.sum() / q.size < 0.75


def test_sparse_points_are_enough():
    q = np.where(np.random.default_rng(1).random(SHAPE) < 0.05, three_planes(noise=0.003, outliers=0.3), UNKNOWN)
    planes, counts = dominant_planes(q.astype(np.float32), TOLERANCE, most=3, least_share=0.05)
    assert largest_error(planes[0], PLANES[1]) < 0.01
    assert counts.sum() <= np.isfinite(q).sum()


def test_the_same_points_give_the_same_planes():
    q = three_planes(noise=0.003, outliers=0.3)
    a, b = (dominant_planes(q, TOLERANCE, most=8, least_share=0.05, seed=3) for _ in range(2))
    np.testing.assert_array_equal(a[0], b[0])
    np.testing.assert_array_equal(a[1], b[1])


@pytest.mark.parametrize("points", [0, 1, 23])
def test_too_few_points_give_no_plane(points):
    q = np.full(SHAPE, UNKNOWN)
    q.ravel()[:points] = 0.5
    planes, counts = dominant_planes(q, TOLERANCE, most=8, least_share=0.01)
    assert planes.shape == (0, 3) and counts.shape == (0,)


def test_points_without_a_plane_give_none():
    q = np.random.default_rng(0).uniform(0.1, 2.0, SHAPE).astype(np.float32)
    planes, _ = dominant_planes(q, TOLERANCE, most=8, least_share=0.1)
    assert planes.shape == (0, 3)


def test_no_more_planes_than_asked_for_and_none_that_is_too_small():
    q = three_planes()
    assert len(dominant_planes(q, TOLERANCE, most=2, least_share=0.05)[0]) == 2
    assert len(dominant_planes(q, TOLERANCE, most=0, least_share=0.05)[0]) == 0
    assert len(dominant_planes(q, TOLERANCE, most=8, least_share=0.25)[0]) == 2  # the third has a fifth


def test_values_that_are_no_depth_are_not_points():
    q = three_planes()
    q[::2, ::2], q[1::2, ::2] = -0.7, 0.0
    planes, counts = dominant_planes(q, TOLERANCE, most=8, least_share=0.05)
    assert largest_error(planes[0], PLANES[1]) < 1e-4 and counts.sum() <= q.size / 2


def test_planes_of_space_are_affine_in_inverse_depth_under_any_camera():
    """αX + βY + γZ = 1 has q = αx + βy + γ with normalized x, y."""
    normal, distance = np.array([0.5, -0.3, -0.8]), 3.0
    truth = plane_depth(OFF_CENTRE, normal, distance)
    alpha, beta, gamma = normal / (normal[2] * distance)
    centre = pixel_rays(OFF_CENTRE).reshape(-1, 3).mean(axis=0) @ [alpha, beta, gamma]
    plane = np.array([[centre, alpha / OFF_CENTRE.fx, beta / OFF_CENTRE.fy]])
    np.testing.assert_allclose(evaluate_planes(plane, SHAPE)[0], 1.0 / truth, rtol=1e-6)
    found, _ = dominant_planes((1.0 / truth).astype(np.float32), TOLERANCE, most=1, least_share=0.5)
    np.testing.assert_allclose(found, plane, rtol=1e-4)


def test_planes_are_evaluated_at_pixels_as_in_the_whole_image():
    everywhere = evaluate_planes(PLANES, SHAPE)
    assert everywhere.dtype == np.float32
    np.testing.assert_allclose(everywhere, inverse_depths(PLANES), rtol=1e-6)
    u, v = np.array([0, 95, 40]), np.array([71, 0, 13])
    np.testing.assert_array_equal(evaluate_planes(PLANES, SHAPE, u, v), everywhere[:, v, u])


def test_no_planes_are_evaluated_to_nothing():
    assert evaluate_planes(np.empty((0, 3)), SHAPE).shape == (0, *SHAPE)
    assert evaluate_planes(np.empty((0, 3)), SHAPE, U[0], V[0]).shape == (0, SHAPE[1])


def upper(m: np.ndarray) -> np.ndarray:
    return m[np.triu_indices(3)]


def test_symmetric_systems_are_solved_as_numpy_does():
    rng = np.random.default_rng(0)
    for _ in range(20):
        a = rng.standard_normal((3, 3))
        m, r = a @ a.T + 0.1 * np.eye(3), rng.standard_normal(3)
        np.testing.assert_allclose(solve_symmetric(upper(m), r), np.linalg.solve(m, r), rtol=1e-9, atol=1e-9)


SINGULAR = {
    "zero": np.zeros((3, 3)),
    "one direction": np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]),
    "two directions": np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0]) + np.outer([1.0, 0.0, 1.0], [1.0, 0.0, 1.0]),
    "unknown": np.full((3, 3), np.nan),
}


@pytest.mark.parametrize("name", SINGULAR)
def test_singular_systems_give_zeros(name):
    assert solve_symmetric(upper(SINGULAR[name]), np.ones(3)) == (0.0, 0.0, 0.0)
