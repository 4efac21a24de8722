"""Over which depths stereo searches where points are known, and how it is noticed that things are beyond them."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import TEXTURED, moved, stereo_views

from polarmap.data.depth_search import DepthSearch
from polarmap.data.plane_field import PlaneField
from polarmap.geometry.camera import PinholeCamera
from polarmap.stereo.depth_range import LARGEST_DISPARITY, PILED_UP, at_ends, beyond_near_end, search_range
from polarmap.stereo.options import StereoOptions
from polarmap.stereo.patchmatch.method import patchmatch
from polarmap.synth import scenes

CAMERA = PinholeCamera(width=120, height=80, fx=100.0, fy=100.0, cx=59.5, cy=39.5)
MOTIONS = [moved(-0.1), moved(-0.2)]
USUAL = search_range(MOTIONS, CAMERA, StereoOptions())  # 0.28 to 80 m


def searched(*known: np.ndarray, **options: float) -> tuple[float, float]:
    return search_range(MOTIONS, CAMERA, StereoOptions(**options), known)


def spread(nearest: float, farthest: float, count: int = 200) -> np.ndarray:
    return np.geomspace(nearest, farthest, count).astype(np.float32)


def field(depth: np.ndarray | float, score=0.9, relative_sigma=0.001) -> PlaneField:
    depth, score, sigma = (np.broadcast_to(np.float32(a), CAMERA.shape).copy() for a in (depth, score, relative_sigma))
    return PlaneField(1 / depth, 0 * depth, 0 * depth, score, sigma / depth)


def test_points_beyond_the_range_widen_it():
    near, far = searched(spread(0.1, 0.2))
    assert 0.05 < near < 0.1 and far == USUAL[1]
    near, far = searched(spread(100.0, 200.0))
    assert near == USUAL[0] and 200.0 < far < 400.0


def test_every_source_of_points_is_heard():
    many, few = np.full(CAMERA.shape, 2.0, np.float32), spread(0.1, 0.2, 40)
    assert searched(many, few)[0] == searched(few)[0] < 0.1


def test_points_inside_the_range_change_nothing():
    assert searched(spread(1.0, 3.0), spread(2.0, 2.1)) == USUAL


def test_a_few_wild_points_do_not_stretch_it():
    wild = np.concatenate([spread(1.0, 3.0, 400), np.float32([1e-3, 1e-4, 1e-5, 1e6, 1e7, 1e8])])
    assert searched(wild) == USUAL
    assert searched(spread(0.001, 0.002, 20)) == USUAL  # too few


def test_no_points_stretch_it_absurdly():
    near, far = searched(spread(1e-6, 1e-5), spread(1e8, 1e9))
    assert USUAL[0] / 100 < near < USUAL[0] < USUAL[1] < far < 100 * USUAL[1]


def test_unknown_depths_do_not_count():
    depths = np.full(CAMERA.shape, np.nan, np.float32)
    depths[0, :60] = -1.0
    depths[1, :60] = 0.0
    assert searched(depths) == USUAL
    depths[2, :60] = 0.1
    assert searched(depths)[0] < 0.1


def test_ends_that_are_given_stay():
    assert searched(spread(0.1, 200.0), depth_min=0.5, depth_max=7.0) == (0.5, 7.0)
    near, far = searched(spread(0.1, 200.0), depth_min=0.5)
    assert near == 0.5 and far > 200.0


def test_pixels_at_the_ends_are_counted():
    depth = np.full(CAMERA.shape, 2.0)
    depth[:20], depth[20:30] = 1.005, 4.97
    search = at_ends(field(depth), (1.0, 5.0))
    assert (search.near, search.far) == (1.0, 5.0)
    assert search.at_near == pytest.approx(0.25) and search.at_far == pytest.approx(0.125)
    inside = at_ends(field(depth), (0.5, 10.0))
    assert inside.at_near == inside.at_far == 0.0


def test_beyond_an_end_counts_as_at_it():
    assert at_ends(field(0.9), (1.0, 5.0)).at_near == 1.0
    assert at_ends(field(5.5), (1.0, 5.0)).at_far == 1.0


def test_only_good_depths_count_at_the_ends():
    """A sky is matched at the far end, where next to nothing moves: its depth is not known well enough to count."""
    above = np.arange(CAMERA.height)[:, None] < 40
    depth = np.where(above, 5.0, 2.0)
    assert at_ends(field(depth), (1.0, 5.0)).at_far == pytest.approx(0.5)
    for poor in (
        field(depth, score=np.where(above, 0.3, 0.9)),
        field(depth, relative_sigma=np.where(above, 0.2, 0.001)),
    ):
        assert at_ends(poor, (1.0, 5.0)).at_far == 0.0


def test_next_to_nothing_matched_is_at_no_end():
    score = np.zeros(CAMERA.shape)
    score[0, :99] = 0.9
    for planes in (PlaneField.empty(CAMERA.shape), field(1.0, score=score)):
        search = at_ends(planes, (1.0, 5.0))
        assert search.at_near == search.at_far == 0.0
    score[1, 0] = 0.9
    assert at_ends(field(1.0, score=score), (1.0, 5.0)).at_near == 1.0


@pytest.mark.parametrize(("ends", "near", "far"), [((0.3, 50.0), 0, 0), ((3.0, 50.0), 1, 0), ((0.3, 1.2), 0, 1)])
def test_stereo_piles_up_at_the_end_beyond_which_things_are(ends, near, far):
    """A wall two metres away, and a range that holds it, begins behind it or ends before it."""
    _, views = stereo_views(scenes.plane(TEXTURED), CAMERA, [moved(0.0), moved(-0.1), moved(0.1)])
    search = at_ends(patchmatch(views[0], views[1:], CAMERA, ends), ends)
    assert (search.at_near > 2 * PILED_UP, search.at_far > 2 * PILED_UP) == (near, far)
    assert near or search.at_near < 0.2 * PILED_UP
    assert far or search.at_far < 0.2 * PILED_UP


def test_a_range_is_searched_again_where_its_near_end_is_not_given():
    piled = DepthSearch(1.0, 5.0, at_near=2 * PILED_UP)
    near, far = beyond_near_end(piled, StereoOptions())
    assert near == pytest.approx(LARGEST_DISPARITY) and far == 5.0
    assert beyond_near_end(piled, StereoOptions(depth_min=1.0)) is None
    assert beyond_near_end(DepthSearch(1.0, 5.0, at_near=0.5 * PILED_UP, at_far=0.5), StereoOptions()) is None
