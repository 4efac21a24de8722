"""The grey front end: S0/2 of any polarization camera, pictures of plain ones, undistorted and calibrated."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.photometric import PhotometricCalibration
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Distortion
from polarmap.io.recording.sequence import open_sequence
from polarmap.sensing.front_end import FrontEnd

CAMERA = PinholeCamera(48, 36, 40.0, 40.0, 23.5, 17.5)
SONY, CLOCKWISE = SensorLayout.SONY_POLARSENS, AngleDirection.CLOCKWISE
BARREL = Distortion("radtan", (-0.2, 0.02, 0.001, -0.002))


def pixels(bit_depth: int, *shape: int) -> np.ndarray:
    values = np.random.default_rng(bit_depth).integers(0, 1 << bit_depth, shape)
    return values.astype(np.uint8 if bit_depth == 8 else np.uint16)


def frame_of(**arrays) -> Frame:
    return Frame(0, 0.0, "000000", Path("000000.png"), **arrays)


def plain(bit_depth: int = 8, **options) -> CameraFile:
    return CameraFile(CAMERA, None, None, bit_depth, **options)


@pytest.mark.parametrize("bit_depth", [8, 12, 16])
@pytest.mark.parametrize("colour", [None, "RGGB"])
@pytest.mark.parametrize("distortion", [None, BARREL])
def test_a_mosaic_gives_the_intensity_of_the_polarization_image(bit_depth, colour, distortion):
    camera_file = CameraFile(CAMERA, SONY, CLOCKWISE, bit_depth, colour=colour, distortion=distortion)
    frame = frame_of(mosaic=pixels(bit_depth, 72, 96))
    grey = FrontEnd(camera_file).grey(frame)
    assert grey.dtype == np.float32 and grey.flags.c_contiguous
    np.testing.assert_allclose(grey, FrontEnd(camera_file).polarization(frame).intensity, atol=2e-6)


def test_four_pictures_give_their_mean():
    channels = pixels(8, 4, 36, 48)
    grey = FrontEnd(CameraFile(CAMERA, None, CLOCKWISE, 8)).grey(frame_of(channels=channels))
    np.testing.assert_allclose(grey, channels.mean(axis=0) / 255, atol=1e-6)


@pytest.mark.parametrize("bit_depth", [8, 10, 16])
def test_the_picture_of_a_plain_camera(bit_depth):
    picture = pixels(bit_depth, 36, 48)
    white = (1 << bit_depth) - 1
    grey = FrontEnd(plain(bit_depth, black_level=20)).grey(frame_of(grey=picture))
    np.testing.assert_allclose(grey, np.maximum(picture - 20.0, 0) / (white - 20), atol=1e-6)


@pytest.mark.parametrize("shape", ["mosaic", "channels", "grey"])
def test_black_and_white(shape):
    layout, direction = (SONY if shape == "mosaic" else None), (None if shape == "grey" else CLOCKWISE)
    front_end = FrontEnd(CameraFile(CAMERA, layout, direction, 12, black_level=64))
    size = {"mosaic": (72, 96), "channels": (4, 36, 48), "grey": (36, 48)}[shape]
    for value, expected in ((0, 0.0), (64, 0.0), (4095, 1.0)):
        grey = front_end.grey(frame_of(**{shape: np.full(size, value, np.uint16)}))
        np.testing.assert_allclose(grey, expected, atol=1e-6)


def test_pixels_that_the_lens_does_not_show_are_black_and_not_valid():
    pincushion = Distortion("radtan", (0.3, 0.0, 0.0, 0.0))
    front_end = FrontEnd(plain(distortion=pincushion))
    grey = front_end.grey(frame_of(grey=np.full((36, 48), 200, np.uint8)))
    assert 0 < front_end.valid_grey.sum() < front_end.valid_grey.size
    np.testing.assert_allclose(grey[front_end.valid_grey], 200 / 255, atol=1e-6)
    assert (grey[~front_end.valid_grey] == 0).all()
    assert FrontEnd(plain()).valid is None and FrontEnd(plain()).valid_grey.all()


def test_the_vignette_belongs_to_the_distorted_image():
    vignette = np.random.default_rng(3).uniform(0.5, 1, CAMERA.shape).astype(np.float32)
    picture = np.rint(0.4 * 65535 * vignette).astype(np.uint16)
    front_end = FrontEnd(plain(16, distortion=BARREL), PhotometricCalibration(vignette=vignette))
    np.testing.assert_allclose(front_end.grey(frame_of(grey=picture))[front_end.valid_grey], 0.4, atol=1e-4)


@pytest.mark.parametrize("distortion", [None, BARREL])
def test_pixels_in_a_vignettes_darkness_are_not_valid(distortion):
    vignette = np.ones(CAMERA.shape, np.float32)
    vignette[:, :10] = 0
    front_end = FrontEnd(plain(distortion=distortion), PhotometricCalibration(vignette=vignette))
    grey = front_end.grey(frame_of(grey=np.full((36, 48), 51, np.uint8)))
    assert not front_end.valid_grey[:, :10].any() and front_end.valid_grey[18, 12:].all()
    np.testing.assert_allclose(grey[front_end.valid_grey], 0.2, atol=1e-6)


@pytest.mark.parametrize(
    ("layout", "direction", "arrays", "expected"),
    [
        (None, None, {"mosaic": np.zeros((72, 96), np.uint8)}, r"no such pixels; .* shape \(36, 48\)"),
        (None, None, {"grey": np.zeros((36, 49), np.uint8)}, r"shape \(36, 49\); .* shape \(36, 48\)"),
        (SONY, CLOCKWISE, {"grey": np.zeros((36, 48), np.uint8)}, r"no such pixels; .* shape \(72, 96\)"),
        (None, CLOCKWISE, {"channels": np.zeros((3, 36, 48), np.uint8)}, r"shape \(3, 36, 48\); .* \(4, 36, 48\)"),
    ],
)
def test_a_frame_of_another_camera_is_named(layout, direction, arrays, expected):
    with pytest.raises(InputError, match=rf"000000\.png: .*{expected}"):
        FrontEnd(CameraFile(CAMERA, layout, direction, 8)).grey(frame_of(**arrays))


def test_the_recorded_mosaics(shared_data):
    sequence = open_sequence(shared_data / "livingroom")
    grey = FrontEnd(sequence.camera_file).grey(sequence[3])
    np.testing.assert_allclose(grey, FrontEnd(sequence.camera_file).polarization(sequence[3]).intensity, atol=1e-6)
