"""Dense depth of rendered views by planes and a free surface, against the truth."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache

import cv2
import numpy as np
import pytest
from scenes import MATERIALS, TEXTURED, TYPICAL, moved, plane_depth, polarization_of

from polarmap.data.codes import Origin
from polarmap.data.polarization_image import PolarizationImage, stabilized
from polarmap.data.view import Neighbour
from polarmap.densify.options import SurfaceOptions
from polarmap.densify.sigma import LEAST_SIGMA, extrapolation_sigma
from polarmap.densify.surfaces.evidence import point_weights
from polarmap.densify.surfaces.expected import Expected
from polarmap.densify.surfaces.find import Surfaces, _boundaries, _bounds, find_surfaces
from polarmap.densify.surfaces.uncertainty import surface_sigma
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.cells import cell_camera
from polarmap.geometry.surface import normals_from_depth
from polarmap.sensing.stokes import polarization_image
from polarmap.synth import Rendering, built_in_scene, render, scenes

OFF_CENTRE = PinholeCamera(width=160, height=120, fx=118.0, fy=120.0, cx=76.0, cy=63.0)
ODD = PinholeCamera(width=127, height=93, fx=94.0, fy=92.0, cx=61.0, cy=48.0)
TWO_HALVES = SurfaceOptions(cells=2000)  # of 3×3 pixels
ROOMS = SurfaceOptions(cells=4800)  # of 2×2 pixels
UNKNOWN = np.float32(np.nan)
WITHIN = 0.02
NOISE = 0.004  # relative, of the points


@dataclass(frozen=True)
class View:
    """What `find_surfaces` is given, and the truth."""

    truth: np.ndarray
    points: np.ndarray
    prior: np.ndarray
    image: PolarizationImage
    stable: np.ndarray
    camera: PinholeCamera

    def surfaces(self, options: SurfaceOptions = ROOMS, others=(), free=None, **changes) -> Surfaces:
        """free: depth maps of what is not planar, the prior if not given. changes: of what the view has."""
        v = replace(self, **changes)
        free = [v.prior] if free is None else free
        return find_surfaces(v.points, free, v.image, v.stable, v.camera, others, options, point_sigma=NOISE)

    def error(self, found: Surfaces) -> np.ndarray:
        return np.abs(found.dense.depth / self.truth - 1.0)


def view_of(rendering: Rendering, camera: PinholeCamera, stripe: int = 0) -> View:
    """Points with 0.4 % noise on most pixels of texture, and a prior that is smooth and off by several per cent.

    stripe: columns at the right border that are textured, too.
    """
    image = polarization_of(rendering, TYPICAL, seed=0)
    rng = np.random.default_rng(0)
    v, u = np.indices(camera.shape)
    stable = stabilized(image.intensity).copy()
    stable += np.where(u >= camera.width - stripe, rng.uniform(-0.15, 0.15, camera.shape), 0.0).astype(np.float32)
    seen = (point_weights(stable).reliability > 0) & (rng.random(camera.shape) < 0.6)
    noisy = rendering.depth * (1.0 + NOISE * rng.standard_normal(camera.shape))
    points = np.where(seen, noisy, UNKNOWN).astype(np.float32)
    prior = cv2.GaussianBlur(rendering.depth, (0, 0), 4) * (1 + 0.06 * np.sin(u / 25) * np.cos(v / 18))
    return View(rendering.depth, points, prior.astype(np.float32), image, stable, camera)


@lru_cache
def room(name: str, camera: PinholeCamera = OFF_CENTRE) -> View:
    scene = built_in_scene(name)
    return view_of(render(scene.scene, camera, scene.path(frames=2)[1][0], supersample=2), camera)


@lru_cache
def two_halves(shape: str, material: str, camera: PinholeCamera = OFF_CENTRE) -> View:
    """A textured half, and a bare one with points at the right border of the image only."""
    scene = getattr(scenes, shape)(TEXTURED, MATERIALS[material])
    return view_of(render(scene, camera, np.eye(4), supersample=2), camera, stripe=3)


@lru_cache
def found_in(name: str) -> Surfaces:
    return room(name).surfaces()


ACCURACY = {"room": (0.015, 0.92), "bare-room": (0.02, 0.88), "corridor": (0.03, 0.85)}


@pytest.mark.parametrize("name", ACCURACY)
def test_rooms_are_dense_and_their_bare_parts_as_good_as_the_rest(name):
    view, found = room(name), found_in(name)
    largest, least = ACCURACY[name]
    error, bare = view.error(found), np.isnan(view.points)
    assert bare.mean() > 0.5 and np.isfinite(error).all()
    assert error.mean() < largest
    assert (error < WITHIN).mean() > least and (error[bare] < WITHIN).mean() > least - 0.02
    prior = np.abs(view.prior / view.truth - 1.0)
    assert error.mean() < prior.mean() and (prior < WITHIN).mean() < 0.5
    assert len(found.planes) >= 5 and 0.0 <= found.polarization_weight <= 0.5


@pytest.mark.parametrize("material", ["matte", "glass", "plastic"])
@pytest.mark.parametrize("shape", ["edge", "corner"])
def test_a_bare_half_is_the_plane_of_its_few_points_and_begins_where_the_texture_ends(shape, material):
    view = two_halves(shape, material)
    error = view.error(view.surfaces(TWO_HALVES))
    bare = np.arange(OFF_CENTRE.width) >= 80
    assert np.isnan(view.points[:, bare]).mean() > 0.85
    assert (error[:, bare] < 0.01).mean() > 0.99
    assert error.mean() < 0.005 and (error < WITHIN).mean() > 0.99


@pytest.mark.parametrize("name", ACCURACY)
def test_the_standard_deviation_is_honest(name):
    """Two thirds of the errors within one, and more from points as good as these; and it tells bad from good."""
    error, sigma = room(name).error(found_in(name)), found_in(name).dense.sigma
    assert 0.65 < (error < sigma).mean() < 0.95 and (error < 2 * sigma).mean() > 0.85
    assert sigma.min() >= 0.5 * NOISE - 1e-6 and np.median(sigma) < 0.02
    good, bad = error < 0.01, error > 0.1
    assert np.median(sigma[bad]) > 1.5 * np.median(sigma[good])
    sure = sigma < np.quantile(sigma, 0.3)
    assert error[sure].mean() < 0.5 * error.mean()


def test_label_and_planes_give_the_depth():
    found, camera = found_in("room"), OFF_CENTRE
    v, u = np.indices(camera.shape)
    assert found.label.dtype == np.int16 and found.planes.dtype == np.float64
    assert set(np.unique(found.label)) <= set(range(len(found.planes) + 1))
    for k, (q, qu, qv) in enumerate(found.planes):
        on = found.label == k
        expected = 1.0 / (q + qu * (u - 79.5) + qv * (v - 59.5))
        np.testing.assert_allclose(found.dense.depth[on], expected[on], rtol=1e-4)
    free = found.label == len(found.planes)
    np.testing.assert_allclose(found.dense.depth[free], room("room").prior[free], rtol=1e-5)


def test_origins_and_distance_say_where_depth_is_from():
    view, dense = room("room"), found_in("room").dense
    agreeing = np.abs(view.points / dense.depth - 1.0) < 0.015
    np.testing.assert_array_equal(dense.distance == 0.0, agreeing)
    np.testing.assert_array_equal(dense.origin == Origin.STEREO, agreeing)
    free = found_in("room").label == len(found_in("room").planes)
    np.testing.assert_array_equal(dense.origin[~agreeing & free], Origin.ESTIMATED)
    np.testing.assert_array_equal(dense.origin[~agreeing & ~free], Origin.PROPAGATED)
    assert (dense.origin != Origin.NONE).all()
    v, u = np.nonzero(agreeing)
    for y, x in ((5, 5), (60, 80), (110, 150)):
        assert dense.distance[y, x] == pytest.approx(np.hypot(v - y, u - x).min(), rel=0.03, abs=0.3)
    assert dense.added == (np.count_nonzero(np.isnan(view.points)),)
    np.testing.assert_array_equal(dense.first, view.prior)


def test_the_standard_deviation_grows_with_the_distance_from_points():
    """Of points alone by 1 % of depth for each hundredth of the diagonal, from 0.3 %."""
    distance = np.tile(np.float32([0.0, 1.0, 10.0, 40.0]), (3, 1))  # a diagonal of 5
    expected = np.hypot(0.003, 1.0 * distance / 5.0)
    np.testing.assert_allclose(extrapolation_sigma(distance), expected, rtol=1e-5)


@pytest.mark.parametrize("name", ACCURACY)
def test_the_standard_deviation_is_that_of_the_surface_and_of_what_else_may_be_there(name):
    found, dense = found_in(name), found_in(name).dense
    own = surface_sigma(dense.distance, found.label < len(found.planes), NOISE)
    assert (dense.sigma >= own - 1e-6).all()
    assert 0.1 < (dense.sigma > 1.2 * own).mean() < 0.9


def test_noisier_points_make_planes_less_certain():
    view = two_halves("corner", "matte")
    given = view.points, [view.prior], view.image, view.stable, view.camera, (), TWO_HALVES
    quiet, noisy = (find_surfaces(*given, point_sigma=sigma).dense.sigma for sigma in (0.002, 0.008))
    assert np.median(noisy / quiet) > 3.0


@pytest.mark.parametrize("name", ["room", "corridor"])
def test_normals_are_those_of_the_planes_up_to_their_borders(name):
    surfaces = found_in(name)
    depth, normal, planar = surfaces.dense.depth, surfaces.dense.normal, surfaces.label < len(surfaces.planes)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=-1)[planar], 1.0, atol=1e-5)
    rays = np.dstack([room(name).camera.normalized(), np.ones_like(depth)])
    assert (np.einsum("hwc,hwc->hw", normal, rays)[planar] < 0).all()
    # n·X is the same all over a plane, negative since the normal looks at the camera
    distances = depth * np.einsum("hwc,hwc->hw", normal, rays)
    for k in np.unique(surfaces.label[planar]):
        of_plane = distances[(surfaces.label == k) & (surfaces.dense.distance > 0)]
        assert of_plane.size == 0 or np.ptp(of_plane) < 1e-3 * abs(of_plane.mean())


def test_cells_look_where_the_middle_of_their_pixels_does():
    cells = cell_camera(OFF_CENTRE, 4)
    rays = OFF_CENTRE.normalized().reshape(30, 4, 40, 4, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(cells.normalized(), rays, atol=1e-6)
    assert cell_camera(ODD, 4).shape == (24, 32)


def test_planes_beyond_all_points_cost_something_and_surfaces_without_depth_the_most():
    """Three planes at 1, at 0.3 of the points' least inverse depth, and behind the camera; free ones, one unknown."""
    inverse_depth = np.full((5, 7), 1.0, np.float32)
    values = np.float32([1.0, 0.3, -0.2, 0.3, 0.0])
    costs = _bounds(np.broadcast_to(values, (3, 4, 5)), 3, inverse_depth)
    np.testing.assert_array_equal(costs, np.broadcast_to(np.float32([0.0, 3.0, 33.0, 0.0, 30.0]), (3, 4, 5)))


@pytest.mark.parametrize("cue", ["depth", "normal"])
def test_what_a_network_expects_decides_where_points_leave_a_choice(cue):
    view = room("corridor")
    normal = normals_from_depth(view.truth, view.camera)
    known = np.isfinite(normal).all(axis=-1) & np.isfinite(view.truth)
    sigma, unsure = (np.full(known.shape, s, np.float32) for s in (0.1, 10.0))
    expected = Expected(
        np.where(known, view.truth, 1.0).astype(np.float32),
        sigma if cue == "depth" else unsure,
        np.where(known[..., None], normal, 0.0).astype(np.float32),
        sigma if cue == "normal" else unsure,
    )
    options = ROOMS.model_copy(update={"expected_depth": 0.3})
    informed = find_surfaces(view.points, [view.prior], view.image, view.stable, view.camera, (), options, expected)
    better, before = view.error(informed), view.error(found_in("corridor"))
    assert (better < WITHIN).mean() > (before < WITHIN).mean()


def unsure_of_all(camera: PinholeCamera) -> Expected:
    """Of a network that expects a wall across the view, and does not believe it itself."""
    ones = np.ones(camera.shape, np.float32)
    return Expected(ones, 10 * ones, np.stack([0 * ones, 0 * ones, -ones], axis=-1), 10 * ones)


def test_points_that_a_network_takes_for_mirrored_weigh_less():
    """Without polarization; a bare patch of the floor has a few points, as far behind it as what it mirrors."""
    view = room("room")
    patch = np.zeros(view.camera.shape, bool)
    patch[85:115, 30:130] = True
    mirrored = patch & np.isfinite(view.points) & (np.random.default_rng(1).random(patch.shape) < 0.1)
    points = np.where(patch, np.where(mirrored, 1.5 * view.points, UNKNOWN), view.points).astype(np.float32)
    image = PolarizationImage.unpolarized(view.image.intensity)
    unsure = unsure_of_all(view.camera)
    misled, warned = (
        view.error(find_surfaces(points, [view.prior], image, view.stable, view.camera, (), ROOMS, expected))[patch]
        for expected in (unsure, replace(unsure, mirrored=mirrored))
    )
    assert (warned < WITHIN).mean() > (misled < WITHIN).mean() + 0.2


@pytest.mark.parametrize("name", ["depth", "mirrored"])
def test_an_expectation_of_another_size_is_refused(name):
    view = room("corridor")
    small = {"depth": np.ones((3, 3), np.float32), "mirrored": np.ones((3, 3), bool)}[name]
    expected = replace(unsure_of_all(view.camera), **{name: small})
    with pytest.raises(InputError, match=f"expected {name}"):
        find_surfaces(view.points, [view.prior], view.image, view.stable, view.camera, (), ROOMS, expected)


def test_labels_change_cheaply_where_brightness_or_polarization_has_a_step():
    grey = np.full((8, 12), 0.5, np.float32)
    grey[:, 3:] = 0.6
    stokes = np.zeros((8, 12, 2), np.float32)
    stokes[4:, :, 1] = 0.3
    right, down = _boundaries(grey, stokes, ROOMS)
    full = ROOMS.boundary_cost * (1 + ROOMS.edge_cost)
    assert (right[:, 2] < 0.1 * full).all() and (right[:, -1] == 0.0).all() and (down[-1] == 0.0).all()
    np.testing.assert_allclose(np.delete(right, 2, axis=1)[:, :-1], full, rtol=1e-5)
    assert (down[2:5] < 0.3 * full).all()  # the step is smoothed over three cells
    np.testing.assert_allclose(down[[0, 1, 5, 6]], full, rtol=1e-5)
    unpolarized = _boundaries(grey, 0.0 * stokes, ROOMS)[1]
    np.testing.assert_allclose(unpolarized[:-1], full, rtol=1e-5)


def assert_same(a: Surfaces, b: Surfaces) -> None:
    for name in ("depth", "sigma", "origin", "distance"):
        np.testing.assert_array_equal(getattr(a.dense, name), getattr(b.dense, name))
    np.testing.assert_array_equal(a.label, b.label)
    np.testing.assert_array_equal(a.planes, b.planes)


@pytest.mark.parametrize("name", ["room", "corridor"])
def test_four_equal_channels_are_as_good_as_no_polarization(name):
    view = room(name)
    equal = polarization_image(np.repeat(view.image.intensity[None], 4, axis=0), TYPICAL)
    assert (equal.dolp == 0.0).all()
    without = view.surfaces(ROOMS.model_copy(update={"polarization": 0.0}))
    assert_same(view.surfaces(image=equal), without)
    assert without.polarization_weight == 0.0
    assert (found_in(name).dense.depth != without.dense.depth).any()


def with_points_at_the_top(view: View, bare: np.ndarray, rows: int) -> View:
    """The view whose bare part has points, with 0.3 % noise, in its topmost rows only, which are textured."""
    rng = np.random.default_rng(0)
    top = bare & (np.indices(bare.shape)[0] < rows)
    noisy = (view.truth * (1.0 + 0.003 * rng.standard_normal(bare.shape))).astype(np.float32)
    stable = view.stable + np.where(top, rng.uniform(-0.15, 0.15, bare.shape), 0.0).astype(np.float32)
    return replace(view, points=np.where(top, noisy, np.where(bare, UNKNOWN, view.points)), stable=stable)


@pytest.mark.parametrize("material", ["matte", "glass", "plastic"])
def test_polarization_closes_a_wall_that_has_one_line_of_points(material):
    """The line leaves its turn open; the textured wall beside it says what polarization is worth."""
    rendering = render(scenes.corner(TEXTURED, MATERIALS[material]), OFF_CENTRE, np.eye(4), supersample=2)
    view = with_points_at_the_top(view_of(rendering, OFF_CENTRE), np.indices(OFF_CENTRE.shape)[1] >= 70, rows=1)
    wall = np.s_[:, 84:]
    found = view.surfaces(TWO_HALVES)
    error, without = (
        view.error(s)[wall] for s in (found, view.surfaces(TWO_HALVES.model_copy(update={"polarization": 0.0})))
    )
    assert found.polarization_weight > 0.1
    assert error.mean() < 0.003 and (error < 0.01).mean() > 0.99
    assert without.mean() > 0.05 and (without < WITHIN).mean() < 0.3


@pytest.mark.xfail(strict=True, reason="polarization has no weight where stereo tells no two planes apart")
def test_polarization_closes_the_only_wall():
    rendering = render(scenes.plane(MATERIALS["matte"], tilt=0.7, azimuth=1.1), OFF_CENTRE, np.eye(4))
    view = with_points_at_the_top(view_of(rendering, OFF_CENTRE), np.ones(OFF_CENTRE.shape, bool), rows=3)
    found = view.surfaces(TWO_HALVES, prior=np.full_like(view.prior, np.nanmedian(view.points)))
    assert view.error(found).mean() < 0.02


def test_without_points_there_is_nothing():
    view = room("room")
    found = view.surfaces(points=np.full_like(view.points, UNKNOWN))
    for array in (found.dense.depth, found.dense.sigma, found.dense.distance, found.dense.first):
        assert np.isnan(array).all() and array.shape == OFF_CENTRE.shape and array.dtype == np.float32
    assert (found.dense.origin == Origin.NONE).all() and found.dense.added == ()
    assert found.planes.shape == (0, 3) and found.polarization_weight == 0.0


def test_points_that_are_not_believed_stay_alone():
    view = room("room")
    dense = view.surfaces(stable=np.full_like(view.stable, 0.5)).dense
    np.testing.assert_array_equal(dense.depth, view.points)
    known = np.isfinite(view.points)
    assert (dense.sigma[known] == LEAST_SIGMA).all() and np.isnan(dense.sigma[~known]).all()
    np.testing.assert_array_equal(dense.origin, np.where(known, Origin.STEREO, Origin.NONE))


@pytest.mark.parametrize("known", [None, 0, 60])
def test_where_no_free_surface_is_known_there_are_planes_and_points(known):
    """Without any, and with one that is known in some of the image's columns."""
    view = room("room")
    prior = np.where(np.arange(160) < (known or 0), view.prior, UNKNOWN)
    found = view.surfaces(free=[] if known is None else [prior])
    dense = found.dense
    assert (view.error(found) < WITHIN).mean() > 0.9
    free = (found.label >= len(found.planes)) & np.isnan(prior)
    np.testing.assert_array_equal(dense.depth[free], view.points[free])
    np.testing.assert_array_equal(np.isfinite(dense.sigma), np.isfinite(dense.depth))
    np.testing.assert_array_equal(dense.origin == Origin.NONE, np.isnan(dense.depth))


def test_with_neither_planes_nor_a_free_surface_the_points_stay():
    """Ten points are too few for a plane."""
    view = room("room")
    few = np.full_like(view.points, UNKNOWN)
    few.ravel()[np.flatnonzero(np.isfinite(view.points))[:10]] = 2.0
    for free in ([], [np.full_like(few, UNKNOWN)]):
        found = view.surfaces(points=few, free=free)
        np.testing.assert_array_equal(found.dense.depth, few)
        np.testing.assert_array_equal(found.dense.origin, np.where(few > 0, Origin.STEREO, Origin.NONE))
        assert len(found.planes) == 0


def test_a_bad_free_surface_does_no_harm_beside_a_good_one():
    view = room("room")
    bad = (9.0 - view.truth).clip(0.5)
    found = view.surfaces(free=[view.prior, bad])
    assert (view.error(found) < WITHIN).mean() > (view.error(found_in("room")) < WITHIN).mean() - 0.01
    assert found.label.max() <= len(found.planes) + 1
    second = found.label == len(found.planes) + 1
    np.testing.assert_allclose(found.dense.depth[second], bad[second], rtol=1e-5)
    np.testing.assert_array_equal(found.dense.first, view.prior)


def test_the_true_free_surface_is_better_than_a_rough_one():
    view = room("room")
    error = view.error(view.surfaces(free=[view.prior, view.truth]))
    assert error.mean() < 0.7 * view.error(found_in("room")).mean()


def test_a_bare_half_of_a_wall_is_carried_to_from_its_other_half():
    """The left half has no point, the prior is a constant, and the picture has an edge between."""
    wall = scenes.corner(MATERIALS["matte"], TEXTURED, turn=1e-3)
    view = view_of(render(wall, OFF_CENTRE, np.eye(4), supersample=2), OFF_CENTRE)
    left = np.arange(OFF_CENTRE.width) < 70
    points = np.where(left, UNKNOWN, view.points)
    found = view.surfaces(TWO_HALVES, points=points, prior=np.full_like(view.prior, 1.5))
    assert (view.error(found)[:, left] < WITHIN).mean() > 0.95


def test_without_planes_there_is_the_prior():
    view = room("room")
    few = np.full_like(view.points, UNKNOWN)
    few.ravel()[np.flatnonzero(np.isfinite(view.points))[:10]] = 2.0
    found = view.surfaces(points=few)
    assert len(found.planes) == 0
    np.testing.assert_allclose(found.dense.depth, view.prior, rtol=1e-6)


@pytest.mark.parametrize("shape", ["edge", "corner"])
def test_units_do_not_matter(shape):
    view = two_halves(shape, "matte")
    metres = view.surfaces(TWO_HALVES)
    larger = view.surfaces(TWO_HALVES, points=view.points * np.float32(40), prior=view.prior * np.float32(40))
    assert (larger.label == metres.label).mean() > 0.995  # rounding may decide a draw
    same = larger.label == metres.label
    np.testing.assert_allclose(larger.dense.depth[same], 40 * metres.dense.depth[same], rtol=1e-4)
    assert np.median(np.abs(larger.dense.sigma / metres.dense.sigma - 1)) < 1e-3


def test_the_same_input_gives_the_same_surfaces():
    assert_same(room("room").surfaces(), found_in("room"))


@pytest.mark.parametrize("cells", [100, 1300, 100_000])
def test_sizes_that_are_no_multiple_of_a_cell(cells):
    """Cells of 11, 3 and 1 pixels."""
    view = two_halves("corner", "matte", ODD)
    found = view.surfaces(SurfaceOptions(cells=cells))
    assert np.isfinite(found.dense.depth).all() and found.dense.depth.shape == ODD.shape
    assert (view.error(found) < WITHIN).mean() > (0.9 if cells == 100 else 0.98)


def test_another_view_that_sees_another_depth_doubles_the_standard_deviation():
    view = two_halves("corner", "matte")
    alone = view.surfaces(TWO_HALVES).dense
    agreeing = Neighbour(view.stable, np.eye(4), view.truth)
    np.testing.assert_array_equal(view.surfaces(TWO_HALVES, [agreeing]).dense.sigma, alone.sigma)
    wrong = np.where(np.indices(OFF_CENTRE.shape)[0] < 60, 1.1 * view.truth, UNKNOWN)
    contradicted = view.surfaces(TWO_HALVES, [Neighbour(view.stable, np.eye(4), wrong.astype(np.float32))]).dense
    np.testing.assert_array_equal(contradicted.depth, alone.depth)
    ratio = contradicted.sigma / alone.sigma
    assert (ratio[:59] == 2.0).mean() > 0.98 and (ratio[60:] == 1.0).all()


def test_other_views_that_look_different_double_the_standard_deviation_if_all_do():
    """Both cameras are where this one is, so that every depth lands on its own pixel."""
    view = two_halves("corner", "matte")
    alone = view.surfaces(TWO_HALVES).dense
    same, brighter = Neighbour(view.stable, np.eye(4)), Neighbour(view.stable + np.float32(0.05), np.eye(4))
    inside = np.s_[1:-1, 1:-1]
    both = view.surfaces(TWO_HALVES, [brighter, brighter]).dense.sigma / alone.sigma
    one = view.surfaces(TWO_HALVES, [brighter, same]).dense.sigma / alone.sigma
    assert (both[inside] == 2.0).mean() > 0.99 and (one == 1.0).all()


def test_a_plane_of_another_view_is_tried_where_this_one_has_no_points():
    """A bare wall without any point, of which a network knows roughly how far it is."""
    view = two_halves("corner", "matte")
    bare = np.indices(view.camera.shape)[1] >= view.camera.width // 2
    blind = np.where(bare, UNKNOWN, view.points)
    image = PolarizationImage.unpolarized(view.image.intensity)
    sigma = np.full(view.camera.shape, 0.1, np.float32)
    expected = replace(unsure_of_all(view.camera), depth=1.05 * view.truth, sigma_depth=sigma)
    wall = normals_from_depth(view.truth, view.camera)[60, 130]
    point = view.truth[60, 130] * np.append(view.camera.normalized()[60, 130], 1.0)
    known = (wall / (wall @ point))[None]

    def with_planes(planes: np.ndarray | None) -> Surfaces:
        given = blind, [view.prior], image, view.stable, view.camera
        return find_surfaces(*given, (), TWO_HALVES, expected, planes)

    alone, helped, misled = map(with_planes, (None, known, 3.0 * known))
    right = [np.mean(view.error(found)[bare] < WITHIN) for found in (alone, helped, misled)]
    assert right[1] > 0.9 and right[0] < 0.5
    assert right[2] > right[0] - 0.02
    assert len(helped.planes) == len(alone.planes) + 1
    assert len(helped.lasting) >= 2
    assert len(with_planes(helped.lasting).planes) == len(helped.planes)  # what is found anew comes once


def test_a_moved_view_of_the_same_scene_contradicts_little():
    scene, T = scenes.corner(TEXTURED, MATERIALS["matte"]), moved(0.1)
    other = render(scene, OFF_CENTRE, T, supersample=2)
    exposure = 0.9 / other.stokes[0].max()  # as `polarization_of` exposes
    stable = stabilized((0.5 * exposure * other.stokes[0]).astype(np.float32))
    view = two_halves("corner", "matte")
    alone = view.surfaces(TWO_HALVES).dense.sigma
    seen = view.surfaces(TWO_HALVES, [Neighbour(stable, moved(-0.1), other.depth)]).dense.sigma
    assert (seen > 1.5 * alone).mean() < 0.1
    misplaced = view.surfaces(TWO_HALVES, [Neighbour(stable, moved(-0.5), other.depth)]).dense.sigma
    assert (misplaced > 1.5 * alone).mean() > 0.3


WRONG = np.zeros((7, 9), np.float32)


@pytest.mark.parametrize("name", ["points", "prior", "stable", "camera"])
def test_what_does_not_fit_the_camera_is_refused(name):
    view = two_halves("corner", "matte")
    with pytest.raises(InputError, match=r"surfaces: .* does not fit the camera"):
        view.surfaces(**{name: ODD if name == "camera" else WRONG})


def test_a_polarization_image_of_another_size_is_refused():
    with pytest.raises(InputError, match=r"surfaces: polarization \(93, 127\) does not fit the camera \(120, 160\)"):
        two_halves("corner", "matte").surfaces(image=two_halves("corner", "matte", ODD).image)


@pytest.mark.parametrize(
    "value", [{"cells": 10}, {"tolerance": 0.0}, {"max_planes": 65}, {"rounds": 0}, {"systematic": 0}]
)
def test_options_out_of_range_are_refused(value):
    with pytest.raises(InputError, match=next(iter(value))):
        SurfaceOptions(**value)


def test_a_plane_behind_the_camera_is_never_chosen():
    """The floor's inverse depth is negative above the horizon."""
    camera = OFF_CENTRE
    floor = plane_depth(camera, (0.0, -1.0, -0.052), 30.0)
    visible = (floor > 0) & (floor < 9.0)
    rng = np.random.default_rng(0)
    stable = np.kron(rng.uniform(0.3, 0.7, (60, 80)), np.ones((2, 2))).astype(np.float32)
    points = np.where(visible & (rng.random(camera.shape) < 0.3), floor, UNKNOWN).astype(np.float32)
    view = replace(
        room("room"), truth=floor, points=points, stable=stable, prior=np.full(camera.shape, 5.0, np.float32)
    )
    found = view.surfaces()
    assert (found.dense.depth > 0).all()
    assert (view.error(found)[visible] < 0.01).mean() > 0.95
