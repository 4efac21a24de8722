"""polarmap eval: results against the truth."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated, Literal

import typer

from polarmap.cli.common import CameraPath, SequencePath, console, read_camera

ResultsFormat = Literal["auto", "polarmap", "colmap", "openmvs", "depth-png", "depth-npy", "ply", "trajectory"]
ScaleRule = Literal["auto", "as-is", "trajectory", "median"]


def evaluate(
    out: Annotated[
        Path,
        typer.Argument(metavar="OUT", help="Folder that 'polarmap run' or another program wrote, or a file of it."),
    ],
    sequence: SequencePath,
    json_file: Annotated[
        Path | None, typer.Option("--json", help="Also write all figures there.", metavar="FILE")
    ] = None,
    format: Annotated[ResultsFormat, typer.Option("--format", help="What wrote OUT; found out if not given.")] = "auto",
    scale: Annotated[
        ScaleRule,
        typer.Option(
            "--scale", help="How another program's depth is scaled: by its trajectory if it has one, or as named."
        ),
    ] = "auto",
    depth_scale: Annotated[
        float | None,
        typer.Option("--depth-scale", help="Values per metre of depth-png and depth-npy files.", metavar="VALUES"),
    ] = None,
    with_map: Annotated[
        bool, typer.Option("--map", help="Also accuracy and completeness of the mesh or cloud; some seconds more.")
    ] = False,
    thresholds: Annotated[
        list[float] | None,
        typer.Option("--threshold", help="Distance in metres for --map; may be repeated.", metavar="METRES"),
    ] = None,
    with_walls: Annotated[
        bool, typer.Option("--walls", help="Also how flat walls are reconstructed; some seconds more.")
    ] = False,
    per_keyframe: Annotated[bool, typer.Option("--keyframes", help="Also a line for each keyframe.")] = False,
    camera: CameraPath = None,
) -> None:
    """Compare a run, or another program's results, with the true depth and poses of the sequence.

    Other programs: COLMAP (dense workspace or sparse model), OpenMVS (\\*.dmap), depth maps as 16-bit PNG or
    .npy by the frames' names, a .ply of points or triangles, a trajectory file.

    Examples: polarmap eval out livingroom --json figures.json

    polarmap eval colmap/dense livingroom --map
    """
    from polarmap.evaluation.measure import evaluate_results
    from polarmap.evaluation.records import write_evaluation
    from polarmap.evaluation.surface import THRESHOLDS
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.report.evaluation_tables import evaluation_tables

    evaluation = evaluate_results(
        out,
        open_sequence(sequence, read_camera(camera, sequence)),
        format=format,
        scale=scale,
        depth_scale=depth_scale,
        with_map=with_map,
        with_walls=with_walls,
        thresholds=tuple(sorted(thresholds)) if thresholds else THRESHOLDS,
    )
    console.print(evaluation_tables(evaluation, per_keyframe))
    if json_file is not None:
        write_evaluation(json_file, evaluation)
