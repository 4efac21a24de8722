"""polarmap inspect: what a recording holds."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from polarmap.cli.common import CameraPath, RecordingPath, console, warn
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.recording import BagOptions, open_recording


@with_option_groups
def inspect(
    sequence: RecordingPath,
    camera: CameraPath = None,
    out: Annotated[
        Path | None, typer.Option(help="Folder for pictures of S0, DoLP, AoLP and normals.", metavar="OUT")
    ] = None,
    samples: Annotated[int, typer.Option(min=1, help="Frames to look at, spread over the sequence.")] = 5,
    *,
    bag: BagOptions,
) -> None:
    """Say what a recording holds, and picture it.

    Saturation, darkness, degree of polarization, the residual (I0+I90)-(I45+I135), which is a few percent of S0 for a
    sound sensor, and how far noise lets the angle be known. Warns where the pictures contradict the camera file: a
    colour sensor read as grey, a mosaic cropped by an odd number, grey pictures in place of mosaics.

    Pictures of normals show what polarization says alone: as if light came from the body and all faced upward, which a
    single picture does not tell. A run resolves that by its map.

    Example: polarmap inspect fruits.png --camera camera.yaml --out pictures
    """
    from polarmap.report.inspection import inspect_sequence
    from polarmap.report.inspection_table import inspection_table

    recording = open_recording(sequence, camera, bag)
    inspection = inspect_sequence(recording, samples, pictures_to=out)
    console.print(inspection_table(inspection))
    for finding in inspection.findings:
        warn(finding)
    if out is not None:
        console.print(f"pictures: {out}")
