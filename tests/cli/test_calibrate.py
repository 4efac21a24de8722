"""polarmap calibrate, from folders of pictures to a camera file that is better."""

from __future__ import annotations

import numpy as np
import pytest
import yaml
from command_line import refused
from polarizer_pictures import TRUTH, behind_polarizer, mosaic_of

from polarmap.data.camera_file import CameraFile
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.images import write_image
from polarmap.io.recording.camera_file import read_camera_file, write_camera_file

ANGLES = np.arange(5.0, 180.0, 15.0)
CAMERA = PinholeCamera(64, 64, 90.0, 90.0, 31.5, 31.5)
FILE = CameraFile(CAMERA, SensorLayout.SONY_POLARSENS, AngleDirection.COUNTERCLOCKWISE, 12, frame_rate=20.0)


@pytest.fixture(scope="module")
def bench(tmp_path_factory):
    """Folders dark, flat and turned, and camera.yaml, of a camera whose black level is 60."""
    folder = tmp_path_factory.mktemp("bench")
    rng = np.random.default_rng(0)
    shots = {
        "dark": [np.zeros(3)] * 3,
        "flat": [np.array([1.2, 0.0, 0.0])] * 2,
        "turned": [behind_polarizer(FILE, angle) for angle in ANGLES],
    }
    for name, lights in shots.items():
        (folder / name).mkdir()
        for i, stokes in enumerate(lights):
            write_image(folder / name / f"{i * 15:03d}.png", mosaic_of(FILE, TRUTH, stokes, rng, black=60.0))
    write_camera_file(folder / "camera.yaml", FILE)
    return folder


def options(bench, *names):
    folders = [item for name in names for item in (f"--{name}", bench / ("turned" if name == "polarizer" else name))]
    return ["--camera", bench / "camera.yaml", *folders]


def test_a_camera_file_comes_out_and_what_was_found_is_told(polarmap, bench, tmp_path):
    out = tmp_path / "calibrated.yaml"
    ended = polarmap("calibrate", *options(bench, "dark", "flat", "polarizer"), "-o", out)
    assert ended.status == 0
    assert "black level" in ended.out and "beyond noise: nothing" in ended.out and "165.png" in ended.out
    read = read_camera_file(out)
    np.testing.assert_allclose(read.polarizers.angles, TRUTH.angles, atol=0.15)
    np.testing.assert_allclose(read.polarizers.gains, TRUTH.gains, atol=2e-3)
    np.testing.assert_allclose(read.polarizers.efficiencies, TRUTH.efficiencies, atol=2e-3)
    assert read.black_level == pytest.approx(60.0, abs=0.2)
    assert (read.camera, read.layout, read.frame_rate) == (FILE.camera, FILE.layout, FILE.frame_rate)
    refused(polarmap("calibrate", *options(bench, "dark"), "-o", out), out, "--force")


def test_known_angles_are_given_in_the_order_of_names(polarmap, bench, tmp_path):
    angles = ",".join(map(str, ANGLES))
    out = tmp_path / "calibrated.yaml"
    ended = polarmap("calibrate", *options(bench, "dark", "polarizer"), "--angles", angles, "--absolute", "-o", out)
    assert ended.status == 0
    np.testing.assert_allclose(read_camera_file(out).polarizers.angles, TRUTH.angles, atol=0.15)


def test_the_black_level_alone(polarmap, bench, tmp_path):
    ended = polarmap("calibrate", *options(bench, "dark"), "-o", tmp_path / "calibrated.yaml")
    assert ended.status == 0
    assert read_camera_file(tmp_path / "calibrated.yaml").polarizers is None


@pytest.mark.parametrize(
    ("names", "more", "words"),
    [
        ((), [], "nothing to calibrate with"),
        (("polarizer",), [], "without a flat field"),
        (("flat", "polarizer"), ["--angles", "0,x"], "is no list of degrees"),
        (("flat", "polarizer"), ["--angles", "0,15"], "2 angles for 12 pictures"),
        (("flat",), ["--dark", "nowhere"], "nowhere"),
    ],
)
def test_what_cannot_be_done_is_one_line(polarmap, bench, tmp_path, names, more, words):
    out = tmp_path / "calibrated.yaml"
    refused(polarmap("calibrate", *options(bench, *names), *more, "-o", out), words)
    assert not out.exists()


def test_the_section_is_read_as_it_was_written_and_may_be_given_in_part(tmp_path):
    path = tmp_path / "camera.yaml"
    write_camera_file(path, FILE)
    values = yaml.safe_load(path.read_text())
    path.write_text(yaml.safe_dump(values | {"calibration": {"gains": [1.02, 0.98, 1.01, 0.99]}}))
    read = read_camera_file(path)
    assert read.polarizers == PolarizerCalibration((0.0, 45.0, 90.0, 135.0), (1.02, 0.98, 1.01, 0.99))
    write_camera_file(path, read)
    assert read_camera_file(path) == read


@pytest.mark.parametrize(
    ("section", "words"),
    [
        ({"angle": [0, 45, 90, 135]}, "did you mean angles?"),
        ({"angles": [0, 45, 90]}, "calibration.angles"),
        ({"angles": [0, 135, 90, 45]}, "more than 20 degrees from 45"),
        ({"gains": [1, 1, 1, ".nan"]}, "calibration"),
        ("none", "calibration"),
    ],
)
def test_a_section_that_cannot_be_is_refused(polarmap, bench, tmp_path, section, words):
    path = tmp_path / "camera.yaml"
    path.write_text(yaml.safe_dump(yaml.safe_load((bench / "camera.yaml").read_text()) | {"calibration": section}))
    refused(polarmap("inspect", bench / "flat" / "000.png", "--camera", path), path, words)


def test_a_plain_camera_has_none(polarmap, bench, tmp_path):
    path = tmp_path / "camera.yaml"
    values = yaml.safe_load((bench / "camera.yaml").read_text())
    del values["mosaic"], values["angle_direction"]
    path.write_text(yaml.safe_dump(values | {"polarization": "none", "calibration": {}}))
    refused(polarmap("inspect", bench / "flat" / "000.png", "--camera", path), "calibration: a camera without")
