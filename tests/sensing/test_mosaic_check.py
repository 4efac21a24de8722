"""Whether raw pictures are what the camera file says: sensors that are read wrongly, and good ones that are not."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import cv2
import numpy as np
import pytest

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.recording.camera_file import read_camera_file, write_camera_file
from polarmap.sensing.mosaic_check import check_mosaic
from polarmap.synth import Sensor, built_in_scene, render_sequence
from polarmap.synth.scenes import SCENES

CAMERA = PinholeCamera(96, 64, 90.0, 90.0, 47.5, 31.5)
SONY, CLOCKWISE = SensorLayout.SONY_POLARSENS, AngleDirection.CLOCKWISE
FILE = CameraFile(CAMERA, SONY, CLOCKWISE, 8)
BAYER = np.kron([[0.45, 0.9], [0.9, 0.3]], np.ones((2, 2)))


@lru_cache
def stokes(height=64, width=96, polarized=0.2, grain=1):
    """A textured picture whose polarization varies slowly, float32 3×H×W."""
    rng = np.random.default_rng(3)
    coarse = rng.random((height // grain, width // grain), dtype=np.float32)
    texture = 0.35 + 0.6 * cv2.GaussianBlur(cv2.resize(coarse, (width, height)), (0, 0), 0.7)
    texture[:, width // 3 :] *= 0.6  # an edge
    angle = np.linspace(0.2, 2.2, width)[None, :] + np.linspace(0.0, 1.0, height)[:, None]
    return np.stack([texture, polarized * texture * np.cos(angle), polarized * texture * np.sin(angle)])


def recorded(sub_pixel=False, polarized=0.2, index=0, bits=8):
    sensor = Sensor(bit_depth=bits, sub_pixel=sub_pixel)
    size = (128, 192) if sub_pixel else (64, 96)
    return sensor.capture(stokes(*size, polarized).astype(np.float32), index)


def under_bayer(mosaic, pattern=BAYER):
    gain = np.tile(pattern, (mosaic.shape[0] // 4, mosaic.shape[1] // 4))
    return np.round(mosaic * gain).astype(mosaic.dtype)


@pytest.mark.parametrize("sub_pixel", [False, True])
@pytest.mark.parametrize("bits", [8, 12])
def test_nothing_is_found_in_a_good_mosaic(sub_pixel, bits):
    file = CameraFile(CAMERA, SONY, CLOCKWISE, bits)
    assert check_mosaic([recorded(sub_pixel, bits=bits)], file) == ()


@pytest.mark.parametrize("sub_pixel", [False, True])
@pytest.mark.parametrize("pattern", [BAYER, BAYER[::-1], np.kron([[0.3, 0.35], [0.35, 0.8]], np.ones((2, 2)))])
def test_a_colour_sensor_read_as_grey_is_named_with_the_key(sub_pixel, pattern):
    mosaic = under_bayer(recorded(sub_pixel), pattern)
    (finding,) = check_mosaic([mosaic], FILE)
    assert finding.startswith("colour: ")
    assert "colour: RGGB" in finding
    assert check_mosaic([mosaic], replace(FILE, colour="RGGB")) == ()


def test_a_colour_sensor_is_seen_by_a_coloured_third_of_a_white_balanced_picture():
    mosaic = recorded()
    coloured = under_bayer(mosaic, np.kron([[0.9, 0.4], [0.4, 0.3]], np.ones((2, 2))))
    mosaic[:, :64] = coloured[:, :64]
    assert check_mosaic([mosaic], FILE)[0].startswith("colour: ")


def test_pictures_of_each_angle_that_keep_a_bayer_pattern_are_named():
    channels = np.stack([under_bayer(recorded())[y::2, x::2] for y, x in ((1, 1), (0, 1), (0, 0), (1, 0))])
    file = replace(FILE, layout=None)
    assert "converted to grey" in check_mosaic([channels], file)[0]
    grey = np.stack([recorded()[y::2, x::2] for y, x in ((1, 1), (0, 1), (0, 0), (1, 0))])
    assert check_mosaic([grey], file) == ()


def test_a_grey_sensor_read_as_a_colour_one_is_named():
    (finding,) = check_mosaic([recorded()], replace(FILE, colour="GBRG"))
    assert "colour: none" in finding


@pytest.mark.parametrize(
    ("cut", "moved", "layout"),
    [
        (np.s_[:, 1:-1], "one column", [45, 90, 0, 135]),
        (np.s_[1:-1], "one row", [135, 0, 90, 45]),
        (np.s_[1:-1, 1:-1], "one row and one column", [0, 135, 45, 90]),
    ],
)
def test_a_mosaic_cropped_by_an_odd_number_is_named_with_the_layout_that_fits(cut, moved, layout):
    mosaic = recorded()[cut]
    (finding,) = check_mosaic([mosaic], FILE)
    assert f"begin {moved} later" in finding
    assert f"mosaic: {layout}" in finding
    fitting = SensorLayout.from_angles(layout)  # its angles are those of the pixels
    assert np.array_equal(angles_of(fitting, mosaic.shape), angles_of(SONY, recorded().shape)[cut])


def angles_of(layout, shape):
    return np.tile(np.reshape(layout.value, (2, 2)), (shape[0] // 2, shape[1] // 2))


def test_a_colour_mosaic_cropped_by_an_odd_number_is_named_even_where_each_pixel_sees_its_own_point():
    findings = check_mosaic([under_bayer(recorded(sub_pixel=True))[:, 1:-3]], FILE)
    assert [finding.split(":")[0] for finding in findings] == ["mosaic", "colour"]
    assert "one column later" in findings[0]


def test_grey_pictures_in_place_of_mosaics_are_named():
    mosaic = recorded(sub_pixel=True)
    grey = cv2.resize(cv2.resize(mosaic, None, fx=0.5, fy=0.5, interpolation=cv2.INTER_AREA), mosaic.shape[::-1])
    assert "no polarization" in check_mosaic([grey], FILE)[0]


def test_an_ordinary_bayer_picture_is_named():
    picture = np.tile([[0.45, 0.9], [0.9, 0.3]], (64, 96)) * recorded(sub_pixel=True, polarized=0.0)
    assert "ordinary Bayer picture" in check_mosaic([np.round(picture).astype(np.uint8)], FILE)[0]


def test_a_block_given_in_another_order_than_row_by_row_is_named():
    mosaic = recorded()
    mosaic[1::2, ::2], mosaic[1::2, 1::2] = mosaic[1::2, 1::2].copy(), mosaic[1::2, ::2].copy()
    assert "row by row" in check_mosaic([mosaic], FILE)[0]


@pytest.mark.parametrize("value", [0, 3, 255])
def test_pictures_in_which_nothing_is_seen_make_no_finding(value):
    assert check_mosaic([np.full((128, 192), value, np.uint8)], FILE) == ()


def test_no_frames_tiny_ones_and_plain_cameras_make_no_finding():
    assert check_mosaic([], FILE) == ()
    assert check_mosaic([recorded()[:6, :6]], FILE) == ()
    plain = CameraFile(CAMERA, None, None, 8)
    assert check_mosaic([recorded()[:64, :96]], plain) == ()


def test_a_large_mosaic_is_judged_by_its_middle():
    mosaic = np.full((2100, 2300), 100, np.uint8)
    y, x = (2100 - 2048) // 8 * 4, (2300 - 2048) // 8 * 4
    tiled = np.tile(under_bayer(recorded()), (16, 11))[:2048, :2048]
    mosaic[y : y + 2048, x : x + 2048][: tiled.shape[0], : tiled.shape[1]] = tiled
    assert check_mosaic([mosaic], FILE)[0].startswith("colour: ")


@pytest.mark.parametrize("sub_pixel", [False, True])
@pytest.mark.parametrize("name", sorted(SCENES))
def test_nothing_is_found_in_the_scenes_of_the_package(name, sub_pixel):
    built_in = built_in_scene(name)
    times, poses = built_in.path(20, built_in.step, 30.0, 0)
    sensor = Sensor(sub_pixel=sub_pixel)
    frames = list(render_sequence(built_in.scene, CAMERA, times[::10], poses[::10], sensor, supersample=1))
    assert check_mosaic([frame.mosaic for frame in frames], FILE) == ()


def test_inspect_prints_one_line_for_a_finding(polarmap, tmp_path):
    (tmp_path / "raw").mkdir()
    for index in range(2):
        cv2.imwrite(str(tmp_path / "raw" / f"{index}.png"), under_bayer(recorded(index=index)))
    write_camera_file(tmp_path / "camera.yaml", FILE)
    ended = polarmap("inspect", tmp_path)
    assert ended.status == 0
    (line,) = [line for line in ended.err.splitlines() if line.startswith("warning: ")]
    assert "write colour: RGGB in the camera file" in line
    write_camera_file(tmp_path / "camera.yaml", replace(FILE, colour="RGGB"))
    assert "warning" not in polarmap("inspect", tmp_path).err


@pytest.mark.parametrize("name", ["livingroom", "objects", "orbit"])
def test_nothing_is_found_in_the_recorded_sequences(shared_data, name):
    file = read_camera_file(shared_data / name / "camera.yaml")
    paths = sorted((shared_data / name / "raw").glob("*.png"))
    mosaics = [cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths[:: len(paths) // 2]]
    assert check_mosaic(mosaics, file) == ()
    (finding,) = check_mosaic([mosaic[:, 1:-1] for mosaic in mosaics], file)
    assert "one column later" in finding


@pytest.mark.parametrize("name", ["fruits", "carps", "polarizer"])
def test_nothing_is_found_in_pictures_of_a_real_sensor(shared_data, name):
    path = shared_data / "raw_imx250mzr" / f"{name}_IMX250MZR.png"
    file = CameraFile(PinholeCamera(1224, 1024, 1900.0, 1900.0, 611.5, 511.5), SONY, CLOCKWISE, 8)
    assert check_mosaic([cv2.imread(str(path), cv2.IMREAD_UNCHANGED)], file) == ()
