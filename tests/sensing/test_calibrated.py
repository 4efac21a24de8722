"""Stokes parameters of measured polarizers: exact where there is no noise, with the noise that simulation finds."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from polarizer_pictures import TRUTH, frame, mosaic_of

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.sensing.calibrated import CalibratedStokes
from polarmap.sensing.front_end import FrontEnd
from polarmap.sensing.stokes import consistency_residual, polarization_image

CLOCKWISE = AngleDirection.CLOCKWISE
IDEAL = PolarizerCalibration((0.0, 45.0, 90.0, 135.0))
NOISE = SensorNoise(8000.0, 4.0)
CAMERA = PinholeCamera(160, 160, 90.0, 90.0, 79.5, 79.5)


def camera_file(direction=CLOCKWISE, **changes):
    return CameraFile(CAMERA, SensorLayout.SONY_POLARSENS, direction, 12, noise=NOISE, **changes)


def random_channels(rng, shape=(4, 24, 24)):
    return rng.uniform(0.05, 0.9, shape).astype(np.float32)


def image_of(calibration, channels, direction=CLOCKWISE):
    saturated = np.zeros(channels.shape[1:], bool)
    return CalibratedStokes(calibration, direction).image(channels, NOISE, 12, 1.0, saturated)


def test_ideal_polarizers_give_what_the_uncalibrated_camera_gives():
    channels = random_channels(np.random.default_rng(0))
    channels[:, 0, 0] = np.nan
    channels[:, 0, 1] = 0.0
    plain, measured = polarization_image(channels, NOISE, 12), image_of(IDEAL, channels)
    for name in ("intensity", "dolp", "aolp", "sigma_dolp", "sigma_aolp"):
        np.testing.assert_allclose(getattr(measured, name), getattr(plain, name), rtol=2e-4, atol=2e-5, err_msg=name)
    assert np.array_equal(measured.underexposed, plain.underexposed)
    stokes = CalibratedStokes(IDEAL, CLOCKWISE)
    np.testing.assert_allclose(stokes.residual(channels), consistency_residual(channels), atol=1e-5)
    np.testing.assert_allclose(stokes.intensity(channels), plain.intensity, atol=1e-6)


@pytest.mark.parametrize("direction", AngleDirection)
def test_the_light_comes_out_of_what_such_polarizers_pass(direction):
    rng = np.random.default_rng(1)
    s0, dolp, aolp = rng.uniform(0.1, 1.0, (9, 9)), rng.uniform(0.05, 1.0, (9, 9)), rng.uniform(0, np.pi, (9, 9))
    stokes = s0 * np.stack([np.ones_like(dolp), dolp * np.cos(2 * aolp), dolp * np.sin(2 * aolp)])
    channels = np.tensordot(TRUTH.measurement_matrix(direction), stokes, axes=1).astype(np.float32)
    image = image_of(TRUTH, channels, direction)
    np.testing.assert_allclose(image.intensity, s0 / 2, rtol=1e-5)
    np.testing.assert_allclose(image.dolp, dolp, atol=1e-5)
    assert np.abs((image.aolp - aolp + np.pi / 2) % np.pi - np.pi / 2).max() < 1e-4
    assert np.abs(CalibratedStokes(TRUTH, direction).residual(channels)).max() < 1e-5


def test_a_label_turning_the_other_way_is_the_mirrored_matrix():
    mirror = np.diag([1.0, 1.0, -1.0])
    one, other = (TRUTH.measurement_matrix(direction) for direction in AngleDirection)
    np.testing.assert_allclose(other, (one @ mirror)[[0, 3, 2, 1]], atol=1e-12)


@pytest.mark.parametrize(("dolp", "aolp"), [(0.1, 0.4), (0.6, 1.3), (0.95, 2.6)])
def test_standard_deviations_are_those_of_simulated_noise(dolp, aolp):
    stokes = 0.9 * np.array([1.0, dolp * np.cos(2 * aolp), dolp * np.sin(2 * aolp)])
    shot = frame(mosaic_of(camera_file(), TRUTH, stokes, np.random.default_rng(2)))
    image = FrontEnd(camera_file(polarizers=TRUTH)).polarization(shot)
    away = (image.aolp - aolp + np.pi / 2) % np.pi - np.pi / 2
    assert image.dolp.mean() == pytest.approx(dolp, abs=2e-3)
    assert image.dolp.std() / image.sigma_dolp.mean() == pytest.approx(1.0, abs=0.05)
    assert away.std() / image.sigma_aolp.mean() == pytest.approx(1.0, abs=0.05)


@pytest.mark.parametrize("direction", AngleDirection)
def test_all_that_shows_brightness_is_calibrated_alike(direction):
    rng = np.random.default_rng(3)
    shot = frame(mosaic_of(camera_file(direction), TRUTH, np.array([0.9, 0.4, -0.3]), rng))
    front_end = FrontEnd(camera_file(direction, polarizers=TRUTH))
    image = front_end.polarization(shot)
    np.testing.assert_allclose(front_end.intensity(shot), image.intensity, rtol=1e-5)
    np.testing.assert_allclose(front_end.grey(shot), image.intensity, rtol=1e-5)
    assert image.intensity.mean() == pytest.approx(0.45, abs=2e-4)
    uncalibrated = FrontEnd(camera_file(direction))
    assert abs(uncalibrated.grey(shot).mean() - 0.45) > 1e-3
    assert front_end.consistency(shot).mean() < uncalibrated.consistency(shot).mean()


def test_one_picture_per_angle_is_calibrated_as_a_mosaic_is():
    file = camera_file(AngleDirection.COUNTERCLOCKWISE, polarizers=TRUTH)
    raw = mosaic_of(file, TRUTH, np.array([0.9, 0.4, -0.3]), np.random.default_rng(4))
    pictures = np.stack([raw[1::2, 1::2], raw[::2, 1::2], raw[::2, ::2], raw[1::2, ::2]])
    apart = Frame(0, 0.0, "a", Path("a.png"), channels=pictures)
    one, other = FrontEnd(file), FrontEnd(replace(file, layout=None))
    np.testing.assert_array_equal(one.polarization(frame(raw)).dolp, other.polarization(apart).dolp)
    np.testing.assert_allclose(one.grey(frame(raw)), other.grey(apart), rtol=1e-5)


def test_nothing_changes_without_a_calibration():
    raw = mosaic_of(camera_file(), TRUTH, np.array([0.9, 0.4, -0.3]), np.random.default_rng(5))
    front_end = FrontEnd(camera_file())
    image = front_end.polarization(frame(raw))
    plain = polarization_image(front_end.channels(frame(raw)), NOISE, 12, 1.0, image.saturated)
    for name in ("intensity", "dolp", "aolp", "sigma_dolp", "sigma_aolp", "underexposed"):
        assert getattr(image, name).tobytes() == getattr(plain, name).tobytes()


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"angles": (0.0, 45.0, 90.0)}, "calibration.angles: not four"),
        ({"angles": (0.0, 135.0, 90.0, 45.0)}, "135 is more than 20 degrees from 45"),
        ({"angles": (0.0, 45.0, 90.0, np.nan)}, "calibration.angles: not four finite"),
        ({"angles": IDEAL.angles, "gains": (0.0, 1.0, 1.0, 1.0)}, "calibration.gains: 0 is not in"),
        ({"angles": IDEAL.angles, "efficiencies": (1.0, 1.0, 1.0, 1.2)}, "calibration.efficiencies: 1.2 is not in"),
    ],
)
def test_values_that_cannot_be_are_refused(values, words):
    with pytest.raises(InputError, match=words):
        PolarizerCalibration(**values)


def test_angles_may_be_given_a_half_turn_further():
    turned = PolarizerCalibration((180.5, 45.0, -90.0, 135.0))
    np.testing.assert_allclose(
        turned.measurement_matrix(CLOCKWISE),
        PolarizerCalibration((0.5, 45.0, 90.0, 135.0)).measurement_matrix(CLOCKWISE),
        atol=1e-12,
    )
