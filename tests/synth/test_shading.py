"""Radiance and polarization of the simulator against the paper's equations and plain geometry."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.ndimage import map_coordinates

from polarmap.data.codes import Reflection
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.synth import Material, Pattern, PointLight, Rectangle, Scene, Sphere, Texture, built_in_scene, render
from polarmap.synth.scenes import BLACK_GLASS, MATTE, plane, sphere

CAMERA = PinholeCamera(width=96, height=72, fx=70.0, fy=70.0, cx=47.5, cy=35.5)
AT_ORIGIN = np.eye(4)


def dolp(stokes: np.ndarray) -> np.ndarray:
    return np.hypot(stokes[1], stokes[2]) / stokes[0]


def aolp(stokes: np.ndarray) -> np.ndarray:
    return 0.5 * np.arctan2(stokes[2], stokes[1])


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between undirected lines, radians in [0, pi/2]."""
    return np.abs((a - b + np.pi / 2) % np.pi - np.pi / 2)


def zenith(rendering, camera=CAMERA) -> np.ndarray:
    cosine = -np.einsum("hwc,hwc->hw", rendering.normal.astype(float), camera.rays())
    return np.arccos(np.clip(cosine, 0.0, 1.0))


def in_image(field: np.ndarray) -> np.ndarray:
    """Image-plane angle of field directions, H×W×3, that are perpendicular to their viewing rays."""
    rays = CAMERA.rays()
    flat = field[..., :2] - field[..., 2:] / rays[..., 2:] * rays[..., :2]
    return np.arctan2(flat[..., 1], flat[..., 0])


@pytest.fixture(scope="module")
def matte():
    return render(sphere(MATTE), CAMERA, AT_ORIGIN)


@pytest.fixture(scope="module")
def glass():
    return render(sphere(BLACK_GLASS), CAMERA, AT_ORIGIN)


def test_diffuse_degree_is_equation_5(matte):
    hit = np.isfinite(matte.depth)
    eta, theta = 1.5, zenith(matte)[hit]
    squared_sine = np.sin(theta) ** 2
    expected = (
        (eta - 1 / eta) ** 2
        * squared_sine
        / (4 * np.cos(theta) * np.sqrt(eta**2 - squared_sine) - (eta + 1 / eta) ** 2 * squared_sine + 2 * eta**2 + 2)
    )
    np.testing.assert_allclose(dolp(matte.stokes)[hit], expected, atol=2e-4)
    assert expected.max() > 0.2


def test_specular_degree_is_equation_6_and_reaches_one(glass):
    hit = np.isfinite(glass.depth)
    eta, theta = 1.5, zenith(glass)[hit]
    squared_sine = np.sin(theta) ** 2
    expected = (
        2 * squared_sine * np.cos(theta) * np.sqrt(eta**2 - squared_sine)
        / (eta**2 - squared_sine - eta**2 * squared_sine + 2 * squared_sine**2)
    )  # fmt: skip
    np.testing.assert_allclose(dolp(glass.stokes)[hit], expected, atol=2e-3)
    assert dolp(glass.stokes)[hit].max() > 0.99


def test_diffuse_light_is_polarized_along_the_plane_of_incidence(matte):
    tilted = zenith(matte) > 0.05
    rays = CAMERA.rays()
    field = matte.normal - np.einsum("hwc,hwc->hw", matte.normal, rays)[..., None] * rays
    assert angle_between(aolp(matte.stokes), in_image(field))[tilted].max() < 1e-3
    assert (matte.reflection[tilted] == Reflection.DIFFUSE).all()


def test_specular_light_is_polarized_across_the_plane_of_incidence(glass):
    tilted = zenith(glass) > 0.05
    field = np.cross(CAMERA.rays(), glass.normal)
    assert angle_between(aolp(glass.stokes), in_image(field))[tilted].max() < 1e-3
    assert (glass.reflection[tilted] == Reflection.SPECULAR).all()


def test_on_the_axis_a_matte_sphere_is_polarized_radially_from_x_toward_y():
    rendering = render(sphere(MATTE, centre=(0.0, 0.0, 2.0)), CAMERA, AT_ORIGIN)
    xy = CAMERA.normalized()
    hit = zenith(rendering) > 0.05
    radial = np.arctan2(xy[..., 1], xy[..., 0])
    assert angle_between(aolp(rendering.stokes), radial)[hit].max() < 1e-3
    below_right = rendering.stokes[:, 42, 54]
    assert below_right[2] > 0  # 45 degrees is down to the right: S2 = I45 - I135 > 0


def test_rolling_the_camera_by_90_degrees_turns_the_angle_by_90_degrees():
    camera = PinholeCamera(width=61, height=61, fx=60.0, fy=60.0, cx=30.0, cy=30.0)
    rolled = np.eye(4)
    rolled[:2, :2] = [[0.0, -1.0], [1.0, 0.0]]  # the camera's x is the world's y
    scene = built_in_scene("sphere").scene
    upright, turned = (render(scene, camera, T) for T in (AT_ORIGIN, rolled))
    back = np.rot90(turned.stokes, k=-1, axes=(1, 2))  # the pixel that sees the same point
    hit = zenith(upright, camera) > 0.05
    np.testing.assert_allclose(np.rot90(turned.depth, k=-1), upright.depth, rtol=1e-5)
    np.testing.assert_allclose(back[0], upright.stokes[0], rtol=1e-5)
    np.testing.assert_allclose(back[1:], -upright.stokes[1:], atol=1e-6)
    assert angle_between(aolp(back), aolp(upright.stokes) + np.pi / 2)[hit].max() < 1e-3


def test_diffuse_and_specular_light_add_before_the_angle_goes_to_the_image(glass):
    """Each is polarized across the other, so degrees subtract and the stronger one decides the angle, exactly."""
    matte = render(sphere(Material("bright matte", albedo=0.8, gloss=0.0)), CAMERA, AT_ORIGIN)
    both = render(sphere(Material("both", albedo=0.8)), CAMERA, AT_ORIGIN)
    hit = np.isfinite(both.depth)
    np.testing.assert_allclose(both.stokes[0], np.where(hit, matte.stokes[0] + glass.stokes[0], 1.0), atol=1e-6)
    along, across = (dolp(part.stokes) * part.stokes[0] for part in (matte, glass))
    np.testing.assert_allclose(np.hypot(both.stokes[1], both.stokes[2])[hit], np.abs(along - across)[hit], atol=1e-6)
    specular = across > along
    np.testing.assert_array_equal((both.reflection == Reflection.SPECULAR)[hit], specular[hit])
    sure = hit & (np.abs(along - across) > 1e-3)
    expected = np.where(specular, aolp(glass.stokes), aolp(matte.stokes))
    assert angle_between(aolp(both.stokes), expected)[sure].max() < 1e-3
    assert specular[sure].any() and not specular[sure].all()


def test_lamberts_law_under_the_lamp():
    lamp = PointLight(position=(0.0, 0.0, 1.0), intensity=2.0)
    scene = Scene(plane(Material("white", albedo=0.8, gloss=0.0), tilt=0.0).primitives, lamp, surround=0.3)
    camera = PinholeCamera(width=3, height=1, fx=1.0, fy=1.0, cx=1.0, cy=0.0)
    stokes = render(scene, camera, AT_ORIGIN).stokes
    below = 0.8 * (0.3 + 2.0 / np.pi)
    assert stokes[0, 0, 1] == pytest.approx(0.96 * below, rel=1e-5)
    at_45_degrees_seen = 0.8 * (0.3 + 2.0 / np.pi / 5.0**1.5)  # 2 m aside, sqrt(5) m from the lamp
    transmittance = 1.0 - (0.0920 + 0.0085) / 2  # Fresnel at 45 degrees, eta 1.5
    assert stokes[0, 0, 2] == pytest.approx(transmittance * at_45_degrees_seen, rel=1e-3)


@pytest.mark.parametrize("shadows", [True, False])
def test_a_ball_throws_a_shadow_where_shadows_are_on(shadows):
    ball_pose = np.eye(4)
    ball_pose[2, 3] = 1.5
    floor = plane(MATTE, distance=3.0, tilt=0.0).primitives
    ball = Sphere(MATTE, ball_pose, radius=0.2)
    lamp = PointLight(position=(1.0, 0.0, 0.0), intensity=5.0, shadows=shadows)
    rendering = render(Scene((*floor, ball), lamp, surround=0.2), CAMERA, AT_ORIGIN)
    shadowed = rendering.stokes[0, 35, round(47.5 - 70.0 / 3.0)]  # the ray from lamp through ball ends at x = -1 m
    ambient = 0.2 * 0.6
    assert (shadowed < ambient) == shadows


def test_black_glass_mirrors_the_wall_behind_it_but_not_its_texture():
    """A glass floor seen at 45 degrees shows the wall's mean radiance times Fresnel's reflectances."""
    wall = Material("wall", albedo=0.5, texture=Texture(Pattern.CHECKER, size=0.3, contrast=1.0))
    facing = np.eye(4)
    facing[2, 3] = 3.0
    level = np.array([[1, 0, 0, 0], [0, 0, -1, 1.0], [0, 1, 0, 0], [0, 0, 0, 1.0]])  # y = 1 m, below the camera
    scene = Scene((Rectangle(wall, facing), Rectangle(BLACK_GLASS, level)), surround=0.8)
    camera = PinholeCamera(width=1, height=1, fx=1.0, fy=1.0, cx=0.0, cy=-1.0)
    rendering = render(scene, camera, AT_ORIGIN)
    stokes = rendering.stokes[:, 0, 0]
    assert rendering.depth[0, 0] == pytest.approx(1.0)
    assert stokes[0] == pytest.approx(0.5 * 0.8 * (0.0920 + 0.0085) / 2, rel=2e-3)
    assert stokes[1] == pytest.approx(0.5 * 0.8 * (0.0920 - 0.0085) / 2, rel=2e-3)  # horizontal, across the plane


def test_a_highlight_appears_at_the_mirror_direction_of_the_lamp():
    shiny = Material("shiny", albedo=0.0, shininess=500.0)
    lamp = PointLight(position=(1.0, 0.0, 0.0), intensity=5.0)
    scene = Scene(plane(shiny, distance=2.0, tilt=0.0).primitives, lamp, surround=0.0)
    stokes = render(scene, CAMERA, AT_ORIGIN).stokes
    v, u = np.unravel_index(stokes[0].argmax(), stokes[0].shape)
    assert abs(u - (47.5 + 70.0 * 0.25)) < 1.0 and abs(v - 35.5) < 1.0
    assert stokes[1, v, u] < 0  # the plane of incidence is the image's x axis: polarized across it


def test_supersampling_averages_stokes_vectors_over_the_pixel():
    built_in = built_in_scene("room")
    pose = built_in.path(frames=1)[1][0]
    coarse = render(built_in.scene, CAMERA, pose, supersample=2)
    fine = render(built_in.scene, CAMERA.scaled(2.0), pose)
    np.testing.assert_allclose(coarse.stokes, fine.stokes.reshape(3, 72, 2, 96, 2).mean(axis=(2, 4)), atol=2e-5)
    np.testing.assert_array_equal(coarse.depth, render(built_in.scene, CAMERA, pose).depth)


@pytest.mark.parametrize("pattern", [Pattern.CHECKER, Pattern.STRIPES, Pattern.NOISE])
def test_a_texture_varies_about_its_albedo(pattern):
    textured = Material("textured", albedo=0.4, texture=Texture(pattern, size=0.1, contrast=0.5), gloss=0.0)
    bare = Material("bare", albedo=0.4, gloss=0.0)
    with_texture, without = (render(plane(m, tilt=0.3), CAMERA, AT_ORIGIN).stokes for m in (textured, bare))
    factor = with_texture[0] / without[0]
    assert factor.min() >= 0.5 - 1e-5 and factor.max() <= 1.5 + 1e-5
    assert factor.std() > 0.1
    assert factor.mean() == pytest.approx(1.0, abs=0.1)
    np.testing.assert_allclose(dolp(with_texture), dolp(without), atol=1e-5)


def test_an_image_lies_on_a_surface_and_repeats_mirrored():
    image = np.random.default_rng(0).uniform(-1, 1, (1, 25, 33)).astype(np.float32)
    texture = Texture(Pattern.IMAGE, size=0.5, contrast=0.8)
    papered = Material("papered", albedo=0.5, texture=texture, gloss=0.0)
    bare = Material("bare", albedo=0.5, gloss=0.0)
    facing = np.diag([1.0, 1.0, 1.0, 1.0])
    facing[2, 3] = 2.0
    with_image, without = (
        render(Scene((Rectangle(m, facing),), images=image), CAMERA, AT_ORIGIN).stokes[0] for m in (papered, bare)
    )
    found = (with_image / without - 1.0) / 0.8
    x, y = (2.0 * CAMERA.normalized()[36:60, 48:80]).transpose(2, 0, 1)  # metres from the rectangle's middle
    step = 0.5 / 24
    v, u = y / step, x / step
    v, u = np.where(v % 48 > 24, 48 - v % 48, v % 48), np.where(u % 64 > 32, 64 - u % 64, u % 64)
    np.testing.assert_allclose(found[36:60, 48:80], map_coordinates(image[0], [v, u], order=1), atol=2e-3)
    np.testing.assert_allclose(found[:36, 48:80], found[71:35:-1, 48:80], atol=2e-3)  # mirrored about y = 0


def test_a_texture_must_find_its_image():
    papered = Material("papered", texture=Texture(Pattern.IMAGE, size=0.5, image=1))
    for images in (None, np.zeros((1, 4, 4), np.float32)):
        with pytest.raises(InputError, match="shows image 1"):
            Scene((Rectangle(papered),), images=images)


def test_noise_depends_on_its_seed_and_nothing_else():
    def picture(seed: int) -> np.ndarray:
        noise = Texture(Pattern.NOISE, size=0.2, seed=seed)
        return render(plane(Material("noise", texture=noise)), CAMERA, AT_ORIGIN).stokes

    np.testing.assert_array_equal(picture(1), picture(1))
    assert np.abs(picture(1) - picture(2)).max() > 0.05


def test_textures_out_of_range_are_refused():
    for wrong in ({"size": 0.0}, {"size": 0.1, "contrast": 1.5}, {"size": 0.1, "octaves": 0}):
        with pytest.raises(InputError, match="texture"):
            Texture(Pattern.NOISE, **wrong)
