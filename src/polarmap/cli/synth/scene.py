"""polarmap synth scene: sequences of the package's own scenes."""

from __future__ import annotations

import math
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer
from rich.table import Table

from polarmap.cli.common import console, rendering
from polarmap.cli.synth.options import FrameRate, PathSeed, Replace, SensorOptions, with_option_groups
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.geometry.camera import PinholeCamera

Frames = Annotated[int, typer.Option("--frames", min=1, max=100000, help="Frames to render.", metavar="N")]
Width = Annotated[int, typer.Option("--width", help="Of the image after the split; the mosaic is twice as wide.")]
Height = Annotated[int, typer.Option("--height", help="As the width.")]
Supersample = Annotated[
    int, typer.Option("--supersample", min=1, max=8, help="Rays along either side of a pixel.", metavar="N")
]
_FOV = math.degrees(2.0 * math.atan(2.0 / 3.0))  # a focal length of 480 at 640 pixels


@with_option_groups
def synth_scene(
    name: Annotated[str, typer.Argument(metavar="NAME", help="One of the scenes that --list names.")] = "",
    out: Annotated[Path | None, typer.Argument(metavar="OUT", help="Folder to write.", show_default=False)] = None,
    frames: Frames = 60,
    width: Width = 640,
    height: Height = 480,
    fov: Annotated[
        float, typer.Option("--fov", help="Horizontal field of view.", metavar="DEG", show_default="67.4")
    ] = _FOV,
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
    """Render one of the package's own scenes along a smooth hand-held path.

    bare-room, corridor, table and street are mostly bare, as the places where ordinary mapping leaves holes; --list has
    them all. The same options give the same files.

    Example: polarmap synth scene table table --frames 300
    """
    from polarmap.synth.scene_recording import pinhole, record_scene
    from polarmap.synth.scenes import SCENES

    if list_scenes:
        return _list(SCENES)
    if out is None:
        raise InputError("name a scene and a folder to write: polarmap synth scene NAME OUT")
    sensor = sensing.sensor()
    camera = pinhole(width, height, fov)
    with rendering(out, frames) as advance:
        record_scene(
            out, name, frames, camera, sensor, step, frame_rate, path_seed, supersample, force, on_frame=advance
        )
    if mitsuba is not None:
        _export(mitsuba, name, camera, path_seed)
    console.print(f"written: {out}, {frames} frames", soft_wrap=True, highlight=False)
    return None


def _export(path: Path, name: str, camera: PinholeCamera, path_seed: int) -> None:
    from polarmap.synth.mitsuba.export import write_mitsuba_scene
    from polarmap.synth.scenes import built_in_scene

    built_in = built_in_scene(name)
    _, poses = built_in.path(frames=1, seed=path_seed)
    write_mitsuba_scene(path, built_in.scene, camera, poses[0])


def _list(scenes: dict) -> None:
    table = Table("scene", "what it shows", highlight=False)
    for name, (_, description) in scenes.items():
        table.add_row(name, description)
    console.print(table)
