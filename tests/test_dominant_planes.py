"""Planes found in sparse points."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import WIDE, plane_depth

from polarmap.densify.dominant_planes import dominant_planes, evaluate_planes, solve_symmetric

FLOOR, WALL = ((0.0, -1.0, -0.25), 1.2), ((0.5, 0.0, -1.0), 3.0)


def inverse_depth(plane) -> np.ndarray:
    return 1.0 / plane_depth(WIDE, *plane)


def points_of(shares: dict, seed: int = 0, outliers: float = 0.0, noise: float = 0.002) -> np.ndarray:
    """Inverse depth at random pixels: for each plane that share of the image, and some that lie anywhere."""
    rng = np.random.default_rng(seed)
    chosen, edge = rng.random(WIDE.shape), 0.0
    points = np.full(WIDE.shape, np.nan, np.float32)
    for plane, share in shares.items():
        at = (chosen >= edge) & (chosen < edge + share)
        points[at] = inverse_depth(plane)[at] * (1 + noise * rng.standard_normal(np.count_nonzero(at)))
        edge += share
    wild = (chosen >= edge) & (chosen < edge + outliers)
    points[wild] = rng.uniform(0.2, 2.0, np.count_nonzero(wild))
    return points


def test_planes_are_found_among_outliers_the_larger_one_first():
    points = points_of({WALL: 0.3, FLOOR: 0.15}, outliers=0.2)
    planes, counts = dominant_planes(points, 0.01, most=8, least_share=0.15)
    assert len(planes) == 2 and counts[0] > counts[1]
    for plane, truth in zip(evaluate_planes(planes, WIDE.shape), (WALL, FLOOR), strict=True):
        np.testing.assert_allclose(plane, inverse_depth(truth), atol=2e-3 * np.abs(inverse_depth(truth)).max())


def test_what_is_found_depends_on_the_seed_alone():
    points = points_of({WALL: 0.3, FLOOR: 0.2}, outliers=0.2)
    first, again, other = (dominant_planes(points, 0.01, 8, 0.05, seed=s)[0] for s in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_allclose(other[:2], first[:2], rtol=0.02, atol=1e-5)


@pytest.mark.parametrize("most", [0, 1])
def test_no_more_planes_than_asked_for(most):
    assert len(dominant_planes(points_of({WALL: 0.3, FLOOR: 0.2}), 0.01, most, 0.05)[0]) == most


def test_few_or_scattered_points_are_no_plane():
    assert dominant_planes(np.full(WIDE.shape, np.nan, np.float32), 0.01, 8, 0.01)[0].shape == (0, 3)
    assert len(dominant_planes(points_of({WALL: 0.001}), 0.01, 8, 0.01)[0]) == 0
    assert len(dominant_planes(points_of({}, outliers=0.3), 0.01, 8, 0.15)[0]) == 0


def test_planes_are_evaluated_at_chosen_pixels_and_at_all():
    planes = np.array([[0.5, 0.001, -0.002], [0.2, 0.0, 0.0]])
    u, v = np.array([0, 119, 60]), np.array([0, 89, 7])
    everywhere = evaluate_planes(planes, WIDE.shape)
    assert everywhere.shape == (2, 90, 120) and everywhere.dtype == np.float32
    np.testing.assert_array_equal(evaluate_planes(planes, WIDE.shape, u, v), everywhere[:, v, u])
    assert everywhere[0, 89, 119] == pytest.approx(0.5 + 0.001 * 59.5 - 0.002 * 44.5)
    assert evaluate_planes(np.empty((0, 3)), WIDE.shape).shape == (0, 90, 120)


def test_symmetric_systems():
    rng = np.random.default_rng(0)
    root = rng.standard_normal((3, 3))
    matrix, right = root @ root.T, rng.standard_normal(3)
    np.testing.assert_allclose(
        solve_symmetric(matrix[np.triu_indices(3)], right), np.linalg.solve(matrix, right), rtol=1e-9
    )
    line = np.outer([1.0, 2.0, 3.0], [1.0, 2.0, 3.0])
    assert solve_symmetric(line[np.triu_indices(3)], right) == (0.0, 0.0, 0.0)
