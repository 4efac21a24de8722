"""Sequences: every layout and bit depth gives the pixels that were written; what is wrong is named."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest

from polarmap.data.camera_file import CameraFile
from polarmap.data.pixel_format import PixelFormat
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.depth_png import write_depth_png
from polarmap.io.formats.images import write_image
from polarmap.io.formats.packed import pack
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import open_sequence
from polarmap.pipeline.mapper import Mapper
from polarmap.report.inspection import inspect_sequence

WIDTH, HEIGHT = 12, 8
ANGLES = (0, 45, 90, 135)


def camera_file(bit_depth: int = 8, layout=SensorLayout.SONY_POLARSENS, **options) -> CameraFile:
    camera = PinholeCamera(WIDTH, HEIGHT, 10.0, 10.0, 5.5, 3.5)
    return CameraFile(camera, layout, AngleDirection.CLOCKWISE, bit_depth, **options)


def pixels(number: int, bit_depth: int = 8, shape=(2 * HEIGHT, 2 * WIDTH)) -> np.ndarray:
    values = np.random.default_rng(number).integers(0, 1 << bit_depth, shape)
    return values.astype(np.uint8 if bit_depth == 8 else np.uint16)


@pytest.fixture
def folder(tmp_path):
    """Three frames of 8-bit mosaics in raw/, with times."""
    (tmp_path / "raw").mkdir()
    write_camera_file(tmp_path / "camera.yaml", camera_file(depth_scale=5000))
    for number in range(3):
        write_image(tmp_path / "raw" / f"{number:06d}.png", pixels(number))
    (tmp_path / "timestamps.txt").write_text("# seconds\n0.0\n0.5\n0.75\n")
    return tmp_path


def write_angles(folder, name_of, frames=2, bit_depth=8):
    for number in range(frames):
        for angle in ANGLES:
            path = folder / name_of(number, angle)
            path.parent.mkdir(exist_ok=True)
            write_image(path, pixels(1000 * number + angle, bit_depth, (HEIGHT, WIDTH)))


def test_mosaics_with_times(folder):
    sequence = open_sequence(folder)
    frames = list(sequence)
    assert len(sequence) == 3
    assert [(frame.index, frame.timestamp, frame.name) for frame in frames] == [
        (0, 0.0, "000000"),
        (1, 0.5, "000001"),
        (2, 0.75, "000002"),
    ]
    for frame in frames:
        np.testing.assert_array_equal(frame.mosaic, pixels(frame.index))
        assert frame.channels is None and frame.path.name == f"{frame.name}.png"


def test_positions_and_slices(folder):
    sequence = open_sequence(str(folder))
    assert sequence[-1].index == 2
    assert [frame.index for frame in sequence[::2]] == [0, 2]
    np.testing.assert_array_equal(sequence[1:].timestamps, [0.5, 0.75])
    with pytest.raises(IndexError):
        sequence[3]


def test_frames_are_read_when_asked_for(folder):
    sequence = open_sequence(folder)
    (folder / "raw" / "000001.png").write_bytes(b"")
    assert sequence[0].index == 0
    with pytest.raises(InputError, match=r"000001\.png: not a PNG"):
        sequence[1]


@pytest.mark.parametrize(
    "name_of",
    [
        lambda number, angle: f"{angle}/{number:04d}.png",
        lambda number, angle: f"I{angle}/{number:04d}.tif",
        lambda number, angle: f"pol{angle:03d}/frame_{number:04d}.png",
        lambda number, angle: f"{number:04d}_{angle}.png",
        lambda number, angle: f"frame-{number:04d}_I{angle}.png",
        lambda number, angle: f"frame_{number:04d}_pol_{angle:03d}.pgm",
    ],
    ids=["folders", "I folders", "pol folders", "suffixes", "I suffixes", "pol suffixes"],
)
@pytest.mark.parametrize("layout", [None, SensorLayout.SONY_POLARSENS], ids=["mosaic none", "mosaic given"])
def test_one_picture_per_angle(tmp_path, name_of, layout):
    write_camera_file(tmp_path / "camera.yaml", camera_file(layout=layout, frame_rate=4))
    write_angles(tmp_path, name_of)
    sequence = open_sequence(tmp_path)
    assert sequence.camera_file.layout is None
    assert [(frame.index, frame.timestamp) for frame in sequence] == [(0, 0.0), (1, 0.25)]
    for frame in sequence:
        assert frame.mosaic is None and frame.channels.shape == (4, HEIGHT, WIDTH)
        for channel, angle in zip(frame.channels, ANGLES, strict=True):
            np.testing.assert_array_equal(channel, pixels(1000 * frame.index + angle, 8, (HEIGHT, WIDTH)))


def test_mosaics_whose_numbers_look_like_angles_are_mosaics(tmp_path):
    for number in ANGLES:
        write_image(tmp_path / f"shot_{number}.png", pixels(number))
    sequence = open_sequence(tmp_path, camera_file())
    assert [frame.index for frame in sequence] == list(ANGLES)


@pytest.mark.parametrize("bit_depth", [8, 10, 12, 16])
def test_bit_depths_of_image_files(tmp_path, bit_depth):
    write_image(tmp_path / "a.png", pixels(0, bit_depth))
    frame = open_sequence(tmp_path, camera_file(bit_depth))[0]
    np.testing.assert_array_equal(frame.mosaic, pixels(0, bit_depth))


@pytest.mark.parametrize("bit_depth", [10, 12])
def test_bits_shifted_to_the_top(tmp_path, bit_depth):
    shifted = pixels(0, bit_depth) << 16 - bit_depth
    write_image(tmp_path / "a.png", shifted)
    (tmp_path / "b.raw").write_bytes(pack(shifted, PixelFormat.MONO16))
    sequence = open_sequence(tmp_path, camera_file(bit_depth, bit_alignment="msb"))
    for frame in sequence:
        np.testing.assert_array_equal(frame.mosaic, pixels(0, bit_depth))
    with pytest.raises(InputError, match="correct bit_depth in the camera file, or write bit_alignment: msb"):
        open_sequence(tmp_path, camera_file(bit_depth))[0]
    write_image(tmp_path / "a.png", shifted + 1)
    with pytest.raises(InputError, match=f"uses the low {16 - bit_depth} bits"):
        sequence[0]


@pytest.mark.parametrize("pixel_format", PixelFormat)
def test_raw_buffers(tmp_path, pixel_format):
    options = camera_file(pixel_format.bits, pixel_format=pixel_format)
    (tmp_path / "0001.raw").write_bytes(pack(pixels(1, pixel_format.bits), pixel_format))
    sequence = open_sequence(tmp_path, options)
    np.testing.assert_array_equal(sequence[0].mosaic, pixels(1, pixel_format.bits))
    (tmp_path / "0001.raw").write_bytes(bytes(100))
    with pytest.raises(InputError, match=rf"0001\.raw: 100 bytes, but 24x16 pixels of {pixel_format.label} take"):
        sequence[0]


def test_raw_buffers_of_one_angle(tmp_path):
    options = camera_file(12, None, pixel_format=PixelFormat.MONO12_PACKED)
    for angle in ANGLES:
        (tmp_path / f"a_{angle}.bin").write_bytes(pack(pixels(angle, 12, (HEIGHT, WIDTH)), PixelFormat.MONO12_PACKED))
    channels = open_sequence(tmp_path, options)[0].channels
    np.testing.assert_array_equal(channels[3], pixels(135, 12, (HEIGHT, WIDTH)))


@pytest.mark.parametrize(
    ("changes", "image", "message"),
    [
        ({}, pixels(0, 16), "16 bits per pixel, expected 8"),
        ({"bit_depth": 12}, pixels(0, 8), "8 bits per pixel, expected 16"),
        ({}, pixels(0, 8, (HEIGHT, WIDTH)), "12x8 pixels, expected 24x16"),
    ],
)
def test_pictures_other_than_the_camera_file_says(tmp_path, changes, image, message):
    write_image(tmp_path / "a.png", image)
    with pytest.raises(InputError, match=rf"a\.png: {message}"):
        open_sequence(tmp_path, camera_file(**changes))[0]


def test_a_missing_frame_is_named(folder):
    (folder / "raw" / "000001.png").unlink()
    write_image(folder / "raw" / "000003.png", pixels(3))
    (folder / "timestamps.txt").unlink()
    write_camera_file(folder / "camera.yaml", camera_file(frame_rate=30))
    with pytest.raises(InputError, match="frame 000001 is missing"):
        open_sequence(folder)


def test_a_missing_frame_is_named_where_the_times_reveal_it(folder):
    write_image(folder / "raw" / "000003.png", pixels(3))
    (folder / "timestamps.txt").write_text("0\n1\n2\n3\n")
    (folder / "raw" / "000001.png").unlink()
    assert [(frame.index, frame.timestamp) for frame in open_sequence(folder)] == [(0, 0.0), (2, 2.0), (3, 3.0)]
    (folder / "timestamps.txt").write_text("0\n1\n2\n3\n4\n5\n")
    (folder / "raw" / "000000.png").unlink()
    write_image(folder / "raw" / "000005.png", pixels(5))
    with pytest.raises(InputError, match=r"6 times for 3 frames \(frame 000004 is missing\)"):
        open_sequence(folder)
    (folder / "raw" / "000005.png").unlink()
    for number in (0, 1):
        write_image(folder / "raw" / f"{number:06d}.png", pixels(number))
    (folder / "timestamps.txt").write_text("0\n1\n2\n3\n")
    (folder / "raw" / "000003.png").unlink()
    with pytest.raises(InputError, match="4 times for 3 frames"):
        open_sequence(folder)


def test_every_other_frame_is_no_gap(folder):
    for number in (3, 4):
        write_image(folder / "raw" / f"{number:06d}.png", pixels(number))
    for number in (1, 3):
        (folder / "raw" / f"{number:06d}.png").unlink()
    assert [frame.index for frame in open_sequence(folder)] == [0, 2, 4]


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("0\n1\n", r"2 times for 3 frames"),
        ("0\n1\n2\n3\n", r"4 times for 3 frames"),
        ("", r"0 times for 3 frames"),
        ("0\n2\n1\n", r"line 3: 1\.0 s does not come after 2\.0 s"),
        ("0\n1\n1\n", r"line 3: 1\.0 s does not come after 1\.0 s"),
        ("0\nnan\n2\n", r"line 2: 'nan' is not one number"),
        ("0\nx\n2\n", r"line 2: 'x' is not one number"),
        ("0 000000.png\n", r"none of its 1 lines names the frame 000001"),
        ("x 7\ny 8\nz 9\n", r"line 1: no column names a frame, such as 000000"),
        ("0\n1e20\n2e20\n", r"is no time in seconds"),
    ],
)
def test_bad_times_are_named(folder, text, message):
    (folder / "timestamps.txt").write_text(text)
    with pytest.raises(InputError, match=rf"timestamps\.txt.*{message}"):
        open_sequence(folder)


def test_a_missing_angle_is_named(tmp_path):
    write_angles(tmp_path, lambda number, angle: f"{angle}/{number:04d}.png")
    (tmp_path / "90" / "0001.png").unlink()
    with pytest.raises(InputError, match="frame 0001 has no picture for 90 degrees"):
        open_sequence(tmp_path, camera_file(layout=None))
    (tmp_path / "90" / "0000.png").unlink()
    (tmp_path / "90").rmdir()
    with pytest.raises(InputError, match="no folder for 90 degrees beside 0"):
        open_sequence(tmp_path, camera_file(layout=None))


def test_a_missing_suffix_is_named(tmp_path):
    write_angles(tmp_path, lambda number, angle: f"a{number}_{angle}.png")
    (tmp_path / "a1_135.png").unlink()
    with pytest.raises(InputError, match="frame a1 has no picture for 135 degrees"):
        open_sequence(tmp_path, camera_file(layout=None))
    write_image(tmp_path / "b.png", pixels(0))
    with pytest.raises(InputError, match=r"b\.png: no angle in its name, such as b_45"):
        open_sequence(tmp_path, camera_file(layout=None))


def test_a_colour_sensors_pictures_of_one_angle_are_refused(tmp_path):
    write_angles(tmp_path, lambda number, angle: f"{angle}/{number:04d}.png")
    with pytest.raises(InputError, match="must be grey"):
        open_sequence(tmp_path, camera_file(colour="RGGB"))


def test_two_files_of_one_frame(folder):
    write_image(folder / "raw" / "000001.tif", pixels(1))
    with pytest.raises(InputError, match=r"000001\.tif: the same frame as 000001\.png"):
        open_sequence(folder)
    (folder / "raw" / "000001.tif").rename(folder / "raw" / "1.tif")
    with pytest.raises(InputError, match="two frames have the same number"):
        open_sequence(folder)


def test_folders_that_are_no_sequence(tmp_path, folder):
    with pytest.raises(InputError, match="no such file or folder"):
        open_sequence(tmp_path / "none")
    with pytest.raises(InputError, match="0: no pictures"):
        (tmp_path / "0").mkdir()
        open_sequence(tmp_path / "0", camera_file())
    (folder / "camera.yaml").unlink()
    with pytest.raises(InputError, match=r"no camera\.yaml; write one, for example {width: 1224, .*}") as error:
        open_sequence(folder)
    assert "\n" not in str(error.value)


def test_jpeg_is_refused_with_the_reason(tmp_path):
    (tmp_path / "a.jpg").write_bytes(b"")
    with pytest.raises(InputError, match="JPEG compression destroys polarization"):
        open_sequence(tmp_path, camera_file())


def test_names_without_numbers_and_clock_times_are_counted(tmp_path):
    for name in ("pears", "apples_IMX250MZR"):
        write_image(tmp_path / f"{name}.png", pixels(0))
    frames = list(open_sequence(tmp_path, camera_file()))
    assert [(frame.index, frame.name) for frame in frames] == [(0, "apples_IMX250MZR"), (1, "pears")]
    assert all(math.isnan(frame.timestamp) for frame in frames)
    (tmp_path / "clock").mkdir()
    for name in ("1403636579763555584", "1403636579813555456"):
        write_image(tmp_path / "clock" / f"{name}.png", pixels(0))
    assert [frame.index for frame in open_sequence(tmp_path / "clock", camera_file())] == [0, 1]


def test_numbers_sort_by_value(tmp_path):
    for number in (8, 9, 10, 11):
        write_image(tmp_path / f"frame{number}.png", pixels(number))
    sequence = open_sequence(tmp_path, camera_file(frame_rate=10))
    assert [(frame.index, frame.timestamp) for frame in sequence] == [(8, 0.8), (9, 0.9), (10, 1.0), (11, 1.1)]


def test_a_single_mosaic(folder):
    sequence = open_sequence(folder / "raw" / "000002.png")
    assert len(sequence) == 1 and math.isnan(sequence[0].timestamp)
    np.testing.assert_array_equal(sequence[0].mosaic, pixels(2))


def test_truth(folder):
    sequence = open_sequence(folder)
    assert sequence.truth_depth(1) is None and sequence.truth_trajectory() is None
    depth = np.full((HEIGHT, WIDTH), 2.0, np.float32)
    depth[0, 0] = np.nan
    (folder / "depth").mkdir()
    write_depth_png(folder / "depth" / "000001.png", depth, 5000)
    (folder / "groundtruth.txt").write_text("0 1 2 3 0 0 0 1\n")
    np.testing.assert_allclose(sequence.truth_depth(1), depth)
    assert sequence.truth_trajectory().poses[0, 0, 3] == 1.0
    with pytest.raises(InputError, match="no frame has the index 7"):
        sequence.truth_depth(7)
    with pytest.raises(InputError, match="needs depth_scale"):
        open_sequence(folder, camera_file()).truth_depth(1)


def test_the_truth_is_never_opened_for_reading_frames(folder):
    (folder / "depth").write_text("not a folder")
    (folder / "groundtruth.txt").write_text("nonsense")
    assert [frame.index for frame in open_sequence(folder)] == [0, 1, 2]


def test_the_recorded_sequence(shared_data):
    sequence = open_sequence(shared_data / "livingroom")
    assert len(sequence) == 48
    frame = sequence[10]
    assert (frame.index, frame.timestamp, frame.mosaic.shape) == (10, 0.333333, (960, 1280))
    depth = sequence.truth_depth(10)
    assert depth.shape == (480, 640) and 0.2 < np.nanmedian(depth) < 10
    assert sequence.truth_trajectory().at(frame.timestamp) is not None


def test_the_recorded_mosaics_without_a_camera_file(shared_data):
    folder = shared_data / "raw_imx250mzr"
    with pytest.raises(InputError, match=r"no camera\.yaml"):
        open_sequence(folder)
    camera = PinholeCamera(1224, 1024, 1900.0, 1900.0, 611.5, 511.5)
    options = CameraFile(camera, SensorLayout.SONY_POLARSENS, AngleDirection.COUNTERCLOCKWISE, 8)
    sequence = open_sequence(folder, options)
    assert [files.name for files in sequence.files] == ["carps_IMX250MZR", "fruits_IMX250MZR", "polarizer_IMX250MZR"]
    assert sequence[1].mosaic.shape == (2048, 2448)


def plain_camera(**options) -> CameraFile:
    return CameraFile(PinholeCamera(WIDTH, HEIGHT, 10.0, 10.0, 5.5, 3.5), None, None, 8, **options)


@pytest.fixture
def write_pictures(tmp_path):
    """Writes 8-bit grey pictures under these names and returns the sequence's folder."""

    def write(*names):
        for i, name in enumerate(names):
            path = tmp_path / name
            path.parent.mkdir(parents=True, exist_ok=True)
            write_image(path, pixels(i, 8, (HEIGHT, WIDTH)))
        return tmp_path

    return write


@pytest.mark.parametrize("place", ["images", "gray", "rgb", "cam0/data", "raw", "."])
def test_plain_pictures(write_pictures, place):
    folder = write_pictures(*(f"{place}/{number:04d}.png" for number in range(3)))
    sequence = open_sequence(folder, plain_camera(frame_rate=10))
    assert [(frame.index, frame.timestamp) for frame in sequence] == [(0, 0.0), (1, 0.1), (2, 0.2)]
    assert np.isnan(sequence.exposures).all()
    for frame in sequence:
        assert frame.mosaic is None and frame.channels is None
        np.testing.assert_array_equal(frame.grey, pixels(frame.index, 8, (HEIGHT, WIDTH)))


def test_plain_colour_pictures_are_read_as_luma(tmp_path):
    colour = np.full((HEIGHT, WIDTH, 3), (10, 100, 200), np.uint8)  # BGR
    write_image(tmp_path / "0.jpg", colour)
    write_image(tmp_path / "1.png", colour)
    for frame in open_sequence(tmp_path, plain_camera()):
        assert frame.grey.dtype == np.uint8 and frame.grey.shape == (HEIGHT, WIDTH)
        np.testing.assert_allclose(frame.grey.astype(float), 119.6, atol=2)


def test_plain_pictures_of_another_size_or_depth(write_pictures):
    folder = write_pictures("0.png")
    with pytest.raises(InputError, match=r"0\.png: 12x8 pixels, expected 8x12"):
        open_sequence(folder, replace(plain_camera(), camera=PinholeCamera(HEIGHT, WIDTH, 10.0, 10.0, 3.5, 5.5)))[0]
    with pytest.raises(InputError, match=r"0\.png: 8 bits per pixel, expected 16"):
        open_sequence(folder, replace(plain_camera(), bit_depth=12, pixel_format=None))[0]


def test_the_folder_of_plain_pictures_must_be_clear(write_pictures):
    folder = write_pictures("gray/0.png", "rgb/0.png", "left/7.png")
    with pytest.raises(InputError, match="pictures may be in gray or rgb; name one in the camera file, as images:"):
        open_sequence(folder, plain_camera())
    assert open_sequence(folder, plain_camera(images="left"))[0].index == 7
    with pytest.raises(InputError, match="no folder right, which the camera file names"):
        open_sequence(folder, plain_camera(images="right"))
    (folder / "empty").mkdir()
    with pytest.raises(InputError, match=r"empty: no pictures \(.png"):
        open_sequence(folder, plain_camera(images="empty"))


def test_a_folder_of_mosaics_can_be_named(folder):
    (folder / "raw").rename(folder / "left")
    np.testing.assert_array_equal(open_sequence(folder, camera_file(images="left"))[1].mosaic, pixels(1))


def test_a_single_plain_picture(write_pictures):
    sequence = open_sequence(write_pictures("a.png") / "a.png", plain_camera())
    assert len(sequence) == 1 and sequence[0].grey.shape == (HEIGHT, WIDTH)


def test_exposures(folder):
    (folder / "exposures.txt").write_text("# milliseconds\n10\n0\n2.5\n")
    sequence = open_sequence(folder)
    np.testing.assert_allclose(sequence.exposures, [0.01, np.nan, 0.0025])
    assert sequence[2].exposure == 0.0025 and sequence[2].timestamp == 0.75
    np.testing.assert_allclose(sequence[1:].exposures, [np.nan, 0.0025])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("1\n1\n", "2 exposures for 3 frames"),
        ("1\n-1\n1\n", r"line 2: -1\.0 is not an exposure in milliseconds"),
        ("1\n1\ninf\n", r"line 3: inf is not an exposure"),
        ("1 2\n1\n1\n", r"line 1: '1 2' is not one number"),
    ],
)
def test_bad_exposures_are_named(folder, text, message):
    (folder / "exposures.txt").write_text(text)
    with pytest.raises(InputError, match=rf"exposures\.txt.*{message}"):
        open_sequence(folder)


def test_times_and_exposures_of_tum_mono(write_pictures):
    folder = write_pictures("images/00000.png", "images/00001.png")
    (folder / "times.txt").write_text("00000 1464001234.5 8.2\n00001 1464001234.55 0\n00002 1464001234.6 8\n")
    sequence = open_sequence(folder, plain_camera(frame_rate=10))
    np.testing.assert_array_equal(sequence.timestamps, [1464001234.5, 1464001234.55])
    np.testing.assert_allclose(sequence.exposures, [0.0082, np.nan])


def test_times_of_tum_rgbd(write_pictures):
    folder = write_pictures("rgb/1305031102.911185.png", "rgb/1305031102.943233.png")
    (folder / "rgb.txt").write_text(
        "# timestamp filename\n"
        "1305031102.911185 rgb/1305031102.911185.png\n1305031102.943233 rgb/1305031102.943233.png\n"
    )
    frames = list(open_sequence(folder, plain_camera()))
    assert [(frame.index, frame.timestamp) for frame in frames] == [(0, 1305031102.911185), (1, 1305031102.943233)]


def test_times_of_euroc(write_pictures):
    folder = write_pictures("mav0/cam0/data/1403636579763555584.png", "mav0/cam0/data/1403636579813555456.png")
    (folder / "mav0" / "cam0" / "data.csv").write_text(
        "#timestamp [ns],filename\r\n1403636579763555584,1403636579763555584.png\r\n"
        "1403636579813555456,1403636579813555456.png\r\n"
    )
    for path in (folder, folder / "mav0"):
        sequence = open_sequence(path, plain_camera())
        np.testing.assert_allclose(sequence.timestamps, [1403636579.763555584, 1403636579.813555456], rtol=1e-15)


def test_times_of_kitti(write_pictures):
    folder = write_pictures("image_0/000000.png", "image_0/000001.png")
    (folder / "times.txt").write_text("0.000000e+00\n1.038734e-01\n")
    sequence = open_sequence(folder, plain_camera(images="image_0"))
    np.testing.assert_array_equal(sequence.timestamps, [0.0, 0.1038734])


@pytest.mark.parametrize(
    ("name", "text", "message"),
    [
        ("times.txt", "0 1.0 5\n", r"none of its 1 lines names the frame 1 \(the first names '0'\)"),
        ("times.txt", "0 1.0 5\n1 1.0 5\n", "frame 1 does not come after 0"),
        ("times.txt", "0 1.0 5\n0 2.0 5\n", "line 2: the frame 0 a second time"),
        ("times.txt", "0 1.0 5\n1 2.0 5 6\n", "line 2: 4 columns"),
        ("times.txt", "0 1.0 5\n1 now 5\n", "line 2: 'now' is not one number"),
        ("times.txt", "0\n", "1 times for 2 frames"),
        ("rgb.txt", "1.0 rgb/0.png\n", "none of its 1 lines names the frame 1"),
        ("rgb.txt", "1.0\n", "1 times for 2 frames"),
    ],
)
def test_bad_listings_are_named(write_pictures, name, text, message):
    folder = write_pictures("rgb/0.png", "rgb/1.png")
    (folder / name).write_text(text)
    with pytest.raises(InputError, match=rf"{name}.*{message}") as error:
        open_sequence(folder, plain_camera())
    assert "\n" not in str(error.value)


def test_a_bad_line_of_euroc_is_named(write_pictures):
    folder = write_pictures("cam0/data/1403636579763555584.png")
    (folder / "cam0" / "data.csv").write_text("1403636579x,1403636579763555584.png\n")
    with pytest.raises(InputError, match=r"data\.csv, line 1: '1403636579x' is not one number"):
        open_sequence(folder, plain_camera())


def test_what_needs_polarization_says_that_there_is_none(write_pictures):
    sequence = open_sequence(write_pictures("0.png"), plain_camera())
    with pytest.raises(InputError, match="no polarization channels") as error:
        inspect_sequence(sequence)
    assert "\n" not in str(error.value)
    with pytest.raises(InputError, match="no polarization channels"):
        Mapper(sequence.camera_file, lambda time: None)


def test_the_recorded_plain_sequences(shared_data):
    camera = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)
    icl = open_sequence(shared_data / "icl_office_kt0", CameraFile(camera, None, None, 8, frame_rate=30.0))
    assert len(icl) == 450 and icl[0].index == 1 and icl[0].timestamp == pytest.approx(1 / 30)
    assert icl[100].grey.shape == (480, 640) and icl[100].grey.std() > 5
    options = CameraFile(camera, None, None, 8, frame_rate=30.0, depth_scale=1000.0)
    redwood = open_sequence(shared_data / "redwood_livingroom1", options)
    assert len(redwood) == 211 and redwood[0].path.suffix == ".jpg"
    assert redwood[210].grey.dtype == np.uint8 and redwood.truth_depth(210).shape == (480, 640)
