"""polarmap synth: polarization sequences with truth, made from RGB-D recordings and from scenes."""

from __future__ import annotations

import math
import re
from dataclasses import fields
from itertools import chain
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Literal

import typer
from rich.table import Table

from polarmap.cli.common import console, making, progress_bar
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.geometry.camera import PinholeCamera
    from polarmap.synth.sensor import Sensor

synth_app = typer.Typer(
    help="Make polarization sequences with truth.", no_args_is_help=True, rich_markup_mode="markdown"
)

RgbdFormat = Literal["auto", "icl", "icl-pov", "tum", "redwood", "replica"]
RgbdModel = Literal["blinn-phong", "fresnel"]

# The sensor's options, alike in all commands; those that are None have a default that --clean changes.

Bits = Annotated[int | None, typer.Option("--bits", help="Bit depth: 8, 10, 12 or 16; 8 if not given.", metavar="N")]
FullWell = Annotated[
    float | None, typer.Option("--full-well", help="Electrons at full scale; 10000 if not given.", metavar="N")
]
ReadNoise = Annotated[float | None, typer.Option("--read-noise", help="Electrons rms; 2.5 if not given.", metavar="N")]
Exposure = Annotated[float, typer.Option("--exposure", help="Factor on the brightness; clips above white.")]
SubPixel = Annotated[
    bool,
    typer.Option("--sub-pixel", help="Each polarizer sees its own point (docs/simulator.md)."),
]
Extinction = Annotated[
    float | None,
    typer.Option("--extinction", help="Extinction ratio of the polarizers, such as 300; ideal if not given."),
]
Shutter = Annotated[
    float | None,
    typer.Option("--shutter", help="Share of the frame interval that the shutter is open: motion blur; 0 for none."),
]
Clean = Annotated[
    bool, typer.Option("--clean", help="No noise, no motion blur, ideal polarizers; 16 bits unless --bits is given.")
]
Seed = Annotated[int, typer.Option("--seed", help="Of the noise.")]


OutFolder = Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write.")]
Replace = Annotated[bool, typer.Option("--force", help="Replace the sequence that 'polarmap synth' made in OUT.")]


@synth_app.command()
def rgbd(
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
    bits: Bits = None,
    full_well: FullWell = None,
    read_noise: ReadNoise = None,
    exposure: Exposure = 1.0,
    sub_pixel: SubPixel = False,
    extinction: Extinction = None,
    shutter: Shutter = None,
    clean: Clean = False,
    seed: Seed = 0,
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

    sensor = make_sensor(bits, full_well, read_noise, exposure, sub_pixel, extinction, shutter, clean, seed)
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

    with progress_bar() as progress, making(out):
        task = progress.add_task("rendering", total=len(recording))
        record_rgbd(recording, out, model, sensor, force, on_frame=lambda: progress.advance(task))


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


def make_sensor(
    bits: int | None,
    full_well: float | None,
    read_noise: float | None,
    exposure: float,
    sub_pixel: bool,
    extinction: float | None,
    shutter: float | None,
    clean: bool,
    seed: int,
) -> Sensor:
    """The sensor that these options describe; InputError where they contradict each other or are out of range."""
    from polarmap.data.sensor import SensorNoise
    from polarmap.synth.sensor import Sensor

    unclean = {"full-well": full_well, "read-noise": read_noise, "extinction": extinction, "shutter": shutter}
    named = [name for name, value in unclean.items() if value is not None]
    if clean and named:
        raise InputError(f"--clean and --{named[0]} contradict each other; leave out one")
    if bits not in (None, 8, 10, 12, 16):
        raise InputError(f"--bits: {bits} is not one of 8, 10, 12 and 16")
    noise = SensorNoise(
        full_well=SensorNoise.full_well if full_well is None else full_well,
        read_noise=SensorNoise.read_noise if read_noise is None else read_noise,
    )
    return Sensor(
        bit_depth=bits or (16 if clean else 8),
        exposure=exposure,
        noise=None if clean else noise,
        sub_pixel=sub_pixel,
        extinction_ratio=math.inf if extinction is None else extinction,
        shutter=shutter or 0.0,
        seed=seed,
    )


Frames = Annotated[int, typer.Option("--frames", min=1, max=100000, help="Frames to render.", metavar="N")]
Width = Annotated[int, typer.Option("--width", help="Of the image after the split; the mosaic is twice as wide.")]
Height = Annotated[int, typer.Option("--height", help="As the width.")]
FrameRate = Annotated[float, typer.Option("--frame-rate", help="Frames a second.", metavar="HZ")]
PathSeed = Annotated[int, typer.Option("--path-seed", min=0, help="Of the hand-held path.")]
Supersample = Annotated[
    int, typer.Option("--supersample", min=1, max=8, help="Rays along either side of a pixel.", metavar="N")
]
_FOV = math.degrees(2.0 * math.atan(2.0 / 3.0))  # a focal length of 480 at 640 pixels


@synth_app.command("scene", no_args_is_help=True)
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
    bits: Bits = None,
    full_well: FullWell = None,
    read_noise: ReadNoise = None,
    exposure: Exposure = 1.0,
    sub_pixel: SubPixel = False,
    extinction: Extinction = None,
    shutter: Shutter = None,
    clean: Clean = False,
    seed: Seed = 0,
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
    sensor = make_sensor(bits, full_well, read_noise, exposure, sub_pixel, extinction, shutter, clean, seed)
    camera = pinhole(width, height, fov)
    with progress_bar() as progress, making(out):
        task = progress.add_task("rendering", total=frames)
        record_scene(
            out, name, frames, camera, sensor, step, frame_rate, path_seed, supersample, force,
            on_frame=lambda: progress.advance(task),
        )  # fmt: skip
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


@synth_app.command("mitsuba", no_args_is_help=True)
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
    bits: Bits = None,
    full_well: FullWell = None,
    read_noise: ReadNoise = None,
    exposure: Annotated[
        float | None, typer.Option("--exposure", help="Factor on the brightness; from the first view if not given.")
    ] = None,
    sub_pixel: SubPixel = False,
    extinction: Extinction = None,
    shutter: Shutter = None,
    clean: Clean = False,
    seed: Seed = 0,
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

    factor = 1.0 if exposure is None else exposure
    sensor = make_sensor(bits, full_well, read_noise, factor, sub_pixel, extinction, shutter, clean, seed)
    require_empty(out, force)
    timed = None if poses is None else _timed_poses(poses, frames)
    loaded = load_scene(scene, variant)
    if fov is None and loaded.fov is None:
        raise InputError(f"{scene}: its sensor has no field of view; give --fov")
    size = (loaded.width if width is None else width, loaded.height if height is None else height)
    camera = pinhole(*size, loaded.fov if fov is None else fov)
    timestamps, path = timed or path_around(loaded, frames or 60, step, frame_rate, path_seed)
    if exposure is None:
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
    with progress_bar() as progress, making(out):
        task = progress.add_task("rendering", total=len(path))
        rendered = render_frames(loaded, camera, timestamps, path, sensor, spp, max_depth)
        first = next(rendered)
        scale = depth_scale_of(first.truth.depth)
        everything = chain([first], rendered)
        write_sequence(out, everything, camera, sensor, parameters, scale, lambda: progress.advance(task))
    console.print(f"written: {out}, {len(path)} frames", soft_wrap=True, highlight=False)


def _timed_poses(path: Path, frames: int | None):
    """Timestamps and T_world_camera of a trajectory file, the first `frames` of them."""
    from polarmap.io.formats.trajectory import read_trajectory

    trajectory = read_trajectory(path)
    if frames is not None and frames > len(trajectory):
        raise InputError(f"{path}: holds {len(trajectory)} poses; --frames {frames} asks for more")
    return trajectory.timestamps[:frames], trajectory.poses[:frames]
