"""A surface whose keyframes move ends as if they had always been where they are."""

from __future__ import annotations

import logging
from dataclasses import replace

import numpy as np
import pytest
from scenes import WIDE, moved, plane_depth, turned

from polarmap.data.depth_map import DepthMap
from polarmap.errors import PolarmapError
from polarmap.fusion.depth_store import DiskStore, MemoryStore
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.surface import Surface
from polarmap.fusion.surface_map import SurfaceMap
from polarmap.geometry.sim3 import Sim3

OPTIONS = FusionOptions(voxel_size=0.05)


def depth_map(seed: int) -> DepthMap:
    """Different for each seed."""
    rng = np.random.default_rng(seed)
    depth = plane_depth(WIDE, (0.2 * rng.random(), 0.1, -1.0), 2.0).astype(np.float32)
    depth[rng.random(WIDE.shape) < 0.2] = np.nan
    grey, confidence = rng.random((2, *WIDE.shape), np.float32)
    return DepthMap(depth, grey, confidence, WIDE)


def matrix(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    return moved(*(0.3 * rng.random(3))) @ turned(tuple(0.2 * rng.random(3)))


def at(T: np.ndarray, scale: float = 1.0) -> Sim3:
    return replace(Sim3.from_matrix(T), scale=scale)


def pose(seed: int) -> Sim3:
    return at(matrix(seed))


def from_scratch(poses: dict[int, Sim3], options=OPTIONS) -> SurfaceMap:
    surface = SurfaceMap(options)
    for frame_id, pose in poses.items():
        m = depth_map(frame_id)
        depth = np.float32(pose.scale) * m.depth
        surface.integrate(depth, m.grey, m.confidence, WIDE, pose.rigid, frame_id)
    return surface


def assert_same(a: SurfaceMap, b: SurfaceMap) -> None:
    ours, theirs = a.volume.voxel_sums(), b.volume.voxel_sums()
    for name in ("coordinates", "sums", "views"):
        np.testing.assert_array_equal(getattr(ours, name), getattr(theirs, name))


@pytest.fixture(params=[MemoryStore, DiskStore])
def store(request):
    return request.param()


def test_after_all_moves_the_surface_is_that_of_the_final_poses(store):
    """Window of three: keyframe k comes, and the three last ones move, each time elsewhere."""
    surface, final = Surface(OPTIONS, store), {}
    for k in range(8):
        window = {i: pose(100 * k + i) for i in range(max(0, k - 2), k + 1)}
        final |= window
        surface.move(window)
        surface.settle([k - 3])
        surface.integrate(k, depth_map(k), window[k], movable=True)
        assert len(surface.movable) <= 3
    settled = surface.settle()
    assert sorted(settled) == [5, 6, 7] and not surface.movable
    assert_same(surface.map, from_scratch(final))


def test_a_loop_that_closes_late_moves_and_scales_keyframes_of_long_ago(store):
    surface = Surface(OPTIONS, store)
    for k in range(5):
        surface.integrate(k, depth_map(k), pose(k), movable=True)
    corrected = {k: at(matrix(50 + k), scale=1.0 + 0.05 * k) for k in range(5)}
    surface.move(corrected)
    assert surface.movable == frozenset(range(5))
    surface.settle()
    assert_same(surface.map, from_scratch(corrected))


def test_final_poses_are_told_when_a_keyframe_is_settled():
    surface = Surface(OPTIONS)
    surface.integrate(0, depth_map(0), pose(0), movable=True)
    surface.integrate(1, depth_map(1), pose(1), movable=True)
    surface.move({0: pose(2), 1: pose(3), 7: pose(4)})
    settled = surface.settle([0, 7])
    assert list(settled) == [0]
    np.testing.assert_array_equal(settled[0].rigid, matrix(2))
    assert surface.movable == {1}


def test_small_moves_wait_until_the_pose_is_final():
    start, nearby = at(moved(0.0)), at(moved(0.4 * OPTIONS.voxel_size))
    surface = Surface(OPTIONS)
    surface.integrate(0, depth_map(0), start, movable=True)
    surface.move({0: nearby})
    assert_same(surface.map, from_scratch({0: start}))
    surface.settle()
    assert_same(surface.map, from_scratch({0: nearby}))


@pytest.mark.parametrize(
    "there", [at(moved(0.6 * OPTIONS.voxel_size)), at(turned((0.0, 0.02, 0.0))), at(np.eye(4), 1.1)]
)
def test_larger_moves_are_followed_at_once(there):
    surface = Surface(OPTIONS)
    surface.integrate(0, depth_map(0), at(np.eye(4)), movable=True)
    surface.move({0: there})
    assert_same(surface.map, from_scratch({0: there}))
    assert surface.movable == {0}


def test_many_small_moves_add_up():
    step = 0.2 * OPTIONS.voxel_size
    surface = Surface(OPTIONS)
    surface.integrate(0, depth_map(0), at(moved(0.0)), movable=True)
    for i in range(1, 4):
        surface.move({0: at(moved(i * step))})
    assert_same(surface.map, from_scratch({0: at(moved(3 * step))}))


def test_poses_that_cannot_change_are_not_kept():
    surface = Surface(OPTIONS)
    surface.integrate(0, depth_map(0), pose(0))
    surface.integrate(2, depth_map(2), pose(2))
    surface.move({0: pose(1)})
    assert not surface.movable and surface.settle() == {}
    assert_same(surface.map, from_scratch({0: pose(0), 2: pose(2)}))


def test_a_keyframe_without_depth_has_a_final_pose_too(store):
    nothing = replace(depth_map(0), depth=np.full(WIDE.shape, np.nan, np.float32))
    surface = Surface(OPTIONS, store)
    surface.integrate(0, nothing, pose(0), movable=True)
    surface.move({0: pose(5)})
    assert surface.mesh() is None and surface.voxel_size is None
    surface.integrate(1, depth_map(1), pose(1))
    np.testing.assert_array_equal(surface.settle()[0].rigid, matrix(5))
    assert_same(surface.map, from_scratch({1: pose(1)}))


def test_without_room_a_keyframe_stays_where_it_is(caplog):
    """Seen askew, a wall touches more blocks than there may be."""
    straight, askew = at(np.eye(4)), at(turned((0.6, 0.6, 0.6)))
    needed = from_scratch({0: straight}).volume.block_count
    assert from_scratch({0: askew}).volume.block_count > needed
    surface = Surface(FusionOptions(voxel_size=0.05, max_blocks=needed))
    surface.integrate(0, depth_map(0), straight, movable=True)
    with caplog.at_level(logging.WARNING):
        surface.move({0: askew})
        surface.settle()
    assert "keyframe 0 stays where it was fused first" in caplog.text
    assert_same(surface.map, from_scratch({0: straight}))


def test_a_store_gives_back_what_it_was_given(store):
    store.put(3, depth_map(3))
    store.put(4, depth_map(4))
    back = store.get(3)
    for name in ("depth", "grey", "confidence"):
        np.testing.assert_array_equal(getattr(back, name), getattr(depth_map(3), name))
    assert back.camera == WIDE
    store.drop(3)
    with pytest.raises(KeyError):
        store.get(3)
    assert store.get(4).depth.shape == WIDE.shape


def test_files_of_depth_maps_go_when_they_are_dropped_and_say_what_is_wrong(tmp_path):
    store = DiskStore(tmp_path)
    store.put(1, depth_map(1))
    (path,) = tmp_path.iterdir()
    path.write_bytes(b"nothing of the kind")
    with pytest.raises(PolarmapError, match=rf"{path.name}: .*cannot be read back"):
        store.get(1)
    store.drop(1)
    assert not list(tmp_path.iterdir())
    with pytest.raises(PolarmapError, match="cannot be written"):
        DiskStore(tmp_path / "missing").put(0, depth_map(0))
