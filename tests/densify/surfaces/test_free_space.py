"""What other views see through, against plain NumPy."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import WIDE, moved, plane_depth, turned

from polarmap.data.view import Sighting
from polarmap.densify.surfaces.free_space import hidden_points
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.cells import cell_camera
from polarmap.geometry.pose import inverse

CELL = 4
ODD = PinholeCamera(width=121, height=88, fx=90.0, fy=92.0, cx=59.5, cy=44.5)  # neither blocks nor cells fit in


def nearest_of(depth: np.ndarray) -> np.ndarray:
    """Of blocks of 3×3 pixels, one by one; NaN where there is nothing."""
    blocks = np.full([-(-size // 3) for size in depth.shape], np.nan, np.float32)
    for i, j in np.ndindex(blocks.shape):
        block = depth[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        if np.isfinite(block).any():
            blocks[i, j] = np.nanmin(block)
    return blocks


def sighting(T_world_camera: np.ndarray, depth: np.ndarray) -> Sighting:
    """Of all of a depth map, for a view at the origin."""
    return Sighting(nearest_of(depth), inverse(T_world_camera))


def middles(*depths: float, camera: PinholeCamera = WIDE) -> np.ndarray:
    """Inverse depth of planes parallel to the image."""
    cells = cell_camera(camera, CELL).shape
    return np.stack([np.full(cells, 1.0 / z, np.float32) for z in depths], axis=-1)


def by_numpy(surface: np.ndarray, other: Sighting, camera: PinholeCamera) -> np.ndarray:
    """Cell by cell in float64: whether the points in the projection's block are more than 4 % behind the surface."""
    hidden = np.zeros(surface.shape)
    for i, j in np.ndindex(surface.shape):
        v, u = (min(k * CELL + CELL // 2, size - 1) for k, size in zip((i, j), camera.shape, strict=True))
        X = np.array([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, 1.0]) / surface[i, j]
        x, y, z = other.T_other_this[:3, :3] @ X + other.T_other_this[:3, 3]
        a, b = round(camera.fx * x / z + camera.cx), round(camera.fy * y / z + camera.cy)
        if z > 0 and 0 <= a < camera.width and 0 <= b < camera.height:
            hidden[i, j] = other.nearest[b // 3, a // 3] > 1.04 * z
    return hidden


def test_a_surface_before_what_another_view_sees_hides_it_and_one_behind_does_not():
    wall = plane_depth(WIDE, (0.0, 0.0, -1.0), 2.0).astype(np.float32)
    hidden = hidden_points(middles(1.5, 2.0, 3.0), [sighting(moved(0.05), wall)], WIDE, CELL)
    assert hidden.shape == (*middles(1.0).shape[:2], 3) and hidden.dtype == np.float32
    inside = np.s_[2:-2, 3:-3]
    assert (hidden[inside][..., 0] == 1).all()
    assert (hidden[..., 1:] == 0).all()


@pytest.mark.parametrize("camera", [WIDE, ODD])
def test_it_is_counted_as_by_numpy(camera):
    rng = np.random.default_rng(0)
    T = moved(0.2, -0.1, 0.1) @ turned((0.05, -0.2, 0.1))
    seen = rng.uniform(1.0, 3.0, camera.shape).astype(np.float32)
    seen[rng.random(camera.shape) < 0.9] = np.nan
    surface = rng.uniform(0.4, 0.9, middles(1.0, camera=camera).shape).astype(np.float32)
    others = [sighting(T, seen), sighting(inverse(T), seen)]
    assert 0.2 < np.isnan(others[0].nearest).mean() < 0.6
    expected = sum(by_numpy(surface[..., 0], other, camera) for other in others)
    found = hidden_points(surface, others, camera, CELL)[..., 0]
    assert (found == expected).mean() > 0.995 and expected.max() == 2


def test_each_surface_is_counted_by_itself():
    rng = np.random.default_rng(1)
    other = sighting(moved(0.1, 0.05) @ turned((0.1, 0.1, 0.0)), rng.uniform(1.0, 3.0, WIDE.shape).astype(np.float32))
    surfaces = middles(1.0, 1.3, 1.7)
    together = hidden_points(surfaces, [other], WIDE, CELL)
    for k in range(3):
        alone = hidden_points(surfaces[..., k : k + 1], [other], WIDE, CELL)
        np.testing.assert_array_equal(together[..., k : k + 1], alone)
    assert together[..., 0].sum() > together[..., 1].sum() > together[..., 2].sum() > 0


def test_the_nearest_of_a_block_decides():
    """One pixel in each block is before the surface: it would be hidden by nothing."""
    depth = np.full(WIDE.shape, 3.0, np.float32)
    assert hidden_points(middles(2.0), [sighting(np.eye(4), depth)], WIDE, CELL).all()
    depth[1::3, 2::3] = 1.5
    assert not hidden_points(middles(2.0), [sighting(np.eye(4), depth)], WIDE, CELL).any()


def test_views_without_points_and_surfaces_without_depth_say_nothing():
    nothing, wall = (np.full(WIDE.shape, z, np.float32) for z in (np.nan, 2.0))
    assert not hidden_points(middles(1.0), [sighting(moved(0.1), nothing)], WIDE, CELL).any()
    assert not hidden_points(middles(1.0), [], WIDE, CELL).any()
    surfaces = np.concatenate([-middles(1.0), 0.0 * middles(1.0)])
    assert not hidden_points(surfaces, [sighting(moved(0.1), wall)], WIDE, CELL).any()


def test_what_another_view_has_behind_it_or_beside_its_picture_is_not_hidden():
    wall = np.full(WIDE.shape, 9.0, np.float32)
    away = turned((0.0, np.pi, 0.0))
    assert not hidden_points(middles(1.0), [sighting(away, wall)], WIDE, CELL).any()
    aside = hidden_points(middles(1.0), [sighting(moved(0.7), wall)], WIDE, CELL)[..., 0]
    columns = np.minimum(np.arange(0, WIDE.width, CELL) + CELL // 2, WIDE.width - 1)
    np.testing.assert_array_equal(aside, np.broadcast_to(columns - 0.7 * WIDE.fx > -0.5, aside.shape))
