"""Costs of surfaces by points and by polarization, against plain NumPy and against rendered light."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scenes import MATERIALS, polarization_of, turned

from polarmap.data.polarization_image import PolarizationImage
from polarmap.densify.surfaces.evidence import (
    FULL_CELL,
    PointWeights,
    before_outlines,
    cell_stokes,
    depth_costs,
    local_doubt,
    mirrored_texture,
    normal_costs,
    point_weights,
    polarization_costs,
    polarization_weight,
    stereo_costs,
)
from polarmap.densify.surfaces.planes import Candidates, evaluate_planes
from polarmap.geometry.camera import PinholeCamera
from polarmap.sensing.noise import estimate_noise
from polarmap.synth import Rendering, render, scenes

OFF_CENTRE = PinholeCamera(width=60, height=44, fx=45.0, fy=46.0, cx=12.3, cy=35.8)
LIGHT = ("matte", "glass", "plastic")  # diffuse, specular, both
VARIANCE = 1e-4  # of a standard deviation of 0.01
NOISE = 0.004  # of sqrt(intensity)


def picture(contrast: np.ndarray, seed: int = 0) -> np.ndarray:
    """Blocks of 2×2 pixels whose brightness varies by `contrast`, with noise, float32 H×W."""
    rng = np.random.default_rng(seed)
    height, width = contrast.shape
    blocks = np.kron(rng.uniform(-1.0, 1.0, (height // 2, width // 2)), np.ones((2, 2)))
    return (0.5 + contrast * blocks + NOISE * rng.standard_normal(contrast.shape)).astype(np.float32)


def columns(*contrasts: float) -> np.ndarray:
    """Vertical strips, 24 pixels wide, float64 48×W."""
    return np.repeat(contrasts, 24)[None] * np.ones((48, 1))


def test_points_on_texture_are_believed_and_those_on_a_bare_wall_are_not():
    reliability = point_weights(picture(columns(0.2, 0.2, 0.0, 0.0))).reliability
    assert reliability.dtype == np.float32 and reliability.shape == (48, 96)
    assert (reliability[:, :44] == 1.0).mean() > 0.98
    assert (reliability[:, 52:] == 0.0).mean() > 0.98


def test_faint_texture_is_believed_by_itself_and_not_beside_a_strong_one():
    """A support window that reaches strong texture is decided by it."""
    faint = point_weights(picture(columns(0.06, 0.06, 0.06, 0.06))).reliability
    beside = point_weights(picture(columns(0.9, 0.06, 0.06, 0.06))).reliability
    reached, beyond = np.s_[:, 27:29], np.s_[:, 34:]
    assert faint[reached].mean() > 0.9 and beside[reached].mean() < 0.1
    assert beside[beyond].mean() > 0.7


def test_reliability_is_nothing_or_at_least_what_is_believed():
    reliability = point_weights(picture(columns(0.3, 0.02, 0.01, 0.0))).reliability
    assert ((reliability == 0.0) | ((reliability >= 0.3) & (reliability <= 1.0))).all()
    assert (point_weights(np.full((20, 30), 0.5, np.float32)).reliability == 0.0).all()


def test_beside_an_outline_a_point_speaks_against_what_is_before_it_only():
    """A step of brightness between two bare halves, at column 48; windows of 9 pixels reach it from up to 6 beside."""
    image = picture(columns(0.0, 0.0, 0.0, 0.0))
    image[:, 48:] += 0.3
    behind = point_weights(image).behind
    assert behind.dtype == np.float32 and behind.shape == image.shape
    assert (behind[:, 46:50] == 1.0).all()  # on the outline
    beside = np.concatenate([behind[:, 41:45], behind[:, 51:55]], axis=1)
    np.testing.assert_allclose(beside, 0.2, atol=1e-6)
    assert behind[:, :36].mean() > 0.85 and behind[:, 60:].mean() > 0.85  # noise has its strongest pixels, too
    wide = point_weights(image, window=17).behind
    np.testing.assert_allclose(wide[:, 37:45], 0.2, atol=1e-6)


def test_only_beside_something_bare_is_an_outline_doubted():
    """Texture on both sides of a step says itself where it is; that on one side does, up to the step."""
    contrasts = (0.06, 0.06, 0.06, 0.06, 0.0, 0.0)
    image = picture(columns(*contrasts))
    image[:, 48:] += 0.3
    behind = point_weights(image).behind
    both, one = behind[:, 40:56], behind[:, 98:102]
    assert both.mean() > one.mean() + 0.3
    textured = point_weights(picture(columns(0.2, 0.2, 0.0, 0.0))).behind
    assert textured[:, :44].mean() > 0.99 and textured[:, 50:54].mean() < 0.25


def test_the_weight_behind_is_the_least_where_a_quarter_of_the_window_is_bare():
    """As NumPy has it, from the gradient of each pixel and of the strongest in the window."""
    image = picture(columns(0.3, 0.05, 0.0, 0.1))
    own = own_texture(image)
    around = maxima(own, 9 + 2 + 2)  # a window, and a rim that spreads into it
    beside = np.clip((0.6 - own / around) / (0.6 - 0.25), 0.0, 1.0)
    bare = means(own < 2.0, 9)
    expected = 1.0 - 0.8 * beside * np.minimum(bare / 0.25, 1.0)
    inside = np.s_[8:-8, 8:-8]
    np.testing.assert_allclose(point_weights(image).behind[inside], expected[inside], atol=1e-3)


def own_texture(image: np.ndarray) -> np.ndarray:
    """Root mean square of the gradient in 3×3 pixels, in standard deviations of the noise, float64 H×W."""
    padded = np.pad(image.astype(float), 1, mode="reflect")
    smooth = np.array([0.25, 0.5, 0.25])
    rows = sum(w * padded[i : i + image.shape[0]] for i, w in enumerate(smooth))
    cols = sum(w * padded[:, i : i + image.shape[1]] for i, w in enumerate(smooth))
    dx, dy = 0.5 * (rows[:, 2:] - rows[:, :-2]), 0.5 * (cols[2:] - cols[:-2])
    return np.sqrt(means(dx * dx + dy * dy, 3)) / estimate_noise(image)


def windows(image: np.ndarray, side: int, value: float) -> np.ndarray:
    """All pixels about each, H×W×side×side."""
    padded = np.pad(np.asarray(image, float), side // 2, constant_values=value)
    return np.lib.stride_tricks.sliding_window_view(padded, (side, side))


def means(image: np.ndarray, side: int) -> np.ndarray:
    return windows(image, side, 0.0).mean(axis=(2, 3))


def maxima(image: np.ndarray, side: int) -> np.ndarray:
    return windows(image, side, -np.inf).max(axis=(2, 3))


def light_of(body: np.ndarray, mirrored: np.ndarray, degrees: tuple[float, float], angle: float) -> PolarizationImage:
    """Body light of one degree of polarization along `angle`, and mirrored light of another across it, float H×W."""
    turn = np.exp(2j * angle)
    stokes = degrees[0] * body * turn - degrees[1] * mirrored * turn
    total = body + mirrored
    rng = np.random.default_rng(1)
    stokes = stokes + 0.002 * (rng.standard_normal(total.shape) + 1j * rng.standard_normal(total.shape))
    flags = np.zeros(total.shape, bool)
    size = np.float32(0.01) + np.zeros_like(total)
    return PolarizationImage(
        total, np.float32(np.abs(stokes) / total), np.float32(0.5 * np.angle(stokes) % np.pi), size, size, flags, flags
    )


BODY, MIRRORED = picture(columns(0.2, 0.2)), 0.5 * picture(columns(0.2, 0.2), seed=5)
BARE = np.full((48, 48), 0.3, np.float32)


@pytest.mark.parametrize("angle", [0.0, 0.7, 2.5])
def test_texture_is_mirrored_where_it_is_polarized_as_a_mirror_polarizes(angle):
    degrees = (0.06, 0.6)
    assert mirrored_texture(light_of(BARE, MIRRORED, degrees, angle)).mean() > 0.97
    assert not mirrored_texture(light_of(BODY, np.zeros_like(BODY), degrees, angle)).any()
    assert mirrored_texture(light_of(BODY, BARE, degrees, angle)).mean() < 0.03  # a textured body under a plain sheen
    assert mirrored_texture(light_of(BARE, MIRRORED, (0.0, 0.0), angle)).mean() < 0.03  # head on: nothing is polarized


def test_texture_that_varies_against_its_polarization_is_an_edge_and_no_mirror():
    """Bright and unpolarized beside dark and polarized: what would be mirrored would be less than nothing."""
    left = (np.arange(48) < 24) & np.ones((48, 1), bool)
    image = light_of(
        np.where(left, 0.5, 0.0).astype(np.float32), np.where(left, 0.0, 0.4).astype(np.float32), (0.0, 0.3), 0.4
    )
    assert not mirrored_texture(image)[:, 18:30].any()


def test_only_usable_pixels_are_told_to_be_mirrored():
    image = light_of(BARE, MIRRORED, (0.06, 0.6), 0.3)
    clipped = np.indices(BARE.shape)[0] < 10
    found = mirrored_texture(PolarizationImage(*[*vars(image).values()][:5], clipped, image.underexposed))
    assert not found[:10].any() and found[10:].mean() > 0.97


@pytest.mark.parametrize("shape", [(12, 16), (13, 17), (3, 2), (1, 9)])
@pytest.mark.parametrize("cell", [1, 4])
def test_points_cost_what_numpy_says(shape, cell):
    """A squared error in standard deviations, at most 9, of each point, and a full cell counts as 16/4 points.

    That of a surface behind the point counts as the second weight says.
    """
    rng = np.random.default_rng(0)
    q = rng.uniform(0.5, 1.0, shape).astype(np.float32)
    q[rng.random(shape) < 0.3] = np.nan
    reliability = np.where(rng.random(shape) < 0.3, 0.0, rng.uniform(0.3, 1.0, shape)).astype(np.float32)
    behind = rng.uniform(0.0, 1.0, shape).astype(np.float32)
    free = (np.nan_to_num(q, nan=0.7) * (1 + 0.02 * rng.standard_normal((2, *shape)))).astype(np.float32)
    free[1] = -1.0
    planes = np.array([[0.7, 0.001, -0.002], [0.8, 0.0, 0.01], [-0.5, 0.0, 0.0]])
    surfaces = np.concatenate([evaluate_planes(planes, shape), free])
    side = np.where(surfaces < q, behind, 1.0)
    error = np.minimum(((surfaces / q - 1.0) / 0.01) ** 2, 9.0) * reliability * side
    rows, cols = -(-shape[0] // cell), -(-shape[1] // cell)
    expected = np.zeros((rows, cols, 5))
    for i, j in np.ndindex(rows, cols):
        part = error[:, i * cell : (i + 1) * cell, j * cell : (j + 1) * cell]
        expected[i, j] = 0.25 * FULL_CELL / cell**2 * np.nansum(part, axis=(1, 2))
    costs = stereo_costs(q, PointWeights(reliability, behind), Candidates(planes, free), cell, 0.01)
    assert costs.dtype == np.float32
    np.testing.assert_allclose(costs, expected, rtol=2e-3, atol=1e-3)


def test_a_point_that_may_be_an_outlines_refuses_what_is_before_it_and_hardly_what_is_behind():
    q, one = np.full((4, 4), 0.5, np.float32), np.ones((4, 4), np.float32)
    surfaces = Candidates(np.empty((0, 3)), np.float32([0.5 * 1.05, 0.5, 0.5 / 1.05])[:, None, None] * one)
    costs = stereo_costs(q, PointWeights(one, 0.2 * one), surfaces, 4, 0.01)[0, 0]
    np.testing.assert_allclose(costs, [36.0, 0.0, 7.2], atol=1e-3)  # 16 points of 9, by a quarter


PATCH = np.s_[24:36, 28:44]  # bare, in 60×72 pixels full of points at a depth of 2


def around_a_patch() -> np.ndarray:
    points = np.full((60, 72), 0.5, np.float32)
    points[PATCH] = np.nan
    return points


def cells_of(*depths: float, shape=(60, 72), cell: int = 4) -> np.ndarray:
    """Inverse depth of planes parallel to the image in the middle of the cells."""
    rows, columns = (-(-size // cell) for size in shape)
    return np.stack([np.full((rows, columns), 1.0 / z, np.float32) for z in depths], axis=-1)


def test_a_surface_before_all_points_around_would_have_shown_outlines_of_its_own():
    """Planes at 1, at 1.95, just before the points, and behind them."""
    before = before_outlines(cells_of(1.0, 1.95, 3.0), around_a_patch(), 4)
    assert before.dtype == bool and before.shape == (15, 18, 3)
    expected = np.zeros((15, 18), bool)
    expected[6:9, 7:11] = True  # the patch's cells
    np.testing.assert_array_equal(before[..., 0], expected)
    assert not before[..., 1:].any()


def test_a_surface_with_an_outline_of_its_own_may_be_before_the_rest():
    """A few points of it are three cells from the nearer end of the patch and five from its farther one."""
    points = around_a_patch()
    points[28:32, 16:20] = 1.0
    before = before_outlines(cells_of(1.0, 0.9), points, 4)
    assert not before[6:9, 7, 0].any() and before[6:9, 8:11, 0].all()
    assert before[6:9, 7:11, 1].all()  # nearer than those, too


def test_where_there_are_points_in_a_cell_or_none_far_around_no_outline_is_missed():
    points = around_a_patch()
    points[24, 28] = 0.5  # of a cell's 16 pixels
    assert not before_outlines(cells_of(1.0), points, 4)[6, 7].any()
    alone = np.full((60, 72), np.nan, np.float32)
    assert not before_outlines(cells_of(1.0), alone, 4).any()
    alone[:4, :4] = 0.5
    before = before_outlines(cells_of(1.0), alone, 4)[..., 0]
    np.testing.assert_array_equal(np.argwhere(before), [(i, j) for i in range(4) for j in range(4) if i or j])


@pytest.mark.parametrize("shape", [(40, 48), (41, 51), (3, 2)])
@pytest.mark.parametrize("cell", [1, 3, 5])
def test_missing_outlines_are_those_of_numpy(shape, cell):
    rng = np.random.default_rng(cell)
    points = rng.uniform(0.3, 1.0, shape).astype(np.float32)
    patches = np.kron(rng.random((6, 6)) < 0.7, np.ones((9, 9)))[: shape[0], : shape[1]] > 0
    points[patches & (rng.random(shape) < 0.97)] = np.nan
    surfaces = rng.uniform(0.3, 1.6, cells_of(1.0, 2.0, 3.0, shape=shape, cell=cell).shape).astype(np.float32)
    found = before_outlines(surfaces, points, cell)
    for i, j in np.ndindex(found.shape[:2]):
        own = np.isfinite(points[i * cell : (i + 1) * cell, j * cell : (j + 1) * cell])
        near = points[max(i - 3, 0) * cell : (i + 4) * cell, max(j - 3, 0) * cell : (j + 4) * cell]
        bare = own.mean() < 0.05 and np.isfinite(near).any()
        expected = surfaces[i, j] > 1.04 * np.nanmax(near) if bare else [False] * 3
        np.testing.assert_array_equal(found[i, j], expected)
    assert shape == (3, 2) or (found.any() and not found.all())


def random_image(shape, seed: int = 0) -> PolarizationImage:
    rng = np.random.default_rng(seed)
    intensity, dolp, aolp, sigma = rng.random((4, *shape), np.float32)
    saturated, underexposed = rng.random((2, *shape)) < 0.2
    return PolarizationImage(intensity, 1.1 * dolp, np.pi * aolp, 0.1 * sigma, sigma, saturated, underexposed)


@pytest.mark.parametrize("shape", [(12, 16), (13, 17), (1, 9)])
def test_cells_average_the_usable_pixels_as_numpy_does(shape):
    image, cell = random_image(shape), 4
    image.saturated[:4, :4] = True  # nothing usable in the first cell
    mean, variance = cell_stokes(image, cell)
    assert mean.shape == (*variance.shape, 2) == (-(-shape[0] // cell), -(-shape[1] // cell), 2)
    s1, s2 = image.dolp * np.cos(2 * image.aolp), image.dolp * np.sin(2 * image.aolp)
    for i, j in np.ndindex(variance.shape):
        part = np.s_[i * cell : (i + 1) * cell, j * cell : (j + 1) * cell]
        usable = image.usable[part]
        if not usable.any():
            assert (mean[i, j] == 0.0).all() and variance[i, j] == np.inf
            continue
        np.testing.assert_allclose(mean[i, j], [s1[part][usable].mean(), s2[part][usable].mean()], atol=1e-6)
        expected = (image.sigma_dolp[part][usable] ** 2).sum() / usable.sum() ** 2
        assert variance[i, j] == pytest.approx(expected, rel=1e-5)


@lru_cache
def tilted_plane(material: str) -> tuple[Rendering, np.ndarray]:
    """A plane before a camera whose axis is off the image's centre, and (S1, S2)/S0 of each pixel."""
    rendering = render(scenes.plane(MATERIALS[material], tilt=0.7, azimuth=2.2), OFF_CENTRE, np.eye(4))
    return rendering, cell_stokes(polarization_of(rendering), 1)[0]


def costs_of_turned_normals(material: str, degrees: float, axis=(1.0, 0.0, 0.0)) -> np.ndarray:
    rendering, stokes = tilted_plane(material)
    R = turned(np.radians(degrees) * np.array(axis))[:3, :3] if degrees else np.eye(3)
    normals = (rendering.normal @ R.T).astype(np.float32)
    return costs_of(stokes, np.full(OFF_CENTRE.shape, VARIANCE, np.float32), normals)


def costs_of(stokes, variance, normal, camera: PinholeCamera = OFF_CENTRE) -> np.ndarray:
    """Of a plane's normal, 3, or those of a free surface, rows×columns×3."""
    if np.ndim(normal) == 1:
        return polarization_costs(stokes, variance, normal[None], [], camera)[..., 0]
    return polarization_costs(stokes, variance, np.empty((0, 3)), [normal], camera)[..., 0]


@pytest.mark.parametrize("material", LIGHT)
def test_the_true_normal_costs_nothing_whatever_the_light(material):
    costs = costs_of_turned_normals(material, 0.0)
    assert costs.shape == OFF_CENTRE.shape and costs.dtype == np.float32
    assert costs.max() < 0.01  # rounding


@pytest.mark.parametrize("share", [0.05, 0.1, 0.2, 0.4, 0.8])
def test_any_mixture_of_diffuse_and_specular_light_costs_little(share):
    """Both half lines meet under a bend, and light between them strays at most by the weaker part times its sine."""
    rendering, diffuse = tilted_plane("matte")
    specular = tilted_plane("glass")[1]
    parts = (1.0 - share) * diffuse, share * specular
    costs = costs_of(sum(parts), np.full(OFF_CENTRE.shape, VARIANCE), rendering.normal)
    lengths = [np.linalg.norm(part, axis=-1) for part in parts]
    sine = (parts[0][..., 0] * parts[1][..., 1] - parts[0][..., 1] * parts[1][..., 0]) / (lengths[0] * lengths[1])
    assert np.abs(sine).max() > 0.5  # radians, far from the axis
    assert (costs <= (np.minimum(*lengths) * sine) ** 2 / VARIANCE + 0.01).all()
    assert costs.mean() < 1.0


@pytest.mark.parametrize("material", LIGHT)
@pytest.mark.parametrize("axis", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0)])
def test_a_turned_normal_costs_more_the_more_it_is_turned(material, axis):
    mean = [costs_of_turned_normals(material, degrees, axis).mean() for degrees in (0.0, 5.0, 15.0, 30.0)]
    assert (np.diff(mean) > 0.02).all()


def test_the_cost_is_the_squared_distance_from_the_line_over_its_variance():
    """On the axis of a camera: a normal toward +x makes S1 > 0 diffuse, S1 < 0 specular, and S2 the error."""
    one = PinholeCamera(1, 1, 10.0, 10.0, 0.0, 0.0)
    normal = np.array([0.6, 0.0, -0.8])
    for s1 in (0.1, 0.0, -0.1):
        stokes = np.array([[[s1, 0.02]]], np.float32)
        for n in (normal, -normal):
            assert costs_of(stokes, np.full((1, 1), VARIANCE), n, one)[0, 0] == pytest.approx(4.0, rel=1e-4)
    across = np.array([[[0.0, 0.5]]], np.float32)
    assert costs_of(across, np.full((1, 1), VARIANCE), normal, one)[0, 0] == 9.0  # the most


def test_one_normal_may_stand_for_all():
    rendering, stokes = tilted_plane("matte")
    variance = np.full(OFF_CENTRE.shape, VARIANCE, np.float32)
    one = costs_of(stokes, variance, 3.0 * rendering.normal[0, 0])  # of any length
    np.testing.assert_allclose(one, costs_of(stokes, variance, rendering.normal), atol=1e-3)


def test_planes_and_free_surfaces_are_judged_each_by_itself():
    rendering, stokes = tilted_plane("matte")
    variance = np.full(OFF_CENTRE.shape, VARIANCE, np.float32)
    planes, free = np.array([[0.1, 0.2, -1.0], [0.5, 0.0, -0.8]]), rendering.normal
    together = polarization_costs(stokes, variance, planes, [free, free[::-1].copy()], OFF_CENTRE)
    alone = [costs_of(stokes, variance, normal) for normal in (*planes, free, free[::-1].copy())]
    np.testing.assert_allclose(together, np.stack(alone, axis=-1), rtol=1e-5, atol=1e-6)


def test_cells_that_say_nothing_and_normals_that_are_not_known_cost_nothing():
    rendering, stokes = tilted_plane("matte")
    wrong = rendering.normal[..., [1, 0, 2]].copy()
    variance = np.full(OFF_CENTRE.shape, VARIANCE, np.float32)
    assert costs_of(stokes, variance, wrong).mean() > 1.0
    assert (costs_of(stokes, np.full(OFF_CENTRE.shape, np.inf), wrong) == 0.0).all()
    wrong[10:20] = np.nan
    assert (costs_of(stokes, variance, wrong)[10:20] == 0.0).all()


def told_apart(size: float, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Polarization's and stereo's costs of 4 planes; a cell's polarization is its own plane's, with Gaussian errors.

    size: of these errors, in their stated standard deviation.
    """
    rng = np.random.default_rng(seed)
    own = rng.integers(4, size=(40, 50))
    expected = 1.5 * np.array([[1.0, 0.0], [0.0, 1.0], [-1.0, 0.0], [0.0, -1.0]])
    seen = expected[own] + size * rng.standard_normal((40, 50, 2))
    polarization = ((seen[..., None, :] - expected) ** 2).sum(axis=-1)
    return polarization.astype(np.float32), np.where(np.arange(4) == own[..., None], 0.0, 9.0).astype(np.float32)


def test_the_weight_is_a_half_where_the_errors_are_what_they_are_said_to_be():
    assert polarization_weight(*told_apart(1.0)) == 0.5


def test_larger_errors_weigh_less():
    assert polarization_weight(*told_apart(2.0)) in (0.1, 0.2)  # exactly 0.5/4
    assert polarization_weight(*told_apart(5.0)) in (0.01, 0.02, 0.05)


def test_polarization_that_says_nothing_weighs_nothing():
    _, stereo = told_apart(1.0)
    random = 9.0 * np.random.default_rng(1).random(stereo.shape)
    assert polarization_weight(random, stereo) <= 0.01
    assert polarization_weight(np.zeros_like(stereo), stereo) == 0.0
    assert polarization_weight(9.0 - told_apart(1.0)[0], stereo) == 0.0  # the contrary of the truth


def test_without_clear_points_there_is_no_weight():
    polarization, stereo = told_apart(1.0)
    assert polarization_weight(polarization, 0.4 * stereo) == 0.0  # stereo prefers no plane clearly
    assert polarization_weight(polarization[:7, :7], stereo[:7, :7]) == 0.0  # too few cells
    assert polarization_weight(polarization[..., :1], stereo[..., :1]) == 0.0
    assert polarization_weight(polarization[..., :0], stereo[..., :0]) == 0.0


def test_the_largest_plane_does_not_decide_alone():
    """Polarization is right on one plane in a corner, and slightly wrong on the other, eight times as large."""
    stereo = np.tile(np.float32([0.0, 9.0]), (40, 50, 1))
    stereo[:15, :15] = 9.0, 0.0
    polarization = np.tile(np.float32([1.0, 0.45]), (40, 50, 1))
    polarization[:15, :15] = 4.0, 0.0
    assert polarization_weight(polarization, stereo) >= 0.2


def test_normals_cost_by_their_angle_in_its_standard_deviation():
    angles = np.radians([0.0, 20.0, 80.0])
    planes = np.stack([np.sin(angles), 0.0 * angles, -np.cos(angles)], axis=1)
    expected = np.broadcast_to(2.5 * planes[1], (3, 4, 3)).astype(np.float32)  # of any length
    sigma = np.full((3, 4), np.radians(10.0), np.float32)
    costs = normal_costs(expected, sigma, planes)
    variance = np.radians(10.0) ** 2 + 0.15**2
    np.testing.assert_allclose(costs[..., 1], 0.0, atol=1e-4)
    np.testing.assert_allclose(costs[..., 0], np.radians(20.0) ** 2 / variance, rtol=1e-3)
    assert (costs[..., 2] == 4.0).all() and costs.shape == (3, 4, 3)


def test_guessed_depth_costs_its_squared_error_in_its_variance_and_never_more_than_4():
    expected, sigma = np.float32([[0.5, 0.5]]), np.float32([[0.0, 1.0]])
    found = np.broadcast_to(np.float32([0.5, 0.5 * np.exp(0.1), 0.5 * np.exp(-0.15), 5.0, -0.2]), (1, 2, 5))
    costs = depth_costs(expected, sigma, found)
    np.testing.assert_allclose(costs[0, 0], [0.0, 1.0, 2.25, 4.0, 4.0], atol=1e-4)
    np.testing.assert_allclose(costs[0, 1, :3], np.float32([0.0, 1.0, 2.25]) / 101, atol=1e-4)


def test_a_guess_is_doubted_where_points_around_contradict_it():
    """It is 40 % off on the left half, right on the right one; the upper half has no points."""
    expected = np.where(np.arange(240) < 120, 1.4, 1.0).astype(np.float32) * np.ones((180, 1), np.float32)
    reliability = np.float32(np.arange(180)[:, None] >= 90) * np.ones((1, 240), np.float32)
    inverse_depth = np.where(reliability > 0, np.float32(1.0), np.float32(np.nan))
    doubt = local_doubt(expected, inverse_depth, reliability, 4)
    assert doubt.shape == (45, 60) and doubt.dtype == np.float32
    np.testing.assert_allclose(doubt[30:, :5], 2.5 * np.log(1.4), rtol=0.02)
    assert (doubt[:, 55:] < 0.02).all()
    assert (doubt[20, :10] > 0.7).all()  # beside the points, where there are none
    assert (local_doubt(expected, inverse_depth, 0 * reliability, 4) == 0).all()
