"""The plane of a bare wall from a line of points at its border, which polarization closes."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import pytest
from scenes import MATERIALS, TYPICAL, polarization_of

from polarmap.data.polarization_image import PolarizationImage
from polarmap.densify.surfaces.bare_regions import region_planes
from polarmap.densify.surfaces.evidence import cell_stokes
from polarmap.densify.surfaces.planes import evaluate_planes
from polarmap.geometry.camera import PinholeCamera
from polarmap.synth import render, scenes

OFF_CENTRE = PinholeCamera(width=120, height=90, fx=90.0, fy=92.0, cx=49.5, cy=54.0)
CELL = 3
TOLERANCE = 0.01
BORDER = np.indices(OFF_CENTRE.shape)[0] < 3  # a strip as thin as what stereo finds along an edge
V, U = np.indices(OFF_CENTRE.shape)
LIGHT = ("matte", "glass")


@lru_cache
def wall(material: str) -> tuple[np.ndarray, PolarizationImage]:
    """Inverse depth of a bare tilted wall and what a camera with the usual noise sees of it."""
    scene = scenes.plane(MATERIALS[material], tilt=0.7, azimuth=1.1)
    rendering = render(scene, OFF_CENTRE, np.eye(4))
    return 1.0 / rendering.depth, polarization_of(rendering, TYPICAL, seed=0)


def planes_of(material: str, inverse_depth: np.ndarray, polarized: bool = True, grey=None) -> np.ndarray:
    """Inverse depth of the planes found, N×H×W. grey: of the cells, the picture's own if not given."""
    _, image = wall(material)
    stokes, variance = cell_stokes(image, CELL)
    planes = region_planes(
        inverse_depth,
        np.isfinite(inverse_depth).astype(np.float32),
        np.zeros_like(variance) + 0.5 if grey is None else grey,
        stokes if polarized else np.zeros_like(stokes),
        variance + np.float32(0.015**2),
        OFF_CENTRE,
        CELL,
        TOLERANCE,
    )
    assert planes.dtype == np.float64 and planes.shape[1:] == (3,)
    return evaluate_planes(planes, OFF_CENTRE.shape)


def points_at(pixels: np.ndarray, inverse_depth: np.ndarray, noise: float = 0.003) -> np.ndarray:
    rng = np.random.default_rng(0)
    noisy = inverse_depth * (1.0 + noise * rng.standard_normal(inverse_depth.shape))
    return np.where(pixels, noisy, np.nan).astype(np.float32)


def largest_error(found: np.ndarray, true: np.ndarray) -> float:
    return float(np.abs(found / true - 1.0).max())


STRIPS = {"above": BORDER, "on the left": U < 3}


@pytest.mark.parametrize("strip", STRIPS)
@pytest.mark.parametrize("material", LIGHT)
def test_a_strip_of_points_and_polarization_give_the_plane(material, strip):
    """Noise of 0.3 % over 3 pixels would grow to several per cent at the far side, 30 times as far away."""
    true, _ = wall(material)
    points = points_at(STRIPS[strip], true)
    found = planes_of(material, points)
    assert len(found) >= 1 and largest_error(found[0], true) < 0.02
    without = planes_of(material, points, polarized=False)
    assert all(largest_error(plane, true) > 0.04 for plane in without)


@pytest.mark.parametrize("material", LIGHT)
def test_a_line_of_points_without_polarization_gives_none(material):
    """One row of pixels leaves the plane's turn about it open."""
    true, _ = wall(material)
    points = points_at(V < 1, true)
    assert len(planes_of(material, points, polarized=False)) == 0
    assert largest_error(planes_of(material, points)[0], true) < 0.02


@pytest.mark.parametrize("material", LIGHT)
def test_without_noise_in_the_points_the_plane_is_that_of_the_angles(material):
    """Angles of hundreds of cells leave a fraction of a per cent: noise of the sensor alone."""
    true, _ = wall(material)
    assert largest_error(planes_of(material, points_at(BORDER, true, noise=0.0))[0], true) < 0.005


@pytest.mark.parametrize("material", LIGHT)
def test_points_of_a_nearer_object_are_ignored(material):
    """Something stands before two fifths of the border."""
    true, _ = wall(material)
    points = points_at(BORDER, true)
    points[BORDER & (np.random.default_rng(1).random(BORDER.shape) < 0.4)] = 1.0 / 1.2
    assert (points[BORDER] > true[BORDER] * 1.1).mean() > 0.3
    assert largest_error(planes_of(material, points)[0], true) < 0.03


def test_points_all_over_a_region_need_no_polarization():
    true, _ = wall("matte")
    scattered = np.random.default_rng(2).random(OFF_CENTRE.shape) < 0.1
    for polarized in (False, True):
        found = planes_of("matte", points_at(scattered, true), polarized)
        assert largest_error(found[0], true) < 0.003


def test_depth_in_other_units_gives_the_same_planes_in_these():
    points = points_at(BORDER, wall("matte")[0])
    np.testing.assert_allclose(planes_of("matte", points / 40.0), planes_of("matte", points) / 40.0, rtol=1e-4)


def test_the_same_input_gives_the_same_planes():
    points = points_at(BORDER, wall("glass")[0])
    np.testing.assert_array_equal(planes_of("glass", points), planes_of("glass", points))


def test_regions_end_at_edges_of_the_picture():
    """Two walls, alike to the polarizers, one farther than the other."""
    true, _ = wall("matte")
    grey = np.where(np.arange(40) < 20, 0.3, 0.6) * np.ones((30, 40))
    stepped = points_at(BORDER, np.where(U < 60, true, 0.7 * true), noise=0.0)
    left, right = planes_of("matte", stepped, grey=grey.astype(np.float32))
    if left[0, 0] < right[0, 0]:
        left, right = right, left
    assert largest_error(left, true) < 0.05 and largest_error(right, 0.7 * true) < 0.05  # the step is 30 %


def test_a_picture_full_of_edges_has_no_bare_region():
    busy = np.indices((30, 40)).sum(axis=0) % 2 * 0.2 + 0.4
    points = points_at(BORDER, wall("matte")[0])
    assert len(planes_of("matte", points, grey=busy.astype(np.float32))) == 0


@pytest.mark.parametrize("count", [0, 19])
def test_too_few_points_give_no_plane(count):
    true, _ = wall("matte")
    assert len(planes_of("matte", points_at(V * OFF_CENTRE.width + U < count, true))) == 0


def test_points_that_agree_on_no_plane_give_none():
    q = np.where(BORDER, np.random.default_rng(0).uniform(0.05, 3.0, BORDER.shape), np.nan).astype(np.float32)
    assert len(planes_of("matte", q)) == 0
