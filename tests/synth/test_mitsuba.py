"""Mitsuba scenes: the frames of its Stokes vectors, and one scene through both renderers."""

from __future__ import annotations

import builtins

import numpy as np
import pytest

from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import look_at
from polarmap.io.recording.sequence import open_sequence
from polarmap.synth import Box, Cylinder, Material, Prism, Rectangle, Revolved, Scene, Sensor, Sphere, render
from polarmap.synth.mitsuba.export import mean_transmittance, write_mitsuba_scene
from polarmap.synth.mitsuba.recording import exposed, path_around, render_frames
from polarmap.synth.mitsuba.stokes_basis import to_image_plane
from polarmap.synth.mitsuba.variant import PLAIN, import_mitsuba
from polarmap.synth.mitsuba.view import centre_distance, geometry, load_scene, render_stokes
from polarmap.synth.recording import write_sequence
from polarmap.synth.scenes import BLACK_GLASS, MATTE, sphere

CAMERA = PinholeCamera(width=24, height=18, fx=16.5, fy=16.5, cx=11.5, cy=8.5)  # 72 degrees wide
UP = np.array([0.0, -1.0, 0.0])
ROLLED = look_at((0.1, 0.0, -0.1), (0.3, -0.1, 1.6), (0.3, -1.0, 0.1))


@pytest.fixture
def mitsuba_installed():
    """The test is skipped where Mitsuba is not installed."""
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed (pip install mitsuba)")


def degree(stokes: np.ndarray) -> np.ndarray:
    return np.hypot(stokes[1], stokes[2]) / stokes[0]


def angle(stokes: np.ndarray) -> np.ndarray:
    return 0.5 * np.arctan2(stokes[2], stokes[1])


def between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.abs((a - b + np.pi / 2) % np.pi - np.pi / 2))


def on_axis(s1: float, s2: float, vertical=UP) -> np.ndarray:
    stokes = np.array([1.0, s1, s2]).reshape(3, 1, 1)
    return to_image_plane(stokes, np.array([[[0.0, 0.0, 1.0]]]), np.asarray(vertical))[:, 0, 0]


def test_on_the_axis_the_angle_changes_its_sense_and_nothing_else():
    np.testing.assert_allclose(on_axis(0.3, 0.0), [1.0, 0.3, 0.0], atol=1e-12)  # level stays level
    np.testing.assert_allclose(on_axis(0.0, 0.2), [1.0, 0.0, -0.2], atol=1e-12)  # 45 degrees up right
    np.testing.assert_allclose(on_axis(0.3, 0.0, vertical=(1.0, 0.0, 0.0)), [1.0, -0.3, 0.0], atol=1e-12)


def test_off_the_axis_fields_are_seen_where_the_plane_through_the_ray_cuts_the_image():
    """A field in the plane spanned by the ray and a direction n is seen along n_xy - n_z·(x, y)."""
    rng = np.random.default_rng(0)
    rays, n = rng.uniform(-0.8, 0.8, (1, 50, 3)), rng.normal(size=(1, 50, 3))
    rays[..., 2] = 1.0
    v = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    x = np.cross(v, UP)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    psi = np.arctan2((n * -np.cross(v, x)).sum(-1), (n * x).sum(-1))
    stokes = np.stack([np.ones((1, 50)), 0.4 * np.cos(2 * psi), 0.4 * np.sin(2 * psi)])
    image = to_image_plane(stokes, rays, UP)
    seen = n[..., :2] - n[..., 2:] * rays[..., :2]
    assert between(angle(image), np.arctan2(seen[..., 1], seen[..., 0])).max() < 1e-6
    np.testing.assert_allclose(degree(image), 0.4, atol=1e-12)


def test_mean_transmittance_is_what_tables_say():
    assert mean_transmittance(1.5) == pytest.approx(1 - 0.0918, abs=2e-4)  # diffuse Fresnel reflectance, Duntley 1942
    assert mean_transmittance(1.0 + 1e-9) == pytest.approx(1.0, abs=1e-3)


@pytest.mark.parametrize("material", [BLACK_GLASS, MATTE, Material("plastic", albedo=0.3)], ids=lambda m: m.name)
def test_one_sphere_through_both_renderers(mitsuba_installed, tmp_path, material):
    """Under a uniform surround both have the same closed form of a convex body; the paths' noise is left."""
    spp = 2048 if material.albedo and material.gloss else 512
    scene = Scene(sphere(material, centre=(0.5, -0.3, 1.5), radius=0.75).primitives, None, 1.0)
    write_mitsuba_scene(tmp_path / "scene.xml", scene, CAMERA, ROLLED)
    loaded = load_scene(tmp_path / "scene.xml")
    assert (loaded.width, loaded.height) == (24, 18) and loaded.fov == pytest.approx(72.06, abs=0.01)
    np.testing.assert_allclose(loaded.T_world_camera, ROLLED, atol=1e-6)
    theirs, ours = render_stokes(loaded, CAMERA, ROLLED, spp, 4, seed=0), render(scene, CAMERA, ROLLED, 4)
    depth, normal = geometry(loaded, CAMERA, ROLLED)
    hit = np.isfinite(ours.depth)
    np.testing.assert_array_equal(np.isfinite(depth), hit)
    np.testing.assert_allclose(depth[hit], ours.depth[hit], atol=1e-4)
    np.testing.assert_allclose(normal[hit], ours.normal[hit], atol=1e-4)
    inner = hit & (degree(ours.stokes) > 0.04)
    inner[1:-1, 1:-1] &= hit[2:, 1:-1] & hit[:-2, 1:-1] & hit[1:-1, 2:] & hit[1:-1, :-2]
    assert inner.sum() > 30
    assert np.median(between(angle(theirs), angle(ours.stokes))[inner]) < 0.5
    assert np.percentile(between(angle(theirs), angle(ours.stokes))[inner], 90) < 1.0
    assert np.percentile(np.abs(degree(theirs) - degree(ours.stokes))[inner], 90) < 0.01
    assert np.median(theirs[0][inner] / ours.stokes[0][inner]) == pytest.approx(1.0, abs=0.01)


def test_all_shapes_are_exported_where_they_stand(mitsuba_installed, tmp_path):
    def at(x: float, y: float) -> np.ndarray:
        place = look_at((0, 0, 0), (0.5, 0.7, 0.4))
        place[:3, 3] = x, y, 3.0
        return place

    behind = np.eye(4)
    behind[2, 3] = 4.5
    scene = Scene(
        (
            Rectangle(MATTE, behind),
            Sphere(MATTE, at(-1.2, -0.8), radius=0.5),
            Box(MATTE, at(0.0, -0.8), size=(0.8, 0.6, 0.4)),
            Cylinder(MATTE, at(1.2, -0.8), radius=0.3, height=0.7),
            Revolved(MATTE, at(-1.0, 0.7), bottom=0.4, middle=0.2, top=0.3, height=0.8),
            Prism(MATTE, at(0.9, 0.7), height=0.5, rounding=0.1),
        )
    )
    camera = CAMERA.scaled(3.0)
    write_mitsuba_scene(tmp_path / "scene.xml", scene, camera, np.eye(4))
    depth, normal = geometry(load_scene(tmp_path / "scene.xml"), camera, np.eye(4))
    ours = render(scene, camera, np.eye(4))
    assert (np.abs(depth - ours.depth) < 0.005).mean() > 0.985  # tessellated outlines apart
    assert ((normal * ours.normal).sum(-1) > 0.999).mean() > 0.97
    assert len(list(tmp_path.glob("scene_*.ply"))) == 2


def test_a_sequence_is_written_and_the_same_for_the_same_seed(mitsuba_installed, tmp_path):
    scene = sphere(MATTE)
    write_mitsuba_scene(tmp_path / "scene.xml", scene, CAMERA, np.eye(4))
    loaded = load_scene(tmp_path / "scene.xml", PLAIN)
    assert centre_distance(loaded) == pytest.approx(2.0 - np.sqrt(0.36 - 0.05), abs=0.03)
    timestamps, poses = path_around(loaded, 2, None, 20.0)
    assert timestamps.tolist() == [0.0, 0.05]
    sensor = exposed(loaded, CAMERA, poses[0], Sensor(shutter=0.5))
    runs = [list(render_frames(loaded, CAMERA, timestamps, poses, sensor, 16, 3)) for _ in range(2)]
    for one, again in zip(*runs, strict=True):
        np.testing.assert_array_equal(one.mosaic, again.mosaic)
    assert 60 < np.median(runs[0][0].mosaic) < 120  # 35 % of 255
    write_sequence(tmp_path / "out", runs[0], CAMERA, sensor)
    assert len(open_sequence(tmp_path / "out")) == 2


def test_without_mitsuba_one_line_says_how_to_get_it(monkeypatch, tmp_path):
    true_import = builtins.__import__

    def without(name, *arguments, **more):
        if name == "mitsuba":
            raise ImportError(name)
        return true_import(name, *arguments, **more)

    monkeypatch.setattr(builtins, "__import__", without)
    with pytest.raises(PolarmapError, match="pip install"):
        load_scene(tmp_path / "scene.xml")


def test_broken_scenes_and_unknown_variants_are_refused(mitsuba_installed, tmp_path):
    with pytest.raises(InputError, match=r"absent\.xml"):
        load_scene(tmp_path / "absent.xml")
    (tmp_path / "broken.xml").write_text("<scene version='3.0.0'><shape")
    with pytest.raises(InputError, match=r"broken\.xml"):
        load_scene(tmp_path / "broken.xml")
    with pytest.raises(InputError, match="scalar_rgb"):
        import_mitsuba("scalar_rgb")
