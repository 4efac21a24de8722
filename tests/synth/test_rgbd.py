"""Polarization made of RGB-D: normals of stored depth, both reflection models against closed forms, and sequences."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import rgbd_folders as folders
import yaml
from scenes import WIDE, polarization_of, view_of

from polarmap.data.codes import Reflection
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import incidence_direction, zenith_of
from polarmap.io.formats.normal_png import read_normal_png
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.io.recording.rgbd import open_rgbd
from polarmap.io.recording.sequence import open_sequence
from polarmap.polarization.cues import disambiguate
from polarmap.polarization.fresnel import diffuse_dolp, specular_dolp
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth import Sensor
from polarmap.synth.rgbd import BlinnPhong, Fresnel, Shader, plane_normals, record_rgbd, render_rgbd
from polarmap.synth.rgbd.blur import blurred
from polarmap.synth.rgbd.conversion import blocks

HEADLIGHT = np.zeros(3)
STEP = 1 / 5000
DIFFUSE = BlinnPhong(specular=0.0, ambient=0.25)
SPECULAR = BlinnPhong(specular=1.0, shininess=0.0)
SHAPES = ("plane", "sphere", "cylinder")


def stored(depth: np.ndarray, step: float = STEP) -> np.ndarray:
    """Depth rounded to the steps of a file."""
    return (np.rint(depth / step) * step).astype(np.float32)


def angles_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Degrees between unit vectors, H×W."""
    return np.degrees(2 * np.arcsin(np.clip(np.linalg.norm(a - b, axis=-1) / 2, 0, 1)))


def dolp_of(stokes: np.ndarray) -> np.ndarray:
    with np.errstate(invalid="ignore"):
        return np.hypot(stokes[1], stokes[2]) / stokes[0]


def aolp_of(stokes: np.ndarray) -> np.ndarray:
    return 0.5 * np.arctan2(stokes[2], stokes[1])


def apart(angle: np.ndarray, other: np.ndarray) -> np.ndarray:
    """Radians between two directions without sense."""
    return np.abs((angle - other + np.pi / 2) % np.pi - np.pi / 2)


def diffuse_direction(normal: np.ndarray) -> np.ndarray:
    """Angle of n_xy - n_z x, along which diffuse light is polarized."""
    d = incidence_direction(normal, WIDE)
    return np.arctan2(d[..., 1], d[..., 0])


def specular_direction(normal: np.ndarray) -> np.ndarray:
    """Angle across the gradient of log range, M⁻¹ d, along which specular light is polarized."""
    d, xy = incidence_direction(normal, WIDE).astype(float), WIDE.normalized().astype(float)
    gradient = d - xy * ((d * xy).sum(-1) / (1 + (xy * xy).sum(-1)))[..., None]
    return np.arctan2(gradient[..., 1], gradient[..., 0]) + np.pi / 2


def shaded(shape: str, model, picture: float = 0.6, light=HEADLIGHT):
    """A built-in surface with its exact normals and a plain picture, and the pixels that see it."""
    view = view_of(shape)
    rendering = Shader(WIDE, model).render(np.full(WIDE.shape, picture, np.float32), view.depth, light, view.normal)
    return rendering, np.isfinite(view.depth)


@pytest.mark.parametrize("step", [0.0, STEP, 0.001])
def test_normals_of_a_plane_are_exact_but_for_the_step_of_its_depth(step):
    view = view_of("plane")
    depth = stored(view.depth, step) if step else view.depth
    error = angles_between(plane_normals(depth, WIDE, step), view.normal)
    assert error.max() < {0.0: 0.01, STEP: 0.1, 0.001: 0.5}[step]


def test_normals_of_bent_surfaces_are_those_of_their_tangent_planes():
    for shape in ("sphere", "cylinder"):
        view = view_of(shape)
        error = angles_between(plane_normals(stored(view.depth), WIDE, STEP), view.normal)
        inner = zenith_of(view.normal, WIDE) < np.radians(60)
        assert np.nanmedian(error[inner]) < 0.3 and np.nanpercentile(error[inner], 95) < 2.5


def test_a_crease_between_planes_stays_crisp():
    view = view_of("corner")
    error = angles_between(plane_normals(stored(view.depth), WIDE, STEP), view.normal)
    off_crease = np.abs(np.arange(WIDE.width) - WIDE.cx) > 1.5
    assert error[:, off_crease].max() < 0.3


def test_windows_do_not_cross_a_depth_edge():
    view = view_of("edge")
    normals = plane_normals(stored(view.depth), WIDE, STEP)
    assert angles_between(normals, view.normal).max() < 0.3


def test_holes_have_no_normal_and_spoil_none_beside_them():
    view = view_of("plane")
    depth = stored(view.depth)
    holes = np.zeros(WIDE.shape, bool)
    holes[20:30, 40:60] = True
    holes[::7, ::5] = True
    depth[holes] = np.nan
    normals = plane_normals(depth, WIDE, STEP)
    np.testing.assert_array_equal(np.isnan(normals[..., 0]), holes)
    assert np.nanmax(angles_between(normals, view.normal)) < 0.3


def test_noise_is_measured_and_averaged_over_large_windows():
    view = view_of("plane")
    noisy = view.depth + 0.004 * np.random.default_rng(0).standard_normal(WIDE.shape).astype(np.float32)
    error = angles_between(plane_normals(noisy, WIDE, STEP), view.normal)
    assert np.median(error) < 2.0  # 3×3 pixels alone would leave 9 degrees


def test_a_step_larger_than_the_scale_says_is_found_in_the_depth():
    """A plane that is nearly level within windows shows no noise by which its millimetres could be known."""
    camera = PinholeCamera(120, 90, 480.0, 480.0, 59.5, 44.5)
    x = camera.normalized()[..., 0]
    depth = stored(3.0 / (1.0 - 0.02 * x), 0.001)
    normal = np.array([0.02, 0.0, -1.0]) / np.hypot(0.02, 1.0)
    error = angles_between(plane_normals(depth, camera, STEP), np.broadcast_to(normal, (90, 120, 3)))
    assert np.median(error) < 0.5


def test_depth_without_any_value_has_no_normals():
    assert np.isnan(plane_normals(np.full(WIDE.shape, np.nan, np.float32), WIDE, STEP)).all()


@pytest.mark.parametrize("eta", [1.3, 1.5])
@pytest.mark.parametrize("shape", SHAPES)
def test_diffuse_blinn_phong_is_equation_5_along_the_plane_of_incidence(shape, eta):
    model = BlinnPhong(specular=0.0, ambient=0.25, eta=eta)
    rendering, seen = shaded(shape, model)
    zenith = zenith_of(rendering.normal, WIDE)
    np.testing.assert_allclose(dolp_of(rendering.stokes)[seen], diffuse_dolp(zenith, eta)[seen], atol=2e-4)
    tilted = seen & (zenith > 0.05)
    assert apart(aolp_of(rendering.stokes), diffuse_direction(rendering.normal))[tilted].max() < 1e-3
    lambert = 0.6 * (0.25 + 0.75 * np.cos(zenith))  # the light is where the camera is
    np.testing.assert_allclose(rendering.stokes[0][seen], lambert[seen], rtol=1e-4)
    assert (rendering.reflection[seen] == Reflection.DIFFUSE).all()


@pytest.mark.parametrize("shape", SHAPES)
def test_specular_blinn_phong_is_equation_6_across_the_plane_of_incidence(shape):
    rendering, seen = shaded(shape, SPECULAR, picture=0.1)
    zenith = zenith_of(rendering.normal, WIDE)
    np.testing.assert_allclose(dolp_of(rendering.stokes)[seen], specular_dolp(zenith, 1.5)[seen], atol=1e-3)
    tilted = seen & (zenith > 0.05) & (zenith < np.radians(85))
    assert apart(aolp_of(rendering.stokes), specular_direction(rendering.normal))[tilted].max() < 1e-3
    assert (rendering.reflection[seen] == Reflection.SPECULAR).all()


def test_the_larger_part_decides_the_polarization_of_all_light():
    light = np.array([1.0, 0.0, 0.0])
    both, seen = shaded("sphere", BlinnPhong(specular=0.5, shininess=8.0, ambient=0.2), 0.4, light)
    normal = both.normal.astype(float)
    points = WIDE.rays() * (view_of("sphere").depth / WIDE.rays()[..., 2])[..., None]
    to_light = light - points
    to_light /= np.linalg.norm(to_light, axis=-1, keepdims=True)
    half = to_light - WIDE.rays()
    half /= np.linalg.norm(half, axis=-1, keepdims=True)
    facing = np.maximum((normal * to_light).sum(-1), 0)
    diffuse = 0.4 * (0.2 + 0.8 * facing)
    specular = np.where(facing > 0, 0.5 * np.maximum((normal * half).sum(-1), 0) ** 8, 0)
    np.testing.assert_allclose(both.stokes[0][seen], (diffuse + specular)[seen], rtol=1e-3)
    clear = seen & (np.abs(diffuse - specular) > 1e-4)
    np.testing.assert_array_equal(both.reflection[clear] == Reflection.SPECULAR, (specular > diffuse)[clear])
    zenith = zenith_of(both.normal, WIDE)
    expected = np.where(specular > diffuse, specular_dolp(zenith, 1.5), diffuse_dolp(zenith, 1.5))
    np.testing.assert_allclose(dolp_of(both.stokes)[clear], expected[clear], atol=1e-3)
    assert 0.05 < (both.reflection[seen] == Reflection.SPECULAR).mean() < 0.95


def test_surfaces_turned_away_from_the_light_keep_the_ambient_share():
    rendering, seen = shaded("plane", DIFFUSE, light=np.array([0.0, 0.0, 100.0]))  # behind the plane
    np.testing.assert_allclose(rendering.stokes[0][seen], 0.6 * 0.25, rtol=1e-5)


@pytest.mark.parametrize("shape", SHAPES)
def test_fresnel_without_gloss_is_equation_5_and_without_albedo_equation_6(shape):
    matte, seen = shaded(shape, Fresnel(gloss=0.0))
    zenith = zenith_of(matte.normal, WIDE)
    np.testing.assert_allclose(dolp_of(matte.stokes)[seen], diffuse_dolp(zenith, 1.5)[seen], atol=2e-4)
    glass, _ = shaded(shape, Fresnel(gloss=1.0, shininess=0.0), picture=0.0)
    np.testing.assert_allclose(dolp_of(glass.stokes)[seen], specular_dolp(zenith, 1.5)[seen], atol=1e-3)
    tilted = seen & (zenith > 0.05) & (zenith < np.radians(85))
    assert apart(aolp_of(matte.stokes), diffuse_direction(matte.normal))[tilted].max() < 1e-3
    assert apart(aolp_of(glass.stokes), specular_direction(glass.normal))[tilted].max() < 1e-3


def test_fresnel_adds_body_surface_and_highlight_as_stokes_vectors():
    light = np.array([0.4, -0.3, 0.0])
    parts = {"gloss": 0.7, "shininess": 20.0, "surround": 0.8}
    both, seen = shaded("sphere", Fresnel(**parts), 0.5, light)
    body, _ = shaded("sphere", Fresnel(**{**parts, "gloss": 0.0}), 0.5, light)
    surface, _ = shaded("sphere", Fresnel(**parts), 0.0, light)
    apart = body.stokes + surface.stokes  # its parts are projected one by one, which turns the sum by a little
    np.testing.assert_allclose(both.stokes[0][seen], apart[0][seen], atol=2e-6)
    np.testing.assert_allclose(both.stokes[1:, seen], apart[1:, seen], atol=0.02)
    assert 0.1 < (both.reflection[seen] == Reflection.SPECULAR).mean() < 0.9


def test_fresnel_light_is_of_unit_strength_at_the_typical_distance():
    camera = PinholeCamera(3, 3, 1000.0, 1000.0, 1.0, 1.0)
    wall, facing = np.full((3, 3), 3.0, np.float32), np.tile(np.float32([0, 0, -1]), (3, 3, 1))
    grey = np.full((3, 3), 0.5, np.float32)
    shader = Shader(camera, Fresnel(gloss=0.0, surround=0.25), typical_distance=3.0)
    at_typical = shader.render(grey, wall, HEADLIGHT, facing).stokes[0, 1, 1]
    assert at_typical == pytest.approx(0.5 * (0.25 + 1.0) * 0.96, rel=1e-4)  # 4 % are reflected on the way out
    far = shader.render(grey, 10 * wall, HEADLIGHT, facing).stokes[0, 1, 1]
    assert far == pytest.approx(0.5 * (0.25 + 2 / 101) * 0.96, rel=1e-4)
    assert shader.light_distance(wall, np.array([0.0, 0.0, 1.0])) == pytest.approx(2.0, rel=1e-3)


@pytest.mark.parametrize(("model", "share"), [(BlinnPhong(ambient=0.3), 1.0), (Fresnel(surround=0.7), 1.7)])
def test_pixels_without_depth_keep_their_picture_unpolarized(model, share):
    depth, picture = view_of("plane").depth.copy(), np.full(WIDE.shape, 0.5, np.float32)
    depth[10:20, 10:20] = np.nan
    rendering = Shader(WIDE, model, gain=2.0).render(picture, depth, HEADLIGHT)
    np.testing.assert_allclose(rendering.stokes[0, 10:20, 10:20], 0.5 * share * 2.0, rtol=1e-6)
    np.testing.assert_array_equal(rendering.stokes[1:, 10:20, 10:20], 0.0)
    assert np.isfinite(rendering.stokes).all()
    assert (rendering.reflection[10:20, 10:20] == 0).all() and (rendering.material[10:20, 10:20] == -1).all()


@pytest.mark.parametrize("model", [BlinnPhong(), Fresnel()], ids=["blinn-phong", "fresnel"])
def test_pixels_on_no_plane_are_shaded_as_facing_the_camera_and_unpolarized(model):
    depth, picture = np.full(WIDE.shape, 2.0, np.float32), np.full(WIDE.shape, 0.5, np.float32)
    depth[45, 60] = 1.0  # a single point before a wall
    rendering = Shader(WIDE, model).render(picture, depth, HEADLIGHT)
    assert np.isnan(rendering.normal[45, 60]).all() and np.isfinite(rendering.normal[45, 61]).all()
    s0, s1, s2 = rendering.stokes[:, 45, 60]
    assert s0 > 0.3 and np.hypot(s1, s2) < 1e-3 * s0
    assert rendering.reflection[45, 60] == Reflection.NONE


@pytest.mark.parametrize("model", [DIFFUSE, SPECULAR], ids=["diffuse", "specular"])
@pytest.mark.parametrize("shape", SHAPES)
def test_cues_of_what_is_made_of_stored_depth_are_the_true_normals(shape, model):
    view = view_of(shape)
    picture = np.full(WIDE.shape, 0.8 if model is DIFFUSE else 0.1, np.float32)
    rendering = Shader(WIDE, model, depth_step=STEP).render(picture, stored(view.depth), HEADLIGHT)
    cues = disambiguate(polarization_of(rendering), rendering.normal, WIDE)
    zenith = zenith_of(view.normal, WIDE)
    known = np.isfinite(cues.zenith) & (zenith > 0.2) & (zenith < 1.0)
    assert known.sum() > 1000
    assert (cues.label[known] == (1 if model is DIFFUSE else 2)).all()
    error = angles_between(cues.normals(WIDE), view.normal)[known]
    assert np.median(error) < 0.5 and np.percentile(error, 90) < 2.0


@pytest.mark.parametrize(
    ("model", "wrong"),
    [
        (BlinnPhong, {"light": (0.0, 1.0)}),
        (BlinnPhong, {"ambient": 1.5}),
        (BlinnPhong, {"specular": -0.1}),
        (BlinnPhong, {"shininess": float("nan")}),
        (BlinnPhong, {"eta": 1.0}),
        (Fresnel, {"gloss": 1.1}),
        (Fresnel, {"surround": -1.0}),
        (Fresnel, {"shininess": -1.0}),
        (Fresnel, {"eta": float("inf")}),
        (Fresnel, {"light": (0.0, 1.0, float("nan"))}),
    ],
)
def test_impossible_models_are_refused(model, wrong):
    with pytest.raises(InputError, match=next(iter(wrong))):
        model(**wrong)


def test_frames_of_another_size_are_refused():
    with pytest.raises(InputError, match="do not fit"):
        Shader(WIDE, DIFFUSE).render(np.zeros((5, 5), np.float32), np.ones((5, 5), np.float32), HEADLIGHT)


def test_blur_leaves_a_resting_view_and_averages_a_moving_one():
    camera = PinholeCamera(64, 8, 50.0, 50.0, 31.5, 3.5)
    stokes = np.zeros((3, 8, 64), np.float32)
    stokes[0, :, 32:] = 1.0
    depth = np.full((8, 64), 2.0, np.float32)
    here = np.eye(4)
    np.testing.assert_allclose(blurred(stokes, depth, camera, here, here[None]), stokes, atol=1e-5)
    views = np.stack([here] * 4)
    views[:, 0, 3] = np.array([-3, -1, 1, 3]) * 2.0 / 50  # each two pixels further
    mean = blurred(stokes, depth, camera, here, views)[0, 4]
    expected = np.mean([np.arange(64) >= 32 - shift for shift in (-3, -1, 1, 3)], axis=0)
    np.testing.assert_allclose(mean[5:-5], expected[5:-5], atol=1e-3)


def test_blur_without_depth_follows_the_rotation():
    camera = PinholeCamera(64, 8, 500.0, 500.0, 31.5, 3.5)
    stokes = np.zeros((3, 8, 64), np.float32)
    stokes[0] = np.arange(64)
    turn = np.eye(4)
    turn[:3, :3] = [[np.cos(0.01), 0, np.sin(0.01)], [0, 1, 0], [-np.sin(0.01), 0, np.cos(0.01)]]
    turn[:3, 3] = 5.0, 0.0, 0.0  # which far points do not feel
    seen = blurred(stokes, np.full((8, 64), np.nan, np.float32), camera, np.eye(4), turn[None])
    np.testing.assert_allclose(seen[0, 4, :50], np.arange(50) + 5.0, atol=0.03)  # 0.01 rad · 500 pixels to the right


@pytest.fixture(scope="module")
def source(tmp_path_factory):
    """The room as a Redwood recording of twelve frames, 80×60."""
    return open_rgbd(folders.write_redwood(tmp_path_factory.mktemp("rgbd") / "redwood"))


@pytest.mark.parametrize("model", [BlinnPhong(), Fresnel()], ids=["blinn-phong", "fresnel"])
def test_a_sequence_is_deterministic_well_exposed_and_has_its_truth(source, model):
    first, again = (list(render_rgbd(source, model)) for _ in range(2))
    assert [frame.index for frame in first] == list(range(12))
    for i, (frame, same) in enumerate(zip(first, again, strict=True)):
        np.testing.assert_array_equal(frame.mosaic, same.mosaic)
        assert frame.mosaic.shape == (120, 160) and frame.mosaic.dtype == np.uint8
        np.testing.assert_array_equal(frame.truth.depth, source[i].depth)
        np.testing.assert_array_equal(frame.T_world_camera, source.poses[i])
        assert np.nanmedian(angles_between(frame.truth.normal, folders.FRAMES[i].truth.normal)) < 0.5
        assert (frame.mosaic == 255).mean() < 0.04 and 40 < np.median(frame.mosaic) < 200
    other = next(iter(render_rgbd(source, model, Sensor(seed=1))))
    assert (other.mosaic != first[0].mosaic).any()


def test_the_light_stands_still_while_the_camera_moves(source):
    """On a matte surface brightness over the picture's value depends on the place alone, not on the camera."""
    frames = list(
        render_rgbd(source, BlinnPhong(specular=0.0, ambient=0.0, light=(0.3, -0.2, -0.4)), Sensor(noise=None))
    )
    first = source.poses[0]
    light = first[:3, :3] @ [0.3, -0.2, -0.4] + first[:3, 3]
    gains = []
    for frame, recorded in zip(frames[::11], [source[0], source[11]], strict=True):
        T, truth = frame.T_world_camera, frame.truth
        points = folders.CAMERA.rays() * (truth.depth / folders.CAMERA.rays()[..., 2])[..., None]
        to_light = light - (points @ T[:3, :3].T + T[:3, 3])
        to_light /= np.linalg.norm(to_light, axis=-1, keepdims=True)
        facing = np.maximum((truth.normal @ T[:3, :3].T * to_light).sum(-1), 0)
        lit = (facing > 0.3) & (recorded.picture > 0.2)
        gains.append(truth.stokes[0][lit] / (recorded.picture * facing)[lit])
    gain = np.concatenate(gains)
    np.testing.assert_allclose(gain, np.median(gain), rtol=0.01)


def test_with_sub_pixels_each_pixel_of_the_recording_has_one_polarizer(source):
    clean = Sensor(noise=None, bit_depth=16)
    whole = next(iter(render_rgbd(source, BlinnPhong(), clean)))
    halved = next(iter(render_rgbd(source, BlinnPhong(), Sensor(noise=None, bit_depth=16, sub_pixel=True))))
    assert halved.mosaic.shape == (60, 80) and halved.truth.depth.shape == (30, 40)
    np.testing.assert_array_equal(halved.mosaic[0::2, 0::2], whole.mosaic[0::4, 0::4])  # the first polarizer's
    s0, s1, _ = whole.truth.stokes[:, 1::2, 1::2]
    np.testing.assert_allclose(halved.mosaic[1::2, 1::2] / 65535, np.minimum(0.5 * (s0 + s1), 1), atol=2e-5)


def test_the_truth_of_blocks_is_that_of_their_centres_on_the_nearer_surface():
    view = view_of("plane")
    depth = view.depth.copy()  # which is changed below
    rendering = Shader(WIDE, DIFFUSE).render(np.ones(WIDE.shape, np.float32), depth, HEADLIGHT, view.normal)
    half = blocks(rendering)
    camera = WIDE.scaled(0.5)
    n = view.normal[0, 0].astype(float)
    d = -(n * WIDE.rays()[0, 0]).sum() * view.depth[0, 0] / WIDE.rays()[0, 0, 2]
    xy = camera.normalized()
    np.testing.assert_allclose(half.depth, -d / (n[0] * xy[..., 0] + n[1] * xy[..., 1] + n[2]), rtol=1e-5)
    np.testing.assert_allclose(half.normal, np.broadcast_to(n, half.normal.shape), atol=1e-6)
    rendering.depth[::2, ::2] = 1.0
    rendering.depth[1::2, 1::2] = np.nan
    np.testing.assert_allclose(blocks(rendering).depth, 1.0)


def test_sub_pixels_need_even_sizes(tmp_path):
    source = open_rgbd(folders.write_redwood(tmp_path / "r"))
    odd = replace(source, camera=PinholeCamera(79, 60, 60.0, 60.0, 39.0, 29.5))
    with pytest.raises(InputError, match="2x2"):
        render_rgbd(odd, BlinnPhong(), Sensor(sub_pixel=True))


def test_the_shutter_blurs_along_the_motion_and_keeps_the_truth(source):
    sharp, soft = (
        next(iter(render_rgbd(source[5:7], Fresnel(), Sensor(noise=None, bit_depth=16, shutter=share))))
        for share in (0.0, 1.0)
    )

    def steps(frame):
        return np.abs(np.diff(frame.mosaic[::2, ::2].astype(float), axis=1))

    assert np.percentile(steps(soft), 99) < 0.9 * np.percentile(steps(sharp), 99)
    assert soft.mosaic.mean() == pytest.approx(sharp.mosaic.mean(), rel=0.02)
    np.testing.assert_array_equal(soft.truth.stokes, sharp.truth.stokes)


def test_a_recording_without_depth_or_frames_is_refused(source, tmp_path):
    with pytest.raises(InputError, match="no frames"):
        render_rgbd(source[5:5], BlinnPhong())
    folder = folders.write_redwood(tmp_path / "redwood")
    for path in (folder / "depth").iterdir():
        folders.write_picture(path, np.zeros((60, 80), np.uint16))
    with pytest.raises(InputError, match="no depth"):
        render_rgbd(open_rgbd(folder), Fresnel())


def test_a_black_recording_is_refused(tmp_path):
    folder = folders.write_redwood(tmp_path / "redwood")
    for path in (folder / "color").iterdir():
        folders.write_picture(path, np.zeros((60, 80), np.uint8))
    with pytest.raises(InputError, match="black"):
        render_rgbd(open_rgbd(folder), BlinnPhong(specular=0.0))


def test_a_recorded_sequence_reads_back_with_all_its_truth(source, tmp_path):
    out, sensor, count = tmp_path / "out", Sensor(bit_depth=12, extinction_ratio=100.0), []
    record_rgbd(source[:3], out, Fresnel(eta=1.4), sensor, on_frame=lambda: count.append(1))
    assert len(count) == 3
    sequence, frames = open_sequence(out), list(render_rgbd(source[:3], Fresnel(eta=1.4), sensor))
    assert sequence.camera_file.camera == folders.CAMERA and sequence.camera_file.noise == sensor.noise
    np.testing.assert_array_equal(sequence.timestamps, source.timestamps[:3])
    np.testing.assert_allclose(sequence.truth_trajectory().poses, source.poses[:3], atol=1e-9)
    for frame, written in zip(frames, sequence, strict=True):
        np.testing.assert_array_equal(written.mosaic, frame.mosaic)
        np.testing.assert_allclose(sequence.truth_depth(frame.index), frame.truth.depth, atol=1e-6)
        normal = read_normal_png(out / "normal" / f"{written.name}.png", (80, 60))
        np.testing.assert_allclose(normal, frame.truth.normal, atol=3e-5)
    values = yaml.safe_load((out / "synth.yaml").read_text())
    assert values["model"]["eta"] == 1.4 and values["model"]["name"] == "fresnel"
    assert values["source"] == "redwood" and values["format"] == "redwood" and values["frames"] == 3
    assert values["sensor"]["extinction_ratio"] == 100.0 and values["gain"] > 0
    with pytest.raises(InputError, match="--force"):
        record_rgbd(source, out, Fresnel())
    record_rgbd(source[:3], out, Fresnel(eta=1.4), sensor, force=True)


def test_noise_of_a_recorded_sequence_is_what_its_camera_file_says(source, tmp_path):
    """Round trip: the angles that the front end reads differ from the truth as much as its sigmas say."""
    record_rgbd(source[:2], tmp_path / "out", BlinnPhong(specular=0.0), Sensor())
    sequence = open_sequence(tmp_path / "out")
    truth = next(iter(render_rgbd(source[:2], BlinnPhong(specular=0.0)))).truth
    image = FrontEnd(read_camera_file(tmp_path / "out" / "camera.yaml")).polarization(sequence[0])
    sure = image.usable & (dolp_of(truth.stokes) > 0.08)
    assert sure.sum() > 500
    off = apart(image.aolp, aolp_of(truth.stokes))[sure] / image.sigma_aolp[sure]
    assert 0.9 < np.sqrt((off**2).mean()) < 1.1
    off = (image.dolp - dolp_of(truth.stokes))[sure] / image.sigma_dolp[sure]
    assert 0.85 < off.std() < 1.15 and abs(off.mean()) < 0.3
    cues = disambiguate(image, truth.normal, folders.CAMERA)
    assert (cues.label[sure] == 1).mean() > 0.98
    turn = zenith_of(truth.normal, folders.CAMERA)
    assert np.median(np.abs(cues.zenith - turn)[sure]) < 0.12
