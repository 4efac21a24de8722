"""The producer with virtual cameras that comes with PyPI's genicam, opened for real."""

from __future__ import annotations

import os
import signal
import threading
import time
from itertools import pairwise
from pathlib import Path

import numpy as np
import pytest
from fake_device import camera

from polarmap.errors import InputError
from polarmap.io.cameras.features import set_features, size_of
from polarmap.io.cameras.genicam import open_genicam
from polarmap.io.cameras.live_camera import LiveCamera
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import open_sequence

genicam = pytest.importorskip("genicam", reason="needs polarmap[genicam]")
pytest.importorskip("harvesters", reason="needs polarmap[genicam]")

CTI = Path(genicam.__file__).parent / "viky.cti"
if not CTI.exists():
    pytest.skip("this release of genicam has no virtual cameras", allow_module_level=True)


def test_frames_come_whole_in_order_and_with_times(caplog):
    with open_genicam(CTI, "1") as device:
        assert size_of(device) == (400, 400) and device.feature("ExposureTime") is None
        set_features(device, ["PixelFormat=Mono8"])
        source = LiveCamera(device, camera(200, 200), frames=12)
        frames = list(source)
    assert [frame.index for frame in frames] == list(range(12)) and source.lost == source.missed == 0
    assert all(frame.mosaic.shape == (400, 400) and frame.mosaic.dtype == np.uint8 for frame in frames)
    assert any((a.mosaic != b.mosaic).any() for a, b in pairwise(frames))  # a ball bounces
    assert (np.diff([frame.timestamp for frame in frames]) > 0).all()
    assert all(np.isnan(frame.exposure) for frame in frames)
    assert caplog.text.count("tells no times") == 1


def test_a_camera_is_asked_whether_it_is_there():
    with open_genicam(CTI, "0") as device:
        device._last -= 1000
        assert device._require_there() is None


@pytest.mark.parametrize("wanted, words", [(None, "3 cameras, choose one"), ("77", "no camera '77'; there is 0: ")])
def test_cameras_that_are_there_are_listed(wanted, words):
    with pytest.raises(InputError, match=words), open_genicam(CTI, wanted):
        pass


def test_what_is_no_producer_is_told(tmp_path):
    (tmp_path / "a.cti").write_text("no library")
    for path, words in ((tmp_path / "a.cti", "no GenTL producer"), (tmp_path / "b.cti", "no such file")):
        with pytest.raises(InputError, match=words), open_genicam(path):
            pass


def test_values_that_a_camera_does_not_take_are_told():
    with open_genicam(CTI, "0") as device:
        for setting, words in (
            ("PixelFormat=Mono12", "does not take PixelFormat=Mono12"),
            ("Foo=1", "does not take Foo=1"),
        ):
            with pytest.raises(InputError, match=words):
                set_features(device, [setting])


def test_the_program_records_what_inspect_reads(polarmap, tmp_path):
    file, out = tmp_path / "camera.yaml", tmp_path / "seq"
    write_camera_file(file, camera(200, 200))
    options = ("--camera", file, "--cti", CTI, "--device", "1", "--out", out)
    ended = polarmap("record", *options)
    assert ended.status == 2 and "RGBa8" in ended.err and not out.exists()
    ended = polarmap("record", *options, "--feature", "PixelFormat=Mono8", "--frames", "8")
    assert ended.status == 0 and "8 frames" in ended.out
    assert len(open_sequence(out)) == 8 and polarmap("inspect", out).status == 0
    write_camera_file(file, camera(400, 400))
    ended = polarmap("record", *options, "--feature", "PixelFormat=Mono8")
    assert ended.status == 2 and "write width: 200" in ended.err


def test_ctrl_c_ends_a_recording_in_order(polarmap, tmp_path):
    file, out = tmp_path / "camera.yaml", tmp_path / "seq"
    write_camera_file(file, camera(200, 200))

    def stop() -> None:
        while len(list(out.glob("raw/*.png"))) < 5:
            time.sleep(0.05)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=stop, daemon=True).start()
    ended = polarmap(
        "record", "--camera", file, "--cti", CTI, "--device", "1", "--feature", "PixelFormat=Mono8", "--out", out
    )
    assert ended.status == 0 and f"{len(open_sequence(out))} frames" in ended.out
