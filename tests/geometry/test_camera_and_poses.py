"""Camera, poses, depth and normals, and carrying depth between views, against direct computation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import (
    WIDE,
    angle_between,
    azimuth_of,
    gradient_of,
    moved,
    pixel_rays,
    plane_depth,
    sphere_depth,
    turn_between,
    turned,
)

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import from_quaternion, inverse, is_rigid, look_at, to_quaternion, without_noise
from polarmap.geometry.surface import (
    incidence_direction,
    log_range_gradient,
    normals_at,
    normals_from_cues,
    normals_from_depth,
    range_factor,
    zenith_of,
)
from polarmap.geometry.warp import transfer_depth, warp_depth

SMALL = PinholeCamera(width=24, height=18, fx=20.0, fy=22.0, cx=11.0, cy=9.5)
coordinate = st.floats(-10.0, 10.0)


def test_rays_and_coordinates_are_those_of_the_pixels_centres():
    rays = pixel_rays(SMALL)
    np.testing.assert_allclose(SMALL.normalized(), rays[..., :2], atol=1e-6)
    np.testing.assert_allclose(SMALL.rays(), rays / np.linalg.norm(rays, axis=-1, keepdims=True), atol=1e-6)
    np.testing.assert_allclose(range_factor(SMALL), np.linalg.norm(rays, axis=-1), rtol=1e-6)
    v, u = np.indices(SMALL.shape)
    np.testing.assert_allclose(rays @ SMALL.matrix.T, np.stack([u, v, np.ones_like(u)], axis=-1), atol=1e-9)


@pytest.mark.parametrize("dtype", [np.float64, np.float32, np.int64])
def test_pixels_are_unprojected_to_depth_1(dtype):
    v, u = np.mgrid[: SMALL.height, : SMALL.width]
    points = SMALL.unproject(np.stack([u, v], axis=-1).astype(dtype))
    assert points.dtype == np.float64 and (points[..., 2] == 1).all()
    np.testing.assert_array_equal(points[..., :2].astype(np.float32), SMALL.normalized())
    assert SMALL.unproject(np.zeros((0, 2), dtype)).shape == (0, 3)


def test_shared_ray_arrays_cannot_be_written():
    with pytest.raises(ValueError, match="read-only"):
        SMALL.rays()[0, 0, 0] = 1.0


@pytest.mark.parametrize("factor", [0.5, 2.0])
def test_a_scaled_camera_sees_the_same_corners(factor):
    """The image's outer corners, at -0.5 and width - 0.5, are the same rays at any resolution."""
    scaled = SMALL.scaled(factor)
    for camera in (SMALL, scaled):
        assert (-0.5 - camera.cx) / camera.fx == pytest.approx((-0.5 - SMALL.cx) / SMALL.fx)
        assert (camera.height - 0.5 - camera.cy) / camera.fy == pytest.approx(
            (SMALL.height - 0.5 - SMALL.cy) / SMALL.fy
        )
    assert scaled.shape == (18 * factor, 24 * factor)


def test_a_resized_camera_sees_the_same_corners_in_other_proportions():
    resized = SMALL.resized((36, 12))
    assert resized.shape == (36, 12)
    for camera in (SMALL, resized):
        corner = (camera.width - 0.5 - camera.cx) / camera.fx, (camera.height - 0.5 - camera.cy) / camera.fy
        assert corner == pytest.approx(
            ((SMALL.width - 0.5 - SMALL.cx) / SMALL.fx, (SMALL.height - 0.5 - SMALL.cy) / SMALL.fy)
        )
        assert (-0.5 - camera.cx) / camera.fx == pytest.approx((-0.5 - SMALL.cx) / SMALL.fx)


@pytest.mark.parametrize(
    ("change", "message"),
    [({"width": 0}, "size"), ({"fx": np.nan}, "finite"), ({"fy": -1.0}, "positive"), ({"cx": np.inf}, "finite")],
)
def test_impossible_cameras_are_refused(change, message):
    with pytest.raises(InputError, match=message):
        PinholeCamera(**{"width": 4, "height": 4, "fx": 1.0, "fy": 1.0, "cx": 0.0, "cy": 0.0, **change})


@given(st.tuples(coordinate, coordinate, coordinate), st.tuples(coordinate, coordinate, coordinate, coordinate))
def test_a_pose_survives_the_way_through_a_quaternion(translation, quaternion):
    if np.linalg.norm(quaternion) < 1e-3:
        return
    T = from_quaternion(translation, quaternion)
    np.testing.assert_allclose(T[:3, :3] @ T[:3, :3].T, np.eye(3), atol=1e-12)
    t, q = to_quaternion(T)
    assert q[3] >= 0
    np.testing.assert_allclose(from_quaternion(t, q), T, atol=1e-12)
    np.testing.assert_allclose(inverse(T) @ T, np.eye(4), atol=1e-12)


def test_a_quaternion_turns_as_its_axis_and_angle_say():
    T = from_quaternion([1.0, 2.0, 3.0], [0.0, 0.0, np.sin(0.15), np.cos(0.15)])
    np.testing.assert_allclose(T, turned((0.0, 0.0, 0.3), (1.0, 2.0, 3.0)), atol=1e-12)


@pytest.mark.parametrize(
    "bad", [([np.nan, 0, 0], [0, 0, 0, 1]), ([0, 0, 0], [0, 0, np.inf, 1]), ([0, 0, 0], [0, 0, 0, 0])]
)
def test_quaternions_that_are_none_are_refused(bad):
    with pytest.raises(InputError, match="pose"):
        from_quaternion(*bad)


@pytest.mark.parametrize(
    ("T", "rigid"),
    [
        (turned((0.3, -0.2, 0.9), (5.0, 1.0, 2.0)), True),
        (np.diag([1.0, 1.0, -1.0, 1.0]), False),
        (np.diag([2.0, 0.5, 1.0, 1.0]), False),
        (np.diag([1.01, 1.01, 1.01, 1.0]), False),
        (np.diag([1.0, 1.0, np.nan, 1.0]), False),
        (moved(np.inf), False),
        (np.eye(3), False),
    ],
)
def test_only_a_rotation_with_a_translation_is_rigid(T, rigid):
    assert is_rigid(T) is rigid


@pytest.mark.parametrize("unit", [1.0, 1000.0, 1e-6])
def test_a_motion_is_the_same_wherever_the_world_has_its_origin(unit):
    """In float64 metres of UTM a nanometre is lost of each position; units do not matter."""
    rng, place = np.random.default_rng(0), unit * np.array([451234.5, 5212345.678, 512.3])
    same = 0
    for _ in range(50):
        near = [from_quaternion(unit * rng.normal(0, 0.2, 3), rng.normal(size=4)) for _ in range(2)]
        far = [T.copy() for T in near]
        for T in far:
            T[:3, 3] = (T[:3, 3] + place) - place
        exact, motion, far_motion = (inverse(b) @ a for a, b in (near, near, far))
        motion = without_noise(motion)
        np.testing.assert_allclose(motion, exact, atol=2**-16 * np.abs(exact[:3, 3]).max())
        np.testing.assert_array_equal(motion[:3, :3], exact[:3, :3])
        same += np.array_equal(motion, without_noise(far_motion))
    assert same >= 47  # now and then the border between two roundings lies between the two
    for none in (np.eye(4), moved(0.0), moved(1e-310)):
        np.testing.assert_allclose(without_noise(none), none, atol=1e-310)


def test_look_at_puts_the_target_on_the_axis_and_up_upward():
    T = look_at((1.0, 2.0, 3.0), (2.0, 4.0, 2.0))
    target = inverse(T) @ [2.0, 4.0, 2.0, 1.0]
    np.testing.assert_allclose(target[:2], 0.0, atol=1e-12)
    assert target[2] == pytest.approx(np.sqrt(6.0))
    assert (inverse(T)[:3, :3] @ [0.0, 0.0, 1.0])[1] < 0  # image y points down
    assert np.linalg.det(T[:3, :3]) == pytest.approx(1.0)
    with pytest.raises(InputError, match="parallel"):
        look_at((0.0, 0.0, 0.0), (0.0, 0.0, 2.0))


@pytest.mark.parametrize(("radius", "stride"), [(1, 1), (2, 1), (4, 2)])
@settings(deadline=None, max_examples=20)
@given(tilt=st.floats(0.0, 0.9), azimuth=st.floats(-3.1, 3.1), distance=st.floats(0.5, 20.0))
def test_normals_of_any_plane_are_exact(radius, stride, tilt, azimuth, distance):
    n = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)])
    depth = plane_depth(WIDE, n, distance)
    depth[~(depth > 0)] = np.nan
    normals = normals_from_depth(depth.astype(np.float32), WIDE, radius, stride, max_slope=0.2, max_step=0.4)
    seen = pixel_rays(WIDE) @ n < -0.3
    assert np.isfinite(normals[seen]).all()
    assert angle_between(normals, n)[seen].max() < 0.1


def test_normals_beside_a_depth_step_are_those_of_each_side():
    near, far = (0.0, 0.4, -1.0), (-0.4, 0.0, -1.0)
    left = np.arange(WIDE.width) < 60
    depth = np.where(left, plane_depth(WIDE, near, 1.5), plane_depth(WIDE, far, 2.5)).astype(np.float32)
    truth = np.where(left[:, None], near, far) / np.sqrt(1.16)
    assert angle_between(normals_from_depth(depth, WIDE, radius=2), truth).max() < 0.1
    for limits in ({"max_slope": 1.0}, {"max_step": 1.0}):
        assert angle_between(normals_from_depth(depth, WIDE, radius=2, **limits), truth).max() < 0.1
    smeared = normals_from_depth(depth, WIDE, radius=2, max_slope=1.0, max_step=1.0)
    assert angle_between(smeared, truth)[:, 58:62].min() > 5.0


def test_a_wide_fit_is_less_noisy():
    noisy = plane_depth(WIDE, (0.3, 0.2, -1.0), 2.0) * (
        1 + 0.002 * np.random.default_rng(0).standard_normal(WIDE.shape)
    )
    errors = [
        np.median(angle_between(normals_from_depth(noisy.astype(np.float32), WIDE, *window), [0.2822, 0.1881, -0.9407]))
        for window in ((1, 1), (2, 1), (4, 2))
    ]
    assert errors[0] > 2 * errors[1] > 6 * errors[2]


def test_a_stride_takes_neighbours_that_far_apart():
    depth = np.full(WIDE.shape, np.nan, np.float32)
    depth[::2, ::2] = 2.0
    assert np.isnan(normals_from_depth(depth, WIDE)).all()
    np.testing.assert_array_equal(np.isfinite(normals_from_depth(depth, WIDE, stride=2)[..., 0]), np.isfinite(depth))


@pytest.mark.parametrize("radius, stride", [(1, 1), (2, 1), (2, 2), (3, 1)])
def test_normals_of_some_pixels_are_those_of_all(radius, stride):
    """Scattered ones, and those of some rows and columns, of a picture with gaps and steps, borders included."""
    rng = np.random.default_rng(radius)
    depth = plane_depth(WIDE, (0.3, 0.2, -1.0), 2.0) * np.where(np.arange(WIDE.width) < 50, 1.0, 1.6)
    depth = (depth * (1.0 + 0.002 * rng.standard_normal(WIDE.shape))).astype(np.float32)
    depth[rng.random(WIDE.shape) < 0.2] = np.nan
    everywhere = normals_from_depth(depth, WIDE, radius, stride)
    where = rng.random(WIDE.shape) < 0.3
    where[20:30], where[31, :40] = False, False
    some = normals_from_depth(depth, WIDE, radius, stride, where=where)
    np.testing.assert_array_equal(some[where], everywhere[where])
    assert np.isnan(some[~where]).all() and np.isfinite(some[where]).mean() > 0.5
    rows, columns = np.array([0, 1, 17, WIDE.height - 1]), np.array([0, 3, 49, 50, WIDE.width - 1])
    few = normals_at(depth, WIDE, rows, columns, radius, stride)
    np.testing.assert_allclose(few, everywhere[rows[:, None], columns], atol=1e-5)


def test_normals_need_neighbours_that_span_a_plane():
    depth = np.full((5, 7), np.nan, np.float32)
    depth[2, 1:6] = 2.0  # a row alone
    depth[0, 0] = 2.0  # a pixel alone
    camera = PinholeCamera(7, 5, 10.0, 10.0, 3.0, 2.0)
    assert np.isnan(normals_from_depth(depth, camera)).all()
    depth[3, 3] = 2.0
    known = np.isfinite(normals_from_depth(depth, camera)[..., 0])
    assert known[2, 2:5].all() and known.sum() == 4


def test_azimuth_and_zenith_give_back_the_normals():
    rng = np.random.default_rng(0)
    normals = rng.standard_normal((*WIDE.shape, 3)).astype(np.float32)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    normals *= -np.sign((normals * WIDE.rays()).sum(-1, keepdims=True))
    again = normals_from_cues(azimuth_of(normals, WIDE), zenith_of(normals, WIDE), WIDE)
    assert angle_between(again, normals).max() < 0.1


def test_zenith_is_the_angle_to_the_viewing_ray():
    facing = -WIDE.rays()
    assert zenith_of(facing, WIDE).max() < 1e-3
    forward = np.broadcast_to(np.float32([0.0, 0.0, -1.0]), facing.shape)
    x, y = WIDE.normalized()[3, 5]
    assert zenith_of(forward, WIDE)[3, 5] == pytest.approx(np.arctan(np.hypot(x, y)), abs=1e-5)
    assert zenith_of(forward, WIDE, orthographic=True).max() == 0.0


def sphere_with_truth():
    """∇ log range per pixel and unit normals of a sphere off the axis, NaN beside it and near its rim."""
    centre, radius = np.array([0.2, -0.1, 2.0]), 0.6
    normals = (pixel_rays(WIDE) * sphere_depth(WIDE, centre, radius)[..., None] - centre) / radius
    normals[zenith_of(normals, WIDE) > 1.2] = np.nan
    return gradient_of(lambda camera: sphere_depth(camera, centre, radius), WIDE), normals


def test_the_cues_of_a_sphere_off_the_axis_ask_for_its_gradient():
    """d ∝ M ∇w and tan²θ = (1+|x|²) ∇wᵀM∇w."""
    expected, normals = sphere_with_truth()
    gradient = log_range_gradient(azimuth_of(normals, WIDE), zenith_of(normals, WIDE), WIDE)
    known = np.isfinite(gradient).all(-1)
    assert known.sum() > 1500
    np.testing.assert_allclose(gradient[known], expected[known], atol=1e-5)
    assert np.abs(expected[known]).max() > 0.02


def test_the_orthographic_gradient_is_off_by_degrees_off_the_axis():
    expected, normals = sphere_with_truth()
    d = incidence_direction(normals, WIDE, orthographic=True)
    gradient = log_range_gradient(np.arctan2(d[..., 1], d[..., 0]), zenith_of(normals, WIDE, True), WIDE, True)
    found, truth = (np.arctan2(g[..., 1] * WIDE.fy, g[..., 0] * WIDE.fx) for g in (gradient, expected))
    assert np.nanmedian(np.degrees(turn_between(found, truth))) > 5.0


def test_the_orthographic_gradient_is_the_papers_on_the_axis():
    """tan φ = ∇y z/∇x z and steepness tan θ, exact where the ray is the axis."""
    tilt, azimuth = 0.5, 0.7
    n = np.array([np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt)])
    camera = PinholeCamera(5, 5, 1000.0, 900.0, 2.0, 2.0)
    z = plane_depth(camera, n, 2.0)
    expected = np.array([np.gradient(np.log(z), axis=1)[2, 2], np.gradient(np.log(z), axis=0)[2, 2]])
    cue = np.full(camera.shape, azimuth, np.float32), np.full(camera.shape, tilt, np.float32)
    for orthographic in (True, False):
        np.testing.assert_allclose(log_range_gradient(*cue, camera, orthographic)[2, 2], expected, rtol=1e-4)


def transferred_by_loop(depth, other, camera, T):
    expected, found = np.full(depth.shape, np.nan), np.full(depth.shape, np.nan)
    points = pixel_rays(camera) * depth[..., None] @ T[:3, :3].T + T[:3, 3]
    for v, u in np.argwhere(points[..., 2] > 0):
        x, y = (camera.matrix @ points[v, u])[:2] / points[v, u, 2]
        column, row = int(np.floor(x + 0.5)), int(np.floor(y + 0.5))
        if 0 <= column < camera.width and 0 <= row < camera.height:
            expected[v, u], found[v, u] = points[v, u, 2], other[row, column]
    return expected, found


@pytest.fixture(scope="module")
def random_depths():
    rng = np.random.default_rng(3)
    depths = rng.uniform(1.0, 3.0, (2, *SMALL.shape)).astype(np.float32)
    depths[rng.random(depths.shape) < 0.2] = np.nan
    return depths


MOTIONS = {
    "none": np.eye(4),
    "turned and moved": turned((0.1, -0.2, 0.3), (0.2, -0.1, 0.3)),
    "past the nearer points": moved(0.0, 0.0, -2.0),
    "turned round": turned((0.0, np.pi, 0.0)),
}


@pytest.mark.parametrize("motion", MOTIONS)
def test_transfer_agrees_with_direct_projection(random_depths, motion):
    depth, other = random_depths
    result = transfer_depth(depth, other, SMALL, MOTIONS[motion])
    for array, expected in zip(result, transferred_by_loop(depth, other, SMALL, MOTIONS[motion]), strict=True):
        np.testing.assert_allclose(array, expected, rtol=1e-5)
    if motion == "none":
        np.testing.assert_array_equal(result[1], np.where(np.isnan(depth), np.nan, other))


@pytest.mark.parametrize("motion", MOTIONS)
def test_warping_keeps_the_nearest_point_on_each_pixel(random_depths, motion):
    depth, T = random_depths[0], MOTIONS[motion]
    expected = np.full(SMALL.shape, np.inf)
    points = pixel_rays(SMALL) * depth[..., None] @ T[:3, :3].T + T[:3, 3]
    for v, u in np.argwhere(points[..., 2] > 0):
        x, y = np.floor((SMALL.matrix @ points[v, u])[:2] / points[v, u, 2] + 1e-6).astype(int)
        for row, column in ((y, x), (y, x + 1), (y + 1, x), (y + 1, x + 1)):
            if 0 <= column < SMALL.width and 0 <= row < SMALL.height:
                expected[row, column] = min(expected[row, column], points[v, u, 2])
    expected[np.isinf(expected)] = np.nan
    found = warp_depth(depth, SMALL, T)
    if motion == "none":  # points fall on pixel centres, where rounding decides
        known = np.isfinite(depth)
        assert (found[known] <= depth[known] * (1 + 1e-6)).all()
    else:
        np.testing.assert_allclose(found, expected, rtol=1e-5)


def test_a_warped_surface_is_the_surface_from_there():
    T_target_source = inverse(turned((0.02, -0.05, 0.03), (0.1, 0.05, -0.1)))
    source = plane_depth(WIDE, (0.3, 0.2, -1.0), 2.0)
    R, t = T_target_source[:3, :3], T_target_source[:3, 3]
    n = R @ [0.3, 0.2, -1.0]
    point = R @ [0.0, 0.0, 2.0] + t
    truth = n @ point / (pixel_rays(WIDE) @ n)
    warped = warp_depth(source.astype(np.float32), WIDE, T_target_source)
    inner = np.s_[15:-15, 15:-15]
    assert np.isfinite(warped[inner]).all()
    assert np.abs(warped / truth - 1)[inner].max() < 0.02
