"""Increments of rigid motions against the matrix exponential and the group's axioms."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm

from polarmap.geometry.lie import adjoint, se3_exp, se3_log, skew
from polarmap.geometry.pose import inverse, is_rigid

SIZES = [0.0, 1e-12, 1e-8, 0.9e-4, 1.1e-4, 1e-2, 1.0, 3.0]  # either side of where the series takes over
increments = st.lists(st.floats(-1.7, 1.7), min_size=6, max_size=6).map(np.array)


def hat(xi: np.ndarray) -> np.ndarray:
    generator = np.zeros((4, 4))
    generator[:3, :3], generator[:3, 3] = skew(xi[3:]), xi[:3]
    return generator


@pytest.mark.parametrize("size", SIZES)
def test_exp_is_the_matrix_exponential(size):
    xi = np.array([0.5, -2.0, 1.0, *(size * np.array([2.0, -1.0, 2.0]) / 3.0)])
    np.testing.assert_allclose(se3_exp(xi), expm(hat(xi)), atol=1e-12)


@pytest.mark.parametrize("size", [*SIZES, 3.1415])
def test_log_undoes_exp(size):
    xi = np.array([0.5, -2.0, 1.0, *(size * np.array([2.0, -1.0, 2.0]) / 3.0)])
    np.testing.assert_allclose(se3_log(se3_exp(xi)), xi, rtol=1e-7, atol=1e-10)


@settings(max_examples=50, deadline=None)
@given(increments)
def test_exp_gives_rigid_motions_whose_inverse_is_the_negative_increment(xi):
    T = se3_exp(xi)
    assert is_rigid(T, 1e-12)
    np.testing.assert_allclose(se3_exp(-xi), inverse(T), atol=1e-12)


@settings(max_examples=50, deadline=None)
@given(increments, increments)
def test_the_adjoint_takes_an_increment_to_the_other_side(motion, xi):
    T = se3_exp(motion)
    np.testing.assert_allclose(T @ se3_exp(xi), se3_exp(adjoint(T) @ xi) @ T, atol=1e-9)


@settings(max_examples=50, deadline=None)
@given(increments, increments)
def test_the_adjoint_of_a_product_is_the_product_of_adjoints(one, other):
    A, B = se3_exp(one), se3_exp(other)
    np.testing.assert_allclose(adjoint(A @ B), adjoint(A) @ adjoint(B), atol=1e-10)


def test_increments_are_applied_from_the_left():
    """The first order of exp(xi) p is rho + w × p."""
    p, xi = np.array([1.0, 2.0, 3.0, 1.0]), 1e-6 * np.array([3.0, 1.0, -2.0, 0.5, -1.0, 2.0])
    expected = p[:3] + xi[:3] + np.cross(xi[3:], p[:3])
    np.testing.assert_allclose((se3_exp(xi) @ p)[:3], expected, atol=1e-11)
