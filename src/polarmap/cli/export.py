"""polarmap export: a finished map for other programs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from polarmap.cli.common import compile_notice, console, progress_bar
from polarmap.errors import InputError

if TYPE_CHECKING:
    from rich.progress import Progress

    from polarmap.export.source import MapSource
    from polarmap.export.upright import Up

ExportFormat = Literal["colmap", "nerfstudio", "glb", "ply", "esdf"]
VertexColour = Literal["grey", "normal"]

_BELONGS = {  # options that not every format has
    "--points": ("colmap", "nerfstudio", "ply"),
    "--min-confidence": ("colmap", "nerfstudio", "ply", "esdf"),
    "--colour": ("glb",),
    "--up": ("glb", "esdf"),
    "--height": ("esdf",),
    "--voxel-size": ("esdf",),
    "--distance": ("esdf",),
}


def export(
    map_folder: Annotated[Path, typer.Argument(metavar="MAP", help="Folder that 'polarmap run --out' wrote.")],
    to: Annotated[ExportFormat, typer.Option("--to", help="What to write.")],
    out: Annotated[Path, typer.Option("--out", "-o", help="Folder to write; for glb and ply the file.", metavar="OUT")],
    points: Annotated[
        int | None,
        typer.Option(
            min=1, max=20_000_000, help="At most so many points; 30000 for colmap and nerfstudio, 1000000 for ply."
        ),
    ] = None,
    min_confidence: Annotated[
        float | None,
        typer.Option("--min-confidence", min=0, max=1, help="Leave out depth that is less sure; 0.1, as fusion does."),
    ] = None,
    colour: Annotated[
        VertexColour | None, typer.Option("--colour", help="Of glb's vertices: the pictures' grey, or the normals'.")
    ] = None,
    up: Annotated[
        tuple[float, float, float] | None,
        typer.Option("--up", help="Which way is up in the world of the poses; found if not given.", metavar="X Y Z"),
    ] = None,
    height: Annotated[
        tuple[float, float] | None,
        typer.Option(
            "--height", help="Of esdf: from where to where over the floor things are in the way.", metavar="MIN MAX"
        ),
    ] = None,
    voxel_size: Annotated[
        float | None,
        typer.Option("--voxel-size", min=1e-6, help="Of esdf, in metres; four times the map's.", metavar="SIZE"),
    ] = None,
    distance: Annotated[
        float | None,
        typer.Option("--distance", min=1e-6, help="Where esdf ends, in metres; 40 voxels.", metavar="LENGTH"),
    ] = None,
    segment: Annotated[int | None, typer.Option("--segment", help="Of a run with several; the main one.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace an earlier export.")] = False,
) -> None:
    """Write a finished map for other programs (docs/export.md).

    colmap: workspace of COLMAP, for its viewer, its fusion and for Gaussian splatting. nerfstudio: transforms.json with
    pictures, depth and points. glb: the mesh for Blender and browsers. ply: points with sigma, confidence and
    kind of reflection. esdf: occupancy grid for Nav2, and signed distances.

    Examples: polarmap export out --to colmap -o colmap

    polarmap export out --to glb -o room.glb --colour normal

    polarmap export out --to esdf -o nav --up 0 0 1 --height 0.1 1.2
    """
    from polarmap.export.source import open_map

    given = {
        "--points": points, "--min-confidence": min_confidence, "--colour": colour, "--up": up,
        "--height": height, "--voxel-size": voxel_size, "--distance": distance,
    }  # fmt: skip
    for option, value in given.items():
        if value is not None and to not in _BELONGS[option]:
            raise InputError(f"{option}: is of {' and '.join(_BELONGS[option])}, not of {to}; leave it out")
    with progress_bar() as progress:
        source = open_map(map_folder, segment, _teller(progress))
        if source.results.poses != "given":
            console.print("lengths are in units of odometry: metres but for one factor that is not known")
        if source.origin.any():
            console.print(f"counted from {' '.join(f'{number:g}' for number in source.origin)} in the poses' world")
        chosen = {"points": points, "min_confidence": min_confidence, "force": force}
        options = {name: value for name, value in chosen.items() if value is not None}
        lines: list[str]
        if to == "glb":
            lines = _glb(source, out, _up(source, up), colour or "grey", force)
        elif to == "esdf":
            lines = _esdf(source, out, _up(source, up), height, voxel_size, distance, options)
        else:
            lines = _POINTS[to](source, out, options)
    for line in (*lines, f"written: {out}"):
        console.print(line, markup=False, highlight=False, soft_wrap=True)


def _teller(progress: Progress) -> Callable[[str, int, int], None]:
    """A bar for the step at hand."""
    task = progress.add_task("", total=None, visible=False)

    def tell(step: str, done: int, total: int) -> None:
        progress.update(task, description=step, completed=done, total=total, visible=done < total)

    return tell


def _up(source: MapSource, direction: tuple[float, float, float] | None) -> Up:
    from polarmap.export.upright import found_up, given_up

    return found_up(source) if direction is None else given_up(direction)


def _up_line(up: Up) -> str:
    numbers = " ".join(f"{number + 0.0:.4f}" for number in up.direction)
    return f"up: {numbers} ({up.reason}{'' if up.reason == 'as given' else '; --up X Y Z says otherwise'})"


def _colmap(source: MapSource, out: Path, options: dict) -> list[str]:
    from polarmap.export.colmap import export_colmap

    return [f"{export_colmap(source, out, **options)} points"]


def _nerfstudio(source: MapSource, out: Path, options: dict) -> list[str]:
    from polarmap.export.nerfstudio import export_nerfstudio

    unit = export_nerfstudio(source, out, **options)
    return [f"depth pictures: nerfstudio-data --depth-unit-scale-factor {unit:g}"]


def _ply(source: MapSource, out: Path, options: dict) -> list[str]:
    from polarmap.export.cloud import export_cloud

    return [f"{export_cloud(source, out, **options)} points"]


_POINTS = {"colmap": _colmap, "nerfstudio": _nerfstudio, "ply": _ply}


def _glb(source: MapSource, out: Path, up: Up, colour: VertexColour, force: bool) -> list[str]:
    from polarmap.export.scene import export_glb

    mesh = export_glb(source, out, up.direction, colour=colour, force=force)
    return [_up_line(up), f"{len(mesh.faces)} triangles"]


def _esdf(
    source: MapSource,
    out: Path,
    up: Up,
    height: tuple[float, float] | None,
    voxel_size: float | None,
    distance: float | None,
    options: dict,
) -> list[str]:
    from polarmap.export.navigation import export_navigation

    with compile_notice("Compiling for this machine; that takes some seconds and is kept."):
        found = export_navigation(
            source, out, up.direction, height=height, voxel_size=voxel_size, truncation=distance, **options
        )
    low, high = (edge - found.grid.floor for edge in found.band)
    shape = "x".join(map(str, found.grid.shape))
    return [
        _up_line(up),
        f"floor at {found.grid.floor:.3g} along up; in the way: {low:.3g} to {high:.3g} over it",
        f"{shape} voxels of {found.grid.voxel_size:.3g}",
    ]
