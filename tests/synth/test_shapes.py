"""Surfaces of revolution and rounded prisms: hits against marching, normals against finite differences, meshes."""

from __future__ import annotations

import math

import numpy as np
import pytest

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import look_at
from polarmap.synth import Box, Cylinder, Material, PointLight, Prism, Rectangle, Revolved, Scene, Sphere, render
from polarmap.synth.bounding import bounding_tree
from polarmap.synth.meshes import shape_mesh
from polarmap.synth.raycast import closest_hit, normal_at, pack
from polarmap.synth.scenes import plane

GREY = Material("grey")
TURNED = look_at((0.0, 0.0, 0.0), (0.3, -0.5, 0.8), (0.1, 0.9, 0.2))[:3, :3]
PENTAGON = ((-0.5, -0.4), (0.3, -0.5), (0.6, 0.1), (0.1, 0.5), (-0.4, 0.3))
SHAPES = {
    "frustum": Revolved(GREY, bottom=0.5, middle=0.35, top=0.2, height=0.8),
    "ellipsoid": Revolved(GREY, bottom=0.0, middle=0.4, top=0.0, height=1.2),
    "waist": Revolved(GREY, bottom=0.5, middle=0.2, top=0.4, height=1.0),
    "barrel": Revolved(GREY, bottom=0.3, middle=0.5, top=0.2, height=0.9),
    "prism": Prism(GREY, outline=PENTAGON, height=0.5, rounding=0.15),
    "sharp": Prism(GREY, outline=PENTAGON, height=0.5, rounding=0.0),
    "rounded cube": Prism(GREY, height=1.0, rounding=0.3),
}


def inside(shape, points: np.ndarray) -> np.ndarray:
    """A function that is negative inside a shape's solid, positive outside, of points N×3 of its frame."""
    x, y, z = np.moveaxis(points, -1, 0)
    if isinstance(shape, Revolved):
        s, low, mid, high = 2.0 * z / shape.height, shape.bottom**2, shape.middle**2, shape.top**2
        lagrange = low * s * (s - 1) / 2 + mid * (1 - s * s) + high * s * (s + 1) / 2
        return np.maximum(x * x + y * y - lagrange, np.abs(s) - 1.0)
    corners = np.array(shape.outline)
    edges = np.roll(corners, -1, axis=0) - corners
    to_point = np.stack([x, y], axis=-1)[:, None] - corners
    along = np.clip((to_point * edges).sum(-1) / (edges**2).sum(-1), 0.0, 1.0)
    apart = np.linalg.norm(to_point - along[..., None] * edges, axis=-1).min(axis=1)
    within = (edges[:, 0] * to_point[..., 1] - edges[:, 1] * to_point[..., 0] >= 0).all(axis=1)
    outline = np.where(within, -apart, apart)
    above = np.abs(z) - shape.height / 2
    beside = np.hypot(np.maximum(outline, 0.0), np.maximum(above, 0.0))
    return beside + np.minimum(np.maximum(outline, above), 0.0) - shape.rounding


def rays(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Origins on a sphere of radius 3 and directions (not of unit length) to points about the middle."""
    rng = np.random.default_rng(seed)
    origins = rng.normal(size=(count, 3))
    origins *= 3.0 / np.linalg.norm(origins, axis=1, keepdims=True)
    return origins, 0.4 * (rng.uniform(-0.9, 0.9, (count, 3)) - origins)


def hits(shape, origins: np.ndarray, directions: np.ndarray):
    packed = pack(Scene((shape,)), np.eye(4))
    t = np.array(
        [closest_hit(packed, tuple(p), tuple(d), math.inf)[1] for p, d in zip(origins, directions, strict=True)]
    )
    return t, packed.primitives[0]


@pytest.mark.parametrize("name", SHAPES)
def test_hits_are_where_marching_enters_the_solid(name):
    shape = SHAPES[name]
    origins, directions = rays(200)
    t, _ = hits(shape, origins, directions)
    steps = np.linspace(0.5, 3.5, 1501)
    values = inside(shape, (origins[:, None] + steps[:, None] * directions[:, None]).reshape(-1, 3)).reshape(200, -1)
    enters = (values < 0.0).any(axis=1)
    first = steps[(values < 0.0).argmax(axis=1)]
    assert 25 < enters.sum() < 195
    assert (np.isfinite(t) >= enters).all() and (np.isfinite(t) != enters).mean() < 0.02  # grazing ones apart
    assert (np.abs(t - first)[enters] <= 1.001 * (steps[1] - steps[0])).mean() > 0.98
    hit = np.isfinite(t)
    np.testing.assert_allclose(inside(shape, origins[hit] + t[hit, None] * directions[hit]), 0.0, atol=1e-7)


@pytest.mark.parametrize("name", SHAPES)
def test_from_inside_the_far_side_is_hit(name):
    shape = SHAPES[name]
    _, directions = rays(60, seed=1)
    t, _ = hits(shape, np.zeros((60, 3)), directions)
    assert np.isfinite(t).all()
    np.testing.assert_allclose(inside(shape, t[:, None] * directions), 0.0, atol=1e-7)
    assert (inside(shape, 0.99 * t[:, None] * directions) < 0).all()


@pytest.mark.parametrize("name", SHAPES)
def test_normals_are_the_gradient_of_the_solid(name):
    shape = SHAPES[name]
    origins, directions = rays(200, seed=2)
    t, primitive = hits(shape, origins, directions)
    hit = np.isfinite(t)
    points = origins[hit] + t[hit, None] * directions[hit]
    normals = np.array([normal_at(primitive, tuple(p)) for p in points])
    steps = 1e-6 * np.eye(3)
    gradient = np.stack([inside(shape, points + h) - inside(shape, points - h) for h in steps], axis=-1)
    gradient /= np.linalg.norm(gradient, axis=-1, keepdims=True)
    assert (np.abs((normals * gradient).sum(-1) - 1.0) < 1e-5).mean() > 0.98  # an edge between two faces apart


def test_a_revolved_is_the_sphere_and_the_cylinder_that_it_can_be():
    camera = PinholeCamera(width=41, height=31, fx=40.0, fy=40.0, cx=20.0, cy=15.0)
    place = np.eye(4)
    place[:3, :3], place[:3, 3] = TURNED, (0.1, -0.1, 3.0)
    pairs = [
        (Sphere(GREY, place, radius=0.6), Revolved(GREY, place, 0.0, 0.6, 0.0, 1.2)),
        (Cylinder(GREY, place, radius=0.4, height=1.0), Revolved(GREY, place, 0.4, 0.4, 0.4, 1.0)),
        (Box(GREY, place, size=(1.0, 1.0, 0.8)), Prism(GREY, place, height=0.8, rounding=0.0)),
    ]
    for one, other in pairs:
        a, b = (render(Scene((shape,)), camera, np.eye(4)) for shape in (one, other))
        np.testing.assert_allclose(a.depth, b.depth, atol=1e-5)
        np.testing.assert_allclose(a.normal, b.normal, atol=1e-5)
        assert np.isfinite(a.depth).sum() > 100


def test_many_things_are_hit_as_if_each_were_asked():
    """The tree of bounding spheres leaves nothing out."""
    rng = np.random.default_rng(3)
    things = [Rectangle(GREY, look_at((0, 0, -1.5), (0, 0.1, 3)))]
    for shape in (Sphere, Box, Revolved, Prism):
        for _ in range(6):
            place = np.eye(4)
            place[:3, :3] = TURNED
            place[:3, 3] = rng.uniform(-1.5, 1.5, 3)
            size = (
                {"size": (0.3, 0.4, 0.5)} if shape is Box else {"radius": 0.3} if shape is Sphere else {"height": 0.4}
            )
            things.append(shape(GREY, place, **size))
    origins, directions = rays(150, seed=4)
    together, _ = hits_of(things, origins, directions)
    alone = np.min([hits_of([thing], origins, directions)[0] for thing in things], axis=0)
    np.testing.assert_array_equal(together, alone)


def hits_of(things, origins, directions):
    packed = pack(Scene(tuple(things)), np.eye(4))
    found = [closest_hit(packed, tuple(p), tuple(d), math.inf) for p, d in zip(origins, directions, strict=True)]
    return np.array([t for _, t in found]), packed


def test_a_tree_holds_each_sphere_once_and_inside_those_above_it():
    rng = np.random.default_rng(5)
    centres, radii = rng.normal(size=(20, 3)), np.append(rng.uniform(0.1, 0.3, 19), np.inf)
    tree = bounding_tree(centres, radii)
    assert sorted(tree["primitive"][tree["primitive"] >= 0]) == list(range(20))
    assert len(bounding_tree(np.empty((0, 3)), np.empty(0))) == 0
    for i, node in enumerate(tree):
        within = tree[i : i + node["leap"]]
        for below in within[within["primitive"] >= 0]:
            apart = np.linalg.norm(node["centre"] - below["centre"])
            assert apart + np.sqrt(below["bound"]) <= np.sqrt(node["bound"]) + 1e-9


def test_light_of_several_lamps_adds_up():
    camera = PinholeCamera(width=31, height=21, fx=30.0, fy=30.0, cx=15.0, cy=10.0)
    wall = plane(Material("shiny", albedo=0.5, shininess=20.0)).primitives
    lamps = PointLight((0.5, -0.5, 0.0), 3.0), PointLight((-0.8, 0.3, 0.4), 2.0)
    both, first, second, none = (
        render(Scene(wall, light, surround=0.4), camera, np.eye(4)).stokes[0] for light in (lamps, *lamps, None)
    )
    np.testing.assert_allclose(both - none, first - none + second - none, atol=1e-5)
    assert (first - none).max() > 0.1 and (second - none).max() > 0.1


@pytest.mark.parametrize("name", SHAPES)
def test_a_mesh_lies_on_its_shape_and_faces_outward(name):
    shape = SHAPES[name]
    mesh = shape_mesh(shape)
    np.testing.assert_allclose(inside(shape, mesh.vertices).max(), 0.0, atol=1e-9)
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1)[np.unique(mesh.faces)], 1.0, atol=1e-9)
    a, b, c = (mesh.vertices[mesh.faces[:, i]] for i in range(3))
    outward = np.cross(b - a, c - a)
    assert ((outward * mesh.normals[mesh.faces].mean(axis=1)).sum(-1) > 0).all()
    volume = (a * np.cross(b, c)).sum() / 6.0
    sample = np.random.default_rng(6).uniform(-1.0, 1.0, (40000, 3))
    assert volume == pytest.approx(8.0 * (inside(shape, sample) < 0).mean(), rel=0.06)


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: Revolved(GREY, bottom=-0.1), "radii"),
        (lambda: Revolved(GREY, bottom=1.0, middle=0.1, top=0.1), "positive radius"),
        (lambda: Revolved(GREY, height=0.0), "size of a revolved"),
        (lambda: Prism(GREY, outline=((0, 0), (1, 0))), "3 to 8 corners"),
        (lambda: Prism(GREY, outline=((0, 0), (0, 1), (1, 0))), "counter-clockwise"),
        (lambda: Prism(GREY, outline=((0, 0), (1, 0), (0.1, 0.1), (0, 1))), "convex"),
        (lambda: Prism(GREY, rounding=-1.0), "rounding"),
    ],
)
def test_impossible_shapes_are_refused(make, what):
    with pytest.raises(InputError, match=what):
        make()
