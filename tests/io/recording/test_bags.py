"""Images and cameras in ROS bags."""

from __future__ import annotations

import builtins
import logging
import os
import re
import sys

import cv2
import numpy as np
import pytest
import yaml
from bag_files import FRAME, IMAGES, KINDS, Sent, header, image, write_bag

from polarmap.errors import InputError
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.ros.camera import CameraSource
from polarmap.io.recording.ros.opening import open_bag
from polarmap.io.recording.ros.recognize import is_bag
from polarmap.io.recording.sequence import open_sequence

WIDTH, HEIGHT = 32, 24  # of a channel
START = 1_700_000_000_123_456_789
STEP = 33_333_333
KEYS = {
    "width": WIDTH, "height": HEIGHT, "fx": 30.0, "fy": 30.0, "cx": 15.5, "cy": 11.5, "mosaic": [90, 45, 135, 0],
    "angle_direction": "counterclockwise", "bit_depth": 8,
}  # fmt: skip


def mosaics(count: int = 5, bits: int = 8) -> list[np.ndarray]:
    rng = np.random.default_rng(0)
    kind = np.uint8 if bits == 8 else np.uint16
    return [rng.integers(0, 1 << bits, (2 * HEIGHT, 2 * WIDTH)).astype(kind) for _ in range(count)]


def camera(folder, **changes):
    path = folder / "camera.yaml"
    path.write_text(yaml.safe_dump({key: value for key, value in (KEYS | changes).items() if value is not None}))
    return path


def images(pictures, encoding="mono8", **changes):
    return [image(picture, START + i * STEP, encoding, **changes) for i, picture in enumerate(pictures)]


def refused(*words):
    return pytest.raises(InputError, match="".join(f"(?=.*{word})" for word in words))


@pytest.mark.parametrize("kind", KINDS)
def test_frames_are_those_that_were_recorded(tmp_path, kind):
    pictures = mosaics()
    path = write_bag(tmp_path / "bag", kind, images(pictures))
    camera(tmp_path)
    recording = open_bag(path)
    assert is_bag(path) and len(recording) == 5 and recording.frame_id == FRAME and recording.topic == IMAGES
    for i, frame in enumerate(recording):
        assert (frame.index, frame.name) == (i, f"{i:06d}") and np.array_equal(frame.mosaic, pictures[i])
        assert frame.timestamp.nanoseconds == START + i * STEP
    for i in (3, 0, 4, 1):  # in any order
        assert np.array_equal(recording[i].mosaic, pictures[i])
    assert [frame.index for frame in recording[1::2]] == [1, 3]
    one, other = iter(recording), iter(recording)
    for i in range(3):  # side by side
        assert np.array_equal(next(one).mosaic, pictures[i]) and np.array_equal(next(other).mosaic, pictures[i])


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap"])
def test_images_recorded_at_one_time_are_told_apart(tmp_path, kind):
    pictures = mosaics()
    sent = [each._replace(recorded=START) for each in images(pictures)]
    recording = open_bag(write_bag(tmp_path / "bag", kind, sent), camera=CameraSource(camera(tmp_path)))
    for i in (4, 2, 3, 0):
        assert np.array_equal(recording[i].mosaic, pictures[i])


@pytest.mark.parametrize("name", ["mono16", "16UC1", "Mono12", "bayer_rggb16", "Polarized16", "BayerRGPolarized16"])
@pytest.mark.parametrize("big", [False, True])
def test_samples_of_16_bits(tmp_path, name, big):
    pictures = mosaics(2, bits=12)
    stored = [picture.astype(">u2" if big else "<u2") for picture in pictures]
    path = write_bag(tmp_path / "bag", "mcap", images(stored, name, is_bigendian=int(big)))
    recording = open_bag(path, camera=CameraSource(camera(tmp_path, bit_depth=12)))
    assert all(np.array_equal(frame.mosaic, picture) for frame, picture in zip(recording, pictures, strict=True))


def test_bits_that_are_shifted_up(tmp_path):
    pictures = mosaics(1, bits=12)
    path = write_bag(tmp_path / "bag", "mcap", images([pictures[0] << 4], "mono16"))
    msb = CameraSource(camera(tmp_path, bit_depth=12, bit_alignment="msb"))
    assert np.array_equal(open_bag(path, camera=msb)[0].mosaic, pictures[0])
    with refused("message 1", "bit_alignment: msb"):
        open_bag(path, camera=CameraSource(camera(tmp_path, bit_depth=12)))
    with refused("16 bits per pixel, expected 8"):
        open_bag(path, camera=CameraSource(camera(tmp_path)))


@pytest.mark.parametrize("last", [True, False])
def test_rows_may_be_padded(tmp_path, last):
    pictures = mosaics(1)
    padded = np.pad(pictures[0], ((0, 0), (0, 7)), constant_values=99)
    data = padded.ravel() if last else padded.ravel()[:-7]
    path = write_bag(tmp_path / "bag", "ros1", images(pictures, step=padded.shape[1], data=data))
    assert np.array_equal(open_bag(path, camera=CameraSource(camera(tmp_path)))[0].mosaic, pictures[0])


def test_pixels_that_a_driver_has_sorted_by_angle(tmp_path):
    channels = np.random.default_rng(0).integers(0, 256, (4, HEIGHT, WIDTH)).astype(np.uint8)
    sorted_pixels = np.ascontiguousarray(np.moveaxis(channels, 0, -1))
    sent = images([sorted_pixels], "polarized_angles_0d_45d_90d_135d_mono8")
    recording = open_bag(write_bag(tmp_path / "bag", "mcap", sent), camera=CameraSource(camera(tmp_path)))
    assert recording.camera_file.layout is None and np.array_equal(recording[0].channels, channels)


def test_compressed_images(tmp_path):
    pictures = mosaics(2)

    def compressed(suffix):
        return [
            Sent(
                f"{IMAGES}/compressed",
                "sensor_msgs/msg/CompressedImage",
                START + i,
                {
                    "header": header(START + i, FRAME),
                    "format": suffix,
                    "data": cv2.imencode(f".{suffix}", picture)[1].ravel(),
                },
            )
            for i, picture in enumerate(pictures)
        ]

    source = CameraSource(camera(tmp_path))
    recording = open_bag(write_bag(tmp_path / "png", "mcap", compressed("png")), camera=source)
    assert all(np.array_equal(frame.mosaic, picture) for frame, picture in zip(recording, pictures, strict=True))
    with refused("JPEG compression destroys polarization", "raw topic"):
        open_bag(write_bag(tmp_path / "jpeg", "mcap", compressed("jpeg")), camera=source)


def test_plain_cameras(tmp_path):
    colours = np.random.default_rng(0).integers(0, 256, (HEIGHT, WIDTH, 3)).astype(np.uint8)
    path = write_bag(tmp_path / "bag", "ros1", images([colours], "rgb8"))
    plain = camera(tmp_path, mosaic=None, angle_direction=None, polarization="none")
    grey = open_bag(path, camera=CameraSource(plain))[0].grey
    assert np.array_equal(grey, cv2.cvtColor(colours, cv2.COLOR_RGB2GRAY))
    with refused("rgb8", "destroys polarization"):
        open_bag(path, camera=CameraSource(camera(tmp_path)))


@pytest.mark.parametrize("name, word", [("mono12p", "packed"), ("yuv422", "not read"), ("32FC1", "not read")])
def test_encodings_that_are_not_read(tmp_path, name, word):
    path = write_bag(tmp_path / "bag", "mcap", images(mosaics(1), name))
    with refused(name, word):
        open_bag(path, camera=CameraSource(camera(tmp_path)))


@pytest.mark.parametrize(
    "changes, words",
    [
        ({"width": 4000}, ("bytes in rows of",)),
        ({"height": 2**32 - 1}, ("no usable image size",)),
        ({"step": 3}, ("bytes in rows of 3",)),
        ({"data": np.zeros(10, np.uint8)}, ("10 bytes",)),
        ({"width": WIDTH, "height": HEIGHT, "step": WIDTH}, ("one channel, half the mosaic",)),
    ],
)
def test_images_that_contradict_themselves(tmp_path, changes, words):
    path = write_bag(tmp_path / "bag", "mcap", images(mosaics(1), **changes))
    with refused("message 1", *words):
        open_bag(path, camera=CameraSource(camera(tmp_path)))


def test_times_of_recording_where_stamps_are_zero(tmp_path, caplog):
    path = write_bag(tmp_path / "bag", "ros1", images(mosaics(), header=header(0, "")))
    recording = open_bag(path, camera=CameraSource(camera(tmp_path)))
    assert recording[2].timestamp.nanoseconds == START + 2 * STEP + 3_000_000
    assert [record.message for record in caplog.records if "that of recording" in record.message] == [
        f"{path}: 5 images of {IMAGES} have no time; that of recording is taken"
    ]


def test_frames_are_in_order_of_their_stamps(tmp_path, caplog):
    pictures = mosaics()
    sent = images(pictures)
    times = [0, 2, 1, 3, 3]
    sent = [each._replace(recorded=START + i, fields=each.fields | {"header": header(START + times[i] * STEP, FRAME)})
            for i, each in enumerate(sent)]  # fmt: skip
    recording = open_bag(write_bag(tmp_path / "bag", "mcap", sent), camera=CameraSource(camera(tmp_path)))
    assert [np.array_equal(frame.mosaic, pictures[i]) for frame, i in zip(recording, (0, 2, 1, 3), strict=True)]
    assert all(np.diff(recording.timestamps) > 0) and "1 images" in caplog.text


def test_a_topic_is_to_be_chosen(tmp_path):
    sent = images(mosaics(2))
    other = [each._replace(topic="/other/image", fields=each.fields | {"encoding": "bayer_rggb8"}) for each in sent]
    note = Sent("/note", "std_msgs/msg/String", START, {"data": "hello"})
    path = write_bag(tmp_path / "bag", "mcap", [*sent, *other[:1], note])
    source = CameraSource(camera(tmp_path))
    assert len(open_bag(path, "/other/image", source)) == 1
    with refused("--topic", r"image_raw \(mono8, 2 messages\)", r"other/image \(bayer_rggb8, 1 messages\)"):
        open_bag(path, None, source)
    with refused("no topic /none", "image_raw"):
        open_bag(path, "/none", source)
    with refused("/note has no images but std_msgs/msg/String"):
        open_bag(path, "/note", source)
    with refused("no topic of images", "/note"):
        open_bag(write_bag(tmp_path / "words", "ros1", [note]), None, source)


def cut(path, share):
    data = path.read_bytes()
    path.write_bytes(data[: int(share * len(data))])


@pytest.mark.parametrize(
    "kind, hint", [("ros1", "rosbag reindex"), ("mcap file", "mcap recover"), ("db3 file", "[.]recover")]
)
@pytest.mark.parametrize("share", [0.0, 0.0005, 0.01, 0.5, 0.99])
def test_cut_bags(tmp_path, kind, hint, share):
    path = write_bag(tmp_path / "bag", kind, images(mosaics(40)))
    cut(path, share)
    try:
        recording = open_bag(path, camera=CameraSource(camera(tmp_path)))
    except InputError as problem:
        assert str(path) in str(problem) and (share < 0.01 or re.search(hint, str(problem)))
    else:  # a database may be whole up to where it was cut
        assert kind == "db3 file" and 0 < len(recording) <= 40


def test_what_was_readable_before_is_kept(tmp_path, caplog):
    pictures = mosaics(30)
    path = write_bag(tmp_path / "bag", "ros1", images(pictures))
    data = bytearray(path.read_bytes())
    begin = data.find(pictures[20].tobytes())
    data[begin - 400 : begin] = b"\xff" * 400  # what goes before the picture, and the end of that before it
    path.write_bytes(data)
    recording = open_bag(path, camera=CameraSource(camera(tmp_path)))
    assert len(recording) == 20 and f"the 20 messages of {IMAGES} before that are used" in caplog.text
    assert all(np.array_equal(recording[i].mosaic, pictures[i]) for i in range(19))


@pytest.mark.parametrize("mode", ["MESSAGE", "FILE"])
def test_compressed_folders(tmp_path, mode):
    pictures = mosaics(3)
    path = write_bag(tmp_path / "bag", "sqlite3", images(pictures), compression=mode)
    recording = open_bag(path, camera=CameraSource(camera(tmp_path)))
    assert all(np.array_equal(frame.mosaic, picture) for frame, picture in zip(recording, pictures, strict=True))


@pytest.mark.parametrize("kind", ["ros1", "mcap file", "db3 file"])
def test_changed_bytes_are_refused_or_read_but_never_a_traceback(tmp_path, kind):
    path = write_bag(tmp_path / "bag", kind, images(mosaics(4)))
    sound, source = path.read_bytes(), CameraSource(camera(tmp_path))
    rng = np.random.default_rng(1)
    outcomes = set()
    for _ in range(60):
        data = bytearray(sound)
        begin = rng.choice([0, len(data) // 2, max(0, len(data) - 4000)])
        for place in rng.integers(begin, len(data), rng.integers(1, 30)):
            data[place] = rng.integers(256)
        path.write_bytes(data)
        try:
            outcomes.add(len(list(open_bag(path, camera=source))))
        except InputError as problem:
            assert "\n" not in str(problem)
            outcomes.add("refused")
    assert "refused" in outcomes


def test_databases_that_were_not_closed(tmp_path, caplog):
    path = write_bag(tmp_path / "bag", "db3 file", images(mosaics(2)))
    path.with_name(path.name + "-wal").write_bytes(b"x")
    assert len(open_bag(path, camera=CameraSource(camera(tmp_path)))) == 2
    assert "was not closed" in caplog.text and "wal_checkpoint" in caplog.text


def test_folders_with_what_is_no_file(tmp_path):
    folder = write_bag(tmp_path / "bag", "mcap", images(mosaics(1)))
    (folder / "bag.mcap").unlink()
    os.mkfifo(folder / "bag.mcap")
    with refused("not a regular file"):
        open_bag(folder)


def test_files_that_are_no_bags(tmp_path):
    (tmp_path / "text.mcap").write_text("this is a text and no bag")
    with refused("not a MCAP file"):
        open_bag(tmp_path / "text.mcap")
    other = write_bag(tmp_path / "bag", "ros1", images(mosaics(1))).rename(tmp_path / "named.mcap")
    with refused("it is a ROS 1 bag"):
        open_bag(other)
    with refused("no such file"):
        open_bag(tmp_path / "none.bag")


def test_folders_without_metadata(tmp_path):
    folder = write_bag(tmp_path / "bag", "mcap", images(mosaics(1)))
    (folder / "metadata.yaml").unlink()
    assert is_bag(folder)
    with refused("no metadata.yaml", "name the file itself", "bag.mcap", "ros2 bag reindex"):
        open_bag(folder)


def test_metadata_is_data_alone(tmp_path):
    folder = write_bag(tmp_path / "bag", "mcap", images(mosaics(1)))
    text = (folder / "metadata.yaml").read_text()
    (folder / "metadata.yaml").write_text(text + "evil: !!python/object/apply:os.system ['echo hello']\n")
    with refused("cannot be read"):
        open_bag(folder)


def test_a_bag_is_no_sequence(tmp_path):
    path = write_bag(tmp_path / "bag", "ros1", images(mosaics(1)))
    with refused("a ROS bag", "open_bag"):
        open_sequence(path)


def test_the_extra_is_named_where_it_is_missing(tmp_path, monkeypatch):
    path = write_bag(tmp_path / "bag", "ros1", images(mosaics(1)))
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    real = builtins.__import__

    def without_rosbags(name, *more):
        if name.split(".")[0] == "rosbags":
            raise ModuleNotFoundError(f"No module named {name!r}")
        return real(name, *more)

    monkeypatch.setattr(builtins, "__import__", without_rosbags)
    with refused(r"pip install 'polarmap\[bags\]'"):
        open_bag(path)


def test_messages_that_are_not_the_standard_ones_are_refused(tmp_path):
    path = write_bag(tmp_path / "bag", "ros1", images(mosaics(1)))
    data = path.read_bytes()
    at = data.rindex(b"md5sum=") + 7
    path.write_bytes(data[:at] + b"0" * 32 + data[at + 32 :])
    with refused("not the standard one"):
        open_bag(path, camera=CameraSource(camera(tmp_path)))


def camera_info(topic="/camera/camera_info", **changes):
    fields = {
        "header": header(START, FRAME),
        "width": 2 * WIDTH,
        "height": 2 * HEIGHT,
        "distortion_model": "plumb_bob",
        "d": [0.1, -0.01, 0.001, 0.002, 0.0],
        "k": [60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1],
    } | changes
    return Sent(topic, "sensor_msgs/msg/CameraInfo", START, fields)


SENSOR = {"mosaic": [90, 45, 135, 0], "angle_direction": "counterclockwise"}


@pytest.mark.parametrize("kind", ["ros1", "mcap", "sqlite3"])
def test_camera_info_of_the_mosaic(tmp_path, kind, caplog):
    caplog.set_level(logging.WARNING)
    path = write_bag(tmp_path / "bag", kind, [*images(mosaics(1)), camera_info()])
    found = open_bag(path, camera=CameraSource(sensor=SENSOR)).camera_file
    assert (found.camera.width, found.camera.height, found.camera.fx) == (WIDTH, HEIGHT, 30.0)
    assert found.camera.cx == pytest.approx(15.5) and found.bit_depth == 8 and found.layout.value == (90, 45, 135, 0)
    assert found.distortion.coefficients == (0.1, -0.01, 0.001, 0.002, 0.0)
    assert "all is halved" in caplog.text


@pytest.mark.parametrize(
    "model, coefficients",
    [("rational_polynomial", (0.1, 0.01, 0.0, 0.0, 0.0, 0.2, 0.03, 0.01)), ("equidistant", (0.1, 0.01, 0.0, 0.0))],
)
def test_camera_info_of_a_channel(tmp_path, model, coefficients):
    info = camera_info(
        "/calibration", width=WIDTH, height=HEIGHT, distortion_model=model, d=list(coefficients),
        k=[30.0, 0, 15.5, 0, 30.0, 11.5, 0, 0, 1],
    )  # fmt: skip
    path = write_bag(tmp_path / "bag", "mcap", [*images(mosaics(1, 12), "mono16"), info])
    source = CameraSource(info="/calibration", sensor=SENSOR | {"bit_depth": 12})
    found = open_bag(path, camera=source).camera_file
    assert (found.camera.width, found.camera.fx, found.bit_depth) == (WIDTH, 30.0, 12)
    assert found.distortion.coefficients == coefficients


def test_camera_info_does_not_know_the_sensor(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", [*images(mosaics(1, 12), "mono16"), camera_info()])
    with refused("--layout", "--angle-direction", "--bit-depth", "--camera"):
        open_bag(path)
    with refused("no topic /none of camera_info", "/camera/camera_info"):
        open_bag(path, camera=CameraSource(info="/none", sensor=SENSOR))
    with refused("describes the camera already"):
        open_bag(path, camera=CameraSource(camera(tmp_path), sensor=SENSOR))
    (tmp_path / "camera.yaml").unlink()
    with refused("no camera.yaml", "no topic /camera/camera_info", "--camera"):
        open_bag(write_bag(tmp_path / "without", "mcap", images(mosaics(1))))


def test_camera_info_of_plain_cameras(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", [*images(mosaics(1)), camera_info()])
    recording = open_bag(path, camera=CameraSource(sensor={"polarization": "none"}))
    assert not recording.camera_file.polarized and recording.camera_file.camera.fx == 60.0
    assert np.array_equal(recording[0].grey, mosaics(1)[0])


def test_camera_info_of_cameras_that_are_not_calibrated(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", [*images(mosaics(1)), camera_info(k=[0.0] * 9)])
    with refused("not calibrated"):
        open_bag(path, camera=CameraSource(sensor=SENSOR))


def test_a_calibration_of_another_program_is_for_the_mosaic(tmp_path):
    path = write_bag(tmp_path / "bag", "ros1", images(mosaics(1)))
    values = {
        "image_width": 2 * WIDTH, "image_height": 2 * HEIGHT, "distortion_model": "plumb_bob",
        "camera_matrix": {"rows": 3, "cols": 3, "data": [60.0, 0, 31.5, 0, 60.0, 23.5, 0, 0, 1]},
        "distortion_coefficients": {"rows": 1, "cols": 5, "data": [0.0] * 5}, **SENSOR,
    }  # fmt: skip
    (tmp_path / "ost.yaml").write_text(yaml.safe_dump(values))
    found = open_bag(path, camera=CameraSource(tmp_path / "ost.yaml")).camera_file
    assert (found.camera.width, found.camera.fx, found.bit_depth) == (WIDTH, 30.0, 8)
    write_camera_file(tmp_path / "camera.yaml", found)
    assert open_bag(path).camera_file == found
