"""Depth, normals and material ids of the ray caster against closed forms."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import look_at
from polarmap.synth import Box, Cylinder, Material, Rectangle, Scene, Sphere, built_in_scene, render
from polarmap.synth.scenes import corner, edge, plane

CAMERA = PinholeCamera(width=81, height=61, fx=60.0, fy=62.0, cx=40.0, cy=30.0)
CENTRE = (30, 40)
GREY = Material("grey")
AT_ORIGIN = np.eye(4)


def placed(x: float, y: float, z: float, rotation: np.ndarray | None = None) -> np.ndarray:
    T = np.eye(4)
    T[:3, 3] = x, y, z
    if rotation is not None:
        T[:3, :3] = rotation
    return T


def view(*primitives, pose=AT_ORIGIN):
    return render(Scene(primitives), CAMERA, pose)


def points(rendering) -> np.ndarray:
    """Camera-frame points of every pixel, H×W×3."""
    xy = CAMERA.normalized()
    return np.concatenate([xy, np.ones((*xy.shape[:2], 1))], axis=-1) * rendering.depth[..., None]


def test_a_plane_has_the_depth_of_its_equation_and_one_normal():
    rendering = render(plane(distance=2.0, tilt=0.6, azimuth=0.5), CAMERA, AT_ORIGIN)
    normal = np.array([np.sin(0.6) * np.cos(0.5), np.sin(0.6) * np.sin(0.5), -np.cos(0.6)])
    np.testing.assert_allclose(points(rendering) @ normal, 2.0 * normal[2], rtol=1e-5)
    np.testing.assert_allclose(rendering.normal, np.broadcast_to(normal, rendering.normal.shape), atol=1e-6)


def test_a_sphere_is_hit_on_its_near_side_and_missed_beside_it():
    rendering = view(Sphere(GREY, placed(0.2, -0.1, 3.0), radius=0.8))
    hit = np.isfinite(rendering.depth)
    outward = (points(rendering) - [0.2, -0.1, 3.0])[hit]
    np.testing.assert_allclose(np.linalg.norm(outward, axis=-1), 0.8, atol=1e-5)
    np.testing.assert_allclose(rendering.normal[hit], outward / 0.8, atol=1e-5)
    assert rendering.depth[hit].max() < 3.0
    rays = CAMERA.rays()
    angle = np.arccos(rays @ np.array([0.2, -0.1, 3.0]) / np.linalg.norm([0.2, -0.1, 3.0]))
    np.testing.assert_array_equal(hit, angle < np.arcsin(0.8 / np.linalg.norm([0.2, -0.1, 3.0])))


def test_an_upright_cylinder_has_the_depth_of_its_circle():
    upright = look_at((0, 0, 0), (0, 1, 0))[:3, :3].T
    rendering = view(Cylinder(GREY, placed(0.0, 0.0, 2.0, upright), radius=0.5, height=1.0))
    x, y = np.moveaxis(CAMERA.normalized().astype(float), -1, 0)
    root = 4.0 - (1 + x**2) * (4.0 - 0.25)
    depth = (2.0 - np.sqrt(np.maximum(root, 0.0))) / (1 + x**2)
    inside = (root > 0) & (np.abs(depth * y) < 0.5)
    np.testing.assert_allclose(rendering.depth[inside], depth[inside], rtol=1e-5)
    assert np.isnan(rendering.depth[root < 0]).all()
    np.testing.assert_allclose(rendering.normal[inside][:, 1], 0.0, atol=1e-6)


def test_a_cylinder_looked_at_along_its_axis_shows_its_cap():
    rendering = view(Cylinder(GREY, placed(0.0, 0.0, 3.0), radius=0.5, height=2.0))
    assert rendering.depth[CENTRE] == pytest.approx(2.0)
    np.testing.assert_allclose(rendering.normal[CENTRE], [0.0, 0.0, -1.0], atol=1e-6)


def test_a_turned_box_shows_two_faces_that_meet_in_an_edge():
    turned = np.array([[1, 0, 1], [0, np.sqrt(2), 0], [-1, 0, 1]]) / np.sqrt(2)
    rendering = view(Box(GREY, placed(0.0, 0.0, 3.0, turned), size=(1.0, 1.0, 1.0)))
    assert rendering.depth[CENTRE] == pytest.approx(3.0 - np.sqrt(0.5))
    np.testing.assert_allclose(rendering.normal[30, 37], [-np.sqrt(0.5), 0, -np.sqrt(0.5)], atol=1e-6)
    np.testing.assert_allclose(rendering.normal[30, 43], [np.sqrt(0.5), 0, -np.sqrt(0.5)], atol=1e-6)


def test_a_box_is_a_room_from_inside():
    rendering = view(Box(GREY, size=(8.0, 4.0, 6.0)))
    xy = np.abs(CAMERA.normalized())
    expected = 1.0 / np.maximum(np.maximum(xy[..., 0] / 4.0, xy[..., 1] / 2.0), 1.0 / 3.0)
    np.testing.assert_allclose(rendering.depth, expected, rtol=1e-5)
    assert (np.einsum("hwc,hwc->hw", rendering.normal, CAMERA.rays()) < 0).all()


def test_a_rectangle_ends_at_its_borders():
    rendering = view(Rectangle(GREY, placed(0.0, 0.0, 2.0), width=1.0, height=0.5))
    hit = np.isfinite(rendering.depth)
    x, y = np.moveaxis(2.0 * CAMERA.normalized(), -1, 0)
    np.testing.assert_array_equal(hit, (np.abs(x) <= 0.5) & (np.abs(y) <= 0.25))


def test_the_nearest_surface_hides_the_others_and_gives_the_material():
    far, near = Material("far"), Material("near")
    scene = (Rectangle(far, placed(0, 0, 4)), Sphere(near, placed(0, 0, 2), radius=0.3))
    rendering = view(*scene)
    assert Scene(scene).materials == (far, near)
    assert rendering.material[CENTRE] == 1
    assert rendering.material[0, 0] == 0
    assert rendering.depth[CENTRE] == pytest.approx(1.7)


def test_where_nothing_is_hit_there_is_no_geometry():
    rendering = view(Sphere(GREY, placed(0, 0, -3)))
    assert np.isnan(rendering.depth).all() and np.isnan(rendering.normal).all()
    assert (rendering.material == -1).all() and (rendering.reflection == 0).all()
    np.testing.assert_allclose(rendering.stokes[0], 1.0)


def test_an_empty_scene_is_its_surround():
    rendering = render(Scene((), surround=0.7), CAMERA, AT_ORIGIN)
    np.testing.assert_allclose(rendering.stokes[0], 0.7)


@pytest.mark.parametrize("name", ["plane", "sphere", "cylinder", "edge", "corner", "room"])
def test_normals_are_those_of_the_depth(name):
    built_in = built_in_scene(name)
    pose = built_in.path(frames=1)[1][0]
    camera = PinholeCamera(width=161, height=121, fx=120.0, fy=120.0, cx=80.0, cy=60.0)
    rendering = render(built_in.scene, camera, pose)
    xy = camera.normalized().astype(float)
    position = np.concatenate([xy, np.ones((121, 161, 1))], axis=-1) * rendering.depth[..., None]
    across = position[1:-1, 2:] - position[1:-1, :-2]
    down = position[2:, 1:-1] - position[:-2, 1:-1]
    normal = np.cross(down, across)
    normal /= np.linalg.norm(normal, axis=-1, keepdims=True)
    agreement = np.einsum("hwc,hwc->hw", normal, rendering.normal[1:-1, 1:-1])
    agreement = agreement[np.isfinite(agreement)]
    assert np.median(agreement) > 0.9999
    assert (agreement > 0.99).mean() > 0.85  # the rest lies across an edge


def test_depth_of_one_view_is_found_from_another():
    """Pose and camera conventions: points of one frame, moved to another, lie where that one sees them."""
    built_in = built_in_scene("room")
    camera = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
    _, (T_world_a, T_world_b) = built_in.path(frames=2, step=0.1)
    a, b = (render(built_in.scene, camera, T) for T in (T_world_a, T_world_b))
    rays = np.concatenate([camera.normalized(), np.ones((120, 160, 1))], axis=-1)
    moved = np.linalg.inv(T_world_b) @ T_world_a
    in_b = (rays * a.depth[..., None]) @ moved[:3, :3].T + moved[:3, 3]
    u = np.rint(in_b[..., 0] / in_b[..., 2] * 120.0 + 79.5).astype(int)
    v = np.rint(in_b[..., 1] / in_b[..., 2] * 120.0 + 59.5).astype(int)
    seen = (u >= 0) & (u < 160) & (v >= 0) & (v < 120)
    difference = np.abs(b.depth[v[seen], u[seen]] - in_b[..., 2][seen])
    assert seen.mean() > 0.9
    assert np.median(difference) < 0.01


def test_the_edge_scene_jumps_and_the_corner_scene_does_not():
    jump = render(edge(gap=1.0), CAMERA, AT_ORIGIN).depth
    assert (np.abs(np.diff(jump, axis=1)) > 0.2).sum(axis=1).tolist() == [1] * 61
    crease = render(corner(), CAMERA, AT_ORIGIN)
    assert np.abs(np.diff(crease.depth, axis=1)).max() < 0.1
    assert crease.depth[CENTRE] == pytest.approx(2.0, abs=1e-6)
    assert (crease.normal[:, :40, 0] < 0).all() and (crease.normal[:, 41:, 0] > 0).all()


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Sphere(GREY, radius=0.0), "size of a sphere"),
        (lambda: Sphere(GREY, 2.0 * np.eye(4)), "pose of a sphere"),
        (lambda: Rectangle(GREY, width=np.nan), "size of a rectangle"),
        (lambda: Material("thin", eta=0.9), "eta of thin"),
        (lambda: Material("bright", albedo=1.2), "albedo of bright"),
        (lambda: Material("odd", gloss=np.nan), "gloss of odd"),
        (lambda: Material("odd", shininess=-1.0), "shininess of odd"),
        (lambda: built_in_scene("castle"), "castle"),
        (lambda: render(Scene(()), CAMERA, AT_ORIGIN, supersample=0), "supersample"),
    ],
)
def test_impossible_scenes_are_refused(make, what):
    with pytest.raises(InputError, match=what):
        make()
