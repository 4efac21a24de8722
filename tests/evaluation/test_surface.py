"""Accuracy and completeness of surfaces, planes, and the wall experiment, on surfaces that are known."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polarmap.errors import InputError
from polarmap.evaluation.planes import Plane, estimate_normals, find_planes, fit_plane, fit_plane_robustly
from polarmap.evaluation.surface import VoxelMeans, number_cells, sample_triangles, surface_metrics
from polarmap.evaluation.walls import WallCollector, true_walls, walls_of_points

SQUARE = np.array([[0.0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])
FACES = np.array([[0, 1, 2], [0, 2, 3]])


def grid(size=1.0, step=0.02, z=0.0):
    """Points of a square on z, float64 N×3."""
    x, y = np.meshgrid(np.arange(0, size + 1e-9, step), np.arange(0, size + 1e-9, step))
    return np.stack([x.ravel(), y.ravel(), np.full(x.size, z)], axis=1)


def test_a_plane_offset_by_a_known_distance():
    m = surface_metrics(grid(z=0.015), grid(), (0.01, 0.02))
    assert (m.precision, m.recall, m.fscore) == ((0.0, 1.0), (0.0, 1.0), (0.0, 1.0))
    assert (m.accuracy.median, m.accuracy.max, m.completeness.mean) == pytest.approx((0.015,) * 3)


def test_a_mesh_offset_by_a_known_distance():
    sampled = sample_triangles(SQUARE + np.array([0, 0, 0.015]), FACES, 0.01)
    m = surface_metrics(sampled, grid(step=0.01), (0.014, 0.02))
    assert (m.precision[0], m.recall[0]) == (0.0, 0.0)
    assert m.precision[1] == 1.0
    assert m.recall[1] > 0.95
    assert m.accuracy.median == pytest.approx(0.015, abs=1e-3)


def test_half_a_plane_is_accurate_and_incomplete():
    truth = grid()
    half = truth[truth[:, 0] < 0.495]
    m = surface_metrics(half, truth, (0.01,))
    assert m.precision == (1.0,)
    share = len(half) / len(truth)
    assert m.recall == pytest.approx((share,))
    assert m.fscore == pytest.approx((2 * share / (1 + share),))


def test_no_point_is_nan_and_one_is_enough():
    nothing = surface_metrics(np.empty((0, 3)), grid(), (0.01,))
    assert np.isnan([nothing.precision[0], nothing.recall[0], nothing.fscore[0], nothing.accuracy.rmse]).all()
    one = surface_metrics(np.zeros((1, 3)), np.array([[0.0, 3.0, 4.0]]), (1.0, 5.5))
    assert (one.precision, one.recall, one.fscore) == ((0.0, 1.0),) * 3
    assert one.accuracy.rmse == 5.0


def test_triangles_are_sampled_evenly():
    points = sample_triangles(np.vstack([SQUARE, [[1, 0, 3], [1, 1, 3]]]), np.array([[0, 1, 2], [1, 4, 5]]), 0.02)
    assert len(points) == pytest.approx(2.0 / 0.02**2, abs=1)  # areas of 1/2 and 3/2
    flat = points[:, 2] == 0
    assert flat.mean() == pytest.approx(0.25, abs=1e-3)
    assert (points[flat, 0] >= points[flat, 1]).all()  # inside the first triangle
    np.testing.assert_allclose(points[flat].mean(axis=0), [2 / 3, 1 / 3, 0], atol=0.02)
    np.testing.assert_array_equal(points, sample_triangles(
        np.vstack([SQUARE, [[1, 0, 3], [1, 1, 3]]]), np.array([[0, 1, 2], [1, 4, 5]]), 0.02
    ))  # fmt: skip


def test_sampling_is_bounded_and_takes_no_area_for_none():
    assert len(sample_triangles(1000 * SQUARE, FACES, 0.001, limit=500)) == 500
    assert sample_triangles(SQUARE, FACES[:0], 0.1).shape == (0, 3)
    assert sample_triangles(np.zeros((4, 3)), FACES, 0.1).shape == (0, 3)
    broken = np.vstack([SQUARE[:3], [[np.nan, 0, 0]]])
    assert np.isfinite(sample_triangles(broken, FACES, 0.1)).all()


def test_voxels_keep_means_and_their_memory():
    cells = VoxelMeans(1.0)
    cells.add(np.array([[0.2, 0.5, 0.5], [0.4, 0.5, 0.5], [np.nan, 0, 0]]))
    cells.add(np.array([[0.6, 0.5, 0.5], [-0.5, 0.5, 0.5], [1e12, 0, 0]]))
    means = cells.means()
    assert len(means) == 3
    np.testing.assert_allclose(sorted(means[:, 0]), [-0.5, 0.4, 1e12])
    bounded = VoxelMeans(0.001, limit=100)
    for seed in range(5):
        bounded.add(np.random.default_rng(seed).random((1000, 3)))
    assert 0 < len(bounded.means()) <= 100
    assert bounded.size > 0.001
    assert VoxelMeans(1.0).means().shape == (0, 3)
    with pytest.raises(InputError, match="positive"):
        VoxelMeans(0.0)


@pytest.mark.parametrize("place", [(0, 5100, 0), (451234, 5212345, 512), (-6.3e6, 2.0**40, 0), (1e9, -1e9, 1e9)])
def test_voxels_are_the_same_anywhere(place):
    """Coordinates and places are binary fractions, so that the shift is exact."""
    points = np.random.default_rng(0).integers(0, 2**12, (20_000, 3)) * 2.0**-9
    place = np.array(place, float)
    near, far = VoxelMeans(0.5), VoxelMeans(0.5)
    near.add(points)
    far.add(points + place)
    assert len(near.means()) == len(far.means()) > 4000
    np.testing.assert_allclose(far.means() - place, near.means(), atol=1e-3)


def test_voxels_hold_points_that_are_far_apart():
    places = np.array([[0.0, 0, 0], [1e12, 0, 0], [0, -1e15, 0], [5e6, 5e6, 1e18]])
    cells = VoxelMeans(0.005)
    cells.add(np.repeat(places, 3, axis=0))
    cells.add(np.array([[0.006, 0, 0]]))
    cells.add(np.array([[1e200, 0, 0], [-np.inf, 0, 0]]))  # no place at all
    expected = np.vstack([places, [[0.006, 0, 0]]])
    np.testing.assert_array_equal(np.unique(cells.means(), axis=0), np.unique(expected, axis=0))


@pytest.mark.parametrize("extent", [5, 2**20, 2**22, 2**52])
def test_cells_are_numbered_in_order(extent):
    rng = np.random.default_rng(1)
    cells = rng.integers(-extent, extent, (2000, 3)).astype(float)
    cells = np.vstack([cells, cells[::3]])
    _, expected = np.unique(cells, axis=0, return_inverse=True)
    np.testing.assert_array_equal(number_cells(cells), expected.ravel())
    assert number_cells(np.empty((0, 3))).shape == (0,)


def room(noise=0.0):
    """A floor, two walls of different size and clutter: points and normals."""
    rng = np.random.default_rng(0)
    floor = np.stack([4 * rng.random(4000), 4 * rng.random(4000), np.zeros(4000)], axis=1)
    wall = np.stack([4 * rng.random(2000), np.full(2000, 4.0), 2 * rng.random(2000)], axis=1)
    side = np.stack([np.zeros(1000), 4 * rng.random(1000), rng.random(1000)], axis=1)
    clutter, turns = 4 * rng.random((500, 3)), rng.normal(size=(500, 3))
    points = np.vstack([floor, wall, side, clutter])
    normals = np.repeat(np.eye(3)[[2, 1, 0]], [4000, 2000, 1000], axis=0)
    normals = np.vstack([normals, turns / np.linalg.norm(turns, axis=1, keepdims=True)])
    return points + noise * rng.normal(size=points.shape), normals


def test_planes_are_found_largest_first():
    points, normals = room(noise=0.002)
    planes = find_planes(points, normals, 0.01)
    assert len(planes) == 3
    for plane, normal, offset in zip(planes, np.eye(3)[[2, 1, 0]], (0.0, 4.0, 0.0), strict=True):
        side = np.sign(plane.normal @ normal)
        assert abs(plane.normal @ normal) > np.cos(np.radians(0.2))
        assert side * plane.offset == pytest.approx(offset, abs=0.01)
    assert find_planes(points[:2], normals[:2], 0.01) == []
    assert find_planes(points[-500:], normals[-500:], 0.01) == []  # clutter


def test_planes_are_fitted():
    R = Rotation.from_rotvec([0.3, 0.5, 0.1]).as_matrix()
    points = grid() @ R.T + [1, 2, 3]
    exact = fit_plane(points)
    assert exact.distances(points).max() < 1e-12
    assert abs(exact.normal @ R[:, 2]) == pytest.approx(1.0)
    outliers = np.random.default_rng(1).random((len(points) // 2, 3)) + np.array([1, 2, 3])
    robust = fit_plane_robustly(np.vstack([points, outliers]), 0.01)
    assert robust.distances(points).max() < 0.01
    np.testing.assert_allclose(np.abs(estimate_normals(grid())), np.tile([0, 0, 1.0], (len(grid()), 1)), atol=1e-9)
    with pytest.raises(InputError, match="2 points"):
        fit_plane(points[:2])


def test_walls_of_the_truth_measure_the_run():
    floor = Plane(np.array([0, 0, 1.0]), 0.0)
    truth = grid(step=0.05)
    normals = np.tile([0.0, 0.0, -1.0], (len(truth), 1))
    rng = np.random.default_rng(0)
    points = truth + np.array([0, 0, 0.04])  # flat, but 4 cm off
    wrong = rng.permutation(len(truth))[: len(truth) // 4]
    points[wrong, 2] += 0.08
    points[rng.permutation(len(truth))[:40]] = np.nan
    collector = WallCollector([floor])
    collector.add(truth, normals, points, points)
    m = collector.metrics((0.01, 0.05, 0.15))
    known = np.isfinite(points[:, 0])
    good = np.count_nonzero(np.isclose(points[known, 2], 0.04))
    assert m.walls[0].pixels == len(truth)
    assert m.walls[0].points == np.count_nonzero(known)
    assert m.within == pytest.approx((good / known.sum(), good / known.sum(), 1.0))
    assert m.of_all == pytest.approx((good / len(truth), good / len(truth), known.mean()))
    assert m.of_truth == pytest.approx((0.0, good / known.sum(), 1.0))


def test_pixels_off_the_wall_do_not_count():
    floor = Plane(np.array([0, 0, 1.0]), 0.0)
    truth = grid(step=0.05)
    normals = np.tile([0.0, 0.0, 1.0], (len(truth), 1))
    truth[: len(truth) // 2, 2] = 0.5  # a table top
    normals[-20:] = [1.0, 0.0, 0.0]
    collector = WallCollector([floor])
    collector.add(truth, normals, truth, truth)
    assert collector.metrics().walls[0].pixels == len(truth) - len(truth) // 2 - 20
    empty = WallCollector([floor]).metrics()
    assert np.isnan(empty.within).all()
    none = WallCollector([]).metrics()
    assert (none.walls, np.isnan(none.of_truth).all()) == ((), True)


def test_walls_found_in_points():
    points, normals = room()
    assert len(true_walls(points, normals)) == 3
    m = walls_of_points(points, normals)
    assert (len(m.walls), m.found_in) == (3, "the points")
    assert [wall.points >= count for wall, count in zip(m.walls, (4000, 2000, 1000), strict=True)] == [True] * 3
    assert m.within[0] > 0.95
    assert m.within[-1] == 1.0
    assert np.isnan(m.of_all).all()
    rough = walls_of_points(room(noise=0.02)[0])
    assert 0.05 < rough.within[0] < 0.35 < 0.6 < rough.within[3]
    nothing = walls_of_points(points[-500:], normals[-500:])
    assert (nothing.walls, np.isnan(nothing.within).all()) == ((), True)
