"""polarmap synth rgbd: sequences out of RGB-D recordings."""

from __future__ import annotations

import re
from dataclasses import fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer

from polarmap.cli.common import console, rendering
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.synth.options import OutFolder, Replace, SensorOptions
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.synth.sensor import Sensor

RgbdFormat = Literal["auto", "icl", "icl-pov", "tum", "redwood", "replica"]
RgbdModel = Literal["blinn-phong", "fresnel"]


@with_option_groups
def synth_rgbd(
    source: Annotated[Path, typer.Argument(metavar="SOURCE", help="Folder of an RGB-D recording with poses.")],
    out: OutFolder,
    model: Annotated[
        RgbdModel, typer.Option("--model", help="The paper's Blinn-Phong, or Fresnel's equations.")
    ] = "blinn-phong",
    format: Annotated[RgbdFormat, typer.Option("--format", help="Format of SOURCE.")] = "auto",
    camera: Annotated[
        Path | None,
        typer.Option("--camera", help="Intrinsics: JSON (Open3D, Replica) or a camera.yaml.", metavar="FILE"),
    ] = None,
    frames: Annotated[
        str | None,
        typer.Option("--frames", help="Which frames, as Python's slices, such as 0:200:2.", metavar="A:B:STEP"),
    ] = None,
    light: Annotated[
        str | None,
        typer.Option(
            "--light",
            help="Point light in the first frame's camera frame, metres; 0.5,0,-0.5 if not given.",
            metavar="X,Y,Z",
        ),
    ] = None,
    ambient: Annotated[
        float | None, typer.Option("--ambient", help="blinn-phong: share of light from everywhere; 0.4 if not given.")
    ] = None,
    specular: Annotated[
        float | None, typer.Option("--specular", help="blinn-phong: strength of specular light; 0.5 if not given.")
    ] = None,
    shininess: Annotated[
        float | None, typer.Option("--shininess", help="Exponent of the highlight; 8 if not given, for fresnel 30.")
    ] = None,
    eta: Annotated[float | None, typer.Option("--eta", help="Refractive index; 1.5 if not given.")] = None,
    surround: Annotated[
        float | None, typer.Option("--surround", help="fresnel: radiance of the uniform surround; 1 if not given.")
    ] = None,
    gloss: Annotated[
        float | None,
        typer.Option("--gloss", help="fresnel: share of light that the surface mirrors; 0.5 if not given."),
    ] = None,
    *,
    sensing: SensorOptions,
    force: Replace = False,
) -> None:
    """Make a polarization sequence with truth out of an RGB-D recording.

    SOURCE is a folder as ICL-NUIM, TUM RGB-D, Redwood/Open3D or Replica have it. Normals come from depth, the albedo
    is the picture; OUT gets raw mosaics, true depth, normals and poses, and all parameters in synth.yaml
    (docs/simulator.md).

    Examples: polarmap synth rgbd living_room_traj0_frei_png kt0

    polarmap synth rgbd rgbd_dataset_freiburg3_long_office_household office --model fresnel --frames 0:300
    """
    from polarmap.io.recording.rgbd import open_rgbd, reprojection_error

    sensor = sensing.sensor()
    position = None if light is None else _position(light)
    values = {"light": position, "ambient": ambient, "specular": specular, "shininess": shininess, "eta": eta,
              "surround": surround, "gloss": gloss}  # fmt: skip
    reflection = _rgbd_model(model, values)
    which = _slice(frames or ":")
    recording = open_rgbd(source, format, camera)
    chosen = recording[which]
    _record_rgbd(chosen, out, reflection, sensor, force)
    left_out = f"; {recording.without_pose} without a pose left out" if recording.without_pose else ""
    console.print(f"{len(chosen)} frames of {recording.format}{left_out}")
    error = reprojection_error(chosen)
    if error == error:
        console.print(f"depth meets that of other frames to {1000 * error:.2g} mm (median)")
    console.print(f"sequence: {out}", soft_wrap=True)


def _record_rgbd(recording, out: Path, model, sensor: Sensor, force: bool) -> None:
    from polarmap.synth.rgbd import record_rgbd

    with rendering(out, len(recording)) as advance:
        record_rgbd(recording, out, model, sensor, force, on_frame=advance)


def _rgbd_model(name: str, values: dict[str, object]):
    """The model of this name with the values that are given; InputError for one that it does not have."""
    from polarmap.synth.rgbd import BlinnPhong, Fresnel

    kind = {model.name: model for model in (BlinnPhong, Fresnel)}[name]
    given = {key: value for key, value in values.items() if value is not None}
    known = {field.name for field in fields(kind)}
    for key in given:
        if key not in known:
            raise InputError(f"--{key}: the model {name} has none; leave it out, or choose the other --model")
    return kind(**given)


def _position(text: str) -> tuple[float, float, float]:
    try:
        x, y, z = (float(number) for number in text.split(","))
    except ValueError:
        raise InputError(f"--light: {text[:40]!r} is not a position X,Y,Z in metres, such as 0.5,0,-0.5") from None
    return x, y, z


def _slice(text: str) -> slice:
    """A:B:STEP as Python's slices, all parts optional."""
    match = re.fullmatch(r"(-?[0-9]{1,9})?(?::(-?[0-9]{1,9})?)(?::([1-9][0-9]{0,8})?)?", text)
    if match is None:
        raise InputError(f"--frames: {text[:40]!r} is not A:B or A:B:STEP, such as 0:200:2")
    return slice(*(None if part is None else int(part) for part in match.groups()))
