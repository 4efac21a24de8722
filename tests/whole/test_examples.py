"""The examples run as they stand, and the public names resolve."""

from __future__ import annotations

import runpy
import sys
from pathlib import Path

import pytest

import polarmap
from polarmap.geometry.camera import PinholeCamera
from polarmap.synth.recording import write_sequence
from polarmap.synth.rendering import render_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor

EXAMPLES = Path(__file__).parents[2] / "examples"


@pytest.fixture(scope="module")
def recording(tmp_path_factory):
    folder = tmp_path_factory.mktemp("recording")
    camera = PinholeCamera(width=240, height=180, fx=180.0, fy=180.0, cx=119.5, cy=89.5)
    room = built_in_scene("room")
    write_sequence(
        folder, render_sequence(room.scene, camera, *room.path(10), Sensor(), supersample=1), camera, Sensor()
    )
    return folder


def run_example(name, monkeypatch, capsys, *arguments):
    monkeypatch.setattr(sys, "argv", [name, *map(str, arguments)])
    runpy.run_path(str(EXAMPLES / name), run_name="__main__")
    return capsys.readouterr().out


def test_map_sequence(recording, monkeypatch, capsys):
    printed = run_example("map_sequence.py", monkeypatch, capsys, recording, recording / "groundtruth.txt")
    assert "keyframe 0: depth for" in printed and "triangles" in printed


def test_polarization_only(recording, monkeypatch, capsys):
    assert "median DoLP 0.0" in run_example("polarization_only.py", monkeypatch, capsys, recording)


def test_arrays_only(monkeypatch, capsys):
    assert "blocks of voxels" in run_example("arrays_only.py", monkeypatch, capsys)


def test_odometry(monkeypatch, capsys):
    printed = run_example("odometry.py", monkeypatch, capsys)
    assert "frame 0: starting" in printed and "frame 13: tracked\n" in printed and "14 poses" in printed


def test_public_names_resolve():
    for name in polarmap.__all__:
        assert getattr(polarmap, name) is not None
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = polarmap.nothing
