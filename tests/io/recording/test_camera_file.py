"""The camera file: round trips, the recorded one, and one clear line for each mistake."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest
import yaml
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from polarmap.data.camera_file import CameraFile, PhotometricFiles
from polarmap.data.pixel_format import PixelFormat
from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Distortion
from polarmap.io.recording.camera_file import MINIMAL_CAMERA_FILE, read_camera_file, write_camera_file
from polarmap.sensing import mosaic

MINIMAL = yaml.safe_load(MINIMAL_CAMERA_FILE)


@pytest.fixture
def read(tmp_path):
    """Reads the minimal camera file with some keys changed; None leaves a key out."""

    def read(**changes):
        values = {key: value for key, value in (MINIMAL | changes).items() if value is not None}
        (tmp_path / "camera.yaml").write_text(yaml.safe_dump(values))
        return read_camera_file(tmp_path / "camera.yaml")

    return read


def message_of(error) -> str:
    message = str(error.value)
    assert "\n" not in message
    assert "camera.yaml: " in message
    return message.split("camera.yaml: ", 1)[1]


def test_the_example_in_messages_can_be_read(tmp_path):
    (tmp_path / "camera.yaml").write_text(MINIMAL_CAMERA_FILE)
    camera_file = read_camera_file(tmp_path / "camera.yaml")
    assert camera_file.camera == PinholeCamera(1224, 1024, 1900.0, 1900.0, 611.5, 511.5)
    assert camera_file.layout is SensorLayout.SONY_POLARSENS
    assert camera_file.angle_direction is AngleDirection.COUNTERCLOCKWISE
    assert (camera_file.bit_depth, camera_file.white_level, camera_file.pixel_format) == (8, 255, PixelFormat.MONO8)
    assert camera_file.mosaic_size == (2448, 2048)
    assert (camera_file.distortion, camera_file.colour, camera_file.frame_rate) == (None, None, None)


def test_the_recorded_camera_file(shared_data):
    camera_file = read_camera_file(shared_data / "livingroom" / "camera.yaml")
    assert camera_file.camera == PinholeCamera(640, 480, 480.0, 480.0, 319.5, 239.5)
    assert camera_file.angle_direction is AngleDirection.CLOCKWISE
    assert (camera_file.frame_rate, camera_file.depth_scale, camera_file.demosaic) == (30.0, 5000.0, "split")


coefficient = st.floats(-0.5, 0.5)
camera_files = st.builds(
    CameraFile,
    camera=st.builds(
        PinholeCamera,
        st.integers(1, 500).map(lambda n: 2 * n),
        st.integers(1, 500).map(lambda n: 2 * n),
        *[st.floats(1e-3, 1e6)] * 2,
        *[st.floats(-1e6, 1e6)] * 2,
    ),
    layout=st.sampled_from(SensorLayout),
    angle_direction=st.sampled_from(AngleDirection),
    bit_depth=st.just(12),
    pixel_format=st.sampled_from([PixelFormat.MONO16, PixelFormat.MONO12P, PixelFormat.MONO12_PACKED]),
    black_level=st.floats(0, 4000),
    colour=st.sampled_from([None, "RGGB", "GBRG"]),
    demosaic=st.sampled_from(["split", "bilinear", "edge-aware"]),
    distortion=st.none()
    | st.builds(Distortion, st.just("equidistant"), st.tuples(*[coefficient] * 4))
    | st.builds(Distortion, st.just("radtan"), st.tuples(*[coefficient] * 5)),
    noise=st.builds(SensorNoise, st.floats(1, 1e6), st.floats(0, 100)),
    frame_rate=st.none() | st.floats(1e-3, 1e4),
    depth_scale=st.none() | st.floats(1e-3, 1e6),
    images=st.none() | st.sampled_from(["gray", "cam0/data"]),
    photometric=st.none()
    | st.builds(PhotometricFiles, *[st.none() | st.sampled_from([Path("here.txt"), Path("/there/b c.png")])] * 2),
)


@settings(max_examples=60, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(camera_files)
def test_round_trip(tmp_path, camera_file):
    write_camera_file(tmp_path / "camera.yaml", camera_file)
    assert read_camera_file(tmp_path / "camera.yaml") == camera_file


def test_round_trip_of_one_picture_per_angle_and_of_shifted_bits(tmp_path, read):
    for camera_file in (read(mosaic="none"), read(bit_depth=10, bit_alignment="msb")):
        write_camera_file(tmp_path / "camera.yaml", camera_file)
        assert read_camera_file(tmp_path / "camera.yaml") == camera_file


@pytest.mark.parametrize("mosaic", [None, "none"])
def test_a_plain_camera_needs_no_angles(tmp_path, read, mosaic):
    camera_file = read(polarization="none", mosaic=mosaic, angle_direction=None, images="gray")
    assert not camera_file.polarized and camera_file.layout is None
    assert camera_file.images == "gray"
    write_camera_file(tmp_path / "again.yaml", camera_file)
    assert read_camera_file(tmp_path / "again.yaml") == camera_file


def test_photometric_files_are_looked_for_beside_the_camera_file(tmp_path, read):
    camera_file = read(photometric={"response": "pcalib.txt", "vignette": "../lens/vignette.png"})
    assert camera_file.photometric.response == tmp_path / "pcalib.txt"
    assert camera_file.photometric.vignette == tmp_path.parent / "lens" / "vignette.png"
    (tmp_path / "elsewhere").mkdir()
    write_camera_file(tmp_path / "elsewhere" / "camera.yaml", camera_file)
    assert "../pcalib.txt" in (tmp_path / "elsewhere" / "camera.yaml").read_text()
    assert read_camera_file(tmp_path / "elsewhere" / "camera.yaml") == camera_file


def test_numbers_without_a_dot_that_yaml_takes_for_text(tmp_path):
    text = MINIMAL_CAMERA_FILE.replace("fx: 1900", "fx: 1.9e3").rstrip("}")
    (tmp_path / "camera.yaml").write_text(text + ", distortion: {model: radtan, coefficients: [1e-1, 2e-5, 0, 0]}}")
    camera_file = read_camera_file(tmp_path / "camera.yaml")
    assert camera_file.camera.fx == 1900.0
    assert camera_file.distortion == Distortion("radtan", (0.1, 2e-5, 0.0, 0.0))


def test_mosaic_row_by_row_in_two_lists(read):
    assert read(mosaic=[[90, 45], [135, 0]]).layout is SensorLayout.SONY_POLARSENS


def test_the_pixel_format_implies_the_bit_depth(read):
    assert read(bit_depth=None, pixel_format="Mono12Packed").bit_depth == 12
    assert read(bit_depth=12).pixel_format is PixelFormat.MONO12
    assert read(bit_depth=12, bit_alignment="msb").pixel_format is PixelFormat.MONO16


@pytest.mark.parametrize("key", ["width", "height", "fx", "fy", "cx", "cy", "mosaic", "angle_direction", "bit_depth"])
def test_a_missing_key_is_named_with_what_to_write(read, key):
    with pytest.raises(InputError) as error:
        read(**{key: None})
    assert message_of(error).startswith(f"{key} is missing; write ")


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"fx": "wide"}, "fx: 'wide' cannot be used; write a finite number"),
        ({"fx": True}, "fx: True cannot be used"),
        ({"cx": float("nan")}, "cx: nan cannot be used"),
        ({"fx": 10**400}, "a number of 401 characters"),
        ({"fy": -480.0}, "focal lengths must be positive"),
        ({"width": 0}, "image size 0x1024 is not positive"),
        ({"width": 640.5}, "width: 640.5 cannot be used; write a whole number"),
        ({"height": 10**8}, "1224x100000000 is more than"),
        ({"focal": 3}, "unknown key focal; known are model, width"),
        ({"angle_direction": None, "angle_directoin": "clockwise"}, "angle_directoin; did you mean angle_direction?"),
        ({"angle_direction": "left"}, "'left' cannot be used; write clockwise or counterclockwise"),
        ({"mosaic": [90, 45, 135]}, "mosaic: this value cannot be used; write the angles 0, 45, 90 and 135"),
        ({"mosaic": [90, 45, 135, 0.5]}, "mosaic: this value cannot be used"),
        ({"mosaic": [90, 90, 0, 0]}, "not a polarizer layout"),
        ({"bit_depth": 9}, "bit_depth: 9 is not one of 8, 10, 12 and 16"),
        ({"bit_depth": 12, "pixel_format": "Mono10p"}, "Mono10p is not for 12 bits"),
        ({"pixel_format": "Mono16"}, "Mono16 is not for 8 bits"),
        ({"pixel_format": "YUV"}, "pixel_format: 'YUV' is not known"),
        ({"bit_depth": 16, "bit_alignment": "msb"}, "msb is for a bit_depth of 10 or 12"),
        ({"bit_alignment": "left"}, "bit_alignment: 'left' is not lsb or msb"),
        ({"black_level": 255}, r"black_level: 255.0 is not in \[0, 255\)"),
        ({"colour": "RGB"}, "colour: 'RGB' is not one of RGGB"),
        ({"colour": "RGGB", "mosaic": "none"}, "only a mosaic sensor"),
        ({"colour": "RGGB", "width": 1223}, "must be even"),
        ({"demosaic": "best"}, "demosaic: 'best' is not one of split, bilinear, edge-aware"),
        ({"distortion": [0.1, 0.2]}, "radtan takes 4, 5 or 8 coefficients"),
        ({"distortion": 3}, "distortion: 3 cannot be used; write none, {model: radtan"),
        ({"distortion": {"model": "fov", "coefficients": [1.0]}}, r"the FOV model \(fov\) is not known here"),
        ({"distortion": {"model": "lens"}}, "model 'lens' is not known; write radtan"),
        ({"distortion": {"model": "radtan", "coeffs": [1.0]}}, "distortion.coeffs; did you mean coefficients?"),
        (
            {"distortion": {"model": "radtan", "coefficients": [1, 2, 3]}},
            r"takes 4, 5 or 8 coefficients \(k1 k2 p1 p2 .*, not 3",
        ),
        ({"noise": {"full_well": 0}}, "full_well is not positive"),
        ({"frame_rate": 0}, "frame_rate: 0.0 is not positive"),
        ({"depth_scale": -1}, "depth_scale: -1.0 is not positive"),
        ({"polarization": "some"}, "polarization: 'some' cannot be used; write none"),
        ({"polarization": "none"}, "angle_direction: leave it out, as polarization is none"),
        ({"polarization": "none", "angle_direction": None}, "mosaic: a camera without polarization has none"),
        ({"images": "../other"}, "images: '../other' is not the name of a folder inside"),
        ({"images": "/etc"}, "images: '/etc' is not the name"),
        ({"images": 3}, "images: 3 cannot be used; write the name"),
        ({"photometric": "pcalib.txt"}, "photometric: 'pcalib.txt' cannot be used; write {response: pcalib.txt"),
        ({"photometric": {"vignet": "v.png"}}, "photometric.vignet; did you mean vignette?"),
        ({"model": "fisheye"}, "model: 'fisheye' cannot be used; write pinhole"),
    ],
)
def test_a_bad_value_is_named(read, changes, message):
    with pytest.raises(InputError, match=message) as error:
        read(**changes)
    message_of(error)


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"fx: [", "not valid YAML at line 1"),
        (b"", "not a list of `key: value` lines"),
        (b"- 1", "not a list of `key: value` lines"),
        (b"\xff\xfe\x00\xd8", "not valid YAML"),
        (b"[" * 5000, "not valid YAML"),
        (b'{"a\\nb": 1}', r"unknown key 'a\\nb'; known are model"),
        (b"fx: " + b"9" * 5000, "not valid YAML"),
        (b"date: 2020-99-99", "unknown key date"),
        (b"!!python/object/apply:os.system [echo]", "not valid YAML"),
        (b"a" * 1_100_000, "more than the 1048576"),
    ],
)
def test_what_is_no_camera_file(tmp_path, data, message):
    (tmp_path / "camera.yaml").write_bytes(data)
    with pytest.raises(InputError, match=message) as error:
        read_camera_file(tmp_path / "camera.yaml")
    message_of(error)


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.binary(max_size=200) | st.text(max_size=200).map(str.encode))
def test_any_bytes_are_refused_in_one_line(tmp_path, data):
    (tmp_path / "camera.yaml").write_bytes(data)
    with pytest.raises(InputError) as error:
        read_camera_file(tmp_path / "camera.yaml")
    message_of(error)


def test_nested_aliases_do_not_expand(tmp_path):
    levels = "\n".join(f"x{i}: &x{i} [{', '.join([f'*x{i - 1}'] * 9)}]" for i in range(1, 12))
    (tmp_path / "camera.yaml").write_text(f"x0: &x0 [0]\n{levels}\nmosaic: *x11\n")
    with pytest.raises(InputError, match="more than 20000 values, aliases written out"):
        read_camera_file(tmp_path / "camera.yaml")


def test_a_missing_file_and_a_folder(tmp_path):
    with pytest.raises(InputError, match=r"camera\.yaml: no such file"):
        read_camera_file(tmp_path / "camera.yaml")
    with pytest.raises(InputError, match="a folder, where a file is expected"):
        read_camera_file(tmp_path)


def test_an_unwritable_place_is_named(tmp_path, read):
    camera_file = read()
    with pytest.raises(PolarmapError, match=r"none.camera\.yaml: cannot be written \(No such file"):
        write_camera_file(tmp_path / "none" / "camera.yaml", camera_file)


def test_values_are_checked_in_python_too(read):
    with pytest.raises(InputError, match="black_level"):
        replace(read(), black_level=-1.0)


def test_the_methods_are_those_of_the_front_end(read):
    for method in mosaic.METHODS:
        assert read(demosaic=method).demosaic == method
