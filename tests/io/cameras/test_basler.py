"""Basler's emulated camera, which plays pictures from a folder, opened for real."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from command_line import refused
from fake_device import camera, mosaic
from room_recording import CAMERA

from polarmap.errors import InputError
from polarmap.io.cameras.basler import open_basler
from polarmap.io.cameras.features import fixed_exposure, set_features
from polarmap.io.cameras.live_camera import LiveCamera
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import open_sequence
from polarmap.io.run_folder.folder import read_results
from polarmap.synth import Sensor, built_in_scene, render_sequence
from polarmap.synth.recording import camera_file

pytest.importorskip("pypylon", reason="needs polarmap[basler]")


@pytest.fixture(autouse=True)
def emulator(monkeypatch):
    monkeypatch.setenv("PYLON_CAMEMU", "1")


def settings(folder, width: int, height: int, pixel_format: str = "Mono8", rate: float = 50.0) -> list[str]:
    """Have the emulator play a folder of mosaics."""
    return [
        "TestImageSelector=Off", "ImageFileMode=On", f"ImageFilename={folder}", f"Width={width}", f"Height={height}",
        f"PixelFormat={pixel_format}", f"AcquisitionFrameRate={rate}", "ExposureTime=3000",
    ]  # fmt: skip


def mosaics(folder, count: int = 5) -> list[np.ndarray]:
    folder.mkdir()
    made = [mosaic(i, (120, 160)) for i in range(count)]
    for i, image in enumerate(made):
        cv2.imwrite(str(folder / f"{i:03d}.png"), image)
    return made


def test_frames_are_those_in_the_files_bit_for_bit(tmp_path, caplog):
    made = mosaics(tmp_path / "raw")
    with open_basler() as device:
        set_features(device, settings(tmp_path / "raw", 160, 120))
        assert fixed_exposure(device) == pytest.approx(0.003)
        source = LiveCamera(device, camera(80, 60), frames=12)
        frames = list(source)
    assert source.lost == source.missed == 0
    for frame in frames:
        np.testing.assert_array_equal(frame.mosaic, made[frame.index % len(made)])
        assert frame.exposure == pytest.approx(0.003)
    assert caplog.text.count("tells no times") == 1


def test_no_such_camera_and_no_such_value_are_told():
    with pytest.raises(InputError, match="no camera '77'; there is 0: "), open_basler("77"):
        pass
    with open_basler("0") as device:
        for setting, words in (("Width=-3", "does not take Width=-3"), ("Foo=1", "does not take Foo=1")):
            with pytest.raises(InputError, match=words):
                set_features(device, [setting])


def test_pictures_that_fail_are_lost_ones(tmp_path):
    mosaics(tmp_path / "raw")
    with open_basler() as device:
        set_features(device, [*settings(tmp_path / "raw", 160, 120), "ForceFailedBufferCount=3"])
        source = LiveCamera(device, camera(80, 60), frames=10)
        for frame in source:
            if frame.index == 2:
                device._camera.ForceFailedBuffer.Execute()
    assert source.lost == 3


def test_the_program_records_mosaics_bit_for_bit(polarmap, tmp_path):
    made, file, out = mosaics(tmp_path / "raw"), tmp_path / "camera.yaml", tmp_path / "seq"
    write_camera_file(file, camera(80, 60))
    features = [word for setting in settings(tmp_path / "raw", 160, 120) for word in ("--feature", setting)]
    ended = polarmap("record", "--camera", file, "--basler", *features, "--frames", "9", "--out", out)
    assert ended.status == 0
    frames = list(open_sequence(out))
    assert len(frames) == 9
    for frame in frames:
        np.testing.assert_array_equal(frame.mosaic, made[frame.index % len(made)])
    refused(
        polarmap("record", "--camera", file, "--basler", "--frames", "9", "--out", out), "sends 1024x1040", "Width=160"
    )


def test_a_live_run_of_a_rendered_room_ends_with_a_map(polarmap, tmp_path):
    sensor, room, frames = Sensor(bit_depth=8, seed=1), built_in_scene("room"), 60
    (tmp_path / "raw").mkdir()
    for frame in render_sequence(room.scene, CAMERA, *room.path(frames=frames, step=0.03), sensor):
        cv2.imwrite(str(tmp_path / "raw" / f"{frame.index:03d}.png"), frame.mosaic)
    file, out = tmp_path / "camera.yaml", tmp_path / "out"
    write_camera_file(file, camera_file(CAMERA, sensor))
    features = [word for s in settings(tmp_path / "raw", 320, 240, rate=8.0) for word in ("--feature", s)]
    ended = polarmap("live", "--camera", file, "--basler", *features, "--frames", frames, "--out", out)
    results = read_results(out)
    assert results.frames + results.live.missed >= frames and results.live.pose.count == results.frames
    assert results.sequence.startswith("Basler") and results.poses == "odometry"
    if ended.status == 0:
        assert results.status == "complete" and (out / "mesh.ply").exists()
    else:  # on a machine too slow to track it
        refused(ended, status=1)
        assert results.status == "failed" and results.reason
