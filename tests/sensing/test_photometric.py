"""Photometric calibration: a simulated camera is undone; its files are read or refused in one line."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polarmap.data.camera_file import CameraFile, PhotometricFiles
from polarmap.data.photometric import PhotometricCalibration
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.images import write_image
from polarmap.io.recording.photometric import read_photometric, read_response, read_vignette
from polarmap.sensing.photometric import corrected

WIDTH, HEIGHT = 40, 30
GAMMA = 2.2
INVERSE_RESPONSE = np.linspace(0, 1, 256).astype(np.float32) ** GAMMA
U, V = np.meshgrid(np.linspace(-1, 1, WIDTH), np.linspace(-1, 1, HEIGHT))
VIGNETTE = (1 - 0.3 * (U**2 + V**2)).astype(np.float32) / np.float32((1 - 0.3 * (U**2 + V**2)).max())


@pytest.fixture
def irradiance() -> np.ndarray:
    return np.random.default_rng(1).uniform(0, 0.95, (HEIGHT, WIDTH)).astype(np.float32)


def test_the_formation_of_an_image_is_undone(irradiance):
    recorded = (irradiance * VIGNETTE) ** (1 / GAMMA)
    found = corrected(recorded.astype(np.float32), PhotometricCalibration(INVERSE_RESPONSE, VIGNETTE))
    assert found.dtype == np.float32
    np.testing.assert_allclose(found, irradiance, atol=1e-4)


def test_each_part_may_be_left_out(irradiance):
    np.testing.assert_allclose(corrected(irradiance, PhotometricCalibration()), irradiance, rtol=1e-6)
    with_response = corrected(irradiance, PhotometricCalibration(INVERSE_RESPONSE))
    np.testing.assert_allclose(with_response, irradiance**GAMMA, atol=1e-5)
    with_vignette = corrected(irradiance, PhotometricCalibration(vignette=VIGNETTE))
    np.testing.assert_allclose(with_vignette, np.minimum(irradiance / VIGNETTE, 1), rtol=1e-5)


def test_table_entries_come_out_as_they_are():
    image = np.linspace(0, 1, 256, dtype=np.float32)[None]
    np.testing.assert_allclose(
        corrected(image, PhotometricCalibration(INVERSE_RESPONSE))[0], INVERSE_RESPONSE, atol=1e-6
    )


def test_a_table_of_a_16_bit_camera():
    table = np.linspace(0, 1, 65536, dtype=np.float32) ** 2
    image = np.array([[0.0, 12345 / 65535, 1.0]], np.float32)
    np.testing.assert_allclose(corrected(image, PhotometricCalibration(table)), image**2, atol=1e-6)


def test_white_stays_white_and_nothing_leaves_the_range():
    calibration = PhotometricCalibration(INVERSE_RESPONSE, VIGNETTE)
    image = np.ones((HEIGHT, WIDTH), np.float32)
    np.testing.assert_array_equal(corrected(image, calibration), 1.0)
    image[:2] = [[-0.5] * WIDTH, [1.5] * WIDTH]
    image[2] = np.nan
    found = corrected(image, calibration)
    assert (found[0] == 0).all() and (found[1] == 1).all() and (found[2] == 0).all()


def test_nothing_is_seen_where_the_lens_lets_nothing_through(irradiance):
    vignette = VIGNETTE.copy()
    vignette[0, :5] = 0
    found = corrected(irradiance, PhotometricCalibration(vignette=vignette))
    assert (found[0, :5] == 0).all() and (found[0, 5:] > 0).all()


def test_an_image_that_is_not_contiguous(irradiance):
    calibration = PhotometricCalibration(INVERSE_RESPONSE)
    np.testing.assert_array_equal(corrected(irradiance.T, calibration), corrected(irradiance, calibration).T)


@pytest.mark.parametrize(
    ("response", "vignette", "message"),
    [
        (np.linspace(0, 1, 255), None, "response: 255 values, expected 256 or more"),
        (np.linspace(0, 255, 256), None, "response: the values must go from 0 to 1"),
        (np.linspace(0.1, 1, 256), None, "from 0 to 1"),
        (np.where(np.arange(256) == 9, 0.9, np.linspace(0, 1, 256)), None, "must increase"),
        (np.where(np.arange(256) == 9, np.nan, np.linspace(0, 1, 256)), None, "from 0 to 1"),
        (None, np.full((3, 4), 255.0), r"vignette: the values must be in \[0, 1\]"),
        (None, np.zeros((3, 4)), "not all 0"),
        (None, np.full((3, 4), np.nan), "vignette: the values"),
        (None, np.ones((3, 4, 3)), "not an image of one channel"),
    ],
)
def test_bad_arrays_are_refused(response, vignette, message):
    with pytest.raises(InputError, match=message):
        PhotometricCalibration(response, vignette)


def test_an_image_of_another_size_is_refused(irradiance):
    with pytest.raises(InputError, match="the image has 40x29 pixels, the vignette 40x30"):
        corrected(irradiance[:-1], PhotometricCalibration(vignette=VIGNETTE))


@pytest.fixture
def camera_file(tmp_path) -> CameraFile:
    (tmp_path / "pcalib.txt").write_text(" ".join(f"{255 * g:.6f}" for g in INVERSE_RESPONSE) + " \n")
    write_image(tmp_path / "vignette.png", np.rint(60000 * VIGNETTE).astype(np.uint16))
    camera = PinholeCamera(WIDTH, HEIGHT, 30.0, 30.0, 19.5, 14.5)
    files = PhotometricFiles(tmp_path / "pcalib.txt", tmp_path / "vignette.png")
    return CameraFile(camera, None, None, 8, photometric=files)


def test_the_files_of_a_camera(camera_file):
    calibration = read_photometric(camera_file)
    np.testing.assert_allclose(calibration.inverse_response, INVERSE_RESPONSE, atol=1e-6)
    np.testing.assert_allclose(calibration.vignette, VIGNETTE, atol=1e-4)
    files = camera_file.photometric
    assert read_photometric(replace(camera_file, photometric=None)) is None
    assert read_photometric(replace(camera_file, photometric=PhotometricFiles())) is None
    assert read_photometric(replace(camera_file, photometric=replace(files, response=None))).inverse_response is None
    assert read_photometric(replace(camera_file, photometric=replace(files, vignette=None))).vignette is None


def test_a_vignette_of_8_bits(tmp_path):
    write_image(tmp_path / "vignette.png", np.rint(200 * VIGNETTE).astype(np.uint8))
    np.testing.assert_allclose(read_vignette(tmp_path / "vignette.png", (WIDTH, HEIGHT)), VIGNETTE, atol=0.003)


def test_a_vignette_that_shows_little_is_said(tmp_path, caplog):
    pixels = np.zeros((HEIGHT, WIDTH), np.uint8)
    pixels[:, :10] = 200
    write_image(tmp_path / "vignette.png", pixels)
    assert (read_vignette(tmp_path / "vignette.png") == 0).mean() == 0.75
    assert "vignette.png: 0 in 75 % of its pixels" in caplog.text


def test_a_response_with_an_offset_and_line_ends_in_between(tmp_path):
    (tmp_path / "pcalib.txt").write_text("\n".join(str(3 + 2 * i) for i in range(256)))
    np.testing.assert_allclose(read_response(tmp_path / "pcalib.txt"), np.linspace(0, 1, 256), atol=1e-6)


RISING = [str(i) for i in range(256)]


@pytest.mark.parametrize(
    ("fields", "message"),
    [
        ([], "0 numbers, expected 256"),
        (RISING[:-1], "255 numbers, expected 256"),
        (["0"] * 70_000, "70000 numbers, expected 256"),
        ([*RISING[:9], "x", *RISING[10:]], "'x' is no number"),
        ([*RISING[:9], "nan", *RISING[10:]], "'nan' is no number"),
        ([*RISING[:9], "8", *RISING[10:]], "number 10 is not more than the one before"),
        ([str(i - 5) for i in range(256)], "number 1 is -5; an irradiance is not negative"),
        ([*RISING[:-1], "-1"], "number 256 is -1; an irradiance is not negative"),
        (["5"] * 256, "number 2 is not more"),
        (RISING[::-1], "must increase"),
    ],
)
def test_a_bad_response_is_named(tmp_path, fields, message):
    (tmp_path / "pcalib.txt").write_text(" ".join(fields))
    with pytest.raises(InputError, match=rf"pcalib\.txt: .*{message}") as error:
        read_response(tmp_path / "pcalib.txt")
    assert "\n" not in str(error.value)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.lists(st.floats(-1e308, 1e308), min_size=256, max_size=256).map(sorted))
def test_any_increasing_numbers_are_read_or_refused(tmp_path, values):
    (tmp_path / "pcalib.txt").write_text(" ".join(map(repr, values)))
    try:
        PhotometricCalibration(read_response(tmp_path / "pcalib.txt"))
    except InputError as error:
        assert "pcalib.txt" in str(error) and "\n" not in str(error)


def test_a_bad_vignette_is_named(tmp_path, camera_file):
    with pytest.raises(InputError, match=r"vignette\.png: 40x30 pixels, expected 30x40"):
        read_vignette(tmp_path / "vignette.png", (HEIGHT, WIDTH))
    write_image(tmp_path / "vignette.png", np.zeros((HEIGHT, WIDTH), np.uint8))
    with pytest.raises(InputError, match=r"vignette\.png: all black"):
        read_photometric(camera_file)
    (tmp_path / "pcalib.txt").unlink()
    with pytest.raises(InputError, match=r"pcalib\.txt: no such file"):
        read_photometric(camera_file)
