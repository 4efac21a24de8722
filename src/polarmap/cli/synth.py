"""polarmap synth: polarization sequences with truth, made from RGB-D recordings and from scenes."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Annotated

import typer

from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.synth.sensor import Sensor

synth_app = typer.Typer(
    help="Make polarization sequences with truth.", no_args_is_help=True, rich_markup_mode="markdown"
)

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
    from polarmap.polarization.types import SensorNoise
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
