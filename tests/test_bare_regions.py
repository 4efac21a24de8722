"""Planes of regions without texture, from points at their border and polarization."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import TYPICAL, WIDE, plane_depth, polarization_of, view_of

from polarmap.densify.bare_regions import region_planes
from polarmap.densify.dominant_planes import evaluate_planes
from polarmap.densify.evidence import cell_stokes

CELL = 3
FLAT = np.full((30, 40), 0.5, np.float32)


def fitted(material: str, points: np.ndarray, polarized: bool = True) -> np.ndarray:
    """Inverse depth of the regions' planes, the largest region first, N×H×W."""
    stokes, variance = cell_stokes(polarization_of(view_of("plane", material), TYPICAL, seed=0), CELL)
    known = np.isfinite(points)
    planes = region_planes(
        points, known.astype(np.float32), FLAT, stokes * np.float32(polarized), variance, WIDE, CELL, 0.01
    )
    return evaluate_planes(planes, WIDE.shape)


def points_on(rows: slice, columns: slice) -> np.ndarray:
    """Inverse depth of the plane there, with noise."""
    points = np.full(WIDE.shape, np.nan, np.float32)
    depth = view_of("plane").depth[rows, columns]
    noise = np.random.default_rng(0).standard_normal(depth.shape)
    points[rows, columns] = (1 + 0.002 * noise) / depth
    return points


LINE = slice(40, 41), slice(None)


@pytest.mark.parametrize("material", ["matte", "glass"])
def test_one_line_of_points_and_polarization_make_a_plane(material):
    truth = 1.0 / view_of("plane").depth
    planes = fitted(material, points_on(*LINE))
    error = np.abs(planes[0] / truth - 1.0)
    assert np.median(error) < 0.02 and np.quantile(error, 0.9) < 0.06


def test_without_polarization_one_line_makes_no_plane_and_two_do():
    assert len(fitted("matte", points_on(*LINE), polarized=False)) == 0
    both = np.fmin(points_on(*LINE), points_on(slice(70, 71), slice(None)))
    found = fitted("matte", both, polarized=False)[0]
    assert np.median(np.abs(found * view_of("plane").depth - 1.0)) < 0.02


def test_what_stands_before_the_region_is_left_aside():
    points = points_on(*LINE)
    points[43:44] = 1.6 / plane_depth(WIDE, (0.0, 0.2, -1.0), 2.0)[43:44]
    truth = 1.0 / view_of("plane").depth
    assert np.median(np.abs(fitted("matte", points)[0] / truth - 1.0)) < 0.03


def test_a_region_with_few_points_has_no_plane():
    assert len(fitted("matte", points_on(np.s_[40:41], slice(0, 15)))) == 0
    assert len(fitted("matte", np.full(WIDE.shape, np.nan, np.float32))) == 0
