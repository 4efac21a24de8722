"""Runs one cell: maps its sequence, or takes what another program made of it, and measures that against the truth."""

from __future__ import annotations

import os
import platform
import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields, is_dataclass
from pathlib import Path
from typing import Any

from polarmap.benchmark.cells import Cell, Curve
from polarmap.benchmark.configuration import import_path, parameters
from polarmap.benchmark.spec import ImportMethod, MappingMethod
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.measure import evaluate_results
from polarmap.evaluation.records import Evaluation, write_evaluation
from polarmap.evaluation.sparse import evaluate_sparse
from polarmap.evaluation.truth import truth_of
from polarmap.io.recording.sequence import Sequence
from polarmap.io.run_folder.folder import EVALUATION_NAME, read_results
from polarmap.io.run_folder.results import RunResults, StepTime
from polarmap.pipeline.poses.found import OdometryPoses, odometry_poses
from polarmap.pipeline.poses.source import PoseSource
from polarmap.prior.priors import make_prior
from polarmap.report.html import write_report
from polarmap.report.run_writer import RunWriter
from polarmap.run import require_times, run_sequence

RUN_FOLDER = "run"

_LONG = ("keyframes", "segments", "curve")  # of an evaluation: not single figures


@dataclass(frozen=True)
class Measured:
    """What a cell gave; see `CellResult`."""

    figures: dict[str, float]
    keyframes: list[int] = field(default_factory=list)
    curves: dict[str, Curve] = field(default_factory=dict)
    notes: list[str] = field(default_factory=list)
    milliseconds: dict[str, StepTime] = field(default_factory=dict)
    versions: dict[str, str] = field(default_factory=dict)


def measure(
    cell: Cell,
    sequence: Sequence,
    folder: Path,
    keep_run: bool,
    on_frame: Callable[[], None],
    indices: list[int] | None = None,
) -> Measured:
    """Run a cell in its folder. on_frame: called after each frame that is mapped.

    indices: the frames at which another program's results are compared, all that it has if None.

    Raises InputError or PolarmapError as mapping and evaluation do.
    """
    if isinstance(cell.method, ImportMethod):
        return _import(cell, sequence, indices)
    return _map(cell.method, cell.seed, sequence, folder / RUN_FOLDER, keep_run, on_frame)


def machine() -> dict[str, Any]:
    """What a cell is run on, as `CellResult` has it."""
    return {
        "machine": f"{platform.system()} {platform.machine()}",
        "processor": _processor(),
        "cpu_count": os.cpu_count(),
    }


def figures_of(value: Any, path: str = "") -> dict[str, float]:
    """Every number in nested dataclasses and dictionaries by its path, such as "depth.abs_rel".

    Shares by threshold have that in their path too, such as "map.precision.0.02".
    """
    if is_dataclass(value):
        value = {f.name: getattr(value, f.name) for f in fields(value)}
    if isinstance(value, Mapping):
        parts = dict(value)
        limits = parts.pop("thresholds", ())
        for name, part in value.items():
            if limits and isinstance(part, tuple) and len(part) == len(limits) and name in parts:
                parts[name] = dict(zip(map(str, limits), part, strict=True))
        found = [figures_of(part, f"{path}.{name}".removeprefix(".")) for name, part in parts.items()]
        return {name: number for figures in found for name, number in figures.items()}
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return {path: float(value)} if number else {}


def _map(method: MappingMethod, seed, sequence, run: Path, keep_run, on_frame) -> Measured:
    config = parameters(method)
    truth = sequence.truth_trajectory()
    poses = _poses(method, sequence, truth, config, seed)
    writer = RunWriter(
        run,
        config,
        sequence.camera_file.camera,
        sequence=str(sequence.path),
        poses="odometry" if method.poses == "odometry" else "given",
        pose_source="" if method.poses == "odometry" else truth.source,
        force=True,
        stages=True,
    )
    run_sequence(sequence, poses, writer, make_prior(method.prior, config.prior), config, lambda *_: on_frame())
    evaluation, unmeasured = _evaluated(run, sequence)
    results = read_results(run)
    measured = Measured(
        figures=_figures(evaluation) | _run_figures(results) | _sparse_figures(poses, sequence),
        keyframes=[keyframe.index for keyframe in evaluation.keyframes],
        curves=_curves(evaluation),
        notes=_pose_notes(results) + _notes(evaluation) + unmeasured,
        milliseconds=results.milliseconds,
        versions=results.versions,
    )
    if keep_run:
        write_evaluation(run / EVALUATION_NAME, evaluation)
        write_report(run)
    else:
        shutil.rmtree(run)
    return measured


def _poses(
    method: MappingMethod, sequence: Sequence, truth: Trajectory | None, config, seed: int
) -> Trajectory | PoseSource:
    if method.poses == "odometry":
        require_times(sequence)
        return odometry_poses(sequence.camera_file, config, seed)
    if truth is None:
        raise InputError(f"{sequence.path}: no groundtruth.txt, which poses: true needs; use poses: odometry")
    return truth


def _import(cell: Cell, sequence: Sequence, indices: list[int] | None) -> Measured:
    method, path = cell.method, import_path(cell)
    rules = {
        "format": method.format,
        "scale": method.scale,
        "depth_scale": method.depth_scale,
        "indices": None if indices is None else set(indices),
    }
    evaluation, unmeasured = _evaluated(path, sequence, **rules)
    figures = _figures(evaluation)
    figures["run.keyframes"] = float(len(evaluation.keyframes))
    if evaluation.keyframes:
        figures["run.depth_points"] = float(sum(keyframe.depth.points for keyframe in evaluation.keyframes))
    # how its scale was found makes the figures better or worse
    notes = [f"scale: {evaluation.scale.reason}", *_notes(evaluation), *unmeasured]
    keyframes = [keyframe.index for keyframe in evaluation.keyframes]
    return Measured(figures, keyframes, _curves(evaluation), notes)


def _evaluated(path: Path, sequence: Sequence, **rules: Any) -> tuple[Evaluation, list[str]]:
    """The evaluation, with map and walls where there is something to measure, and a note where there is not."""
    try:
        return evaluate_results(path, sequence, **rules, with_map=True, with_walls=True), []
    except InputError as error:
        return evaluate_results(path, sequence, **rules), [f"map and walls are not measured: {error}"]


def _figures(evaluation: Evaluation) -> dict[str, float]:
    return figures_of({f.name: getattr(evaluation, f.name) for f in fields(evaluation) if f.name not in _LONG})


def _run_figures(results: RunResults) -> dict[str, float]:
    keyframes = results.keyframes
    spent = [
        t.median if t.median is not None else t.total / max(len(keyframes), 1) for t in results.milliseconds.values()
    ]
    return {
        "run.frames": float(results.frames),
        "run.posed": float(results.posed),
        "run.keyframes": float(len(keyframes)),
        "run.map_points": float("nan") if results.map is None else float(results.map.points),
        "run.depth_points": float(sum(keyframe.points for keyframe in keyframes)),
        "run.ms_per_keyframe": sum(spent) if keyframes else float("nan"),
        "run.seconds": results.seconds,
    }


def _sparse_figures(poses: Trajectory | PoseSource, sequence: Sequence) -> dict[str, float]:
    """Odometry's own points as depth, the first step of the ablation; nothing where the poses were given."""
    if not isinstance(poses, OdometryPoses):
        return {}
    try:
        sparse = evaluate_sparse(poses.odometry.result(), truth_of(sequence))
    except InputError:
        return {}
    return figures_of(sparse.depth, "stages.sparse")


def _curves(evaluation: Evaluation) -> dict[str, Curve]:
    curves = {}
    if evaluation.curve.density:
        curves["confidence"] = Curve(x=list(evaluation.curve.density), y=list(evaluation.curve.abs_rel))
    if evaluation.walls is not None:
        curves["wall"] = Curve(x=list(evaluation.walls.thresholds), y=list(evaluation.walls.within))
    return curves


def _pose_notes(results: RunResults) -> list[str]:
    lost = results.frames - results.posed
    return [f"{lost} of {results.frames} frames have no pose"] if lost else []


def _notes(evaluation: Evaluation) -> list[str]:
    notes = []
    if evaluation.without_scale:
        notes.append(f"{evaluation.without_scale} keyframes are left out, since their scale is not known")
    if evaluation.without_truth:
        notes.append(f"{evaluation.without_truth} keyframes are left out, since they have no true depth")
    return notes


def _processor() -> str:
    """The processor's name where the system tells it."""
    try:
        lines = Path("/proc/cpuinfo").read_text("utf-8", "replace").splitlines()
    except OSError:
        return platform.processor()
    names = [line.partition(":")[2].strip() for line in lines if line.startswith("model name")]
    return names[0] if names else platform.processor()
