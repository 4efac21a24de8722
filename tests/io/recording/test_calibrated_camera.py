"""Camera files made of a calibration by another program and the name of a sensor."""

from __future__ import annotations

import numpy as np
import pytest
from calibration_texts import FILES
from command_line import refused

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor import SensorLayout
from polarmap.data.sensor_presets import SENSOR_PRESETS, find_preset, region_of
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.images import write_image
from polarmap.io.recording.calibrated_camera import SensorChoice, calibrated_camera
from polarmap.io.recording.camera_file import read_camera_file

SENSOR = find_preset("imx250mzr")
COLOUR = find_preset("IMX250MYR")


def write(folder, text, name="calibration"):
    path = folder / name
    path.write_text(text, encoding="utf-8")
    return path


def picture(folder, width, height, dtype=np.uint8):
    path = folder / "picture.png"
    write_image(path, np.full((height, width), 90, dtype))
    return path


def ros(width, height, fx=1900.0, model="plumb_bob", d="[-0.08, 0.11, 0.0004, -0.0002, 0.0]", cx=None, cy=None):
    cx, cy = (width - 1) / 2 if cx is None else cx, (height - 1) / 2 if cy is None else cy
    return (
        f"image_width: {width}\nimage_height: {height}\ndistortion_model: {model}\n"
        f"camera_matrix: {{rows: 3, cols: 3, data: [{fx}, 0.0, {cx}, 0.0, {fx}, {cy}, 0.0, 0.0, 1.0]}}\n"
        f"distortion_coefficients: {{rows: 1, cols: {len(d.split(','))}, data: {d}}}\n"
    )


@pytest.mark.parametrize(("text", "distortion"), FILES.values(), ids=FILES)
def test_every_programs_file_on_a_region_of_a_sensor(tmp_path, text, distortion):
    made = calibrated_camera(write(tmp_path, text), SensorChoice(SENSOR, picture(tmp_path, 64, 48)))
    assert made.camera_file.camera == PinholeCamera(32, 24, 24.0, made.camera_file.camera.fy, 15.25, 11.75)
    assert made.camera_file.distortion == distortion
    assert any("32x24 is the size of a channel" in fact for fact in made.facts)


@pytest.mark.parametrize("size", [(2448, 2048), (2464, 2056)])
def test_a_calibration_of_the_whole_mosaic_is_halved(tmp_path, size):
    made = calibrated_camera(write(tmp_path, ros(*size, fx=3800.0)), SensorChoice(SENSOR))
    camera = made.camera_file.camera
    assert (camera.width, camera.height, camera.fx) == (size[0] // 2, size[1] // 2, 1900.0)
    assert camera.cx == pytest.approx((camera.width - 1) / 2)
    assert made.camera_file.distortion.coefficients == (-0.08, 0.11, 0.0004, -0.0002, 0.0)
    assert any("the size of the mosaic, so that all is halved" in fact for fact in made.facts)


def test_a_calibration_of_a_channel_is_kept_and_the_sensor_comes_from_the_preset(tmp_path):
    made = calibrated_camera(write(tmp_path, ros(1224, 1024)), SensorChoice(SENSOR, bit_depth=12))
    file = made.camera_file
    assert (file.camera.fx, file.camera.cx) == (1900.0, 611.5)
    assert (file.layout, file.angle_direction.value, file.bit_depth) == (
        SensorLayout.SONY_POLARSENS,
        "counterclockwise",
        12,
    )
    assert (file.noise, file.colour, file.demosaic) == (SENSOR.noise, None, "edge-aware")


@pytest.mark.parametrize(
    ("model", "d", "expected"),
    [
        ("plumb_bob", "[-0.1, 0.02, 0.0, 0.0, 0.0]", "radtan"),
        ("radial-tangential", "[-0.1, 0.02, 0.0, 0.0]", "radtan"),
        ("rational_polynomial", "[-0.1, 0.02, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0]", "radtan"),
        ("equidistant", "[-0.1, 0.02, 0.0, 0.0]", "equidistant"),
        ("fisheye", "[-0.1, 0.02, 0.0, 0.0]", "equidistant"),
    ],
)
def test_models_are_known_by_their_names(tmp_path, model, d, expected):
    made = calibrated_camera(write(tmp_path, ros(1224, 1024, model=model, d=d)), SensorChoice(SENSOR))
    assert made.camera_file.distortion.model == expected


@pytest.mark.parametrize("of", [(2448, 2048), (1224, 1024)])
def test_a_calibration_of_the_whole_sensor_is_moved_to_a_region_of_it(tmp_path, of):
    """A point that the whole picture has at u lies at u - offset in the region."""
    scale = of[0] / 2448
    text = ros(*of, fx=3800.0 * scale, cx=1240.0 * scale, cy=1000.0 * scale)
    sensor = SensorChoice(SENSOR, picture(tmp_path, 640, 480), (1001, 800))
    file = calibrated_camera(write(tmp_path, text), sensor).camera_file
    in_whole = (1240.0 * scale + 0.5) / (2 * scale) - 0.5  # in a channel of the whole
    assert file.camera.fx == 1900.0
    assert file.camera.cx == pytest.approx(in_whole - 1001 / 2)
    assert (file.camera.width, file.camera.height) == (320, 240)
    assert file.layout.value == (45, 90, 0, 135)


@pytest.mark.parametrize("offset", [(x, y) for x in range(4) for y in range(4)])
def test_the_block_of_a_region_is_that_of_the_pixels_it_begins_with(offset):
    whole = np.tile(np.reshape(SENSOR.layout.value, (2, 2)), (4, 4))
    layout, _ = region_of(SENSOR, offset)
    x, y = offset
    assert np.array_equal(whole[y : y + 2, x : x + 2].ravel(), layout.value)


@pytest.mark.parametrize("offset", [(0, 0), (2, 0), (0, 2), (6, 2), (4, 8)])
def test_the_colours_of_a_region_are_those_of_the_pixels_it_begins_with(offset):
    whole = np.kron(
        np.tile(np.reshape(list(COLOUR.colour), (2, 2)), (4, 4)).view(np.uint32), np.ones((2, 2), np.uint32)
    )
    layout, colour = region_of(COLOUR, offset)
    x, y = offset
    seen = whole[y : y + 4 : 2, x : x + 4 : 2].ravel()
    assert [chr(code) for code in seen] == list(colour)
    assert layout is COLOUR.layout


def test_an_odd_offset_on_a_colour_sensor_is_refused():
    with pytest.raises(InputError, match="cuts the 2x2 polarizer blocks of the colour sensor IMX250MYR"):
        region_of(COLOUR, (1, 0))


def test_a_region_whose_begin_is_not_told_is_said_to_be_taken_for_even(tmp_path):
    made = calibrated_camera(write(tmp_path, ros(320, 240)), SensorChoice(SENSOR, picture(tmp_path, 640, 480)))
    assert any("taken to begin at even numbers of columns and rows" in fact for fact in made.facts)


REFUSED = {
    "another size": (ros(1000, 800), {}, "calibrated with pictures of 1000x800, but an IMX250MZR has 2448x2048"),
    "offset without picture": (ros(1224, 1024), {"offset": (8, 8)}, "with --picture"),
    "region of the whole": (ros(1224, 1024), {"size": (640, 480)}, "say where that region begins, with --offset"),
    "half of it": (ros(612, 512), {"size": (1224, 1024)}, "a picture of one channel, or binned"),
    "odd": (ros(320, 240), {"size": (641, 480)}, "both sides must be even"),
    "too large": (ros(1300, 1024), {"size": (2600, 2048)}, "is more than an IMX250MZR has"),
    "beyond the end": (ros(1224, 1024), {"size": (640, 480), "offset": (2000, 0)}, "beyond the 2464x2056"),
    "16 bits": (ros(320, 240), {"size": (640, 480), "dtype": np.uint16}, "say how many count, with --bit-depth"),
    "no calibration": ("width: 3\n", {}, "no calibration of OpenCV, ROS"),
    "lens model": (ros(1224, 1024, model="omni"), {}, "omnidirectional"),
    "two cameras": (FILES["kalibr"][0] + FILES["kalibr"][0].replace("cam0", "cam1"), {}, "choose one"),
}


@pytest.mark.parametrize(("text", "given", "words"), REFUSED.values(), ids=REFUSED)
def test_what_does_not_fit_is_refused_in_one_line(tmp_path, text, given, words):
    shot = picture(tmp_path, *given["size"], given.get("dtype", np.uint8)) if "size" in given else None
    with pytest.raises(InputError) as error:
        calibrated_camera(write(tmp_path, text), SensorChoice(SENSOR, shot, given.get("offset")))
    assert words in str(error.value)


def test_lines_of_the_sensor_in_the_calibration_come_first(tmp_path):
    text = ros(1224, 1024) + "bit_depth: 12\nblack_level: 64\ndemosaic: bilinear\n"
    file = calibrated_camera(write(tmp_path, text), SensorChoice(SENSOR)).camera_file
    assert (file.bit_depth, file.black_level, file.demosaic) == (12, 64.0, "bilinear")


def test_one_of_several_cameras_is_named(tmp_path):
    text = FILES["kalibr"][0] + FILES["kalibr"][0].replace("cam0", "cam1").replace("24.0, 24.5", "25.0, 25.5")
    sensor = SensorChoice(SENSOR, picture(tmp_path, 64, 48))
    assert calibrated_camera(write(tmp_path, text), sensor, "cam1").camera_file.camera.fx == 25.0


@pytest.mark.parametrize("preset", SENSOR_PRESETS, ids=lambda preset: preset.name)
def test_every_preset_is_found_by_its_names_and_makes_a_camera_file(tmp_path, preset):
    for name in (preset.name.lower(), *preset.cameras, *(camera.split()[-1] for camera in preset.cameras)):
        if name not in ("Pol", "M2450-Polarized"):
            assert find_preset(name) is preset
    width, height = preset.sizes[0]
    made = calibrated_camera(write(tmp_path, ros(width // 2, height // 2)), SensorChoice(preset))
    assert isinstance(made.camera_file, CameraFile)
    assert made.camera_file.colour == preset.colour
    assert made.camera_file.mosaic_size == (width, height)


def test_an_unknown_sensor_is_answered_with_near_names():
    with pytest.raises(InputError, match="did you mean IMX250MZR"):
        find_preset("imx250mz")
    with pytest.raises(InputError, match="known are IMX250MZR"):
        find_preset("eyeball")


def test_the_command_writes_a_camera_file_and_says_what_it_found(polarmap, tmp_path):
    source, out = write(tmp_path, ros(2448, 2048, fx=3800.0), "camera_info.yaml"), tmp_path / "camera.yaml"
    ended = polarmap("camera", source, "--layout", "imx250mzr", "-o", out)
    assert ended.status == 0
    assert "all is halved for a channel" in ended.out and "block 90 45 135 0" in ended.out
    read = read_camera_file(out)
    assert (read.camera.width, read.camera.fx, read.layout) == (1224, 1900.0, SensorLayout.SONY_POLARSENS)
    refused(polarmap("camera", source, "--layout", "imx250mzr", "-o", out), out, "--force")


def test_the_command_lists_what_it_knows(polarmap):
    ended = polarmap("camera", "--list")
    assert ended.status == 0
    for preset in SENSOR_PRESETS:
        assert preset.name in ended.out and all(camera in ended.out for camera in preset.cameras)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["--layout", "imx250mzr"], "FROM is missing"),
        (["x.yaml"], "--layout is missing"),
        (["x.yaml", "--layout", "imx250mzr"], "x.yaml"),
        (["x.yaml", "--layout", "imx250mzr", "--offset", "3"], "is not X,Y"),
        (["x.yaml", "--layout", "imx250mzr", "--angle-direction", "left"], "is not clockwise or counterclockwise"),
    ],
)
def test_the_command_says_what_is_missing(polarmap, tmp_path, monkeypatch, arguments, words):
    monkeypatch.chdir(tmp_path)
    refused(polarmap("camera", *arguments), words)
