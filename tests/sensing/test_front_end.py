"""The front end on raw frames: any sensor gives back the scene's Stokes vectors."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pytest

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Distortion
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth import Sensor, built_in_scene, render

CAMERA = PinholeCamera(48, 48, 40.0, 40.0, 23.5, 23.5)
SONY = SensorLayout.SONY_POLARSENS
CLOCKWISE, COUNTERCLOCKWISE = AngleDirection.CLOCKWISE, AngleDirection.COUNTERCLOCKWISE
ROLL_90 = np.array([[0, -1, 0, 0], [1, 0, 0, 0], [0, 0, 1, 0], [0, 0, 0, 1.0]])  # image x toward y


def camera_file(bit_depth=12, layout=SONY, direction=CLOCKWISE, **changes):
    return CameraFile(CAMERA, layout, direction, bit_depth, **changes)


def frame_of(mosaic=None, channels=None):
    return Frame(0, 0.0, "000000", Path("raw/000000.png"), mosaic, channels)


def scene_stokes(T_world_camera):
    return render(built_in_scene("sphere").scene, CAMERA, T_world_camera).stokes


def angle_difference(a, b):
    return np.abs((a - b + np.pi / 2) % np.pi - np.pi / 2)


@pytest.fixture(scope="module")
def stokes():
    stokes = scene_stokes(np.eye(4))
    return stokes * 1.8 / stokes[0].max()


@pytest.mark.parametrize("layout", SensorLayout)
@pytest.mark.parametrize("bit_depth", [8, 10, 12, 16])
@pytest.mark.parametrize("direction", AngleDirection)
def test_any_sensor_gives_the_stokes_vectors_of_the_scene(stokes, layout, bit_depth, direction):
    sensor = Sensor(layout, direction, bit_depth, noise=None)
    front_end = FrontEnd(camera_file(bit_depth, layout, direction))
    image = front_end.polarization(frame_of(sensor.capture(stokes)))
    step = 1 / (2**bit_depth - 1)
    s0, s1, s2 = stokes
    np.testing.assert_allclose(image.intensity, s0 / 2, atol=step)
    lit = s0 > 0.05
    assert np.abs(image.dolp - np.hypot(s1, s2) / s0)[lit].max() < 2 * step / 0.05
    polarized = lit & (np.hypot(s1, s2) > 0.05)
    assert polarized.sum() > 100
    assert angle_difference(image.aolp, 0.5 * np.arctan2(s2, s1))[polarized].max() < step / 0.05
    assert not image.saturated.any()


@pytest.mark.parametrize("direction", AngleDirection)
def test_a_rolled_camera_sees_the_angle_turned_back(direction):
    sensor = Sensor(angle_direction=direction, bit_depth=16, noise=None, exposure=0.2)
    front_end = FrontEnd(camera_file(16, direction=direction))
    upright, rolled = (front_end.polarization(frame_of(sensor.capture(scene_stokes(T)))) for T in (np.eye(4), ROLL_90))
    turned = np.rot90(upright.aolp)  # what was right of the centre is now above it
    polarized = np.rot90((upright.dolp > 0.1) & (upright.intensity > 0.01))
    assert polarized.sum() > 100
    np.testing.assert_allclose(rolled.intensity, np.rot90(upright.intensity), atol=1e-4)
    assert angle_difference(rolled.aolp, turned + np.pi / 2)[polarized].max() < 0.01


def test_the_wrong_direction_mirrors_the_angle(stokes):
    mosaic = Sensor(angle_direction=COUNTERCLOCKWISE, bit_depth=16, noise=None).capture(stokes)
    right, wrong = (
        FrontEnd(camera_file(16, direction=direction)).polarization(frame_of(mosaic))
        for direction in (COUNTERCLOCKWISE, CLOCKWISE)
    )
    np.testing.assert_allclose(wrong.dolp, right.dolp, atol=1e-6)
    assert angle_difference(wrong.aolp, -right.aolp)[right.dolp > 0.05].max() < 1e-5


@pytest.mark.parametrize("direction", AngleDirection)
def test_one_picture_per_angle_is_the_same_as_the_mosaic(stokes, direction):
    mosaic = Sensor(angle_direction=direction, bit_depth=12, noise=None).capture(stokes)
    labelled = np.stack([mosaic[1::2, 1::2], mosaic[::2, 1::2], mosaic[::2, ::2], mosaic[1::2, ::2]])
    from_mosaic = FrontEnd(camera_file(direction=direction)).polarization(frame_of(mosaic))
    from_pictures = FrontEnd(camera_file(layout=None, direction=direction)).polarization(frame_of(channels=labelled))
    for name in ("intensity", "dolp", "aolp", "sigma_dolp", "saturated"):
        np.testing.assert_array_equal(getattr(from_pictures, name), getattr(from_mosaic, name))


def test_black_level_is_no_light_and_white_level_is_full_scale():
    mosaic = np.full((96, 96), 64, np.uint16)
    front_end = FrontEnd(camera_file(10, black_level=64.0))
    assert front_end.channels(frame_of(mosaic)).max() == 0
    np.testing.assert_allclose(front_end.channels(frame_of(mosaic * 0 + 1023)), 1.0, atol=1e-6)


@pytest.mark.parametrize(("method", "spread"), [("split", 0), ("bilinear", 1), ("edge-aware", 1)])
def test_a_clipped_raw_pixel_marks_every_pixel_that_takes_it(method, spread):
    mosaic = np.full((96, 96), 100, np.uint8)
    mosaic[40, 61] = 255
    image = FrontEnd(camera_file(8, demosaic=method)).polarization(frame_of(mosaic))
    expected = np.zeros((48, 48), bool)
    expected[20 - spread : 21 + spread, 30 - spread : 31 + spread] = True
    np.testing.assert_array_equal(image.saturated, expected)


def test_colour_superpixels_measure_the_same_polarization(stokes):
    """Each colour sees its own share of the same light, so the luminance has the light's DoLP and AoLP."""
    smooth = np.stack([cv2.GaussianBlur(s, (0, 0), 3) for s in stokes])
    share = np.tile([[0.5, 0.9], [0.9, 0.7]], (24, 24)).astype(np.float32)  # RGGB
    mosaic = Sensor(bit_depth=12, noise=None).capture(smooth * share)
    image = FrontEnd(camera_file(colour="RGGB", demosaic="bilinear")).polarization(frame_of(mosaic))
    inner = np.zeros((48, 48), bool)
    inner[4:-4, 4:-4] = True
    inner &= smooth[0] > 0.2
    dolp = np.hypot(smooth[1], smooth[2]) / smooth[0]
    np.testing.assert_allclose(image.intensity[inner], 0.75 * smooth[0][inner] / 2, rtol=0.08)
    np.testing.assert_allclose(image.dolp[inner], dolp[inner], atol=0.03)


@pytest.mark.parametrize(
    "distortion",
    [Distortion("radtan", (0.25, 0.05, 0.002, -0.001)), Distortion("equidistant", (0.02, 0.0, 0.0, 0.0))],
)
def test_distortion_is_undone_and_outside_is_dark(distortion):
    u, v = np.meshgrid(np.arange(48.0), np.arange(48.0))
    pixels = np.stack([u.ravel(), v.ravel()], axis=1)[:, None]
    undo = cv2.undistortPoints if distortion.model == "radtan" else cv2.fisheye.undistortPoints
    x, y = undo(pixels, CAMERA.matrix, np.array(distortion.coefficients))[:, 0].T.reshape(2, 48, 48)
    distorted = np.stack([0.4 + 0.2 * x, 0.3 + 0.1 * y, 0.2 - 0.1 * x, 0.3 + 0.1 * x])
    mosaic = np.empty((96, 96), np.uint16)
    mosaic[1::2, 1::2], mosaic[::2, 1::2], mosaic[::2, ::2], mosaic[1::2, ::2] = np.round(distorted * 65535)
    front_end = FrontEnd(camera_file(16, distortion=distortion))
    channels, image = front_end.channels(frame_of(mosaic)), front_end.polarization(frame_of(mosaic))
    seen = np.isfinite(channels).all(axis=0)
    x, y = np.moveaxis(front_end.camera.normalized(), -1, 0)
    truth = np.stack([0.4 + 0.2 * x, 0.3 + 0.1 * y, 0.2 - 0.1 * x, 0.3 + 0.1 * x])
    assert seen.all() == (distortion.model == "equidistant")
    assert seen.mean() > 0.5
    np.testing.assert_allclose(channels[:, seen], truth[:, seen], atol=2e-3)
    for name in ("intensity", "dolp", "aolp", "sigma_dolp", "sigma_aolp"):
        assert np.isfinite(getattr(image, name)).all()
    assert image.underexposed[~seen].all()
    assert not image.intensity[~seen].any()


def test_clipped_pixels_are_carried_through_undistortion():
    mosaic = np.full((96, 96), 100, np.uint8)
    mosaic[:, 48:] = 255
    file = camera_file(8, distortion=Distortion("radtan", (-0.1, 0.0, 0.0, 0.0)))
    image = FrontEnd(file).polarization(frame_of(mosaic))
    interpolated = (image.intensity > 101 / 255) & ~image.underexposed
    assert image.saturated[interpolated].all()
    assert not image.saturated[:, :22].any()


def test_a_front_end_is_repeatable_and_leaves_the_frame_alone(stokes):
    mosaic = Sensor().capture(stokes)
    before = mosaic.copy()
    front_end = FrontEnd(replace(camera_file(8), demosaic="edge-aware"))
    first, second = front_end.polarization(frame_of(mosaic)), front_end.polarization(frame_of(mosaic))
    np.testing.assert_array_equal(first.aolp, second.aolp)
    np.testing.assert_array_equal(mosaic, before)


def test_a_frame_that_does_not_fit_the_camera_file_is_refused():
    front_end = FrontEnd(camera_file())
    with pytest.raises(InputError, match=r"raw/000000.png: .*\(48, 48\).*\(96, 96\)"):
        front_end.polarization(frame_of(np.zeros((48, 48), np.uint16)))
    with pytest.raises(InputError, match="no such pixels"):
        front_end.polarization(frame_of(channels=np.zeros((4, 48, 48), np.uint16)))
