"""Curved surfaces and steps of depth, on things of known shape."""

from __future__ import annotations

import numpy as np
import pytest

from polarmap.evaluation.regions import is_curved, near_steps, region_metrics
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_depth
from polarmap.synth import render, scenes

CAMERA = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)


def slanted(step: float = 0.0) -> np.ndarray:
    """A floor seen at a grazing angle; its right half farther by a factor."""
    y = CAMERA.normalized()[..., 1]
    depth = 1.0 / (0.05 + 0.4 * (y + 0.6))
    depth[:, 80:] *= 1.0 + step
    return depth.astype(np.float32)


def test_a_plane_has_neither_steps_nor_curves():
    depth = slanted()
    assert not near_steps(depth).any()
    assert not is_curved(normals_from_depth(depth, CAMERA)).any()


def test_pixels_within_eight_of_a_step_are_near_it():
    near = near_steps(slanted(0.2))
    np.testing.assert_array_equal(np.flatnonzero(near.all(axis=0)), np.arange(79 - 8, 80 + 9))
    assert not near[:, :71].any() and not near[:, 89:].any()


def test_what_is_not_known_is_a_step_too():
    depth = slanted()
    depth[60, 40] = np.nan
    near = near_steps(depth)
    assert near[60, 48] and near[52, 40] and not near[60, 51]


def test_a_sphere_is_curved_and_the_wall_behind_it_is_not():
    truth = render(scenes.sphere(scenes.MATTE), CAMERA, np.eye(4))
    curved = is_curved(truth.normal) & ~near_steps(truth.depth)
    on = np.isfinite(truth.depth) & (np.abs(np.gradient(truth.depth, axis=1)) < 0.05)
    assert curved[on].mean() > 0.5
    found = region_metrics(1.01 * truth.depth, truth.normal, truth.depth, truth.normal)
    assert found.curved == np.count_nonzero(curved) and found.curved_within == 1.0 and found.edges > 0
    assert found.curved_normals == pytest.approx(0.0, abs=0.1)
    off = region_metrics(1.03 * truth.depth, np.roll(truth.normal, 1, axis=-1), truth.depth, truth.normal)
    assert off.curved_within == 0.0 and off.edges_within == 0.0 and off.curved_normals > 20


def test_without_such_pixels_there_are_no_figures():
    depth = slanted()
    normal = normals_from_depth(depth, CAMERA)
    found = region_metrics(depth, normal, depth, normal)
    assert (found.curved, found.edges) == (0.0, 0.0)
    assert np.isnan([found.curved_within, found.curved_normals, found.edges_within]).all()
