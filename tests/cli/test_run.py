"""The command line as a user meets it: what it writes, and one clear line for everything that goes wrong."""

from __future__ import annotations

import json

import numpy as np
import pytest
import yaml
from command_line import refused, run_python

from polarmap.geometry.camera import PinholeCamera
from polarmap.synth.recording import write_sequence
from polarmap.synth.rendering import render_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor

CAMERA = PinholeCamera(width=320, height=240, fx=240.0, fy=240.0, cx=159.5, cy=119.5)


@pytest.fixture(scope="module")
def recorded(tmp_path_factory):
    """A recording of ten frames of the room."""
    folder = tmp_path_factory.mktemp("recorded")
    room = built_in_scene("room")
    frames = render_sequence(room.scene, CAMERA, *room.path(10), Sensor(), supersample=1)
    write_sequence(folder, frames, CAMERA, Sensor())
    return folder


@pytest.fixture
def sequence(recorded, tmp_path):
    """A copy to damage."""
    copy = tmp_path / "sequence"
    for path in recorded.rglob("*"):
        if path.is_file():
            target = copy / path.relative_to(recorded)
            target.parent.mkdir(parents=True, exist_ok=True)
            target.write_bytes(path.read_bytes())
    return copy


def test_a_recording_is_mapped_and_judged(polarmap, recorded, tmp_path):
    out = tmp_path / "out"
    arguments = ("--poses", recorded / "groundtruth.txt", "--out", out, "--stages", "--set", "fusion.min_faces=0")
    status, printed, _ = polarmap("run", recorded, *arguments)
    assert status == 0 and "report.html" in printed
    results = json.loads((out / "results.json").read_text())
    assert results["status"] == "complete" and results["frames"] == 10 and len(results["keyframes"]) >= 2
    for name in ("config.yaml", "trajectory.txt", "keyframes.txt", "mesh.ply", "cloud.ply", "report.html"):
        assert (out / name).stat().st_size > 0, name
    with np.load(out / "keyframes" / "000000.npz", allow_pickle=False) as arrays:
        assert arrays["depth"].shape == (240, 320) and arrays["normal"].shape == (240, 320, 3)
    figures = tmp_path / "figures.json"
    status, printed, _ = polarmap("eval", out, recorded, "--json", figures)
    assert status == 0 and "AbsRel" in printed
    evaluated = json.loads(figures.read_text())
    assert evaluated["depth"]["abs_rel"] < 0.1 and evaluated["depth"]["density"] > 0.5


def test_the_written_configuration_is_read_back(polarmap, recorded, tmp_path):
    path = tmp_path / "config.yaml"
    status, printed, _ = polarmap("config", "--yaml", "--set", "paper.max_steps=48")
    path.write_text(printed)
    assert status == 0 and yaml.safe_load(printed)["paper"]["max_steps"] == 48
    assert "48" in polarmap("config", "--config", path)[1]


def test_inspect_writes_pictures(polarmap, recorded, tmp_path):
    status, printed, _ = polarmap("inspect", recorded, "--samples", 2, "--out", tmp_path / "pictures")
    assert status == 0 and "10 frames" in " ".join(printed.split())
    assert len(list((tmp_path / "pictures").glob("*overview*"))) == 2


def test_help_teaches(polarmap):
    status, printed, _ = polarmap("run", "--help")
    assert status == 0 and "--poses" in printed and "Example" in printed


def run(polarmap, sequence, *more, out="out"):
    return polarmap("run", sequence, "--poses", sequence / "groundtruth.txt", "--out", sequence.parent / out, *more)


def test_missing_sequence(polarmap, tmp_path):
    refused(polarmap("inspect", tmp_path / "nowhere"), "nowhere", "no such file")


def test_missing_camera_file(polarmap, sequence):
    (sequence / "camera.yaml").unlink()
    refused(run(polarmap, sequence), "camera.yaml")


def test_malformed_camera_file(polarmap, sequence):
    (sequence / "camera.yaml").write_text("width: [640\n")
    refused(run(polarmap, sequence), "camera.yaml")


def test_wrong_bit_depth(polarmap, sequence):
    text = (sequence / "camera.yaml").read_text()
    (sequence / "camera.yaml").write_text(text.replace("bit_depth: 8", "bit_depth: 12").replace("Mono8", "Mono12"))
    refused(run(polarmap, sequence), "000000.png", "8 bits")


def test_wrong_size(polarmap, sequence):
    text = (sequence / "camera.yaml").read_text()
    (sequence / "camera.yaml").write_text(text.replace("width: 320", "width: 400"))
    refused(run(polarmap, sequence), "raw", "640x480", "800x480")


def test_truncated_image_keeps_what_was_done(polarmap, sequence):
    last = sequence / "raw" / "000009.png"
    last.write_bytes(last.read_bytes()[:-2000])
    refused(run(polarmap, sequence), "000009.png")
    out = sequence.parent / "out"
    results = json.loads((out / "results.json").read_text())
    assert results["status"] == "interrupted" and results["frames"] == 9
    assert (out / "report.html").exists()
    assert list((out / "keyframes").glob("*.npz")), "keyframes that were done must stay"


def test_a_missing_frame_is_named_and_the_others_are_mapped(polarmap, sequence, caplog):
    (sequence / "raw" / "000003.png").unlink()
    status, _, _ = run(polarmap, sequence)
    assert status == 0
    assert "frame 000003 is missing" in caplog.text


def test_a_missing_frame_whose_times_are_not_known(polarmap, sequence):
    (sequence / "raw" / "000003.png").unlink()
    times = (sequence / "timestamps.txt").read_text().splitlines()
    (sequence / "timestamps.txt").write_text("\n".join(times[:-2]) + "\n")
    refused(run(polarmap, sequence), "timestamps.txt", "000003")


def test_backward_timestamps(polarmap, sequence):
    lines = (sequence / "timestamps.txt").read_text().split()
    lines[4] = "0.0"
    (sequence / "timestamps.txt").write_text("\n".join(lines) + "\n")
    refused(run(polarmap, sequence), "timestamps.txt", "5")


def test_trajectory_of_another_time(polarmap, sequence):
    poses = np.loadtxt(sequence / "groundtruth.txt")
    poses[:, 0] += 1e6
    np.savetxt(sequence / "groundtruth.txt", poses)
    refused(run(polarmap, sequence), "groundtruth.txt", "1000000")
    assert not (sequence.parent / "out").exists()


def test_poses_that_are_not_numbers(polarmap, sequence):
    lines = (sequence / "groundtruth.txt").read_text().splitlines()
    lines[2] = "nan " * 8
    (sequence / "groundtruth.txt").write_text("\n".join(lines))
    refused(run(polarmap, sequence), "groundtruth.txt", "3")


def test_a_network_that_is_none(polarmap, sequence):
    (sequence / "midas.onnx").write_bytes(b"not a network")
    refused(run(polarmap, sequence, "--prior", sequence / "midas.onnx"), "midas.onnx")


def test_unwritable_output(polarmap, sequence):
    blocked = sequence.parent / "file"
    blocked.write_text("")
    refused(polarmap("run", sequence, "--poses", sequence / "groundtruth.txt", "--out", blocked / "out"), "file")


def test_output_is_not_overwritten(polarmap, sequence):
    out = sequence.parent / "out"
    out.mkdir()
    (out / "thesis.txt").write_text("mine")
    refused(run(polarmap, sequence), out, "--force")
    assert run(polarmap, sequence, "--force")[0] == 0
    assert (out / "thesis.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("setting", "word"),
    [("densify.max_steps=no", "max_steps"), ("densify.steps=3", "steps"), ("nothing", "section.name=value")],
)
def test_bad_settings(polarmap, sequence, setting, word):
    refused(run(polarmap, sequence, "--set", setting), word)


def test_eval_of_something_else(polarmap, recorded, tmp_path):
    refused(polarmap("eval", tmp_path, recorded), tmp_path)


@pytest.mark.slow
def test_a_full_disk_ends_the_run_with_status_1(recorded, tmp_path):
    """A limit on file size stands for the disk: the keyframe files do not fit, the text files do."""
    out = tmp_path / "out"
    program = (
        "import resource, signal, sys; signal.signal(signal.SIGXFSZ, signal.SIG_IGN); "
        "resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, 100_000)); "
        f"sys.argv = ['polarmap', 'run', {str(recorded)!r}, '--poses', {str(recorded / 'groundtruth.txt')!r}, "
        f"'--out', {str(out)!r}]; from polarmap.cli import main; main()"
    )
    ended = run_python(program)
    assert ended.status == 1
    assert "Traceback" not in ended.err and "keyframes" in ended.err
    assert not list(out.rglob("*.tmp"))
    assert json.loads((out / "results.json").read_text())["status"] == "interrupted"
