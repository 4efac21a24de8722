"""Calibration files of other programs in place of a camera file, and the words that they use."""

from __future__ import annotations

import logging

import cv2
import numpy as np
import pytest
from calibration_texts import (
    COLMAP,
    COLMAP_PINHOLE,
    EUROC,
    FILES,
    KALIBR,
    OPENCV,
    OPENCV_XML,
    ORB_SLAM,
    ORB_SLAM_FISHEYE,
    RADTAN_5,
    ROS,
    ROS_MESSAGE,
    VINS,
)
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Distortion
from polarmap.io.formats.images import write_image
from polarmap.io.recording.calibration import lens_distortion
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.io.recording.sequence import open_sequence

CHANNEL = PinholeCamera(32, 24, 24.0, 24.5, 15.25, 11.75)
SENSOR = "mosaic: [90, 45, 135, 0]\nangle_direction: counterclockwise\nbit_depth: 8\n"


@pytest.fixture
def sequence(tmp_path):
    """A sequence of one mosaic of 64×48, with its own camera file."""
    folder = tmp_path / "sequence"
    (folder / "raw").mkdir(parents=True)
    write_image(folder / "raw" / "a.png", np.full((48, 64), 90, np.uint8))
    (folder / "camera.yaml").write_text(f"width: 32\nheight: 24\nfx: 9\nfy: 9\ncx: 9\ncy: 9\n{SENSOR}black_level: 3\n")
    return folder


def write(folder, text, name="calibration"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def numbers(camera):
    return [camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy]


@pytest.mark.parametrize(("text", "distortion"), FILES.values(), ids=FILES)
def test_a_calibration_given_in_place_of_a_camera_file(tmp_path, sequence, caplog, text, distortion):
    with caplog.at_level(logging.WARNING):
        camera_file = read_camera_file(write(tmp_path, text), sequence)
    assert numbers(camera_file.camera) == pytest.approx(numbers(CHANNEL))
    assert camera_file.distortion == distortion
    assert camera_file.layout is SensorLayout.SONY_POLARSENS
    assert camera_file.angle_direction is AngleDirection.COUNTERCLOCKWISE
    assert camera_file.black_level == 3
    assert "read as a calibration of " in caplog.text
    assert "the sensor is that of the sequence's camera.yaml" in caplog.text
    assert len(caplog.records) == 1
    assert open_sequence(sequence, camera_file)[0].mosaic.shape == (48, 64)


@pytest.mark.parametrize("name", [name for name in FILES if name.split()[0] != "colmap" and "xml" not in name])
def test_the_same_file_as_camera_yaml_with_the_sensors_lines(sequence, name):
    text, distortion = FILES[name]
    lines = SENSOR
    if text.startswith("{"):
        text = text.rstrip().removesuffix("}") + ", "
        lines = '"mosaic": [90, 45, 135, 0], "angle_direction": "counterclockwise", "bit_depth": 8}'
    write(sequence, text + lines, "camera.yaml")
    camera_file = open_sequence(sequence).camera_file
    assert numbers(camera_file.camera) == pytest.approx(numbers(CHANNEL))
    assert camera_file.distortion == distortion and camera_file.layout is SensorLayout.SONY_POLARSENS


@pytest.mark.parametrize("text", [text for text, _ in FILES.values()], ids=FILES)
def test_without_any_word_on_the_sensor_the_lines_to_add_are_named(sequence, text):
    (sequence / "camera.yaml").unlink()
    path = write(sequence, text, "camera.yaml")
    with pytest.raises(InputError) as caught:
        open_sequence(sequence)
    message = str(caught.value)
    assert message.startswith(f"{path}: a calibration of ")
    for words in ("mosaic: [90, 45, 135, 0]", "angle_direction: counterclockwise", "polarization: none"):
        assert words in message
    assert "bit_depth" not in message  # which the pictures tell


@pytest.mark.parametrize("size", ["mosaic", "channel"])
def test_numbers_at_the_size_of_the_mosaic_are_halved_and_it_is_said(tmp_path, sequence, caplog, size):
    text = KALIBR
    if size == "mosaic":  # pixel (u, v) of a channel is the block centred at (2u + 1/2, 2v + 1/2)
        text = text.replace("[24.0, 24.5, 15.25, 11.75]", "[48.0, 49.0, 31.0, 24.0]").replace("[32, 24]", "[64, 48]")
    with caplog.at_level(logging.WARNING):
        camera = read_camera_file(write(tmp_path, text), sequence).camera
    assert numbers(camera) == pytest.approx(numbers(CHANNEL))
    assert f"is the size of {'the mosaic, so that all is halved for' if size == 'mosaic' else ''}" in caplog.text
    assert "a channel" in caplog.text


def test_the_size_is_known_by_the_centre_where_the_file_does_not_tell_it(tmp_path, sequence):
    mosaic = ORB_SLAM_FISHEYE.replace("24.5", "49").replace("24.0", "48").replace("15.25", "31").replace("11.75", "24")
    for text in (ORB_SLAM_FISHEYE, mosaic):
        camera = read_camera_file(write(tmp_path, text), sequence).camera
        assert numbers(camera) == pytest.approx(numbers(CHANNEL))
    far = ORB_SLAM_FISHEYE.replace("15.25", "100.0")
    with pytest.raises(
        InputError, match=r"does not tell the size of its pictures; add Camera\.width and Camera\.height"
    ):
        read_camera_file(write(tmp_path, far), sequence)


def test_pictures_of_one_angle_are_of_a_channels_size(tmp_path, sequence):
    (sequence / "raw" / "a.png").unlink()
    for angle in (0, 45, 90, 135):
        write_image(sequence / "raw" / f"a_{angle}.png", np.full((24, 32), 90, np.uint8))
    camera_file = read_camera_file(write(tmp_path, KALIBR), sequence)
    assert numbers(camera_file.camera) == pytest.approx(numbers(CHANNEL))
    assert open_sequence(sequence, camera_file)[0].channels.shape == (4, 24, 32)


def test_pictures_of_another_size_are_refused(tmp_path, sequence):
    text = KALIBR.replace("[32, 24]", "[48, 36]")
    with pytest.raises(
        InputError, match=r"pictures of 48x36, but a\.png has 64x48 and a channel of it 32x24; calibrate"
    ):
        read_camera_file(write(tmp_path, text), sequence)


def test_a_plain_cameras_calibration(tmp_path, caplog):
    folder = tmp_path / "plain"
    (folder / "images").mkdir(parents=True)
    write_image(folder / "images" / "a.png", np.full((24, 32, 3), 90, np.uint8))
    write(folder, EUROC + "polarization: none\n", "camera.yaml")
    recording = open_sequence(folder)
    assert not recording.camera_file.polarized
    assert recording.camera_file.frame_rate == 20
    assert recording.camera_file.bit_depth == 8
    assert recording[0].grey.shape == (24, 32)
    assert "bit_depth 8 as in the pictures" in caplog.text


@pytest.mark.parametrize(
    ("text", "message"),
    [
        (KALIBR + KALIBR.replace("cam0", "cam1"), r"2 cameras \(cam0, cam1\); choose one: add the line `camera: cam0`"),
        (KALIBR + "camera: left\n", r"camera: 'left' is none of those in the file \(cam0\)"),
        (KALIBR.replace("pinhole", "omni"), r"the omnidirectional model \(omni\) is not known here"),
        (KALIBR.replace("pinhole", "eucm"), r"the extended unified model \(eucm\) is not known here"),
        (KALIBR.replace("pinhole", "ds"), r"the double sphere model \(ds\) is not known here"),
        (KALIBR.replace("radtan", "fov"), r"the FOV model \(fov\) is not known here; calibrate again with radtan"),
        (KALIBR.replace("radtan", "none"), "model 'none' has none, but coefficients are given"),
        (KALIBR.replace("24.5, ", ""), "intrinsics: 3 numbers, expected 4"),
        (KALIBR.replace("24.5", ".nan"), "intrinsics: nan is no finite number"),
        (KALIBR.replace("24.5", "wide"), "intrinsics: 'wide' is no finite number"),
        (KALIBR.replace("24.5", "-24.5"), "focal lengths must be positive"),
        (KALIBR.replace("  resolution: [32, 24]\n", ""), "resolution is missing"),
        (KALIBR.replace("[32, 24]", "[32.5, 24]"), "resolution: .* are no image size"),
        (ROS.replace("plumb_bob", "thin_prism"), "model 'thin_prism' is not known; write radtan"),
        (ROS.replace("15.25, 0.0", "15.25, 0.5"), "camera_matrix: not a camera matrix"),
        (ROS.replace("24.0, 0.0", "24.0, 0.5"), "camera_matrix: a skew of 0.5 is not known here"),
        (ROS.replace("cols: 5", "cols: 4"), "distortion_coefficients: 1x4, but 5 numbers"),
        (ROS_MESSAGE.replace("binning_x: 0", "binning_x: 2"), "binning_x: intrinsics of binned pictures"),
        (ROS_MESSAGE.replace("x_offset: 0", "x_offset: 8"), "roi: intrinsics of a region"),
        (ORB_SLAM + "Camera2.fx: 1.0\n", r"2 cameras \(Camera1, Camera2\); choose one"),
        (ORB_SLAM.replace("Camera1.fy: 24.5\n", ""), r"Camera1\.fy is missing"),
        (ORB_SLAM.replace("PinHole", "Fancy"), "model 'Fancy' is not known"),
        (VINS.replace("PINHOLE", "MEI"), r"Mei's model \(MEI\) is not known here"),
        (OPENCV.replace("camera_matrix", "M1") + "M2: [[24, 0, 15], [0, 24, 11], [0, 0, 1]]\n", "choose one"),
        (OPENCV_XML.replace("<opencv_s", "<!DOCTYPE a [<!ENTITY b 'c'>]><opencv_s", 1), "XML with a DOCTYPE"),
        (OPENCV_XML.replace("opencv_storage", "storage"), "XML, but not OpenCV's"),
        (OPENCV_XML[:300], "not valid XML"),
        (OPENCV.replace("24., 0.", "24., [0."), "not valid YAML at line"),
        (OPENCV.replace("!!opencv-matrix", "!!python/object/apply:os.getcwd"), "not valid YAML"),
        (COLMAP_PINHOLE + "4 PINHOLE 32 24 24 24.5 15.75 12.25\n", r"2 cameras \(3, 4\); keep the line of the one"),
        (COLMAP + "1 FOV 32 24 24 24.5 15.75 12.25 0.9\n", r"the FOV model \(FOV\) is not known here"),
        (COLMAP + "1 PINHOLE 32 24 24 24.5 15.75\n", "3 parameters of PINHOLE, expected 4"),
    ],
)  # fmt: skip
def test_what_cannot_be_used_is_named_in_one_line(tmp_path, sequence, text, message):
    path = write(tmp_path, text)
    with pytest.raises(InputError, match=message) as caught:
        read_camera_file(path, sequence)
    assert str(caught.value).startswith(str(path)) and str(caught.value).count(str(path)) == 1
    assert "\n" not in str(caught.value)


def test_one_of_several_cameras_is_chosen_by_a_line(tmp_path, sequence):
    second = KALIBR.replace("cam0", "cam1").replace("24.5", "30.0")
    assert read_camera_file(write(tmp_path, KALIBR + second + "camera: cam1\n"), sequence).camera.fy == 30.0


@pytest.mark.parametrize(
    ("model", "coefficients", "expected"),
    [
        ("plumb_bob", (-0.1, 0.02, 0, 0, 0), Distortion("radtan", (-0.1, 0.02, 0, 0, 0))),
        ("radial-tangential", (-0.1, 0.02, 0, 0), Distortion("radtan", (-0.1, 0.02, 0, 0))),
        ("Brown Conrady", (-0.1, 0.02, 0, 0), Distortion("radtan", (-0.1, 0.02, 0, 0))),
        ("rational_polynomial", (0.1,) + 13 * (0.0,), Distortion("radtan", (0.1,) + 7 * (0.0,))),
        ("radtan", 14 * (0.0,), None),
        ("plumb_bob", (), None),
        ("none", (), None),
        ("none", (0, 0, 0, 0), None),
        ("fisheye", (0, 0, 0, 0), Distortion("equidistant", (0, 0, 0, 0))),
        ("KANNALA_BRANDT4", (-0.1, 0, 0, 0), Distortion("equidistant", (-0.1, 0, 0, 0))),
    ],
)
def test_the_names_that_programs_have_for_lens_models(model, coefficients, expected):
    assert lens_distortion(model, coefficients) == expected


@pytest.mark.parametrize(
    ("model", "coefficients", "words"),
    [
        ("rational_polynomial", 8 * (0.0,) + (0.1,) + 5 * (0.0,), "thin prism and tilt coefficients"),
        ("radtan", (0.1,), "takes 4, 5 or 8"),
        ("fisheye", (0.1, 0.2), "equidistant takes 4"),
        ("fov", (0.9,), "the FOV model"),
        ("inverse_brown_conrady", 5 * (0.0,), "the inverse Brown-Conrady model"),
        ("wide", (), "model 'wide' is not known; write radtan"),
        ("radtan", (float("nan"), 0, 0, 0), "finite"),
    ],
)
def test_lens_models_that_are_refused(model, coefficients, words):
    with pytest.raises(InputError, match=words):
        lens_distortion(model, coefficients)


@pytest.mark.parametrize("distortion", ["none", "{model: none, coefficients: []}", "{model: none}", "[0, 0, 0, 0, 0]"])
def test_a_camera_file_may_say_in_many_ways_that_there_is_no_distortion(sequence, distortion):
    text = (sequence / "camera.yaml").read_text() + f"distortion: {distortion}\n"
    assert read_camera_file(write(sequence, text, "camera.yaml")).distortion is None


def test_a_camera_file_of_the_mosaics_size_is_told_which_size_to_write(sequence):
    text = (sequence / "camera.yaml").read_text().replace("width: 32", "width: 64").replace("height: 24", "height: 48")
    write(sequence, text, "camera.yaml")
    with pytest.raises(InputError, match=r"half the mosaic's; if this is a raw mosaic, write width: 32 and height: 24"):
        open_sequence(sequence)[0]
    write(sequence, text.replace("[90, 45, 135, 0]", "none").replace("64", "16").replace("48", "12"), "camera.yaml")
    for angle in (0, 45, 90, 135):
        write_image(sequence / "raw" / f"a_{angle}.png", np.full((24, 32), 90, np.uint8))
    (sequence / "raw" / "a.png").unlink()
    with pytest.raises(InputError, match="for a raw mosaic write its layout in place of mosaic: none"):
        open_sequence(sequence)[0]


def test_a_raw_buffer_of_the_wrong_size_is_told_the_same(sequence):
    text = (sequence / "camera.yaml").read_text().replace("width: 32", "width: 64").replace("height: 24", "height: 48")
    write(sequence, text, "camera.yaml")
    (sequence / "raw" / "a.png").unlink()
    (sequence / "raw" / "a.raw").write_bytes(bytes(64 * 48))
    with pytest.raises(InputError, match="write width: 32 and height: 24"):
        open_sequence(sequence)[0]


def test_a_big_tiff_is_named(sequence):
    (sequence / "raw" / "a.png").unlink()
    (sequence / "raw" / "a.tif").write_bytes(b"II+\0\x08\0\0\0" + bytes(100))
    with pytest.raises(InputError, match=r"a\.tif: a BigTIFF file, which is not read; write a classic TIFF"):
        open_sequence(sequence)[0]


def test_opencvs_own_files_are_read(tmp_path, sequence):
    for suffix in ("yml", "xml", "json"):
        path = tmp_path / f"calibration.{suffix}"
        storage = cv2.FileStorage(str(path), cv2.FILE_STORAGE_WRITE)
        storage.write("image_width", 32)
        storage.write("image_height", 24)
        storage.write("camera_matrix", CHANNEL.matrix)
        storage.write("distortion_coefficients", np.array([RADTAN_5.coefficients]))
        storage.release()
        camera_file = read_camera_file(path, sequence)
        assert numbers(camera_file.camera) == pytest.approx(numbers(CHANNEL))
        assert camera_file.distortion.coefficients == pytest.approx(RADTAN_5.coefficients)


def test_inspect_takes_a_calibration(polarmap, tmp_path, sequence):
    ended = polarmap("inspect", sequence, "--camera", write(tmp_path, KALIBR))
    assert ended.status == 0, ended.err
    assert "32x24, 8 bit" in ended.out


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(data=st.data())
def test_a_damaged_calibration_is_read_or_refused_in_one_line(tmp_path, sequence, data):
    text, _ = FILES[data.draw(st.sampled_from(sorted(FILES)))]
    start = data.draw(st.integers(0, len(text)))
    end = data.draw(st.integers(start, min(len(text), start + 20)))
    damaged = text[:start] + data.draw(st.text(max_size=6)) + text[end:]
    path = tmp_path / "damaged"
    path.write_bytes(damaged.encode("utf-8", "replace"))
    try:
        read_camera_file(path, sequence)
    except InputError as error:
        assert "\n" not in str(error)
