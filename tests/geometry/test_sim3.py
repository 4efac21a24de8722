import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polarmap.errors import InputError
from polarmap.geometry import pose
from polarmap.geometry.sim3 import Sim3

coordinates = st.floats(-10, 10)
vectors = st.tuples(coordinates, coordinates, coordinates).map(np.array)
rotations = st.tuples(*[st.floats(-2, 2)] * 3).map(lambda w: Rotation.from_rotvec(w).as_matrix())
similarities = st.builds(Sim3, st.floats(0.1, 10), rotations, vectors)
IDENTITY = Sim3.from_matrix(np.eye(4))


def rigid_motion(seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.eye(4)
    T[:3, :3] = Rotation.from_rotvec(rng.normal(size=3)).as_matrix()
    T[:3, 3] = rng.normal(size=3)
    return T


def assert_same(a: Sim3, b: Sim3) -> None:
    """To rounding, at coordinates that reach ten thousand where scales are multiplied."""
    np.testing.assert_allclose(a.matrix, b.matrix, rtol=1e-9, atol=1e-8)


@given(similarities, similarities, similarities)
def test_composition_is_associative(a, b, c):
    assert_same((a @ b) @ c, a @ (b @ c))


@given(similarities)
def test_identity_changes_nothing_and_inverse_undoes(a):
    assert_same(a @ IDENTITY, a)
    assert_same(IDENTITY @ a, a)
    assert_same(a @ a.inverse(), IDENTITY)
    assert_same(a.inverse() @ a, IDENTITY)


@given(similarities, similarities, vectors)
def test_composition_applies_one_after_the_other(a, b, point):
    points = np.stack([point, -2 * point])
    np.testing.assert_allclose((a @ b).apply(points), a.apply(b.apply(points)), rtol=1e-9, atol=1e-8)
    homogeneous = np.append(point, 1.0)
    np.testing.assert_allclose((a.matrix @ homogeneous)[:3], a.apply(point[None])[0], rtol=1e-9, atol=1e-9)


@given(similarities, similarities)
def test_relative_leads_from_one_to_the_other(a, b):
    assert_same(a @ a.relative(b), b)


@given(similarities, vectors, vectors)
def test_lengths_grow_by_the_scale(a, p, q):
    moved = a.apply(np.stack([p, q]))
    np.testing.assert_allclose(np.linalg.norm(moved[1] - moved[0]), a.scale * np.linalg.norm(q - p), atol=1e-8)


def test_at_scale_one_the_motions_themselves_are_kept():
    T_w_a, T_w_b = rigid_motion(1), rigid_motion(2)
    a, b = Sim3.from_matrix(T_w_a), Sim3.from_matrix(T_w_b)
    np.testing.assert_array_equal(a.rigid, T_w_a)
    np.testing.assert_array_equal(a.matrix, T_w_a)
    np.testing.assert_array_equal((a @ b).rigid, T_w_a @ T_w_b)
    np.testing.assert_array_equal(a.inverse().rigid, pose.inverse(T_w_a))
    np.testing.assert_array_equal(a.relative(b).rigid, pose.inverse(T_w_a) @ T_w_b)


def test_a_later_change_of_the_matrix_does_not_reach_it():
    T = rigid_motion(3)
    a = Sim3.from_matrix(T)
    T[:3, 3] = 7.0
    assert not (a.translation == 7.0).any()


def test_the_rigid_part_has_no_scale():
    a = Sim3(3.0, np.eye(3), np.array([1.0, 2.0, 3.0]))
    np.testing.assert_array_equal(a.rigid[:3, :3], np.eye(3))
    np.testing.assert_array_equal(a.rigid[:3, 3], [1.0, 2.0, 3.0])
    np.testing.assert_array_equal(a.matrix[:3, :3], 3.0 * np.eye(3))


@pytest.mark.parametrize("scale", [0.0, -1.0, np.nan, np.inf])
def test_a_scale_that_is_none_is_refused(scale):
    with pytest.raises(InputError, match="scale"):
        Sim3(scale, np.eye(3), np.zeros(3))


@pytest.mark.parametrize("rotation", [2 * np.eye(3), -np.eye(3), np.full((3, 3), np.nan), np.eye(4)])
def test_a_rotation_that_is_none_is_refused(rotation):
    with pytest.raises(InputError, match="rotation"):
        Sim3(1.0, rotation, np.zeros(3))


def test_a_matrix_that_is_not_rigid_is_refused():
    with pytest.raises(InputError, match="rigid"):
        Sim3.from_matrix(np.diag([2.0, 2.0, 2.0, 1.0]))
