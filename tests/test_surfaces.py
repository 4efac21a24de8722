"""Dense depth from planes and free surfaces, on scenes with known answers."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import MATERIALS, TYPICAL, WIDE, polarization_of

from polarmap.densify.result import Origin, OtherView, extrapolation_sigma
from polarmap.densify.surfaces import SurfaceOptions, find_surfaces
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.stereo.patchmatch import stabilized
from polarmap.synth import Material, Pattern, Scene, Texture, built_in_scene, render, scenes

CAMERA = PinholeCamera(160, 120, 120.0, 120.0, 79.5, 59.5)
ODD = PinholeCamera(151, 113, 110.0, 112.0, 76.0, 55.0)
TEXTURED = MATERIALS["textured"]


class View:
    """A rendering, its polarization image, and points where the scene has texture."""

    def __init__(self, scene: Scene, camera=CAMERA, T=None, share: float = 0.5, noise: float = 0.002):
        rng = np.random.default_rng(0)
        self.camera = camera
        self.rendering = render(scene, camera, np.eye(4) if T is None else T, supersample=2)
        self.image = polarization_of(self.rendering, TYPICAL, seed=0)
        self.stable = stabilized(self.image.intensity)
        textured = [i for i, material in enumerate(scene.materials) if material.texture is not None]
        at = np.isin(self.rendering.material, textured) & (rng.random(camera.shape) < share)
        jitter = 1 + noise * rng.standard_normal(camera.shape)
        self.points = np.where(at, self.rendering.depth * jitter, np.nan).astype(np.float32)
        self.free = np.full(camera.shape, np.nanmedian(self.points), np.float32)

    def surfaces(self, points=None, free=None, image=None, others=(), **options):
        points = self.points if points is None else points
        free = [self.free] if free is None else free
        image = image or self.image
        return find_surfaces(
            points, free, image, self.stable, self.camera, others, SurfaceOptions(cells=1200, **options)
        )

    def error(self, depth: np.ndarray) -> np.ndarray:
        return np.abs(depth / self.rendering.depth - 1.0)


@pytest.fixture(scope="module")
def room() -> View:
    room = built_in_scene("room")
    return View(room.scene, T=room.path(frames=1)[1][0])


def test_most_of_a_room_is_right_though_most_of_it_is_bare(room):
    found = room.surfaces()
    assert np.isfinite(room.points).mean() < 0.2
    error = room.error(found.dense.depth)
    assert np.isfinite(error).all() and (error < 0.02).mean() > 0.6
    sigma = found.dense.sigma
    surest = np.argsort(sigma.ravel())[: sigma.size // 2]
    assert error.ravel()[surest].mean() < 0.5 * error.mean()
    assert 0.5 < (error < sigma).mean() < 0.95


def test_two_walls_meet_where_they_do():
    corner = scenes.corner(TEXTURED, replace(TEXTURED, name="other", albedo=0.3), turn=0.6)
    view = View(corner, share=0.2)
    error = view.error(view.surfaces().dense.depth)
    assert (error < 0.01).mean() > 0.95


def test_a_bare_wall_is_carried_to_by_its_other_half():
    """The wall's right half is textured; its left half is bare and has no point."""
    texture = Texture(Pattern.NOISE, 0.2, 0.9, octaves=3, seed=1)
    bare = Material("bare", albedo=0.45, gloss=0.0)
    wall = scenes.corner(bare, Material("textured", albedo=0.45, texture=texture, gloss=0.0), turn=1e-3)
    view = View(wall)
    left = view.error(view.surfaces().dense.depth)[:, :70]
    assert (left < 0.02).mean() > 0.9


def test_four_equal_channels_are_as_if_polarization_did_not_count(room):
    zero = np.zeros(CAMERA.shape, np.float32)
    blind = replace(room.image, dolp=zero, aolp=zero)
    np.testing.assert_array_equal(room.surfaces(image=blind).dense.depth, room.surfaces(polarization=0.0).dense.depth)


def test_a_bad_free_surface_does_no_harm_beside_a_good_one(room):
    bad = (6.0 - room.rendering.depth).clip(0.5).astype(np.float32)
    good, both = (room.surfaces(free=free).dense.depth for free in ([room.free], [room.free, bad]))
    assert np.mean(room.error(both) < 0.02) > np.mean(room.error(good) < 0.02) - 0.03


def test_where_nothing_else_is_known_the_points_stay(room):
    few = np.full(CAMERA.shape, np.nan, np.float32)
    few[40:42, 50:55] = 2.0
    found = room.surfaces(points=few, free=[])
    np.testing.assert_array_equal(found.dense.depth, few)
    assert (found.dense.origin[np.isfinite(few)] == Origin.STEREO).all()
    nothing = room.surfaces(points=np.full_like(few, np.nan))
    assert np.isnan(nothing.dense.depth).all() and (nothing.dense.origin == Origin.NONE).all()


def test_a_hole_in_the_free_surface_is_filled_by_planes(room):
    holed = np.where(np.arange(160) < 80, room.free, np.nan).astype(np.float32)
    found = room.surfaces(free=[holed])
    assert np.isfinite(found.dense.depth).mean() > 0.95


def test_scale_drops_out(room):
    small = room.surfaces()
    large = room.surfaces(points=64 * room.points, free=[64 * room.free])
    np.testing.assert_allclose(large.dense.depth, 64 * small.dense.depth, rtol=1e-5)
    np.testing.assert_allclose(large.dense.sigma, small.dense.sigma, rtol=1e-3)


def test_origin_and_distance(room):
    found = room.surfaces()
    stereo = np.abs(room.points / found.dense.depth - 1.0) < 0.015
    np.testing.assert_array_equal(found.dense.origin == Origin.STEREO, stereo)
    np.testing.assert_array_equal(found.dense.distance == 0, stereo)
    planar = (found.dense.origin == Origin.PROPAGATED) & ~stereo
    assert (found.label[planar] < len(found.planes)).all() and planar.any()


def test_a_view_that_disagrees_raises_sigma(room):
    other = OtherView(room.stable, np.eye(4), 1.2 * room.rendering.depth)
    agreeing = OtherView(room.stable, np.eye(4), room.rendering.depth)
    doubted, believed = (room.surfaces(others=[view]).dense for view in (other, agreeing))
    right = room.error(believed.depth) < 0.02
    np.testing.assert_allclose(doubted.sigma[right], 2 * believed.sigma[right], rtol=1e-5)


def test_sizes_that_are_no_multiple_of_a_cell():
    view = View(scenes.plane(TEXTURED), camera=ODD, share=0.1)
    assert (view.error(view.surfaces().dense.depth) < 0.01).mean() > 0.98


def test_what_does_not_fit_is_refused(room):
    with pytest.raises(InputError, match=r"points \(90, 120\) does not fit the camera \(120, 160\)"):
        room.surfaces(points=np.ones(WIDE.shape, np.float32))
    with pytest.raises(InputError, match="surface"):
        room.surfaces(free=[room.free[1:]])


def test_sigma_grows_with_the_distance():
    distance = np.float32([[0.0, 10.0, 200.0]])
    sigma = extrapolation_sigma(distance)
    assert sigma[0, 0] == pytest.approx(0.004) and (np.diff(sigma[0]) > 0).all()
