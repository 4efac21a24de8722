"""polarmap demo as a user meets it."""

from __future__ import annotations

import yaml

from polarmap.io.run_folder.folder import read_results
from polarmap.synth import scene_recording
from polarmap.synth.scene_recording import pinhole, record_scene


def test_a_demo_renders_maps_and_judges_the_scene_that_is_named(polarmap, monkeypatch, tmp_path):
    def small(folder, name, frames, **more):
        record_scene(folder, name, frames, pinhole(160, 120, 67.4), **more)

    monkeypatch.setattr(scene_recording, "record_scene", small)
    out = tmp_path / "demo"
    status, printed, error = polarmap("demo", "--out", out, "--scene", "things", "--frames", 6)
    assert status == 0, error
    assert yaml.safe_load((out / "sequence" / "synth.yaml").read_text())["scene"] == "things"
    assert "within 2 %" in printed and "curved" in printed
    assert read_results(out / "map").status == "complete"
    assert (out / "map" / "report.html").is_file()


def test_a_demo_of_no_scene_is_refused(polarmap, tmp_path):
    status, _, error = polarmap("demo", "--out", tmp_path / "demo", "--scene", "castle")
    assert status == 2 and len(error.strip().splitlines()) == 1
    assert "castle" in error and "things" in error and not (tmp_path / "demo").exists()
