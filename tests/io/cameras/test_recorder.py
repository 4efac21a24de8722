"""Recordings of a camera: sequences, whatever ended them."""

from __future__ import annotations

import json
import time
from dataclasses import replace

import numpy as np
import pytest
from fake_device import MS, FakeDevice, camera, mosaic, packed_picture, picture

from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError
from polarmap.io.cameras import recorder
from polarmap.io.cameras.device import Unplugged
from polarmap.io.cameras.recorder import Recorder
from polarmap.io.recording.sequence import open_sequence


@pytest.mark.parametrize("raw", [False, True])
def test_a_recording_is_a_sequence_with_every_bit(tmp_path, raw):
    sent = [packed_picture(i, "Polarized12p", PixelFormat.MONO12P, b"chunk") for i in range(6)]
    device = FakeDevice(sent, features={"Gain": "0.0", "PixelFormat": "Polarized12p"})
    done = Recorder(tmp_path / "seq", device, camera(bits=12), raw).record(frames=6)
    assert (done.written, done.lost, done.missed) == (6, 0, 0) and device.stopped == 1
    sequence = open_sequence(tmp_path / "seq")
    assert {path.suffix for path in (tmp_path / "seq" / "raw").iterdir()} == {".raw" if raw else ".png"}
    for i, frame in enumerate(sequence):
        np.testing.assert_array_equal(frame.mosaic, mosaic(i, bits=12))
        assert frame.exposure == pytest.approx(0.002)
    record = json.loads((tmp_path / "seq" / "recording.json").read_text())
    assert record["gain"] == 0.0 and record["frames"] == 6 and record["camera"] == "Fake 42"


def test_lost_frames_leave_a_gap_and_times_stay_with_their_frames(tmp_path):
    numbers = [3, 4, 7, 8]
    sent = [picture(i, number=n, clock=10**9 + 40 * MS * n) for i, n in enumerate(numbers)]
    done = Recorder(tmp_path / "seq", FakeDevice(sent), camera()).record(frames=4)
    sequence = open_sequence(tmp_path / "seq")
    assert done.lost == 2 and [files.index for files in sequence.files] == [0, 1, 4, 5]
    nanoseconds = [files.timestamp.nanoseconds for files in sequence.files]
    assert np.diff(nanoseconds).tolist() == [40 * MS, 120 * MS, 40 * MS]
    for i, frame in enumerate(sequence):
        np.testing.assert_array_equal(frame.mosaic, mosaic(i))


def test_a_camera_that_is_unplugged_leaves_what_came(tmp_path):
    device = FakeDevice([picture(i) for i in range(5)], goes=True)
    with pytest.raises(Unplugged):
        Recorder(tmp_path / "seq", device, camera()).record()
    assert len(open_sequence(tmp_path / "seq")) == 5
    assert json.loads((tmp_path / "seq" / "recording.json").read_text())["frames"] == 5


def test_what_waits_when_it_is_stopped_is_written(tmp_path):
    device = FakeDevice([picture(i) for i in range(40)])
    done = Recorder(tmp_path / "seq", device, camera()).record(stopped=lambda: device.empty)
    assert done.written == len(open_sequence(tmp_path / "seq")) == 40


def test_it_ends_after_its_seconds(tmp_path):
    device = FakeDevice([picture(i) for i in range(10_000)], pace=0.01)
    done = Recorder(tmp_path / "seq", device, camera()).record(seconds=0.3)
    assert 1 <= done.written < 10_000 and not device.empty


def test_a_line_of_times_without_its_picture_does_no_harm(tmp_path):
    """As a program that is killed leaves it."""
    Recorder(tmp_path / "seq", FakeDevice([picture(i) for i in range(5)]), camera()).record(frames=5)
    (tmp_path / "seq" / "raw" / "000004.png").unlink()
    sequence = open_sequence(tmp_path / "seq")
    assert len(sequence) == 4 and not np.isnan(sequence.timestamps).any()


def test_no_recording_is_replaced(tmp_path):
    (tmp_path / "notes.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty"):
        Recorder(tmp_path, FakeDevice([]), camera())
    with pytest.raises(InputError, match="is a file"):
        Recorder(tmp_path / "notes.txt", FakeDevice([]), camera())


def test_where_writing_is_behind_pictures_are_kept_as_they_come(tmp_path, monkeypatch):
    """Some as PNG and some as raw bytes, in one sequence."""
    monkeypatch.setattr(recorder, "_MEMORY", 0)  # as little room as there may be
    sent = [packed_picture(i, "Mono12p", PixelFormat.MONO12P) for i in range(30)]
    device = FakeDevice(sent)
    done = Recorder(tmp_path / "seq", device, camera(bits=12)).record(
        stopped=lambda: device.empty, on_frame=lambda progress: time.sleep(0.02)
    )
    suffixes = [path.suffix for path in (tmp_path / "seq" / "raw").iterdir()]
    assert done.missed > 0 and done.written + done.missed == 30 and suffixes.count(".raw") > 3 and ".png" in suffixes
    for frame in open_sequence(tmp_path / "seq"):
        np.testing.assert_array_equal(frame.mosaic, mosaic(frame.index, bits=12))


def test_values_shifted_up_are_recorded_so(tmp_path):
    data = (mosaic(0, bits=12) << 4).astype("<u2").tobytes()
    file = replace(camera(bits=12), bit_alignment="msb", pixel_format=None)
    Recorder(tmp_path / "seq", FakeDevice([picture(0, pixel_format="Mono16", data=data)]), file).record(frames=1)
    np.testing.assert_array_equal(open_sequence(tmp_path / "seq")[0].mosaic, mosaic(0, bits=12))
