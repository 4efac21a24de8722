"""polarmap synth mitsuba: sequences of Mitsuba scenes."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Annotated

import typer

from polarmap.cli.common import console, rendering
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.synth.options import FrameRate, OutFolder, PathSeed, Replace, SensorOptions
from polarmap.errors import InputError


@dataclass(frozen=True)
class SensorOptionsOfScene(SensorOptions):
    """The same, with an exposure that the scene's brightness decides unless it is given."""

    exposure: Annotated[
        float | None, typer.Option("--exposure", help="Factor on the brightness; from the first view if not given.")
    ] = None


@with_option_groups
def synth_mitsuba(
    scene: Annotated[Path, typer.Argument(metavar="SCENE.xml", help="Scene file of Mitsuba 3.")],
    out: OutFolder,
    poses: Annotated[
        Path | None,
        typer.Option("--poses", help="Trajectory (TUM, EuRoC); a hand-held path if not given.", metavar="FILE"),
    ] = None,
    frames: Annotated[
        int | None, typer.Option("--frames", min=1, help="Frames; 60, or all of --poses, if not given.", metavar="N")
    ] = None,
    width: Annotated[int | None, typer.Option("--width", help="Of the image; the scene's film if not given.")] = None,
    height: Annotated[int | None, typer.Option("--height", help="As the width.")] = None,
    fov: Annotated[
        float | None,
        typer.Option("--fov", help="Horizontal field of view; the scene's if not given.", metavar="DEG"),
    ] = None,
    step: Annotated[
        float | None, typer.Option("--step", help="Way per frame; a hundredth of the distance if not given.")
    ] = None,
    frame_rate: FrameRate = 30.0,
    path_seed: PathSeed = 0,
    spp: Annotated[int, typer.Option("--spp", min=1, max=65536, help="Paths a pixel.", metavar="N")] = 256,
    max_depth: Annotated[int, typer.Option("--max-depth", min=2, max=64, help="Segments of a path.")] = 8,
    variant: Annotated[
        str | None, typer.Option("--variant", help="Of Mitsuba; the fastest that works if not given.")
    ] = None,
    *,
    sensing: SensorOptionsOfScene,
    force: Replace = False,
) -> None:
    """Render a Mitsuba scene with full polarized light transport (needs the extra `mitsuba`).

    Materials that polarize are Mitsuba's pplastic, dielectrics and conductors; lengths are taken as metres. Nothing is
    denoised: the paths' own noise falls with the root of --spp.

    Example: polarmap synth mitsuba room/scene.xml room_sequence --frames 48 --spp 1024
    """
    from polarmap.synth.mitsuba.recording import exposed, path_around, render_frames
    from polarmap.synth.mitsuba.view import load_scene
    from polarmap.synth.recording import require_empty, write_sequence
    from polarmap.synth.scene_recording import depth_scale_of, pinhole

    sensor = sensing.sensor()
    require_empty(out, force)
    timed = None if poses is None else _timed_poses(poses, frames)
    loaded = load_scene(scene, variant)
    if fov is None and loaded.fov is None:
        raise InputError(f"{scene}: its sensor has no field of view; give --fov")
    size = (loaded.width if width is None else width, loaded.height if height is None else height)
    camera = pinhole(*size, loaded.fov if fov is None else fov)
    timestamps, path = timed or path_around(loaded, frames or 60, step, frame_rate, path_seed)
    if sensing.exposure is None:
        sensor = exposed(loaded, camera, path[0], sensor)
    hand_held = {"step": step, "frame_rate": frame_rate, "path_seed": path_seed}
    parameters = {
        "mitsuba_scene": str(scene),
        "variant": loaded.mi.variant(),
        "spp": spp,
        "max_depth": max_depth,
        "frames": len(path),
        **(hand_held if poses is None else {"poses": str(poses)}),
    }
    with rendering(out, len(path)) as advance:
        rendered = render_frames(loaded, camera, timestamps, path, sensor, spp, max_depth)
        first = next(rendered)
        scale = depth_scale_of(first.truth.depth)
        everything = chain([first], rendered)
        write_sequence(out, everything, camera, sensor, parameters, scale, advance)
    console.print(f"written: {out}, {len(path)} frames", soft_wrap=True, highlight=False)


def _timed_poses(path: Path, frames: int | None):
    """Timestamps and T_world_camera of a trajectory file, the first `frames` of them."""
    from polarmap.io.formats.trajectory import read_trajectory

    trajectory = read_trajectory(path)
    if frames is not None and frames > len(trajectory):
        raise InputError(f"{path}: holds {len(trajectory)} poses; --frames {frames} asks for more")
    return trajectory.timestamps[:frames], trajectory.poses[:frames]
