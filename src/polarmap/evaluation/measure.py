"""Evaluate any results, a run's or another program's: what `polarmap eval` does."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from functools import partial
from pathlib import Path

from polarmap.errors import InputError
from polarmap.evaluation.evaluate_import import ScaleRule, evaluate_import
from polarmap.evaluation.evaluate_run import evaluate_run
from polarmap.evaluation.imported import OWN_FORMAT, detect_format, import_run
from polarmap.evaluation.reconstruction import imported_reconstruction, measure_map, measure_walls, run_reconstruction
from polarmap.evaluation.records import Evaluation
from polarmap.evaluation.surface import THRESHOLDS
from polarmap.evaluation.truth import truth_of
from polarmap.io.recording.sequence import Sequence

_THRESHOLDS = (1e-6, 1e6)  # metres


def evaluate_results(
    path: Path | str,
    sequence: Sequence,
    *,
    format: str = "auto",
    scale: ScaleRule = "auto",
    depth_scale: float | None = None,
    indices: Collection[int] | None = None,
    with_map: bool = False,
    with_walls: bool = False,
    thresholds: tuple[float, ...] = THRESHOLDS,
) -> Evaluation:
    """Compare a run of `polarmap`, or another program's results, with the truth of their sequence.

    format: "polarmap" or one of `polarmap.evaluation.imported`; "auto": by what is there.
    scale, depth_scale, indices: of other programs' results alone, see `evaluate_import` and `import_run`.
    with_map, with_walls: also measure the surface, at distances of `thresholds` metres, and the walls.
    Raises InputError for a threshold that is no distance, as `evaluate_run`, `import_run`, `evaluate_import`,
    `measure_map` and `measure_walls` do, and where a rule for the scale is given for a run of `polarmap`, which
    has its own.
    """
    path, truth = Path(path), truth_of(sequence)
    for threshold in thresholds:
        if not _THRESHOLDS[0] <= threshold <= _THRESHOLDS[1]:
            raise InputError(f"a threshold of {threshold:g} m is not in [{_THRESHOLDS[0]:g}, {_THRESHOLDS[1]:g}]")
    if (detect_format(path) if format == "auto" else format) == OWN_FORMAT:
        if scale != "auto" or depth_scale is not None or indices is not None:
            raise InputError(
                f"{path}: is a run of polarmap, whose scale follows from its poses and is not to be chosen"
            )
        evaluation = evaluate_run(path, truth)
        reconstruct = partial(run_reconstruction, path, truth, evaluation)
    else:
        run = import_run(path, sequence, format, depth_scale)
        evaluation = evaluate_import(run, truth, scale, indices)
        reconstruct = partial(imported_reconstruction, run, truth, evaluation)
        if not run.frames and run.surface is not None and not with_map and not with_walls:
            raise InputError(f"{path}: points alone have no depth to compare; add --map or --walls")
    if not with_map and not with_walls:
        return evaluation
    reconstruction = reconstruct()
    return replace(
        evaluation,
        map=measure_map(reconstruction, truth, thresholds) if with_map else None,
        walls=measure_walls(reconstruction, truth) if with_walls else None,
    )
