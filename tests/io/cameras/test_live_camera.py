"""Frames of a camera: bit for bit, at their times, and what is lost is counted."""

from __future__ import annotations

import threading
from dataclasses import replace
from time import perf_counter, sleep

import numpy as np
import pytest
from fake_device import MS, FakeDevice, camera, mosaic, packed_picture, picture

from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError
from polarmap.io.cameras.choice import choose
from polarmap.io.cameras.device import Unplugged
from polarmap.io.cameras.features import fixed_exposure, set_features, warn_of_features
from polarmap.io.cameras.live_camera import LiveCamera


def taken(pictures, camera_file=None, **options):
    """Frames of these pictures, the camera, and its device."""
    device = FakeDevice(pictures)
    source = LiveCamera(device, camera_file or camera(), **{"frames": len(pictures)} | options)
    return list(source), source, device


def test_frames_are_those_that_were_sent():
    frames, source, device = taken([picture(i, number=5 + i, clock=10 + 40 * MS * i) for i in range(4)])
    assert [frame.index for frame in frames] == [0, 1, 2, 3]
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.mosaic, mosaic(i))
        assert frame.exposure == 0.002
    assert np.diff([frame.timestamp.nanoseconds for frame in frames]).tolist() == [40 * MS] * 3
    assert (source.lost, source.missed, device.started, device.stopped) == (0, 0, 1, 1)
    assert source.begun <= source.exposed <= perf_counter() + 0.2
    assert not [thread for thread in threading.enumerate() if thread.name == "polarmap-camera"]


@pytest.mark.parametrize(
    "name, label", [("Polarized12p", "Mono12p"), ("PolarizeMono12Packed", "Mono12Packed"), ("Mono12", "Mono12")]
)
def test_packed_pixels_are_unpacked_and_chunk_data_is_cut_off(name, label):
    sent = [packed_picture(i, name, PixelFormat.from_name(label), b"chunk" * 9) for i in range(2)]
    frames, source, _ = taken(sent, camera(bits=12))
    for i, frame in enumerate(frames):
        np.testing.assert_array_equal(frame.mosaic, mosaic(i, bits=12))
    assert source.camera_file.pixel_format is PixelFormat.MONO12


def test_padding_of_rows_is_taken_out():
    padded = np.pad(mosaic(0), ((0, 0), (0, 3))).tobytes()
    frames, _, _ = taken([picture(0, data=padded, padding=3), picture(1, data=padded[:-3], padding=3)])
    for frame in frames:
        np.testing.assert_array_equal(frame.mosaic, mosaic(0))


def test_values_shifted_up_are_shifted_down():
    data = (mosaic(0, bits=12) << 4).astype("<u2").tobytes()
    file = replace(camera(bits=12), bit_alignment="msb", pixel_format=None)
    frames, source, _ = taken([picture(0, pixel_format="Mono16", data=data)], file)
    np.testing.assert_array_equal(frames[0].mosaic, mosaic(0, bits=12))
    assert source.camera_file.bit_alignment == "lsb"


@pytest.mark.parametrize(
    "numbers, indices, lost",
    [
        ([1, 2, 5, 6], [0, 1, 4, 5], 2),
        ([65534, 65535, 1, 3], [0, 1, 2, 4], 1),  # GigE Vision 1 counts so
        ([7, 8, 0, 1], [0, 1, 2, 3], 0),  # begun anew
        ([7, 8, 8 + 10**12], [0, 1, 2], 0),
    ],
)
def test_numbers_left_out_are_frames_that_were_lost(numbers, indices, lost, caplog):
    frames, source, _ = taken([picture(i, number=number) for i, number in enumerate(numbers)])
    assert [frame.index for frame in frames] == indices and source.lost == lost
    assert caplog.text.count("lost on the way") == (lost > 0)


def test_pictures_of_which_a_part_is_missing_are_lost_ones():
    sent = [picture(0, data=None, width=0, height=0), picture(1), picture(2, data=mosaic(2).tobytes()[:-1]), picture(3)]
    frames, source, _ = taken(sent, frames=2)
    assert [frame.index for frame in frames] == [1, 3] and source.lost == 2


def test_what_nobody_takes_is_lost_and_counted_apart():
    device = FakeDevice([picture(i) for i in range(20)])
    source = LiveCamera(device, camera(), buffer=3, ended=lambda: device.empty and not source.feed.waiting)
    came = []
    for frame in source:
        while not device.empty:
            sleep(0.002)
        came.append(frame.index)
    assert came[0] == 0 and 3 <= len(came) <= 4 and source.missed >= 15 and source.lost == 0


@pytest.mark.parametrize(
    "change, file, words",
    [
        ({"width": 8, "height": 6}, camera(), "size of one channel; write width: 4"),
        ({"width": 20}, camera(), "sends 20x12 pixels"),
        ({"pixel_format": "RGB8"}, camera(), "not that of a raw mosaic"),
        ({"pixel_format": "Mono12p"}, camera(), "bit_depth: 8"),
        ({"pixel_format": "Mono16"}, camera(), "bit_depth: 8"),
        ({"pixel_format": "BayerRG8"}, camera(), "write colour: RGGB"),
        ({}, replace(camera(), layout=None), "mosaic: none"),
        ({"pixel_format": "Mono16", "data": b"\xff" * 384}, camera(bits=12), "more than 12 bits"),
    ],
)
def test_a_camera_that_is_not_that_of_the_file_is_told_in_one_line(change, file, words):
    with pytest.raises(InputError, match=words) as told:
        taken([picture(0, **change)], file)
    assert str(told.value).startswith("Fake 42: ")


def test_a_size_that_changes_on_the_way_is_told_after_what_came_before():
    device, came = FakeDevice([picture(0), picture(1), picture(2, width=8)]), []
    with pytest.raises(InputError, match="sends 8x12"):
        for frame in LiveCamera(device, camera()):
            came.append(frame.index)
    assert came == [0, 1] and device.stopped == 1


def test_a_camera_that_is_unplugged_is_told_after_what_came_before():
    device, came = FakeDevice([picture(0), picture(1)], goes=True), []
    with pytest.raises(Unplugged, match="does not answer"):
        for frame in LiveCamera(device, camera()):
            came.append(frame.index)
    assert came == [0, 1] and device.stopped == 1


def test_it_ends_when_it_is_asked_to_though_nothing_comes():
    device = FakeDevice([picture(0)])
    source = LiveCamera(device, camera(), ended=lambda: device.empty and source.feed.waiting == 0)
    assert [frame.index for frame in source] in ([], [0])
    assert device.stopped == 1


def test_who_leaves_early_leaves_no_thread():
    device = FakeDevice([picture(i) for i in range(50)], pace=0.001)
    for frame in LiveCamera(device, camera()):
        if frame.index == 3:
            break
    sleep(0.1)
    assert device.stopped == 1
    assert not [thread for thread in threading.enumerate() if thread.name == "polarmap-camera"]


def test_a_plain_camera_gives_grey_pictures():
    file = replace(camera(16, 12), layout=None, angle_direction=None)
    frames, _, _ = taken([picture(0)], file)
    np.testing.assert_array_equal(frames[0].grey, mosaic(0))


def test_automatic_functions_are_warned_of_and_give_no_exposure(caplog):
    device = FakeDevice([], features={"ExposureAuto": "Continuous", "GainAuto": "Off", "ExposureTime": "4000"})
    warn_of_features(device)
    assert "ExposureAuto on" in caplog.text and "GainAuto" not in caplog.text
    assert np.isnan(fixed_exposure(device))
    set_features(device, ["ExposureAuto=Off", "ExposureTime = 2500"])
    assert fixed_exposure(device) == pytest.approx(0.0025)
    with pytest.raises(InputError, match="NAME=VALUE"):
        set_features(device, ["Gain"])
    with pytest.raises(InputError, match="no feature Gain"):
        set_features(device, ["Gain=0"])


def test_a_camera_is_chosen_by_serial_number_or_index_and_else_all_are_listed():
    cameras = [("123", "A"), ("1", "B")]
    assert choose(cameras, "1", "x") == 1  # a serial number before an index
    assert choose(cameras, "0", "x") == 0
    assert choose(cameras[:1], None, "x") == 0
    for wanted, words in (
        (None, "2 cameras, choose one with --device: 0: A .serial number 123.; 1: B"),
        ("9", "there is 0: A"),
    ):
        with pytest.raises(InputError, match=words):
            choose(cameras, wanted, "x")
    with pytest.raises(InputError, match="no camera is found"):
        choose([], None, "x")
