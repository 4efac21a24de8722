"""What a mapped view surely sees, and as which witness it stays when its pictures are gone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import moved, turned

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.view import View, Witness
from polarmap.geometry.pose import inverse
from polarmap.geometry.sim3 import Sim3

NAN = float("nan")
POSE = turned((0.1, -0.3, 0.2), (0.4, 1.0, -2.0))


def view_of(stereo: np.ndarray, depth: np.ndarray | None = None, T_world_camera: np.ndarray = POSE, **rest) -> View:
    """depth: the dense one, that of stereo if not given."""
    image = PolarizationImage.unpolarized(np.ones(stereo.shape, np.float32))
    return View(image, T_world_camera, stereo=stereo, depth=stereo if depth is None else depth, **rest)


def test_points_are_surely_there_where_stereo_and_the_dense_map_agree():
    """To 3 %, in five blocks beside each other."""
    stereo = np.repeat(np.float32([2.0, 2.0, NAN, 2.0, 2.0]), 3)[None]
    depth = np.repeat(np.float32([2.04, 2.2, 2.0, NAN, 1.95]), 3)[None]
    view = view_of(stereo, depth)
    np.testing.assert_array_equal(view.witness.nearest, np.float32([[2.0, NAN, NAN, NAN, 2.0]]))
    assert replace(view, depth=None).witness is None and replace(view, stereo=None).witness is None


@pytest.mark.parametrize("shape", [(9, 12), (10, 13), (8, 11), (2, 1)])
def test_a_block_keeps_the_nearest_of_its_points(shape):
    rng = np.random.default_rng(0)
    stereo = rng.uniform(1.0, 3.0, shape).astype(np.float32)
    stereo[rng.random(shape) < 0.7] = NAN
    stereo[:3, :3] = NAN
    nearest = view_of(stereo).witness.nearest
    assert nearest.dtype == np.float32 and nearest.shape == (-(-shape[0] // 3), -(-shape[1] // 3))
    assert np.isnan(nearest[0, 0])
    for i, j in np.ndindex(nearest.shape):
        block = stereo[3 * i : 3 * i + 3, 3 * j : 3 * j + 3]
        known = block[np.isfinite(block)]
        np.testing.assert_array_equal(nearest[i, j], known.min() if known.size else np.float32(NAN))


def test_a_witness_is_where_its_view_is():
    view = view_of(np.full((6, 6), 2.0, np.float32), index=7, given=True, scale=1.5)
    witness = view.witness
    assert (witness.index, witness.given, witness.scale) == (7, True, 1.5)
    np.testing.assert_array_equal(witness.T_world_camera, POSE)


def test_a_witness_that_moves_grows_with_its_world_as_its_view_does():
    stereo = np.random.default_rng(1).uniform(1.0, 3.0, (7, 8)).astype(np.float32)
    stereo[:3] = NAN
    view = view_of(stereo, scale=0.5)
    pose = Sim3(1.25, POSE[:3, :3].T.copy(), np.array([3.0, 2.0, 1.0]))
    witness, of_moved = view.witness.moved(pose), view.moved(pose).witness
    for ours in (witness, of_moved):
        np.testing.assert_allclose(ours.nearest, 2.5 * view.witness.nearest, rtol=1e-6)
        np.testing.assert_array_equal(ours.T_world_camera, pose.rigid)
        assert ours.scale == 1.25
    again = witness.moved(replace(pose, translation=np.zeros(3)))  # of the same scale
    np.testing.assert_array_equal(again.nearest, witness.nearest)
    assert np.isnan(witness.nearest[0]).all() and not np.isnan(witness.nearest[1:]).any()


def test_a_view_sees_a_witness_from_itself():
    witness = view_of(np.full((3, 3), 2.0, np.float32), T_world_camera=moved(1.0) @ POSE).witness
    view = view_of(np.full((3, 3), 5.0, np.float32))
    sighting = witness.sighting(view)
    np.testing.assert_array_equal(sighting.nearest, witness.nearest)
    np.testing.assert_allclose(sighting.T_other_this, inverse(moved(1.0) @ POSE) @ POSE, atol=1e-12)
    np.testing.assert_allclose(sighting.T_other_this[:3, 3], -POSE[:3, :3].T @ [1.0, 0.0, 0.0], atol=1e-12)


def test_between_given_poses_the_origin_of_their_world_does_not_matter():
    here, there = np.eye(4), moved(0.25)
    far = moved(1e6, -2e6, 3e6)

    def motion(origin: np.ndarray, given: bool) -> np.ndarray:
        other = Witness(np.ones((1, 1), np.float32), origin @ there @ turned((0.0, 0.3, 0.0)), given=given)
        return other.sighting(view_of(np.ones((3, 3), np.float32), None, origin @ here, given=True)).T_other_this

    np.testing.assert_array_equal(motion(far, given=True), motion(np.eye(4), given=True))
    assert (motion(far, given=False) != motion(np.eye(4), given=False)).any()
