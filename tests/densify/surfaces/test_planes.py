"""Planes in space and in the image are the same planes, wherever they are seen from."""

from __future__ import annotations

import numpy as np
from scenes import plane_depth

from polarmap.densify.surfaces.planes import Candidates, evaluate_planes, in_image, in_space, seen_from
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse, look_at

OFF_CENTRE = PinholeCamera(width=160, height=120, fx=118.0, fy=125.0, cx=76.0, cy=63.0)
NORMALS = np.array([[0.5, -0.3, -0.8], [0.0, 0.2, -1.0], [-0.4, 0.4, -0.6]])
UNIT = NORMALS / np.linalg.norm(NORMALS, axis=1, keepdims=True)


def planes_at(distance: float) -> np.ndarray:
    """(α, β, γ) of planes whose ray through the image's middle is that long along z."""
    return np.array([n / (n @ [0.0, 0.0, distance]) for n in UNIT])


def test_a_plane_in_the_image_gives_its_inverse_depth():
    for normal in UNIT:
        depth = plane_depth(OFF_CENTRE, normal, 3.0)
        point = depth[70, 50] * np.append(OFF_CENTRE.normalized()[70, 50], 1.0)
        plane = normal / (normal @ point)
        found = evaluate_planes(in_image(plane[None], OFF_CENTRE), OFF_CENTRE.shape)[0]
        np.testing.assert_allclose(found * depth, 1.0, rtol=1e-4)


def test_there_and_back_is_the_same_plane():
    planes = planes_at(2.0)
    np.testing.assert_allclose(in_space(in_image(planes, OFF_CENTRE), OFF_CENTRE), planes, rtol=1e-12)


def test_a_plane_seen_from_elsewhere_holds_the_same_points():
    T = inverse(look_at((0.4, -0.2, 0.3), (0.1, 0.0, 2.0), (0.0, -1.0, 0.0)))
    planes = planes_at(2.0)
    moved = seen_from(planes, T)
    rng = np.random.default_rng(0)
    for plane, other in zip(planes, moved, strict=True):
        rays = rng.normal(size=(50, 3))
        points = rays / (rays @ plane)[:, None]
        np.testing.assert_allclose((points @ T[:3, :3].T + T[:3, 3]) @ other, 1.0, atol=1e-9)


def test_a_camera_that_has_passed_a_plane_does_not_see_it():
    ahead = np.array([[0.0, 0.0, 0.5], [0.0, 0.0, 0.1]])  # z = 2 and z = 10
    T = np.eye(4)
    T[2, 3] = -3.0  # 3 m forward
    np.testing.assert_allclose(seen_from(ahead, T), [[0.0, 0.0, 1 / 7]])
    assert seen_from(ahead[:0], T).shape == (0, 3)


def test_candidates_have_planes_first_and_nothing_where_a_free_one_says_nothing():
    """In the middle of cells, some of which the image's border cuts."""
    rng = np.random.default_rng(0)
    planes = np.array([0.5, 0.0, 0.0]) + rng.uniform(-0.01, 0.01, (2, 3))
    depth = rng.uniform(1.0, 3.0, (13, 18)).astype(np.float32)
    depth[4:8, 4:8], depth[0, 0] = np.nan, -1.0
    candidates = Candidates.of(planes, [depth, 2.0 * depth], depth.shape)
    middles = candidates.middles(4)
    assert len(candidates) == 4 and middles.shape == (4, 5, 4) and middles.dtype == np.float32
    for i, j in np.ndindex(4, 5):
        v, u = min(4 * i + 2, 12), min(4 * j + 2, 17)
        free = [1.0 / depth[v, u], 0.5 / depth[v, u]] if depth[v, u] > 0 else [0.0, 0.0]
        expected = [*evaluate_planes(planes, depth.shape)[:, v, u], *free]
        np.testing.assert_allclose(middles[i, j], expected, rtol=1e-6)
