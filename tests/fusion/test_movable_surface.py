"""A surface whose keyframes move ends as if they had always been where they are."""

from __future__ import annotations

import logging

import numpy as np
import pytest
from scenes import WIDE, moved, plane_depth, turned

from polarmap.fusion.movable_surface import MovableSurface
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.surface_map import SurfaceMap

OPTIONS = FusionOptions(voxel_size=0.05)


def depth_map(seed: int) -> tuple:
    """Depth, grey, confidence and camera, different for each seed."""
    rng = np.random.default_rng(seed)
    depth = plane_depth(WIDE, (0.2 * rng.random(), 0.1, -1.0), 2.0).astype(np.float32)
    depth[rng.random(WIDE.shape) < 0.2] = np.nan
    grey, confidence = rng.random((2, *WIDE.shape), np.float32)
    return depth, grey, confidence, WIDE


def pose(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return moved(*(0.3 * rng.random(3))) @ turned(tuple(0.2 * rng.random(3)))


def from_scratch(poses: dict[int, np.ndarray], options=OPTIONS) -> SurfaceMap:
    surface = SurfaceMap(options)
    for frame_id, T in poses.items():
        surface.integrate(*depth_map(frame_id), T, frame_id)
    return surface


def assert_same(a: SurfaceMap, b: SurfaceMap) -> None:
    ours, theirs = a.volume.voxel_sums(), b.volume.voxel_sums()
    for name in ("coordinates", "sums", "views"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


def test_after_all_moves_the_surface_is_that_of_the_final_poses():
    """Window of three: keyframe k comes, and the three last ones move, each time elsewhere."""
    surface, final = MovableSurface(OPTIONS), {}
    for k in range(8):
        window = {i: pose(100 * k + i) for i in range(max(0, k - 2), k + 1)}
        final |= window
        surface.move(window)
        surface.integrate(*depth_map(k), window[k], k)
        assert surface.held <= 3
    settled = surface.settle()
    assert sorted(settled) == [5, 6, 7] and surface.held == 0
    assert_same(surface.surface, from_scratch(final))


def test_final_poses_are_told_when_a_keyframe_leaves():
    surface = MovableSurface(OPTIONS)
    surface.move({0: pose(0), 1: pose(1)})
    surface.integrate(*depth_map(0), pose(0), 0)
    surface.integrate(*depth_map(1), pose(1), 1)
    assert surface.move({0: pose(2), 1: pose(3)}) == {}
    settled = surface.move({1: pose(4)})
    assert list(settled) == [0]
    np.testing.assert_array_equal(settled[0], pose(2))
    assert surface.held == 1


def test_small_moves_wait_until_the_pose_is_final():
    start, nearby = moved(0.0), moved(0.4 * OPTIONS.voxel_size)
    surface = MovableSurface(OPTIONS)
    surface.move({0: start})
    surface.integrate(*depth_map(0), start, 0)
    surface.move({0: nearby})
    assert_same(surface.surface, from_scratch({0: start}))
    surface.settle()
    assert_same(surface.surface, from_scratch({0: nearby}))


@pytest.mark.parametrize("T", [moved(0.6 * OPTIONS.voxel_size), turned((0.0, 0.02, 0.0))])
def test_larger_moves_are_followed_at_once(T):
    surface = MovableSurface(OPTIONS)
    surface.move({0: np.eye(4)})
    surface.integrate(*depth_map(0), np.eye(4), 0)
    surface.move({0: T})
    assert_same(surface.surface, from_scratch({0: T}))
    assert surface.held == 1


def test_many_small_moves_add_up():
    step = 0.2 * OPTIONS.voxel_size
    surface = MovableSurface(OPTIONS)
    surface.move({0: moved(0.0)})
    surface.integrate(*depth_map(0), moved(0.0), 0)
    for i in range(1, 4):
        surface.move({0: moved(i * step)})
    assert_same(surface.surface, from_scratch({0: moved(3 * step)}))


def test_poses_that_cannot_change_are_not_held():
    surface = MovableSurface(OPTIONS)
    surface.integrate(*depth_map(0), pose(0), 0)
    surface.move({1: pose(1)})
    surface.integrate(*depth_map(2), pose(2), 2)
    assert surface.held == 0 and surface.settle() == {}
    assert_same(surface.surface, from_scratch({0: pose(0), 2: pose(2)}))


def test_a_keyframe_without_depth_has_a_final_pose_too():
    nothing = np.full(WIDE.shape, np.nan, np.float32)
    surface = MovableSurface(OPTIONS)
    surface.move({0: pose(0), 1: pose(1)})
    surface.integrate(nothing, *depth_map(0)[1:], pose(0), 0)
    assert surface.move({0: pose(5), 1: pose(1)}) == {} and surface.mesh() is None
    surface.integrate(*depth_map(1), pose(1), 1)
    settled = surface.settle()
    np.testing.assert_array_equal(settled[0], pose(5))
    assert_same(surface.surface, from_scratch({1: pose(1)}))


def test_a_pose_that_the_caller_changes_later_does_no_harm():
    T = np.eye(4)
    surface = MovableSurface(OPTIONS)
    surface.move({0: T})
    surface.integrate(*depth_map(0), T, 0)
    T[0, 3] = 9.0
    surface.settle()
    assert_same(surface.surface, from_scratch({0: np.eye(4)}))


def test_without_room_a_keyframe_stays_where_it_is(caplog):
    """Seen askew, a wall touches more blocks than there may be."""
    straight, askew = np.eye(4), turned((0.6, 0.6, 0.6))
    needed = from_scratch({0: straight}).volume.block_count
    assert from_scratch({0: askew}).volume.block_count > needed
    surface = MovableSurface(FusionOptions(voxel_size=0.05, max_blocks=needed))
    surface.move({0: straight})
    surface.integrate(*depth_map(0), straight, 0)
    with caplog.at_level(logging.WARNING):
        surface.move({0: askew})
        surface.settle()
    assert "keyframe 0 stays where it was fused first" in caplog.text
    assert_same(surface.surface, from_scratch({0: straight}))
