"""Real odometry behind the command line: plain video, calibrated cameras, trajectories without times."""

from __future__ import annotations

import shutil
from dataclasses import replace

import cv2
import numpy as np
import pytest
from fake_odometry import FakeOdometry

from polarmap import run
from polarmap.data.camera_file import PhotometricFiles
from polarmap.data.trajectory import Trajectory
from polarmap.evaluation.trajectories import compare_trajectories
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.images import write_image
from polarmap.io.formats.trajectory import read_trajectory, write_trajectory
from polarmap.io.recording.camera_file import read_camera_file, write_camera_file
from polarmap.io.recording.photometric import read_photometric
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.io.run_folder.folder import read_results
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses import found
from polarmap.pipeline.poses.found import OdometryPoses
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth.recording import write_sequence
from polarmap.synth.rendering import render_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor

CAMERA = PinholeCamera(width=320, height=240, fx=240.0, fy=240.0, cx=159.5, cy=119.5)
FRAMES = 14
START = 100.0  # seconds, so that no index is a time


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of fourteen frames of the room, with its truth."""
    folder = tmp_path_factory.mktemp("recorded")
    room = built_in_scene("room")
    timestamps, poses = room.path(FRAMES)
    frames = render_sequence(room.scene, CAMERA, START + timestamps, poses, Sensor(), supersample=1)
    write_sequence(folder, frames, CAMERA, Sensor())
    return folder


@pytest.fixture
def sequence(recorded, tmp_path):
    """A copy to change."""
    return shutil.copytree(recorded, tmp_path / "sequence")


@pytest.fixture(scope="module")
def plain(recorded, tmp_path_factory):
    """The same as a plain camera's colour video."""
    folder = tmp_path_factory.mktemp("plain")
    (folder / "images").mkdir()
    front_end = FrontEnd(read_camera_file(recorded / "camera.yaml"))
    for frame in open_sequence(recorded):
        grey = np.rint(255 * front_end.grey(frame)).astype(np.uint8)
        write_image(folder / "images" / f"{frame.name}.png", cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR))
    described = read_camera_file(recorded / "camera.yaml")
    write_camera_file(folder / "camera.yaml", replace(described, layout=None, angle_direction=None))
    for name in ("timestamps.txt", "groundtruth.txt"):
        shutil.copy(recorded / name, folder)
    return folder


def calibrated(sequence, vignette: np.ndarray) -> Sequence:
    """The sequence with a vignette, uint8 H×W, that its camera file names."""
    write_image(sequence / "vignette.png", vignette)
    path = sequence / "camera.yaml"
    files = PhotometricFiles(vignette=sequence / "vignette.png")
    write_camera_file(path, replace(read_camera_file(path), photometric=files))
    return open_sequence(sequence)


def half_dark() -> np.ndarray:
    vignette = np.full(CAMERA.shape, 200, np.uint8)
    vignette[:, :120] = 0
    return vignette


@pytest.mark.parametrize("kind", ["recorded", "plain"])
def test_polarized_and_plain_video_are_tracked(polarmap, request, tmp_path, kind):
    folder, out = request.getfixturevalue(kind), tmp_path / "poses.txt"
    status, printed, _ = polarmap("odometry", folder, "--out", out, "--truth", folder / "groundtruth.txt")
    assert status == 0 and "adjust" in printed
    found, truth = read_trajectory(out), read_trajectory(folder / "groundtruth.txt")
    error = compare_trajectories(found, truth)
    path_length = np.linalg.norm(np.diff(truth.poses[:, :3, 3], axis=0), axis=1).sum()
    assert len(found) >= FRAMES - 1 and error.similar < 0.02 * path_length
    assert f"{error.similar:.4f} m" in printed


def test_a_plain_video_is_not_mapped(polarmap, plain, tmp_path):
    status, _, error = polarmap("run", plain, "--out", tmp_path / "out")
    assert status == 2 and "no polarization channels" in error and len(error.strip().splitlines()) == 1
    assert not (tmp_path / "out").exists()


@pytest.mark.parametrize("format", [pytest.param("kitti", marks=pytest.mark.slow), "log"])
def test_poses_without_times_are_those_of_the_frames(polarmap, recorded, tmp_path, format):
    truth = read_trajectory(recorded / "groundtruth.txt")
    path = tmp_path / "truth.txt"
    write_trajectory(path, truth, format)
    assert polarmap("run", recorded, "--poses", path, "--out", tmp_path / "out")[0] == 0
    assert read_results(tmp_path / "out").posed == FRAMES
    status, printed, _ = polarmap("odometry", recorded, "--out", tmp_path / "poses.txt", "--truth", path)
    found = read_trajectory(tmp_path / "poses.txt")
    assert status == 0 and f"{compare_trajectories(found, truth).similar:.4f} m" in printed


@pytest.mark.parametrize("option", ["--poses", "--truth"])
def test_poses_without_times_for_other_frames_are_refused(polarmap, recorded, tmp_path, option):
    truth = read_trajectory(recorded / "groundtruth.txt")
    path = tmp_path / "truth.txt"
    write_trajectory(path, Trajectory(truth.timestamps[1:], truth.poses[1:]), "kitti")
    command = "run" if option == "--poses" else "odometry"
    status, _, error = polarmap(command, recorded, option, path, "--out", tmp_path / "out")
    assert status == 2 and "truth.txt: 13 poses, but 14 timestamps" in error
    assert not (tmp_path / "out").exists()


def test_trajectories_are_written_as_logs(polarmap, recorded, tmp_path):
    for format in ("tum", "log"):
        assert polarmap("odometry", recorded, "--out", tmp_path / f"poses.{format}", "--format", format)[0] == 0
    tum, log = (read_trajectory(tmp_path / f"poses.{format}") for format in ("tum", "log"))
    np.testing.assert_allclose(log.poses, tum.poses, atol=1e-9)


def test_a_calibration_that_is_not_there_is_refused_before_any_work(polarmap, sequence):
    calibrated(sequence, half_dark())
    (sequence / "vignette.png").unlink()
    for command in ("odometry", "run"):
        out = sequence.parent / command
        status, _, error = polarmap(command, sequence, "--out", out)
        assert status == 2 and "vignette.png" in error and not out.exists()


class Watching(FakeOdometry):
    """Keeps what it is given."""

    def __init__(self, poses) -> None:
        super().__init__(poses)
        self.images, self.exposures = [], []

    def process(self, grey, timestamp, index, exposure=None):
        self.images.append(grey)
        self.exposures.append(exposure)
        return super().process(grey, timestamp, index, exposure)


def test_mapping_corrects_the_image_of_odometry_and_no_other(sequence):
    recording = calibrated(sequence, half_dark())
    (sequence / "exposures.txt").write_text("8\n" * (FRAMES - 1) + "nan\n")
    recording = open_sequence(sequence, recording.camera_file)
    odometry = Watching(dict(enumerate(recording.truth_trajectory().poses)))
    front_end = FrontEnd(recording.camera_file, read_photometric(recording.camera_file))
    keyframes = []
    mapper = Mapper(recording.camera_file, OdometryPoses(odometry, front_end), on_keyframe=keyframes.append)
    for frame in recording:
        mapper.process(frame)
    mapper.finish()
    np.testing.assert_array_equal(odometry.images[3], front_end.grey(recording[3]))
    assert (odometry.images[3][:, :120] == 0).all() and (keyframes[0].image.intensity[:, :120] > 0).any()
    np.testing.assert_allclose(odometry.exposures, [0.008] * (FRAMES - 1) + [np.nan])


def test_points_are_chosen_where_the_lens_shows_something(sequence):
    recording = calibrated(sequence, half_dark())
    front_end = found.calibrated_front_end(recording.camera_file)
    odometry = found.make_odometry(front_end, Config())
    run.track_sequence(recording, front_end, odometry)
    points = odometry.result().points
    assert len(points.pixel) > 200 and points.pixel[:, 0].min() >= 120


def test_a_map_has_the_poses_that_odometry_alone_finds(polarmap, recorded, tmp_path):
    assert polarmap("odometry", recorded, "--out", tmp_path / "poses.txt")[0] == 0
    assert polarmap("run", recorded, "--out", tmp_path / "out")[0] == 0
    alone, mapped = read_trajectory(tmp_path / "poses.txt"), read_trajectory(tmp_path / "out" / "trajectory.txt")
    np.testing.assert_array_equal(alone.timestamps, mapped.timestamps)
    np.testing.assert_allclose(alone.poses, mapped.poses, atol=1e-9)
