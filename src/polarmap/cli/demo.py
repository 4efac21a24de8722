"""polarmap demo: a recording is made, mapped and judged."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from polarmap.cli.common import Force, Out, console, read_parameters, rendering
from polarmap.cli.mapping import map_recording
from polarmap.prior.names import DEFAULT_PRIOR


def demo(
    out: Out = Path("demo"),
    scene: Annotated[
        str, typer.Option(help="Which of the scenes that 'polarmap synth scene --list' names.", metavar="NAME")
    ] = "room",
    frames: Annotated[int, typer.Option(min=2, max=1000, help="Frames to render.")] = 24,
    force: Force = False,
) -> None:
    """Render a small room with bare walls, or another scene, map it, and print how accurate the map is.

    The recording goes to OUT/sequence in the format of a real one, the map to OUT/map.
    """
    from polarmap.evaluation.evaluate_run import evaluate_run
    from polarmap.evaluation.truth import truth_of
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.prior.priors import make_prior
    from polarmap.report.evaluation_tables import evaluation_tables
    from polarmap.synth.scene_recording import record_scene

    parameters = read_parameters(None, None)
    folder = out / "sequence"
    with rendering(folder, frames) as advance:
        record_scene(folder, scene, frames, force=force, on_frame=advance)
    recording = open_sequence(folder)
    prior = make_prior(DEFAULT_PRIOR, parameters.prior)
    map_recording(recording, recording.truth_trajectory(), prior, parameters, out / "map", stages=True, force=force)
    console.print(evaluation_tables(evaluate_run(out / "map", truth_of(recording))))
