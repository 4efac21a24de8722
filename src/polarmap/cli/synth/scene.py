"""polarmap synth scene: sequences of the package's own scenes."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from polarmap.cli.common import console, rendering
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.synth.options import FrameRate, PathSeed, Replace, SensorOptions
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.geometry.camera import PinholeCamera

Frames = Annotated[int, typer.Option("--frames", min=1, max=100000, help="Frames to render.", metavar="N")]
Width = Annotated[int, typer.Option("--width", help="Of the image after the split; the mosaic is twice as wide.")]
Height = Annotated[int, typer.Option("--height", help="As the width.")]
Supersample = Annotated[
    int, typer.Option("--supersample", min=1, max=8, help="Rays along either side of a pixel.", metavar="N")
]
PathKind = Literal["hand-held", "arc"]


@with_option_groups
def synth_scene(
    name: Annotated[str, typer.Argument(metavar="NAME", help="One of the scenes that --list names.")] = "",
    out: Annotated[Path | None, typer.Argument(metavar="OUT", help="Folder to write.", show_default=False)] = None,
    frames: Frames = 60,
    width: Width = 640,
    height: Height = 480,
    path: Annotated[
        PathKind, typer.Option("--path", help="Hand-held, or a wide arc about the things; 'things' has one.")
    ] = "hand-held",
    fov: Annotated[
        float | None,
        typer.Option(
            "--fov", help="Horizontal field of view; 67.4 if not given, for an arc the scene's own.", metavar="DEG"
        ),
    ] = None,
    step: Annotated[
        float | None, typer.Option("--step", help="Way per frame; the scene's own if not given.", metavar="M")
    ] = None,
    frame_rate: FrameRate = 30.0,
    path_seed: PathSeed = 0,
    supersample: Supersample = 2,
    *,
    sensing: SensorOptions,
    force: Replace = False,
    mitsuba: Annotated[
        Path | None,
        typer.Option("--mitsuba", help="Also write the first view as a Mitsuba scene there.", metavar="FILE.xml"),
    ] = None,
    list_scenes: Annotated[bool, typer.Option("--list", help="Name the scenes.")] = False,
) -> None:
    """Render one of the package's own scenes along a smooth hand-held path, or an arc.

    bare-room, corridor, table and street are mostly bare, as the places where ordinary mapping leaves holes; things are
    glossy and curved; --list has them all. The same options give the same files.

    Examples: polarmap synth scene table table --frames 300

    polarmap synth scene things orbit --path arc --frames 22
    """
    from polarmap.synth.scene_recording import pinhole, record_scene
    from polarmap.synth.scenes import SCENES, built_in_scene

    if list_scenes:
        return _list(SCENES)
    if out is None:
        raise InputError("name a scene and a folder to write: polarmap synth scene NAME OUT")
    sensor = sensing.sensor()
    camera = pinhole(width, height, built_in_scene(name).fov_of(path) if fov is None else fov)
    with rendering(out, frames) as advance:
        record_scene(out, name, frames, camera, sensor, step, frame_rate, path_seed, supersample, force, advance, path)
    if mitsuba is not None:
        _export(mitsuba, name, camera, path, path_seed)
    console.print(f"written: {out}, {frames} frames", soft_wrap=True, highlight=False)
    return None


def _export(file: Path, name: str, camera: PinholeCamera, path: PathKind, path_seed: int) -> None:
    from polarmap.synth.mitsuba.export import write_mitsuba_scene
    from polarmap.synth.scenes import built_in_scene

    built_in = built_in_scene(name)
    _, poses = built_in.path(frames=1, seed=path_seed, kind=path)
    write_mitsuba_scene(file, built_in.scene, camera, poses[0])


def _list(scenes: dict) -> None:
    table = Table("scene", "what it shows", highlight=False)
    for name, (_, description) in scenes.items():
        table.add_row(name, description)
    console.print(table)
