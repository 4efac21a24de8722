"""polarmap camera: a camera file of another program's calibration."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from polarmap.cli.common import console
from polarmap.errors import InputError

_DIRECTIONS = ("clockwise", "counterclockwise")


def camera(
    calibration: Annotated[
        Path | None,
        typer.Argument(
            metavar="[FROM]",
            help="A calibration by OpenCV, ROS, Kalibr, EuRoC, ORB-SLAM, VINS-Fusion or COLMAP (docs/formats.md).",
        ),
    ] = None,
    layout: Annotated[
        str | None,
        typer.Option(help="The sensor, as imx250mzr, or the camera's name; --list shows all.", metavar="SENSOR"),
    ] = None,
    out: Annotated[Path, typer.Option("--out", "-o", help="Camera file to write.", metavar="FILE")] = Path(
        "camera.yaml"
    ),
    picture: Annotated[
        Path | None,
        typer.Option(help="A raw picture of this camera, or a folder of some: tells size and bits.", metavar="PATH"),
    ] = None,
    offset: Annotated[
        str | None,
        typer.Option(help="Where on the sensor a cropped picture begins (OffsetX,OffsetY).", metavar="X,Y"),
    ] = None,
    bit_depth: Annotated[int | None, typer.Option(help="Significant bits of a pixel: 8, 10, 12 or 16.")] = None,
    angle_direction: Annotated[
        str | None,
        typer.Option(help="clockwise or counterclockwise, in place of the sensor's; for mirrored pictures."),
    ] = None,
    name: Annotated[str | None, typer.Option(help="Which camera of several in FROM, as cam1.", metavar="NAME")] = None,
    show: Annotated[bool, typer.Option("--list", help="List sensors and cameras that carry them, and end.")] = False,
    force: Annotated[bool, typer.Option("--force", help="Replace the file if it exists.")] = False,
) -> None:
    """Make a camera file of another program's calibration and the sensor's name.

    Says whether the calibration was made with the whole mosaic or with one channel, which has half the size, and
    converts it. Check the result with 'polarmap inspect'; the direction of the angles as docs/camera.md tells.

    Example: polarmap camera camchain.yaml --layout imx250mzr --picture raw/000000.png -o camera.yaml
    """
    if show:
        _show_presets()
        return
    from polarmap.data.sensor_presets import find_preset
    from polarmap.io.recording.calibrated_camera import SensorChoice, calibrated_camera
    from polarmap.io.recording.camera_file import write_camera_file

    if calibration is None:
        raise InputError("FROM is missing: give the calibration file, or --list to see the sensors that are known")
    if layout is None:
        raise InputError(
            "--layout is missing; name the sensor, as --layout imx250mzr, or the camera (--list shows all)"
        )
    if angle_direction is not None and angle_direction not in _DIRECTIONS:
        raise InputError(f"--angle-direction: {angle_direction!r} is not {' or '.join(_DIRECTIONS)}")
    sensor = SensorChoice(find_preset(layout), picture, _offset(offset), bit_depth, angle_direction)
    made = calibrated_camera(calibration, sensor, name)
    refuse_existing(out, force)
    write_camera_file(out, made.camera_file)
    for fact in made.facts:
        console.print(f"- {fact}", markup=False, highlight=False, soft_wrap=True)
    size = f"{made.camera_file.camera.width}x{made.camera_file.camera.height}"
    console.print(f"{out}: a channel has {size} pixels; look at a recording with 'polarmap inspect'", soft_wrap=True)


def refuse_existing(out: Path, force: bool) -> None:
    """Raise InputError where a file would be replaced and --force is not given."""
    if out.exists() and not force:
        raise InputError(f"{out} exists; give another --out, or --force to replace it")


def _offset(text: str | None) -> tuple[int, int] | None:
    if text is None:
        return None
    parts = text.split(",")
    if len(parts) != 2 or not all(part.strip().isdecimal() and len(part) < 10 for part in parts):
        raise InputError(f"--offset: {text[:40]!r} is not X,Y, two whole numbers of pixels, such as 0,512")
    return int(parts[0]), int(parts[1])


def _show_presets() -> None:
    from polarmap.data.sensor_presets import SENSOR_PRESETS

    for preset in SENSOR_PRESETS:
        sizes = " or ".join(f"{width}x{height}" for width, height in preset.sizes)
        block, noise = preset.layout.value, preset.noise
        electrons = "not known" if noise is None else f"{noise.full_well:g} e- full, {noise.read_noise:g} e- read"
        console.print(preset.name, style="bold", highlight=False)
        console.print(
            f"    {sizes}, {preset.colour or 'grey'}, block {block[0]} {block[1]} / {block[2]} {block[3]}, "
            f"{', '.join(map(str, preset.bit_depths))} bits, noise {electrons}",
            highlight=False,
            soft_wrap=True,
        )
        if preset.cameras:
            console.print(f"    {', '.join(preset.cameras)}", highlight=False, soft_wrap=True)
