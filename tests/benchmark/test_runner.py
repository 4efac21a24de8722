"""A benchmark from its specification to its tables: figures, resuming, cells that fail, and other programs' results."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
from run_samples import sample_keyframe, sample_map, true_depth, write_sequence

from polarmap.benchmark import measure as measuring
from polarmap.benchmark import runner as running
from polarmap.benchmark.cells import read_result
from polarmap.benchmark.measure import Measured, figures_of
from polarmap.benchmark.runner import Benchmark, Watcher
from polarmap.benchmark.spec import read_spec
from polarmap.data.keyframe import Stages
from polarmap.errors import InputError, PolarmapError
from polarmap.evaluation.walls import WallMetrics
from polarmap.io.formats.depth_png import write_depth_png

SPEC = """
sequences: [{name: slope, path: slope}, {name: step, path: step}]
methods: [{name: ours}, {name: coarse, settings: [paper.max_steps=2]}]
"""


@pytest.fixture
def folder(tmp_path):
    """Two sequences of a slanted plane and a specification."""
    for name in ("slope", "step"):
        write_sequence(tmp_path / name)
    (tmp_path / "spec.yaml").write_text(SPEC)
    return tmp_path


class Recorder(Watcher):
    """Names of the cells that were run, and of those that were not."""

    def __init__(self):
        self.run, self.kept = [], []

    def done(self, cell, result, again):
        (self.run if again else self.kept).append(cell.name)


def benchmark(folder, text=None, make=None) -> Benchmark:
    if text is not None:
        (folder / "spec.yaml").write_text(text)
    path = folder / "spec.yaml"
    return Benchmark(read_spec(path), path, folder / "out", make, Recorder())


def names(sequence="slope", method="ours", seed=0) -> str:
    return f"{sequence}/{method}, seed {seed}"


@pytest.fixture
def measured(monkeypatch):
    """Cells that give their number in place of mapping, or raise what is put into this mapping under their name."""
    failures: dict[str, BaseException] = {}
    calls = []

    def measure(cell, sequence, folder, keep_run, on_frame, indices):
        if cell.name in failures:
            raise failures[cell.name]
        calls.append(cell.name)
        return Measured({"depth.abs_rel": float(len(calls))}, versions={"polarmap": "1"})

    monkeypatch.setattr(running, "measure", measure)
    return failures


def test_what_is_done_is_not_run_again(folder, measured):
    first = benchmark(folder)
    results = first.run([])
    assert first.watcher.run == [names(s, m) for s in ("slope", "step") for m in ("ours", "coarse")]
    assert [r.figures["depth.abs_rel"] for r in results.values()] == [1, 2, 3, 4]
    again = benchmark(folder)
    assert again.run([]) == results
    assert again.watcher.run == [] and len(again.watcher.kept) == 4


def test_only_a_deleted_cell_is_run(folder, measured):
    benchmark(folder).run([])
    (folder / "out" / "cells" / "step" / "ours" / "seed0" / "result.json").unlink()
    again = benchmark(folder)
    results = again.run([])
    assert again.watcher.run == [names("step")]
    assert [r.figures["depth.abs_rel"] for r in results.values()] == [1, 2, 5, 4]


def test_a_damaged_result_is_none(folder, measured):
    benchmark(folder).run([])
    path = folder / "out" / "cells" / "step" / "ours" / "seed0" / "result.json"
    path.write_text(path.read_text()[:-20])
    again = benchmark(folder)
    again.run([])
    assert again.watcher.run == [names("step")]


def test_force_runs_all(folder, measured):
    benchmark(folder).run([])
    again = benchmark(folder)
    again.run(["slope/*"], force=True)
    assert again.watcher.run == [names(), names(method="coarse")]


def test_a_changed_setting_or_sequence_runs_its_cells_again(folder, measured):
    benchmark(folder).run([])
    changed = benchmark(folder, SPEC.replace("max_steps=2", "max_steps=3"))
    assert [key for key, result in changed.results().items() if result is None] == [
        ("slope", "coarse", 0),
        ("step", "coarse", 0),
    ]
    changed.run([])
    assert changed.watcher.run == [names(method="coarse"), names("step", "coarse")]
    (folder / "step" / "depth" / "000003.png").unlink()
    again = benchmark(folder)
    again.run([])
    assert again.watcher.run == [names("step"), names("step", "coarse")]


def test_an_interrupted_cell_is_run_again(folder, measured):
    measured[names("step")] = KeyboardInterrupt()
    stopped = benchmark(folder)
    with pytest.raises(KeyboardInterrupt):
        stopped.run([])
    known = stopped.results()
    assert [key for key, result in known.items() if result is not None] == [
        ("slope", "ours", 0),
        ("slope", "coarse", 0),
    ]
    measured.clear()
    again = benchmark(folder)
    again.run([])
    assert again.watcher.run == [names("step"), names("step", "coarse")]


def test_an_interrupted_cell_that_was_done_before_is_not_done_any_more(folder, measured):
    benchmark(folder).run([])
    measured[names("step")] = KeyboardInterrupt()
    with pytest.raises(KeyboardInterrupt):
        benchmark(folder).run(["step/ours"], force=True)
    assert benchmark(folder).results()["step", "ours", 0] is None


def test_a_cell_that_fails_does_not_stop_the_rest(folder, measured):
    measured[names()] = InputError("no frame\ncould be tracked")
    measured[names("step")] = ZeroDivisionError("division by zero")
    first = benchmark(folder)
    results = first.run([])
    assert [r.status for r in results.values()] == ["failed", "complete", "failed", "complete"]
    assert results["slope", "ours", 0].reason == "no frame could be tracked"
    reason = "internal error, see traceback.txt: ZeroDivisionError: division by zero"
    assert results["step", "ours", 0].reason == reason
    trace = folder / "out" / "cells" / "step" / "ours" / "seed0" / "traceback.txt"
    assert "ZeroDivisionError" in trace.read_text()
    measured.clear()
    again = benchmark(folder)
    assert all(r.status == "complete" for r in again.run([]).values())
    assert again.watcher.run == [names(), names("step")]
    assert not trace.exists()


def test_what_is_missing_is_said_before_anything_is_run(folder, measured):
    text = SPEC.replace("path: step", "path: stepp")
    with pytest.raises(InputError, match=r"spec\.yaml: sequence step: .*stepp: no such folder"):
        benchmark(folder, text).run([])
    with pytest.raises(InputError, match=r"spec\.yaml: method coarse: settings: .*max_stepz"):
        benchmark(folder, SPEC.replace("max_steps", "max_stepz")).run([])
    text = SPEC.replace("{name: ours}", "{name: ours, prior: net.onnx}")
    with pytest.raises(InputError, match=r"spec\.yaml: method ours: .*net\.onnx: no such file"):
        benchmark(folder, text).run([])
    assert not (folder / "out").exists()


def test_a_folder_with_other_things_is_left_alone(folder, measured):
    (folder / "out").mkdir()
    (folder / "out" / "thesis.txt").write_text("mine")
    with pytest.raises(InputError, match="is not empty and not a benchmark's"):
        benchmark(folder).run([])


SYNTH = "sequences: [{name: made, synth: scene $SCENE --frames 4}]\nmethods: [{name: ours}]\nseeds: [0, 7]\n"


def test_a_sequence_is_made_once_for_each_seed(folder, measured, monkeypatch):
    monkeypatch.setenv("SCENE", "table")
    made = []

    def make(arguments, where):
        made.append(arguments)
        assert where == folder
        write_sequence(Path(arguments[4]))

    benchmark(folder, SYNTH + "\n", make).run([])
    assert [a[:4] + a[5:] for a in made] == [["scene", "table", "--frames", "4", "--seed", s] for s in "07"]
    assert [path.name for path in sorted((folder / "out" / "sequences").iterdir())] == ["made_seed0", "made_seed7"]
    benchmark(folder, SYNTH + "keep: figures\n", make).run([], force=True)
    assert len(made) == 2
    other = benchmark(folder, SYNTH.replace("4", "5"), make)
    other.run([])
    assert len(made) == 4 and len(other.watcher.run) == 2


def test_a_sequence_that_cannot_be_made_fails_its_cells(folder, measured, monkeypatch):
    monkeypatch.setenv("SCENE", "table")
    tried = []

    def make(arguments, where):
        tried.append(arguments)
        Path(arguments[4]).mkdir()
        raise PolarmapError("no such scene")

    text = SYNTH.replace("[{name: ours}]", "[{name: ours}, {name: other}]").replace("[0, 7]", "[0]")
    results = benchmark(folder, text, make).run([])
    assert [r.reason for r in results.values()] == ["no such scene"] * 2 and len(tried) == 1
    assert all(r.status == "failed" for r in benchmark(folder, text, make).results().values())
    write = lambda arguments, where: write_sequence(Path(arguments[4]))  # noqa: E731
    assert all(r.status == "complete" for r in benchmark(folder, text, write).run([]).values())


def test_a_made_sequence_replaces_nothing_else(folder, measured, monkeypatch):
    monkeypatch.setenv("SCENE", "table")
    mine = folder / "out" / "sequences" / "made_seed0"
    mine.mkdir(parents=True)
    (mine / "thesis.txt").write_text("mine")
    (folder / "out" / "spec.yaml").write_text("")
    results = benchmark(folder, SYNTH, lambda a, w: write_sequence(Path(a[4]))).run([])
    assert "is in the way" in results["made", "ours", 0].reason
    assert results["made", "ours", 7].status == "complete"
    assert (mine / "thesis.txt").read_text() == "mine"


def test_frames_that_a_sequence_does_not_have(folder, measured):
    results = benchmark(folder, SPEC.replace("path: step", "path: step, frames: '9:'")).run(["step"])
    assert "has 4 frames, and none of 9:" in results["step", "ours", 0].reason


# From here on cells are measured in earnest, on a run whose errors are known.

FACTOR = np.repeat(np.float32([1.01, 1.1, 1.5]), 16)[:, None]


@pytest.fixture
def mapped(monkeypatch):
    """Mapping that makes depth 1, 10 and 50 % too far in the upper, middle and lower rows of two keyframes."""

    def run_sequence(sequence, poses, writer, prior, config, on_frame):
        with writer:
            for frame in sequence:
                T = poses.at(frame.timestamp)
                writer.add_frame(frame.timestamp, T)
                on_frame(1, None)
                if frame.index in (0, 3):
                    depth = FACTOR * np.nan_to_num(true_depth(frame.index), nan=2.0)
                    stereo = np.where(np.arange(48)[:, None] < 16, depth, np.float32(np.nan))
                    stages = Stages(stereo, stereo, depth)
                    writer.add_keyframe(sample_keyframe(frame.index, depth, T_world_camera=T, stages=stages))
            writer.add_map(sample_map())

    monkeypatch.setattr(measuring, "run_sequence", run_sequence)


def test_figures_of_a_cell(folder, mapped):
    text = SPEC.replace("path: step", "path: step, frames: '0:4'").replace("{name: ours}", "{name: ours, title: A & B}")
    results = benchmark(folder, text).run(["*/ours"])
    result = results["slope", "ours", 0]
    assert result.status == "complete" and result.notes == []
    figures = result.figures
    assert figures["depth.abs_rel"] == pytest.approx((0.01 + 0.1 + 0.5) / 3, abs=1e-4)
    assert figures["stages.inliers.abs_rel"] == pytest.approx(0.01, abs=1e-4)
    assert figures["depth.within_5"] == pytest.approx(62 / 64 / 3)
    assert (figures["run.frames"], figures["run.keyframes"], figures["run.map_points"]) == (4, 2, 4)
    assert figures["run.depth_points"] == 2 * 48 * 64
    assert figures["run.ms_per_keyframe"] == pytest.approx(101.5 + 50 + 12 / 2)
    assert 0 <= figures["map.fscore.0.02"] <= 1
    assert figures["walls.within.0.05"] <= figures["walls.within.0.2"]
    assert result.curves["confidence"].x[-1] == pytest.approx(1.0)
    assert result.milliseconds["densify"].median == 50.0
    assert result.versions["polarmap"] and result.cpu_count
    assert (
        read_result(folder / "out" / "cells" / "slope" / "ours" / "seed0").model_dump_json() == result.model_dump_json()
    )
    run = folder / "out" / "cells" / "slope" / "ours" / "seed0" / "run"
    assert "AbsRel" in (run / "report.html").read_text()


def test_a_cell_may_keep_its_figures_alone(folder, mapped):
    benchmark(folder, SPEC + "keep: figures\n").run(["slope/ours"])
    cell = folder / "out" / "cells" / "slope" / "ours" / "seed0"
    assert [path.name for path in cell.iterdir()] == ["result.json"]


def test_true_poses_must_be_there(folder, mapped):
    (folder / "slope" / "groundtruth.txt").unlink()
    result = benchmark(folder).run(["slope/ours"])["slope", "ours", 0]
    assert "no groundtruth.txt" in result.reason and "poses: odometry" in result.reason


IMPORT = (
    "sequences: [{name: slope, path: slope}]\nmethods: [{name: net, kind: import, path: 'net/{sequence}/{seed}'}]\n"
)


def test_another_programs_depth_is_measured_by_the_same_code(folder):
    for seed, factor in ((0, 1.02), (4, 1.04)):
        depth = folder / "net" / "slope" / str(seed)
        depth.mkdir(parents=True)
        for i in range(4):
            write_depth_png(depth / f"{i:06d}.png", np.float32(factor) * true_depth(i), 5000.0)
    results = benchmark(folder, IMPORT + "seeds: [0, 4, 5]\n").run([])
    errors = [results["slope", "net", seed].figures["depth.abs_rel"] for seed in (0, 4)]
    assert errors == pytest.approx([0.02, 0.04], abs=2e-4)
    assert results["slope", "net", 0].figures["run.depth_points"] == 4 * 48 * 62
    assert "scale: none: depth is taken as it is" in results["slope", "net", 0].notes
    assert "net/slope/5: no such file or folder; put the results of slope/net" in results["slope", "net", 5].reason
    again = benchmark(folder)
    write_depth_png(folder / "net" / "slope" / "4" / "000002.png", true_depth(2), 5000.0)
    again.run([])
    assert again.watcher.kept == [names(method="net")]  # seed 4 has changed, seed 5 failed
    assert again.watcher.run == [names(method="net", seed=4), names(method="net", seed=5)]


def test_another_program_is_compared_at_the_same_frames(folder, mapped):
    (folder / "net" / "slope").mkdir(parents=True)
    for i in range(4):
        factor = np.float32(1.02 if i in (0, 3) else 1.5)
        write_depth_png(folder / "net" / "slope" / f"{i:06d}.png", factor * true_depth(i), 5000.0)
    text = IMPORT.replace("[{name: net,", "[{name: ours}, {name: net, keyframes_of: ours,").replace("/{seed}", "")
    assert "has no keyframes" in benchmark(folder, text).run(["slope/net"])["slope", "net", 0].reason
    results = benchmark(folder, text).run([])
    assert results["slope", "ours", 0].keyframes == results["slope", "net", 0].keyframes == [0, 3]
    assert results["slope", "net", 0].figures["depth.abs_rel"] == pytest.approx(0.02, abs=2e-4)
    again = benchmark(folder)
    again.run([])
    assert again.watcher.run == []


def test_shares_are_named_by_their_threshold():
    walls = WallMetrics("points", (), (0.01, 0.05), (0.25, 0.5), (float("nan"),) * 2, (0.1, 0.2))
    figures = figures_of({"walls": walls, "sparse": False, "run": "x", "count": 3})
    assert np.isnan(figures.pop("walls.of_all.0.01")) and np.isnan(figures.pop("walls.of_all.0.05"))
    assert figures == {
        "walls.within.0.01": 0.25,
        "walls.within.0.05": 0.5,
        "walls.of_truth.0.01": 0.1,
        "walls.of_truth.0.05": 0.2,
        "count": 3.0,
    }


def test_the_command_writes_tables(polarmap, folder, mapped):
    out = folder / "out"
    (folder / "spec.yaml").write_text(SPEC.replace(", {name: step, path: step}", ""))
    status, printed, said = polarmap("bench", folder / "spec.yaml", "--out", out, "--only", "slope/ours")
    assert status == 0 and f"tables: {out / 'tables.md'}" in printed
    assert "slope/ours, seed 0: AbsRel 0.2033, density 100.0 %" in said
    page = (out / "tables.md").read_text()
    assert "| AbsRel | slope | 0.2033 | not run | – | – | – | – |" in page
    assert json.loads((out / "tables" / "accuracy.json").read_text())["name"] == "accuracy"
    assert (out / "plots" / "confidence.png").exists() and (out / "plots" / "wall.svg").exists()
    assert polarmap("bench", folder / "spec.yaml", "--out", out)[0] == 0
    assert "not run" not in (out / "tables.md").read_text()


SMALL = """
sequences: [{name: room, synth: scene room --frames 6 --width 160 --height 120 --supersample 1}]
methods: [{name: ours, settings: [fusion.min_faces=0]}]
seeds: [5]
"""


def test_a_made_sequence_is_mapped_and_measured(polarmap, tmp_path):
    """All in earnest, on six small frames."""
    (tmp_path / "spec.yaml").write_text(SMALL)
    out = tmp_path / "out"
    assert polarmap("bench", tmp_path / "spec.yaml", "--out", out)[0] == 0
    result = read_result(out / "cells" / "room" / "ours" / "seed5")
    assert 0 < result.figures["depth.abs_rel"] < 0.3
    assert result.figures["run.frames"] == 6 and result.figures["trajectory.rigid"] < 1e-6
    assert (out / "sequences" / "room_seed5" / "groundtruth.txt").exists()
    assert polarmap("bench", tmp_path / "spec.yaml", "--out", out)[0] == 0
    assert read_result(out / "cells" / "room" / "ours" / "seed5").model_dump_json() == result.model_dump_json()


def test_a_failure_is_in_the_tables_and_in_the_exit_status(polarmap, folder, measured):
    measured[names()] = PolarmapError("the disk is full")
    status, printed, said = polarmap("bench", folder / "spec.yaml", "--out", folder / "out")
    assert status == 1
    assert "1 of 4 cells failed" in said and "slope, ours, seed 0: failed: the disk is full" in printed
    page = (folder / "out" / "tables.md").read_text()
    assert "| AbsRel | slope | failed (1) | 1.0000 |" in page
    assert "1. slope, ours, seed 0: failed: the disk is full" in page


def test_an_interruption_leaves_the_tables_of_what_was_done(polarmap, folder, measured):
    measured[names("step")] = KeyboardInterrupt()
    status, _, said = polarmap("bench", folder / "spec.yaml", "--out", folder / "out")
    assert status == 130 and "the same command goes on" in said
    assert "| AbsRel | slope | 1.0000 | 2.0000 |" in (folder / "out" / "tables.md").read_text()


def test_bad_input_is_one_line(polarmap, folder):
    for arguments, words in (
        (("bench", folder / "nowhere.yaml", "--out", folder / "out"), "nowhere.yaml: no such file"),
        (("bench", folder / "spec.yaml", "--out", folder / "out", "--only", "a/b"), "--only a/b: there is no such"),
    ):
        status, _, said = polarmap(*arguments)
        assert status == 2 and len(said.strip().splitlines()) == 1 and words in said


@pytest.mark.parametrize("path", sorted((Path(__file__).parents[2] / "benchmarks" / "specs").glob("*.yaml")), ids=str)
def test_the_ready_made_specifications_are_valid(path, monkeypatch):
    for name in ("POLARMAP_DATA", "POLARMAP_MODELS"):
        monkeypatch.setenv(name, "/elsewhere")
    assert read_spec(path).sequences


def test_synth_arguments_that_make_nothing_are_said(folder, measured, monkeypatch):
    monkeypatch.setenv("SCENE", "--help")
    results = benchmark(folder, SYNTH, lambda arguments, where: None).run([])
    assert "'polarmap synth scene --help" in results["made", "ours", 0].reason
    assert results["made", "ours", 0].reason.endswith("makes none")
