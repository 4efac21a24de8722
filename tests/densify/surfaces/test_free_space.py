"""What other views see through, against plain NumPy."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import WIDE, moved, plane_depth, turned

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.view import Neighbour, View
from polarmap.densify.surfaces.free_space import hidden_points
from polarmap.geometry.cells import cell_middles
from polarmap.geometry.pose import inverse

CELL = 4
NOTHING = np.zeros(WIDE.shape, np.float32)


def neighbour(T_world_camera: np.ndarray, seen: np.ndarray | None) -> Neighbour:
    return Neighbour(NOTHING, inverse(T_world_camera), None, seen)


def middles(*depths: float) -> np.ndarray:
    """Inverse depth of planes parallel to the image."""
    surfaces = np.array([np.full(WIDE.shape, 1.0 / z, np.float32) for z in depths])
    return cell_middles(surfaces, CELL)


def by_numpy(surface: np.ndarray, other: Neighbour) -> np.ndarray:
    """Cell by cell in float64: whether all points around the projection are more than 4 % behind the surface."""
    hidden = np.zeros(surface.shape)
    for i, j in np.ndindex(surface.shape):
        v, u = (min(k * CELL + CELL // 2, size - 1) for k, size in zip((i, j), WIDE.shape, strict=True))
        X = np.array([(u - WIDE.cx) / WIDE.fx, (v - WIDE.cy) / WIDE.fy, 1.0]) / surface[i, j]
        x, y, z = other.T_other_this[:3, :3] @ X + other.T_other_this[:3, 3]
        a, b = round(WIDE.fx * x / z + WIDE.cx), round(WIDE.fy * y / z + WIDE.cy)
        if z > 0 and 1 <= a < WIDE.width - 1 and 1 <= b < WIDE.height - 1:
            around = other.seen[b - 1 : b + 2, a - 1 : a + 2]
            hidden[i, j] = np.isfinite(around).any() and np.nanmin(around) > 1.04 * z
    return hidden


def test_a_surface_before_what_another_view_sees_hides_it_and_one_behind_does_not():
    wall = plane_depth(WIDE, (0.0, 0.0, -1.0), 2.0).astype(np.float32)
    hidden = hidden_points(middles(1.5, 2.0, 3.0), [neighbour(moved(0.05), wall)], WIDE, CELL)
    assert hidden.shape == (*middles(1.0).shape[1:], 3) and hidden.dtype == np.float32
    inside = np.s_[2:-2, 3:-3]
    assert (hidden[inside][..., 0] == 1).all()
    assert (hidden[..., 1:] == 0).all()


def test_it_is_counted_as_by_numpy():
    rng = np.random.default_rng(0)
    T = moved(0.2, -0.1, 0.1) @ turned((0.05, -0.2, 0.1))
    seen = rng.uniform(1.0, 3.0, WIDE.shape).astype(np.float32)
    seen[rng.random(WIDE.shape) < 0.8] = np.nan
    surface = rng.uniform(0.4, 0.9, middles(1.0).shape).astype(np.float32)
    others = [neighbour(T, seen), neighbour(inverse(T), seen)]
    expected = sum(by_numpy(surface[0], other) for other in others)
    found = hidden_points(surface, others, WIDE, CELL)[..., 0]
    assert (found == expected).mean() > 0.995 and expected.max() == 2


@pytest.mark.parametrize("seen", [None, np.full(WIDE.shape, np.nan, np.float32)])
def test_views_without_points_say_nothing(seen):
    assert not hidden_points(middles(1.0), [neighbour(moved(0.1), seen)], WIDE, CELL).any()


def test_points_are_surely_there_where_stereo_and_the_dense_map_agree():
    image = PolarizationImage.unpolarized(np.ones((1, 3), np.float32))
    view = View(image, np.eye(4), stereo=np.float32([[2.0, 2.0, np.nan]]), depth=np.float32([[2.04, 2.2, 2.0]]))
    np.testing.assert_array_equal(view.seen, np.float32([[2.0, np.nan, np.nan]]))
    assert replace(view, depth=None).seen is None and replace(view, stereo=None).seen is None
