"""The `sparse` prior: planes are exact, edges are kept, and nothing runs away."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.errors import InputError
from polarmap.prior import plane_grid
from polarmap.prior.sparse import interpolate_inverse_depth

SHAPE = (120, 160)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)


def points_of(inverse_depth: np.ndarray, share: float = 0.02, seed: int = 0) -> np.ndarray:
    known = np.random.default_rng(seed).random(inverse_depth.shape) < share
    return np.where(known, 1.0 / inverse_depth, np.nan).astype(np.float32)


def relative_error(found: np.ndarray, truth: np.ndarray) -> np.ndarray:
    return np.abs(found / truth - 1.0)


SLANTED = 0.4 + 0.001 * U - 0.0015 * V
GREY = np.full(SHAPE, 0.5, np.float32)


def test_a_plane_is_exact():
    found = interpolate_inverse_depth(GREY, points_of(SLANTED))
    assert found.dtype == np.float32
    assert relative_error(found, SLANTED).max() < 1e-3


def test_a_plane_is_carried_over_a_hole():
    points = points_of(SLANTED, 0.05)
    points[30:90, 40:120] = np.nan
    found = interpolate_inverse_depth(GREY, points)
    assert relative_error(found, SLANTED).max() < 5e-3


def test_outliers_do_not_bend_a_plane():
    rng = np.random.default_rng(1)
    points = points_of(SLANTED, 0.1)
    wrong = np.isfinite(points) & (rng.random(SHAPE) < 0.1)
    points[wrong] = rng.uniform(1.5, 5.0, np.count_nonzero(wrong))
    found = interpolate_inverse_depth(GREY, points)
    assert np.quantile(relative_error(found, SLANTED), 0.95) < 0.01


def test_nothing_leaks_over_an_edge():
    near, far = 0.8 + 0.001 * V, 0.3 - 0.0008 * U
    left = U < 83  # not on a border of cells
    truth, image = np.where(left, near, far), np.where(left, 0.9, 0.2).astype(np.float32)
    found = interpolate_inverse_depth(image, points_of(truth, 0.03))
    away = np.abs(U - 83) > 3
    assert relative_error(found, truth)[away].max() < 0.03


def test_without_points_an_area_follows_the_side_it_looks_like():
    near, far = 0.8, 0.3
    left = U < 80
    truth, image = np.where(left, near, far), np.where(left, 0.9, 0.2).astype(np.float32)
    points = points_of(truth.astype(np.float32), 0.05)
    points[:, 60:140] = np.nan
    found = interpolate_inverse_depth(image, points)
    assert np.median(relative_error(found, truth)[:, 60:76]) < 0.02
    assert np.median(relative_error(found, truth)[:, 84:140]) < 0.1  # the other side's depth is off by 1.7


def test_extrapolation_stays_near_the_range_of_the_points():
    points = np.full(SHAPE, np.nan, np.float32)
    points[50:70, 70:90] = 1.0 / (0.2 + 0.03 * (U - 70))[50:70, 70:90]  # steep: far outside it would turn negative
    found = interpolate_inverse_depth(GREY, points)
    assert found.min() >= 0.2 / 1.3
    assert found.max() <= 0.77 * 1.3


@pytest.mark.parametrize("n_points", [0, 1, 2])
def test_fewer_than_three_points_say_nothing(n_points):
    points = np.full(SHAPE, np.nan, np.float32)
    points.ravel()[:n_points] = 2.0
    assert np.isnan(interpolate_inverse_depth(GREY, points)).all()


def test_three_points_suffice():
    points = np.full(SHAPE, np.nan, np.float32)
    points[10, 10] = points[100, 20] = points[60, 150] = 2.0
    np.testing.assert_allclose(interpolate_inverse_depth(GREY, points), 0.5, rtol=1e-3)


def test_zero_negative_and_infinite_depths_are_no_points():
    points = points_of(SLANTED)
    points[0, :4] = (0.0, -1.0, np.inf, -np.inf)
    assert relative_error(interpolate_inverse_depth(GREY, points), SLANTED).max() < 1e-3


def test_points_weigh_by_confidence():
    points = points_of(SLANTED, 0.2)
    bad = np.isfinite(points) & (np.random.default_rng(3).random(SHAPE) < 0.6)
    points[bad] *= 1.5
    confidence = np.where(bad, 1e-3, 1.0).astype(np.float32)
    assert relative_error(interpolate_inverse_depth(GREY, points, confidence), SLANTED).max() < 0.02
    unknown = np.where(U < 80, np.nan, 1.0).astype(np.float32)
    expected = interpolate_inverse_depth(GREY, np.where(U < 80, np.nan, points).astype(np.float32))
    np.testing.assert_array_equal(interpolate_inverse_depth(GREY, points, unknown), expected)
    with pytest.raises(InputError, match="confidence"):
        interpolate_inverse_depth(GREY, points, confidence[:5])


@settings(max_examples=15, deadline=None)
@given(height=st.integers(2, 150), width=st.integers(2, 150), seed=st.integers(0, 99))
def test_any_size_and_any_image_give_finite_positive_depth(height, width, seed):
    rng = np.random.default_rng(seed)
    image = rng.random((height, width), np.float32)
    image[rng.random(image.shape) < 0.1] = np.nan
    points = np.where(rng.random(image.shape) < 0.3, rng.uniform(0.5, 50.0, image.shape), np.nan).astype(np.float32)
    points.ravel()[:3] = 1.0
    found = interpolate_inverse_depth(image, points)
    assert found.shape == image.shape
    assert np.isfinite(found).all()
    assert found.min() > 0


def test_a_black_image_is_one_surface():
    found = interpolate_inverse_depth(np.zeros(SHAPE, np.float32), points_of(SLANTED))
    assert relative_error(found, SLANTED).max() < 1e-3


def dense_solution(values, weights, cell_guide, cell, contrast, flatness):
    """The first round of `solve_planes`, by least squares on an explicit matrix."""
    rows, columns = cell_guide.shape
    equations, targets = [], []

    def equation(target, weight, *terms):
        row = np.zeros((rows, columns, 3))
        for i, j, coefficients in terms:
            row[i, j] += coefficients
        equations.append(np.sqrt(weight) * row.ravel())
        targets.append(np.sqrt(weight) * target)

    for v, u in np.argwhere(weights > 0):
        position = (1.0, (u + 0.5) / cell - columns / 2, (v + 0.5) / cell - rows / 2)
        equation(values[v, u], weights[v, u], (v // cell, u // cell, position))
    for i in range(rows):
        for j in range(columns):
            equation(0.0, flatness, (i, j, (0, 1, 0)))
            equation(0.0, flatness, (i, j, (0, 0, 1)))
            for k, m, x, y in ((i, j + 1, j + 1.0, i + 0.5), (i + 1, j, j + 0.5, i + 1.0)):
                if k < rows and m < columns:
                    bond = np.exp(-abs(cell_guide[i, j] - cell_guide[k, m]) / contrast)
                    middle = np.array((1.0, x - columns / 2, y - rows / 2))
                    for p in (middle, np.array((0.0, 1.0, 0.0)), np.array((0.0, 0.0, 1.0))):
                        equation(0.0, bond, (i, j, p), (k, m, -p))
    solution = np.linalg.lstsq(np.array(equations), np.array(targets), rcond=None)[0]
    return solution.reshape(rows, columns, 3)


def test_the_solver_agrees_with_a_dense_one(monkeypatch):
    monkeypatch.setattr(plane_grid, "_ITERATIONS", (300,))
    rng = np.random.default_rng(5)
    cell, shape = 4, (21, 26)
    values = rng.uniform(0.2, 1.0, shape).astype(np.float32)
    weights = np.where(rng.random(shape) < 0.3, rng.uniform(0.5, 2.0, shape), 0.0).astype(np.float32)
    cell_guide = rng.random((6, 7)).astype(np.float32)
    args = (values, weights, cell_guide, cell)
    found = plane_grid.solve_planes(*args, contrast=0.5, noise=0.01, flatness=1e-3)
    np.testing.assert_allclose(found, dense_solution(*args, 0.5, 1e-3), atol=2e-4)
