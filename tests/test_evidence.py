"""What stereo and polarization say of surfaces, against NumPy and against exact light."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import EXACT, WIDE, polarization_of, view_of

from polarmap.densify.evidence import (
    cell_stokes,
    point_reliability,
    polarization_costs,
    polarization_weight,
    stereo_costs,
)
from polarmap.geometry.camera import PinholeCamera

CELLS = PinholeCamera(40, 30, 30.0, 92 / 3, (59.5 - 1) / 3, (44.5 - 1) / 3)  # WIDE in cells of 3×3 pixels


def test_points_of_bare_surfaces_are_not_believed():
    rng = np.random.default_rng(0)
    image = (0.5 + 0.002 * rng.standard_normal((90, 120))).astype(np.float32)
    image[:, 60:] += 0.1 * rng.standard_normal((90, 60)).astype(np.float32)
    reliability = point_reliability(image)
    assert reliability[:, 64:].mean() > 0.95
    assert reliability[:, 48:55].mean() < 0.1  # within reach of the texture
    assert ((reliability == 0) | ((reliability >= 0.3) & (reliability <= 1))).all()


@pytest.mark.parametrize("cell", [1, 4, 7])
def test_stereo_costs(cell):
    rng = np.random.default_rng(1)
    points = np.where(rng.random((22, 31)) < 0.4, rng.uniform(0.4, 0.6, (22, 31)), np.nan).astype(np.float32)
    reliability = np.where(np.isnan(points), 0, rng.random((22, 31))).astype(np.float32)
    surfaces = rng.uniform(0.45, 0.55, (3, 22, 31)).astype(np.float32)
    found = stereo_costs(points, reliability, surfaces, cell, 0.05)
    assert found.shape == (-(-22 // cell), -(-31 // cell), 3)
    squared = np.minimum(((surfaces / points - 1) / 0.05) ** 2, 9.0)
    each = np.nan_to_num(reliability * squared * 0.25 * 16 / cell**2)
    for i, j in ((0, 0), (found.shape[0] - 1, found.shape[1] - 1), (1, 2)):
        block = each[:, i * cell : (i + 1) * cell, j * cell : (j + 1) * cell]
        np.testing.assert_allclose(found[i, j], block.sum((1, 2)), rtol=1e-4)


def test_stokes_of_cells():
    image = polarization_of(view_of("sphere", "plastic"), EXACT, seed=0)
    usable = np.random.default_rng(0).random(WIDE.shape) < 0.7
    usable[:8, :8] = False
    image.saturated[:] = ~usable
    mean, variance = cell_stokes(image, 4)
    assert mean.shape == (23, 30, 2) and np.isinf(variance[0, 0]) and (mean[0, 0] == 0).all()
    block = np.s_[40:44, 60:64]
    chosen = image.usable[block]
    s1, s2 = (image.dolp * f(2 * image.aolp) for f in (np.cos, np.sin))
    np.testing.assert_allclose(mean[10, 15], [s1[block][chosen].mean(), s2[block][chosen].mean()], rtol=1e-4)
    assert variance[10, 15] == pytest.approx((image.sigma_dolp[block][chosen] ** 2).sum() / chosen.sum() ** 2, rel=1e-4)


def plane_costs(material: str, turn: float) -> np.ndarray:
    """Of the normals of a plane, turned about the optical axis by `turn`, in the light of the plane itself."""
    view = view_of("plane", material)
    stokes, _ = cell_stokes(polarization_of(view), 3)
    normal = np.nanmean(view.normal, axis=(0, 1))
    c, s = np.cos(turn), np.sin(turn)
    normal = np.array([[c, -s, 0], [s, c, 0], [0, 0, 1]]) @ normal
    return polarization_costs(stokes, np.full(CELLS.shape, 0.01**2, np.float32), normal, CELLS)


@pytest.mark.parametrize("material", ["matte", "glass"])
def test_polarization_fits_the_plane_that_it_is_of(material):
    """Diffuse and specular light alike, also far from the centre of the image."""
    assert plane_costs(material, 0.0).max() < 0.01  # float32 of (S1, S2)/S0 near 1
    assert 0.05 < plane_costs(material, 0.1).mean() < plane_costs(material, 0.3).mean()


def test_polarization_of_mixed_light_fits_too():
    assert np.median(plane_costs("plastic", 0.0)) < 0.05
    assert np.median(plane_costs("plastic", 0.4)) > 0.5


def test_cells_without_polarization_say_nothing():
    nothing = np.zeros((*CELLS.shape, 2), np.float32)
    assert (polarization_costs(nothing, np.full(CELLS.shape, np.inf, np.float32), [0, 0, -1.0], CELLS) == 0).all()


def test_polarization_weighs_as_much_as_it_agrees_with_stereo():
    rng = np.random.default_rng(0)
    stereo = rng.uniform(10, 20, (20, 30, 4)).astype(np.float32)
    own = rng.integers(4, size=(20, 30))
    np.put_along_axis(stereo, own[..., None], 0.0, axis=2)
    gaussian = rng.standard_normal((20, 30)) ** 2
    far = rng.uniform(4, 9, (20, 30, 4))
    np.put_along_axis(far, own[..., None], gaussian[..., None], axis=2)
    assert polarization_weight(far, stereo) >= 0.3
    assert polarization_weight(rng.uniform(0, 9, (20, 30, 4)), stereo) <= 0.01
    assert polarization_weight(far[..., :1], stereo[..., :1]) == 0.0
    assert polarization_weight(far, np.zeros_like(stereo)) == 0.0
