"""The benchmarks of live runs run to their end, on a few small frames; what they measure is not looked at."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

import numpy as np
import pytest

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def benchmark(monkeypatch, capsys):
    """Runs a script of benchmarks/ with arguments; gives what it printed, line by line, as cells."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.setenv("COLUMNS", "120")

    def run(name: str, *arguments: str) -> list[list[str]]:
        monkeypatch.setattr(sys, "argv", [name, *arguments])
        importlib.import_module(name).main()
        lines = capsys.readouterr().out.splitlines()
        return [[cell.strip() for cell in line.strip("│┃").split("│")] for line in lines]

    return run


def test_how_mapping_keeps_up(benchmark):
    small = ("--sizes", "240x180", "--rendered", "20", "--frames", "45", "--repeats", "1")
    rows = {cells[0]: cells[-1] for cells in benchmark("bench_live", *small) if len(cells) == 3}
    assert float(rows["seconds of recording"]) == pytest.approx(44 / 30, abs=0.01)
    assert float(rows["real-time factor"]) > 0
    assert int(rows["frames"]) + int(rows["frames missed"]) == 45
    assert int(rows["keyframes mapped"]) > 0


def test_memory_of_a_live_run(benchmark, monkeypatch):
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    monkeypatch.setattr(importlib.import_module("bench_live_memory"), "RENDERED", 20)
    lines = benchmark("bench_live_memory", "--frames", "45", "--every", "15")
    rows = [cells for cells in lines if len(cells) == 5 and cells[0].isdigit()]
    assert [cells[0] for cells in rows[-3:]] == ["15", "30", "45"]
    assert all(float(cells[1]) > 0 for cells in rows)
    assert any("MB per 1000 frames, from frame 30 to 45" in cells[0] for cells in lines)
    assert any(cells[0].startswith("frames missed: 0;") for cells in lines)


def test_frames_that_are_played_forth_and_back(monkeypatch, tmp_path):
    """Each picture but those at the ends comes once in either direction, at even times, as the file has it."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    rooms = importlib.import_module("rooms")
    recording = rooms.recorded_room(tmp_path / "room", 32, 24, frames=4, step=0.1)
    played = rooms.forth_and_back(recording, 9, rate=10.0)
    shown = [0, 1, 2, 3, 2, 1, 0, 1, 2]
    assert [frame.index for frame in played] == list(range(9))
    np.testing.assert_allclose(played.timestamps, np.arange(9) / 10)
    for frame, number in zip(played, shown, strict=True):
        np.testing.assert_array_equal(frame.mosaic, recording[number].mosaic)
