"""polarmap synth scene and synth mitsuba as a user meets them."""

from __future__ import annotations

import numpy as np
import pytest
import yaml

from polarmap.io.recording.sequence import open_sequence
from polarmap.synth import scene_recording
from polarmap.synth.mitsuba.export import write_mitsuba_scene
from polarmap.synth.scene_recording import pinhole
from polarmap.synth.scenes import MATTE, built_in_scene, sphere

SMALL = ("--frames", 2, "--width", 40, "--height", 30, "--supersample", 1)


def test_a_scene_becomes_a_sequence(polarmap, tmp_path):
    out = tmp_path / "out"
    options = ("--fov", 80, "--step", 0.1, "--frame-rate", 10, "--bits", 12, "--shutter", 0.4, "--path-seed", 3)
    status, printed, _ = polarmap("synth", "scene", "corridor", out, *SMALL, *options)
    assert status == 0 and str(out) in printed.replace("\n", "")
    sequence = open_sequence(out)
    assert len(sequence) == 2 and sequence.camera_file.bit_depth == 12
    assert sequence.camera_file.camera == pinhole(40, 30, 80.0)
    np.testing.assert_allclose(sequence.timestamps, [0.0, 0.1])
    poses = sequence.truth_trajectory().poses
    assert np.linalg.norm(poses[1, :3, 3] - poses[0, :3, 3]) == pytest.approx(0.1, rel=0.05)
    written = yaml.safe_load((out / "synth.yaml").read_text())
    assert (written["scene"], written["step"], written["path_seed"]) == ("corridor", 0.1, 3)
    assert written["sensor"]["shutter"] == 0.4


def test_an_arc_has_a_lens_and_a_step_of_its_own(polarmap, tmp_path):
    out = tmp_path / "out"
    assert polarmap("synth", "scene", "things", out, *SMALL, "--path", "arc")[0] == 0
    sequence, arc = open_sequence(out), built_in_scene("things").arc
    assert sequence.camera_file.camera == pinhole(40, 30, arc.fov)
    first, second = sequence.truth_trajectory().poses[:, :3, 3]
    assert np.linalg.norm(second - first) == pytest.approx(arc.step, rel=0.1)
    written = yaml.safe_load((out / "synth.yaml").read_text())
    assert (written["path"], written["step"]) == ("arc", arc.step)
    assert polarmap("synth", "scene", "things", out, *SMALL, "--path", "arc", "--fov", 50, "--force")[0] == 0
    assert open_sequence(out).camera_file.camera == pinhole(40, 30, 50.0)


def test_a_scene_is_also_written_for_mitsuba(polarmap, tmp_path):
    status, _, _ = polarmap("synth", "scene", "table", tmp_path / "out", *SMALL, "--mitsuba", tmp_path / "table.xml")
    assert status == 0
    text = (tmp_path / "table.xml").read_text()
    assert text.count("<shape ") > 39 and 'type="pplastic"' in text
    assert len(list(tmp_path.glob("table_*.ply"))) == text.count('type="ply"') > 10


def test_the_scenes_are_listed(polarmap):
    status, printed, _ = polarmap("synth", "scene", "--list")
    assert status == 0
    for name in ("bare-room", "corridor", "table", "things", "street"):
        assert name in printed


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("castle", "OUT"), ("castle", "bare-room")),
        (("table",), ("NAME OUT",)),
        (("table", "OUT", "--width", 0), ("image size 0x30",)),
        (("table", "OUT", "--fov", 200), ("field of view",)),
        (("table", "OUT", "--step", -1), ("step",)),
        (("table", "OUT", "--step", "nan"), ("step",)),
        (("table", "OUT", "--frame-rate", "inf"), ("frame_rate",)),
        (("table", "OUT", "--step", 1e9), ("too many rounds",)),
        (("table", "OUT", "--shutter", 2), ("shutter",)),
        (("table", "OUT", "--bits", 9), ("--bits",)),
        (("table", "OUT", "--path", "arc"), ("no arc",)),
        (("things", "OUT", "--path", "arc", "--step", 0), ("arc: ", "step")),
    ],
)
def test_bad_options_are_one_clear_line_and_nothing_is_written(polarmap, tmp_path, arguments, words):
    out = tmp_path / "out"
    named = [out if a == "OUT" else a for a in arguments]
    status, _, error = polarmap("synth", "scene", named[0], *named[1:2], *SMALL, *named[2:])
    assert status == 2 and len(error.strip().splitlines()) == 1 and not out.exists()
    for word in words:
        assert word in error


def test_a_folder_in_use_is_kept_and_force_replaces_a_made_sequence(polarmap, tmp_path):
    (tmp_path / "mine.txt").write_text("mine")
    for options in ((), ("--force",)):
        status, _, error = polarmap("synth", "scene", "sphere", tmp_path, *SMALL, *options)
        assert status == 2 and "not empty, and not made by" in error
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]
    out = tmp_path / "out"
    assert polarmap("synth", "scene", "sphere", out, *SMALL)[0] == 0
    status, _, error = polarmap("synth", "scene", "sphere", out, *SMALL)
    assert status == 2 and "add --force" in error
    (out / "raw" / "notes.txt").write_text("mine")
    assert polarmap("synth", "scene", "sphere", out, *SMALL, "--frames", 1, "--force")[0] == 0
    assert len(open_sequence(out)) == 1 and [path.name for path in (out / "depth").iterdir()] == ["000000.png"]
    assert (out / "raw" / "notes.txt").read_text() == "mine"


@pytest.mark.parametrize(
    ("when", "words"), [("render_sequence", "make it anew with --force"), ("pinhole", "interrupted")]
)
def test_ctrl_c_is_one_line_and_status_130(polarmap, monkeypatch, tmp_path, when, words):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(scene_recording, when, interrupt)
    status, _, error = polarmap("synth", "scene", "sphere", tmp_path / "out", *SMALL)
    assert status == 130 and words in error and len(error.strip().splitlines()) == 1


def test_messages_hold_no_pictograms(polarmap, tmp_path):
    status, _, error = polarmap("synth", "rgbd", tmp_path, tmp_path / "out", "--frames", "::-1")
    assert status == 2 and "A:B:STEP" in error


def test_a_mitsuba_scene_becomes_a_sequence_along_given_poses(polarmap, tmp_path):
    pytest.importorskip("mitsuba", reason="Mitsuba is not installed (pip install mitsuba)")
    write_mitsuba_scene(tmp_path / "scene.xml", sphere(MATTE), pinhole(16, 12, 70.0), np.eye(4))
    (tmp_path / "path.txt").write_text("0.0 0 0 0 0 0 0 1\n0.1 0.02 0 0 0 0 0 1\n0.2 0.04 0 0 0 0 0 1\n")
    options = ("--poses", tmp_path / "path.txt", "--frames", 2, "--spp", 16, "--variant", "scalar_spectral_polarized")
    status, _, error = polarmap("synth", "mitsuba", tmp_path / "scene.xml", tmp_path / "out", *options)
    assert status == 0, error
    sequence = open_sequence(tmp_path / "out")
    assert sequence.camera_file.camera.shape == (12, 16) and sequence.timestamps.tolist() == [0.0, 0.1]
    written = yaml.safe_load((tmp_path / "out" / "synth.yaml").read_text())
    assert written["spp"] == 16 and written["sensor"]["exposure"] > 0
    assert written["frames"] == 2 and written["poses"].endswith("path.txt")
    status, _, error = polarmap("synth", "mitsuba", tmp_path / "absent.xml", tmp_path / "other")
    assert status == 2 and "absent.xml" in error and not (tmp_path / "other").exists()
    status, _, error = polarmap(
        "synth", "mitsuba", tmp_path / "scene.xml", tmp_path / "other", *options[:2], "--frames", 9
    )
    assert status == 2 and "holds 3 poses" in error
    for option, word in (("--exposure", "exposure"), ("--width", "image size 0x12")):
        status, _, error = polarmap("synth", "mitsuba", tmp_path / "scene.xml", tmp_path / "other", option, 0)
        assert status == 2 and word in error and not (tmp_path / "other").exists()
