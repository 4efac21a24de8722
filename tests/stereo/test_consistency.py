"""Which stereo depths are kept, what other views say of them, and where stereo searches."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import TEXTURED, moved, plane_depth, stereo_views, turned

from polarmap.data.plane_field import PlaneField
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.stereo.consistency import agreement, drop_islands, inliers, photometric_filter
from polarmap.stereo.depth_range import LARGEST_DISPARITY, SMALLEST_DISPARITY, search_range
from polarmap.stereo.options import ConsistencyOptions, InlierOptions, StereoOptions
from polarmap.stereo.patchmatch.method import patchmatch
from polarmap.synth import scenes

CAMERA = PinholeCamera(width=60, height=40, fx=50.0, fy=50.0, cx=29.5, cy=19.5)
UNKNOWN = np.float32(np.nan)


def field(depth=2.0, score=0.9, relative_sigma=0.001) -> PlaneField:
    depth, score, sigma = (np.broadcast_to(np.float32(a), CAMERA.shape).copy() for a in (depth, score, relative_sigma))
    return PlaneField(1 / depth, 0 * depth, 0 * depth, score, sigma / depth)


def aside(*baselines: float) -> list[np.ndarray]:
    """Cameras beside each other, T_other_reference."""
    return [moved(-baseline) for baseline in baselines]


def wall(z=2.0) -> np.ndarray:
    return np.full(CAMERA.shape, z, np.float32)


def test_poor_and_badly_localized_matches_are_dropped():
    left = np.arange(CAMERA.width) < 30
    above = np.arange(CAMERA.height)[:, None] < 20
    for planes in (field(score=np.where(left, 0.51, 0.49)), field(relative_sigma=np.where(left, 0.019, 0.021))):
        np.testing.assert_array_equal(np.isfinite(photometric_filter(planes)), np.broadcast_to(left, CAMERA.shape))
    planes = field(depth=np.where(above, 2.0, 4.0), relative_sigma=np.where(above, 0.021, 0.019))
    np.testing.assert_array_equal(
        photometric_filter(planes), np.where(above, UNKNOWN, np.broadcast_to(4.0, CAMERA.shape))
    )
    kept = photometric_filter(field(score=0.1), ConsistencyOptions(min_score=0.0))
    np.testing.assert_allclose(kept, 2.0)


def test_unlocalized_matches_are_dropped():
    assert np.isnan(photometric_filter(field(relative_sigma=np.inf))).all()


@pytest.mark.parametrize("size", [39, 40])
def test_islands_are_dropped_below_the_least_size(size):
    depth = wall(np.nan)
    depth[5 : 5 + size // 3, 10:13] = 2.0
    depth[5, 13 : 13 + size % 3] = 2.0
    assert np.count_nonzero(np.isfinite(depth)) == size
    kept = drop_islands(depth, min_region=40, max_step=0.02)
    np.testing.assert_array_equal(kept, depth if size == 40 else wall(np.nan))


@pytest.mark.parametrize(("step", "joined"), [(0.01, True), (0.05, False)])
def test_a_depth_step_parts_islands(step, joined):
    depth = wall(2.0)
    depth[10:15, 10:15] *= 1 + step
    kept = drop_islands(depth, min_region=40, max_step=0.02)
    assert np.isfinite(kept[12, 12]) == joined
    assert np.isfinite(kept[20:]).all()


def test_a_slanted_wall_is_one_island():
    depth = plane_depth(CAMERA, (0.5, 0.2, -1.0), 2.0).astype(np.float32)
    np.testing.assert_array_equal(drop_islands(depth, CAMERA.width * CAMERA.height, 0.02), depth)


def test_nothing_known_stays_nothing():
    assert np.isnan(drop_islands(wall(np.nan), 40, 0.02)).all()


def test_views_that_agree_and_disagree_are_counted():
    """From 0.2 m to the right a wall at 2 m moves 5 pixels to the left."""
    T_other_this = moved(-0.2)
    same, nearer, patchy = wall(), wall(1.5), wall(np.nan)
    patchy[:20] = 2.0
    others = [(same, T_other_this), (nearer, T_other_this), (patchy, T_other_this)]
    agreeing, disagreeing = agreement(wall(), others, CAMERA, 0.1)
    seen = np.arange(CAMERA.width) >= 5
    upper = np.arange(CAMERA.height)[:, None] < 20
    np.testing.assert_array_equal(agreeing, seen * (1 + upper))
    np.testing.assert_array_equal(disagreeing, np.broadcast_to(seen * 1, CAMERA.shape))


def test_the_tolerance_is_in_units_of_depth():
    for tolerance, agrees in ((0.049, 0), (0.051, 1)):
        agreeing, disagreeing = agreement(wall(), [(wall(2.05), np.eye(4))], CAMERA, tolerance)
        assert (agreeing == agrees).all() and (disagreeing == 1 - agrees).all()


def test_unknown_points_are_neither_confirmed_nor_contradicted():
    agreeing, disagreeing = agreement(wall(np.nan), [(wall(), np.eye(4))], CAMERA, 0.1)
    assert not agreeing.any() and not disagreeing.any()


def test_inliers_are_confirmed_or_unseen_and_well_matched():
    """Columns: confirmed, contradicted, unseen; upper half well matched, lower half badly."""
    other = wall()
    other[:, 20:40], other[:, 40:] = 1.5, np.nan
    score = np.where(np.arange(40)[:, None] < 20, np.float32(0.8), np.float32(0.6)) * np.ones(60, np.float32)
    kept = np.isfinite(inliers(wall(), score, [(other, np.eye(4))], CAMERA))
    assert kept[:, :20].all() and not kept[:, 20:40].any()
    assert kept[:20, 40:].all() and not kept[20:, 40:].any()


def test_one_view_that_agrees_is_enough():
    others = [(wall(), np.eye(4)), (wall(1.5), np.eye(4))]
    assert np.isfinite(inliers(wall(), wall(0.6), others, CAMERA)).all()


@pytest.mark.parametrize("depth", [1.0, 8.0])
def test_the_inlier_tolerance_is_a_share_of_the_depth(depth):
    for share, kept in ((0.019, True), (0.021, False)):
        found = inliers(wall(depth), wall(0.9), [(wall(depth * (1 + share)), np.eye(4))], CAMERA)
        assert np.isfinite(found).all() == kept
    loose = inliers(wall(depth), wall(0.9), [(wall(depth * 1.04), np.eye(4))], CAMERA, InlierOptions(tolerance=0.05))
    assert np.isfinite(loose).all()


def test_inliers_keep_the_depth_they_had():
    np.testing.assert_array_equal(inliers(wall(), wall(0.9), [], CAMERA), wall())


def test_the_search_range_follows_the_baselines():
    near, far = search_range(aside(0.1, 0.2), CAMERA, StereoOptions())
    assert CAMERA.fx * 0.2 / far == pytest.approx(SMALLEST_DISPARITY)
    assert CAMERA.fx * 0.1 / near == pytest.approx(LARGEST_DISPARITY * CAMERA.width)


@pytest.mark.parametrize("degrees", [4.0, 10.0, 20.0])
@pytest.mark.parametrize("field_of_view", [18.0, 60.0])
def test_cameras_that_converge_search_what_they_look_at(degrees, field_of_view):
    """On an arc of radius 2 about a thing, which cameras side by side would take to be too near."""
    focal = 0.5 * 640 / np.tan(np.radians(field_of_view) / 2)
    camera = PinholeCamera(640, 480, focal, focal, 319.5, 239.5)
    angles = np.radians([0.0, degrees, -degrees])
    poses = [turned((0.0, a + 1e-12, 0.0), (-2.0 * np.sin(a), 0.0, -2.0 * np.cos(a))) for a in angles]
    motions = [inverse(pose) @ poses[0] for pose in poses[1:]]
    near, far = search_range(motions, camera, StereoOptions())
    assert 0.2 < near < 1.6 and far > 4.0


@pytest.mark.parametrize("direction", [(1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.6, 0.8, 0.0), (-0.9, 0.2, 0.0)])
@pytest.mark.parametrize("camera", [CAMERA, PinholeCamera(640, 480, 480.0, 480.0, 319.5, 239.5)])
def test_cameras_side_by_side_search_as_far_as_their_baseline_allows(camera, direction):
    near, _ = search_range([moved(*(0.1 * np.array(direction)))], camera, StereoOptions())
    assert near == pytest.approx(camera.fx * 0.1 * np.linalg.norm(direction) / (LARGEST_DISPARITY * camera.width))


def test_cameras_behind_each_other_search_as_before():
    near, _ = search_range([moved(0.0, 0.0, -0.1)], CAMERA, StereoOptions())
    assert near == pytest.approx(CAMERA.fx * 0.1 / (LARGEST_DISPARITY * CAMERA.width))


def test_a_search_range_that_is_given_is_kept():
    assert search_range(aside(0.1), CAMERA, StereoOptions(depth_min=0.5, depth_max=7.0)) == (0.5, 7.0)
    near, far = search_range(aside(0.1), CAMERA, StereoOptions(depth_max=0.2))
    assert near == pytest.approx(0.1) and far == pytest.approx(0.2)
    near, far = search_range(aside(0.1), CAMERA, StereoOptions(depth_min=50.0))
    assert near == 50.0 and far > near


def test_a_view_that_has_hardly_moved_does_not_spoil_the_search():
    camera = CAMERA.scaled(2.0)
    poses = [moved(0.0), moved(-0.25), moved(0.25), moved(1e-5)]
    truth, views = stereo_views(scenes.plane(TEXTURED), camera, poses)
    planes = patchmatch(views[0], views[1:], camera, search_range(aside(0.25, 0.25, 1e-5), camera, StereoOptions()))
    depth = photometric_filter(planes)
    assert np.isfinite(depth).mean() > 0.3 and np.nanmedian(np.abs(depth / truth.depth - 1)) < 0.01


def test_an_empty_search_range_is_refused():
    with pytest.raises(InputError):
        search_range(aside(0.1), CAMERA, StereoOptions(depth_min=5.0, depth_max=1.0))
