"""PatchMatch on surfaces with known answers: textured ones come out exact, bare ones come out empty."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from scenes import TEXTURED, TYPICAL, angle_between, moved, pixel_rays, plane_depth, stereo_views, turned

from polarmap.data.plane_field import PlaneField
from polarmap.data.polarization_image import PolarizationImage, stabilized
from polarmap.data.sensor import SensorNoise
from polarmap.data.view import View
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.sensing.noise import estimate_noise
from polarmap.stereo.consistency import photometric_filter
from polarmap.stereo.options import PatchMatchOptions
from polarmap.stereo.patchmatch.level import Level
from polarmap.stereo.patchmatch.matching import pack, plane_cost, reference_window
from polarmap.stereo.patchmatch.method import patchmatch
from polarmap.synth import Scene, scenes

CAMERA = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
SIDES = (moved(0.0), moved(-0.25, -0.03), moved(0.25, 0.05))
RANGE = (0.6, 12.0)


def ball_before_a_wall() -> Scene:
    ball, wall = scenes.sphere(TEXTURED), scenes.plane(TEXTURED, distance=3.0, tilt=0.2)
    return Scene((*ball.primitives, *wall.primitives), scenes.LAMP)


TEXTURED_SCENES = {
    "plane": scenes.plane(TEXTURED),
    "steep plane": scenes.plane(TEXTURED, tilt=1.0),
    "facing plane": scenes.plane(TEXTURED, tilt=0.0),
    "ball": ball_before_a_wall(),
    "edge": scenes.edge(TEXTURED, TEXTURED),
}


@pytest.fixture(scope="module", params=TEXTURED_SCENES)
def matched(request):
    """(truth, planes) of a textured scene seen from three places."""
    truth, views = stereo_views(TEXTURED_SCENES[request.param], CAMERA, SIDES)
    return truth, patchmatch(views[0], views[1:], CAMERA, RANGE)


def relative_error(depth, truth) -> np.ndarray:
    return np.abs(depth / truth.depth - 1)[np.isfinite(depth)]


def test_textured_surfaces_are_found_to_a_few_thousandths(matched):
    truth, planes = matched
    depth = photometric_filter(planes)
    error = relative_error(depth, truth)
    assert error.size > 0.5 * depth.size
    assert np.median(error) < 0.003
    assert (error > 0.02).mean() < 0.1
    assert np.quantile(error, 0.8) < 0.01


def test_textured_surfaces_get_their_normals(matched):
    truth, planes = matched
    known = np.isfinite(photometric_filter(planes))
    normals = planes.normals(CAMERA)
    np.testing.assert_allclose(np.linalg.norm(normals, axis=-1), 1.0, atol=1e-5)
    assert (np.einsum("hwc,hwc->hw", normals, CAMERA.rays()) < 0).all()
    assert np.median(angle_between(normals, truth.normal)[known]) < 10.0
    assert np.quantile(angle_between(normals, truth.normal)[known], 0.3) < 6.0


def test_sigma_is_of_the_size_of_the_error_and_cost_is_small(matched):
    truth, planes = matched
    known = np.isfinite(photometric_filter(planes))
    error = np.abs(planes.inverse_depth - 1 / truth.depth)[known]
    assert 0.15 < np.median(error / planes.sigma[known]) < 1.5
    assert np.median(planes.score[known]) > 0.9


@pytest.mark.parametrize("tilt", [0.0, 0.6])
@pytest.mark.parametrize("noise", [TYPICAL, SensorNoise(1000.0, 10.0)], ids=["typical", "poor sensor"])
def test_a_bare_wall_comes_out_empty(tilt, noise):
    _, views = stereo_views(scenes.plane(scenes.MATTE, tilt=tilt), CAMERA, SIDES, noise)
    depth = photometric_filter(patchmatch(views[0], views[1:], CAMERA, RANGE))
    assert np.isfinite(depth).mean() < 0.005


def test_only_the_textured_half_of_a_corner_is_found():
    truth, views = stereo_views(scenes.corner(TEXTURED, scenes.MATTE), CAMERA, SIDES)
    depth = photometric_filter(patchmatch(views[0], views[1:], CAMERA, RANGE))
    window = 6  # pixels that a support window reaches over the border
    assert np.isfinite(depth[:, 80 + window :]).mean() < 0.01
    assert np.isfinite(depth[10:-10, 40:78]).mean() > 0.8
    assert np.median(relative_error(depth, truth)) < 0.003


def test_a_view_in_which_the_surface_is_hidden_does_no_harm():
    """Two of four views see something else; the best two decide."""
    truth, views = stereo_views(scenes.plane(TEXTURED), CAMERA, (*SIDES, moved(0.1, 0.2), moved(-0.1, -0.2)))
    rng = np.random.default_rng(1)
    hidden = [
        View(PolarizationImage.unpolarized(rng.uniform(0.1, 0.6, CAMERA.shape).astype(np.float32)), v.T_world_camera)
        for v in views[3:]
    ]
    depth = photometric_filter(patchmatch(views[0], [*hidden, *views[1:3]], CAMERA, RANGE))
    assert np.isfinite(depth).mean() > 0.6
    assert np.median(relative_error(depth, truth)) < 0.003


def test_what_one_view_does_not_show_is_matched_in_the_best_two():
    poses = (*SIDES, moved(0.2, -0.15), moved(-0.2, 0.15))
    truth, views = stereo_views(scenes.edge(TEXTURED, TEXTURED), CAMERA, poses)
    depth = photometric_filter(patchmatch(views[0], views[1:], CAMERA, RANGE))
    beside_the_edge = np.s_[:, 86:96]  # hidden by the near plane in the views from the left
    right = np.abs(depth / truth.depth - 1)[beside_the_edge] < 0.02
    assert right.mean() > 0.6


def test_a_seed_decides_all():
    _, views = stereo_views(scenes.plane(TEXTURED), CAMERA, SIDES)
    first, again, other = (
        patchmatch(views[0], views[1:], CAMERA, RANGE, PatchMatchOptions(seed=seed)) for seed in (1, 1, 2)
    )
    for a, b in zip(vars(first).values(), vars(again).values(), strict=True):
        np.testing.assert_array_equal(a, b)
    assert (first.inverse_depth != other.inverse_depth).mean() > 0.5
    assert np.median(np.abs(first.depth / other.depth - 1)) < 0.005


def test_a_start_near_the_answer_helps():
    truth, views = stereo_views(scenes.plane(TEXTURED), CAMERA, SIDES)
    hasty = PatchMatchOptions(sweeps=(1,), trials=(1,))
    start = 1 / truth.depth
    start[::3] = np.nan
    errors = [
        np.median(np.abs(patchmatch(views[0], views[1:], CAMERA, RANGE, hasty, initial).depth / truth.depth - 1))
        for initial in (None, start)
    ]
    assert errors[1] < 0.5 * errors[0]


def test_rotation_and_forward_motion_are_understood():
    poses = (moved(0.0), turned((0.03, -0.06, 0.1), (0.25, 0.0, 0.1)), turned((0.0, 0.05, -0.1), (-0.2, 0.1, -0.15)))
    truth, views = stereo_views(scenes.plane(TEXTURED), CAMERA, poses)
    depth = photometric_filter(patchmatch(views[0], views[1:], CAMERA, RANGE))
    assert np.isfinite(depth).mean() > 0.4
    assert np.median(relative_error(depth, truth)) < 0.003


@pytest.mark.parametrize("shape", [(121, 161), (63, 85)])
def test_odd_sizes_work(shape):
    camera = PinholeCamera(shape[1], shape[0], 120.0, 120.0, (shape[1] - 1) / 2, (shape[0] - 1) / 2)
    truth, views = stereo_views(scenes.plane(TEXTURED), camera, SIDES)
    depth = photometric_filter(patchmatch(views[0], views[1:], camera, RANGE))
    assert np.isfinite(depth).mean() > 0.3
    assert np.median(relative_error(depth, truth)) < 0.004


def window_cost(image, source, camera, T_source_reference, q, gu, gv, u, v, options, noise) -> float:
    """1 - NCC with bilateral weights of one window, its samples carried over by the plane point by point."""
    steps = (np.arange(5) - 2) * options.window_step
    du, dv = (g.ravel() for g in np.meshgrid(steps, steps))
    values = image[np.clip(v + dv, 0, camera.height - 1), np.clip(u + du, 0, camera.width - 1)].astype(float)
    weights = 1 / (1 + ((values - image[v, u]) / options.colour_sigma) ** 2) ** 2
    rays = np.stack([(u + du - camera.cx) / camera.fx, (v + dv - camera.cy) / camera.fy, np.ones(du.size)])
    points = T_source_reference[:3, :3] @ (rays / (q + gu * du + gv * dv)) + T_source_reference[:3, 3:]
    x, y = (camera.matrix @ points)[:2] / points[2]
    matched = cv2.remap(source, x.astype(np.float32), y.astype(np.float32), cv2.INTER_LINEAR).ravel().astype(float)
    covariance = np.cov(values, matched, aweights=weights, ddof=0) + np.diag([noise**2, noise**2])
    return 1 - covariance[0, 1] / np.sqrt(covariance[0, 0] * covariance[1, 1])


def test_the_cost_is_one_minus_the_weighted_correlation():
    poses = (moved(0.0), turned((0.01, -0.02, 0.05), (0.1, 0.02, 0.05)), moved(-0.1))
    _, views = stereo_views(scenes.plane(TEXTURED), CAMERA, poses)
    options, noise = PatchMatchOptions(), 0.003
    images = [view.image.stable for view in views]
    motions = [inverse(T) for T in poses[1:]]
    rng = np.random.default_rng(2)
    q = rng.uniform(0.35, 0.65, CAMERA.shape).astype(np.float32)
    gu, gv = (rng.uniform(-0.5, 0.5, (2, *CAMERA.shape)) * q / CAMERA.fx).astype(np.float32)
    matcher = Level.of(images[0], images[1:], motions, CAMERA, 0, options, RANGE, noise)
    found, _ = matcher.search((q, gu, gv), sweeps=0, trials=0, coarsest=True)
    inner = [(v, u) for v, u in zip(rng.integers(30, 90, 200), rng.integers(30, 130, 200), strict=True)]
    expected = [
        np.mean(
            [
                window_cost(images[0], image, CAMERA, T, q[p], gu[p], gv[p], p[1], p[0], options, noise)
                for image, T in zip(images[1:], motions, strict=True)
            ]
        )
        for p in inner
    ]
    assert np.ptp(expected) > 0.8
    np.testing.assert_allclose([found[p] for p in inner], expected, atol=0.03)  # the kernel's homography is linearized


def test_the_best_views_count():
    """With one good and one useless view the cost is the good one's, the useless one's, or their mean."""
    _, views = stereo_views(scenes.plane(TEXTURED), CAMERA, SIDES[:2])
    useless = np.random.default_rng(0).uniform(0.3, 0.8, CAMERA.shape).astype(np.float32)
    image, good = (view.image.stable for view in views)
    q = (1 / plane_depth(CAMERA, _normal_of_the_plane(), 2.0)).astype(np.float32)
    slopes = [np.full(CAMERA.shape, slope, np.float32) for slope in (q[0, 1] - q[0, 0], q[1, 0] - q[0, 0])]
    motion = inverse(SIDES[1])

    def cost(sources, best_views):
        options = PatchMatchOptions(best_views=best_views)
        matcher = Level.of(image, sources, [motion] * len(sources), CAMERA, 0, options, RANGE, 0.003)
        return matcher.search((q, *slopes), 0, 0, True)[0][30:90, 60:100]

    of_good, of_useless = cost([good], 1), cost([useless], 1)
    assert np.median(of_good) < 0.05 and np.median(of_useless) > 0.6
    np.testing.assert_allclose(cost([useless, good], 1), np.minimum(of_good, of_useless), atol=5e-4)
    np.testing.assert_allclose(cost([useless, good], 2), (of_good + of_useless) / 2, atol=5e-4)  # of 16 bits


def test_a_pixel_tries_the_views_that_matched_it_best():
    """Of three views the last one shows the same; the coarsest level tries them all."""
    _, views = stereo_views(scenes.plane(TEXTURED), CAMERA, SIDES[:2])
    image, good = (view.image.stable for view in views)
    rng = np.random.default_rng(0)
    useless = [rng.uniform(0.3, 0.8, CAMERA.shape).astype(np.float32) for _ in range(2)]
    q = (1 / plane_depth(CAMERA, _normal_of_the_plane(), 2.0)).astype(np.float32)
    planes = (q, *(np.full(CAMERA.shape, slope, np.float32) for slope in (q[0, 1] - q[0, 0], q[1, 0] - q[0, 0])))
    options = PatchMatchOptions(best_views=1, tried_views=1)
    matcher = Level.of(image, [*useless, good], [inverse(SIDES[1])] * 3, CAMERA, 0, options, RANGE, 0.003)
    _, best = matcher.search(planes, 0, 0, coarsest=False)
    _, every = matcher.search(planes, 0, 0, coarsest=True)
    assert best.shape == (*CAMERA.shape, 1) and (best[30:90, 60:100] == 2).mean() > 0.98
    assert (np.sort(every, axis=2) == np.arange(3)).all() and (every[..., :1] == best).all()


def _normal_of_the_plane():
    tilt, azimuth = 0.6, 0.5  # those of scenes.plane
    return np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)


def test_a_planes_gradient_gives_its_normal():
    normal = np.array(_normal_of_the_plane())
    q = 1 / plane_depth(CAMERA, normal, 2.0)
    slopes = [np.full(CAMERA.shape, slope) for slope in (q[0, 1] - q[0, 0], q[1, 0] - q[0, 0])]
    planes = PlaneField(q, *slopes, np.zeros(CAMERA.shape), np.zeros(CAMERA.shape))
    assert angle_between(planes.normals(CAMERA), normal).max() < 0.01
    np.testing.assert_allclose(planes.depth * pixel_rays(CAMERA)[..., 2], plane_depth(CAMERA, normal, 2.0))


def test_an_empty_field_passes_no_filter():
    assert np.isnan(photometric_filter(PlaneField.empty(CAMERA.shape))).all()


def test_the_square_root_makes_shot_noise_even():
    np.testing.assert_allclose(stabilized(np.float32([-0.1, 0.0, 0.25, 1.0])), [0.0, 0.0, 0.5, 1.0])
    rng = np.random.default_rng(0)
    for intensity in (0.1, 0.8):
        noisy = intensity + np.sqrt(intensity / 10_000) * rng.standard_normal(10_000)
        assert stabilized(noisy).std() == pytest.approx(0.005, rel=0.05)


@pytest.mark.parametrize("sigma", [0.002, 0.01])
def test_noise_is_measured_on_shaded_surfaces(sigma):
    v, u = np.indices((90, 120)) / 100
    shaded = 0.5 + 0.3 * u - 0.2 * v + 0.05 * np.sin(3 * u)
    shaded[:, 40:60] += 0.3 * ((np.indices((90, 20)) // 3).sum(0) % 2)  # a textured stripe
    noisy = shaded + sigma * np.random.default_rng(0).standard_normal(shaded.shape)
    assert estimate_noise(noisy.astype(np.float32)) == pytest.approx(sigma, rel=0.25)


def test_unusable_input_is_refused():
    grey = np.full(CAMERA.shape, 0.5, np.float32)
    here, aside = (
        View(PolarizationImage.unpolarized(grey), np.eye(4)),
        View(PolarizationImage.unpolarized(grey), moved(0.1)),
    )
    for sources, depth_range, message in (
        ([], RANGE, "at least one"),
        ([here], RANGE, "moved"),
        ([View(PolarizationImage.unpolarized(grey[1:]), moved(0.1))], RANGE, "the camera says"),
        ([aside], (2.0, 1.0), "near < far"),
        ([aside], (0.0, 1.0), "near < far"),
        ([aside], (np.nan, 1.0), "near < far"),
    ):
        with pytest.raises(InputError, match=message):
            patchmatch(here, sources, CAMERA, depth_range)


@pytest.mark.parametrize("options", [{"trials": (4,)}, {"sweeps": ()}, {"sweeps": (5, -3, 1)}])
def test_levels_that_do_not_match_are_refused(options):
    with pytest.raises(InputError):
        PatchMatchOptions(**options)


def test_four_neighbours_are_in_one_number():
    image = np.random.default_rng(0).uniform(0, 1.5, (7, 9)).astype(np.float32)
    packed = pack(image, np.float32(1.5))
    numbers = np.rint(image / 1.5 * 65535).astype(np.uint64)
    padded = np.pad(numbers, ((0, 1), (0, 1)), mode="edge")
    for shift, (dv, du) in enumerate(((0, 0), (0, 1), (1, 0), (1, 1))):
        found = (packed >> np.uint64(16 * shift)) & np.uint64(0xFFFF)
        expected = padded[dv : dv + 7, du : du + 9]
        assert np.abs(found.astype(int) - expected.astype(int)).max() <= 1


def test_only_what_the_image_can_tell_is_searched():
    """The bare half of a corner keeps its random planes, and of the other every pixel gets one, searched or not."""
    _, views = stereo_views(scenes.corner(TEXTURED, scenes.MATTE), CAMERA, SIDES)
    planes = patchmatch(views[0], views[1:], CAMERA, RANGE)
    assert np.isinf(planes.sigma[:, 90:]).mean() > 0.99 and (planes.score[:, 90:] > 0.5).mean() < 0.01
    known = np.isfinite(photometric_filter(planes))[10:-10, 10:70]
    for dv, du in ((0, 0), (0, 1), (1, 0), (1, 1)):
        assert known[dv::2, du::2].mean() > 0.75


def test_searching_every_pixel_finds_the_same_surface():
    truth, views = stereo_views(ball_before_a_wall(), CAMERA, SIDES)
    shares = {}
    for spacing in (1, 2):
        depth = photometric_filter(patchmatch(views[0], views[1:], CAMERA, RANGE, PatchMatchOptions(spacing=spacing)))
        shares[spacing] = (np.abs(depth / truth.depth - 1) < 0.01).mean()
    assert shares[2] > 0.9 * shares[1] > 0.4


def test_a_plane_that_cannot_win_is_given_up_and_one_that_can_is_not():
    """What is given back for a limit is the cost, or no less than the limit where the cost is not below it either."""
    _, views = stereo_views(scenes.plane(TEXTURED), CAMERA, SIDES)
    level = Level.of(
        views[0].image.stable, [v.image.stable for v in views[1:]], [inverse(T) for T in SIDES[1:]], CAMERA, 0,
        PatchMatchOptions(), RANGE, 0.003,
    )  # fmt: skip
    rng = np.random.default_rng(0)
    chosen = np.tile(np.arange(2, dtype=np.uint8), (*CAMERA.shape, 1))
    offsets, inverse_colour, unit, noise, best = level._window()
    values, weights, costs = (np.empty(25, np.float32) for _ in range(3))
    given_up = 0
    for _ in range(200):
        u, v = int(rng.integers(30, 130)), int(rng.integers(30, 90))
        q, limit = np.float32(rng.uniform(0.3, 0.7)), np.float32(rng.uniform(0.0, 1.0))
        stats = reference_window(level.image, u, v, offsets, inverse_colour, values, weights)
        slope = np.float32(0.0)
        whole, limited = (
            plane_cost(
                q, slope, slope, u, v, level.M, level.b, values, weights, stats, offsets, level.sources, *CAMERA.shape,
                unit, noise, best, costs, chosen, v, u, bound,
            )
            for bound in (np.float32(1e9), limit)
        )  # fmt: skip
        assert limited == whole or (limit <= limited <= whole)
        given_up += limited < whole
    assert given_up > 20
