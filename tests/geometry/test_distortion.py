"""Undistortion against the models' equations written out again, and on pictures with known content."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Distortion, Undistorter, undistortion_maps

CAMERA = PinholeCamera(80, 60, 60.0, 62.0, 38.0, 31.0)
MILD = {"radtan": (-0.2, 0.05, 0.002, -0.003, 0.01), "equidistant": (0.05, -0.02, 0.01, -0.003)}


def reference_maps(camera: PinholeCamera, distortion: Distortion) -> tuple[np.ndarray, np.ndarray]:
    """The equations term by term, in float64."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    x, y = (u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy
    r2 = x**2 + y**2
    if distortion.model == "radtan":
        k1, k2, p1, p2, k3, k4, k5, k6 = np.pad(distortion.coefficients, (0, 8 - len(distortion.coefficients)))
        s = (1 + k1 * r2 + k2 * r2**2 + k3 * r2**3) / (1 + k4 * r2 + k5 * r2**2 + k6 * r2**3)
        xd = x * s + 2 * p1 * x * y + p2 * (r2 + 2 * x**2)
        yd = y * s + p1 * (r2 + 2 * y**2) + 2 * p2 * x * y
    else:
        k1, k2, k3, k4 = distortion.coefficients
        r = np.sqrt(r2)
        angle = np.arctan(r)
        scale = angle * (1 + k1 * angle**2 + k2 * angle**4 + k3 * angle**6 + k4 * angle**8) / np.where(r > 0, r, 1)
        xd, yd = x * scale, y * scale
    return camera.fx * xd + camera.cx, camera.fy * yd + camera.cy


@pytest.mark.parametrize(
    "distortion",
    [
        Distortion("radtan", (-0.2, 0.05, 0.002, -0.003)),
        Distortion("radtan", MILD["radtan"]),
        Distortion("radtan", (0.1, -0.02, 0.001, 0.0, 0.003, 0.2, 0.01, 0.002)),
        Distortion("equidistant", MILD["equidistant"]),
    ],
    ids=["radtan 4", "radtan 5", "radtan 8", "equidistant"],
)
def test_maps_follow_the_equations(distortion):
    for found, expected in zip(undistortion_maps(CAMERA, distortion), reference_maps(CAMERA, distortion), strict=True):
        np.testing.assert_allclose(found, expected, atol=1e-4)


@settings(max_examples=30, deadline=None)
@given(st.sampled_from(["radtan", "equidistant"]), st.floats(-0.3, 0.3), st.floats(-0.1, 0.1))
def test_maps_follow_the_equations_wherever_the_model_grows(model, k1, k2):
    distortion = Distortion(model, (k1, k2, 0.0, 0.0))
    map_x, map_y = undistortion_maps(CAMERA, distortion)
    expected_x, expected_y = reference_maps(CAMERA, distortion)
    known = np.isfinite(map_x)
    assert known[31, 38]
    np.testing.assert_allclose(map_x[known], expected_x[known], atol=1e-4)
    np.testing.assert_allclose(map_y[known], expected_y[known], atol=1e-4)


@pytest.mark.parametrize("model", MILD)
def test_a_distorted_picture_of_a_ramp_becomes_the_ramp(model):
    undistorter = Undistorter(CAMERA, Distortion(model, MILD[model]))
    u, v = np.meshgrid(np.arange(80.0, dtype=np.float32), np.arange(60.0, dtype=np.float32))
    undistorted = undistorter(np.stack([u, v, u + v, u - v]))
    expected_x, expected_y = reference_maps(CAMERA, Distortion(model, MILD[model]))
    valid = undistorter.valid
    assert undistorted.dtype == np.float32
    # OpenCV 4 rounds positions to 1/32 pixel
    np.testing.assert_allclose(undistorted[0][valid], expected_x[valid], atol=0.02)
    np.testing.assert_allclose(undistorted[1][valid], expected_y[valid], atol=0.02)
    np.testing.assert_allclose(undistorted[2][valid], (expected_x + expected_y)[valid], atol=0.04)


def test_pixels_out_of_view_are_nan_and_invalid():
    pincushion = Distortion("radtan", (0.4, 0.0, 0.0, 0.0))
    undistorter = Undistorter(CAMERA, pincushion)
    undistorted = undistorter(np.ones((4, 60, 80), np.float32))
    assert 0.5 < undistorter.valid.mean() < 1.0
    assert not undistorter.valid[0, 0] and undistorter.valid[31, 38]
    np.testing.assert_array_equal(np.isnan(undistorted), np.broadcast_to(~undistorter.valid, (4, 60, 80)))


def test_a_folding_polynomial_shows_nothing_twice():
    # r (1 - 1.2 r²) grows until r = 1/sqrt(3.6) = 0.527; farther pixels would come from inside again.
    folding = Distortion("radtan", (-1.2, 0.0, 0.0, 0.0))
    assert folding.field_radius(1.0) == pytest.approx(0.527, abs=1e-3)
    x, y = CAMERA.normalized()[..., 0], CAMERA.normalized()[..., 1]
    valid = Undistorter(CAMERA, folding).valid
    np.testing.assert_array_equal(valid, np.hypot(x, y) <= folding.field_radius(float(np.hypot(x, y).max())))


def test_no_distortion_changes_nothing():
    channels = np.random.default_rng(0).random((4, 60, 80), np.float32)
    undistorter = Undistorter(CAMERA, Distortion("radtan", (0.0, 0.0, 0.0, 0.0)))
    assert undistorter.valid.all()
    np.testing.assert_allclose(undistorter(channels), channels, atol=1e-3)


def test_spread_marks_all_that_a_flagged_pixel_contributes_to():
    undistorter = Undistorter(CAMERA, Distortion("radtan", MILD["radtan"]))
    flagged = np.zeros((60, 80), bool)
    flagged[20, 50] = True
    spread = undistorter.spread(flagged)
    map_x, map_y = reference_maps(CAMERA, Distortion("radtan", MILD["radtan"]))
    distance = np.maximum(np.abs(map_x - 50), np.abs(map_y - 20))
    assert spread[distance < 0.95].all() and spread.any()
    assert not spread[distance > 1.05].any()


@pytest.mark.parametrize(
    ("model", "coefficients", "message"),
    [
        ("fov", (0.1,), "model 'fov' is not known; write radtan or equidistant"),
        ("radtan", (0.1, 0.2, 0.3), "radtan takes 4 or 5 or 8 coefficients, not 3"),
        ("equidistant", (0.1, 0.2, 0.3, float("nan")), "must be finite"),
    ],
)
def test_bad_distortions_are_refused(model, coefficients, message):
    with pytest.raises(InputError, match=message):
        Distortion(model, coefficients)


def test_an_image_of_another_size_is_refused():
    undistorter = Undistorter(CAMERA, Distortion("radtan", MILD["radtan"]))
    with pytest.raises(InputError, match="has 60x80 pixels, the camera 80x60"):
        undistorter(np.zeros((4, 80, 60), np.float32))
