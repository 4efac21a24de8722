"""Options that the commands of `polarmap synth` share."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.synth.sensor import Sensor

OutFolder = Annotated[Path, typer.Argument(metavar="OUT", help="Folder to write.")]
Replace = Annotated[bool, typer.Option("--force", help="Replace the sequence that 'polarmap synth' made in OUT.")]
FrameRate = Annotated[float, typer.Option("--frame-rate", help="Frames a second.", metavar="HZ")]
PathSeed = Annotated[int, typer.Option("--path-seed", min=0, help="Of the path.")]

_UNCLEAN = ("full_well", "read_noise", "extinction", "shutter")


@dataclass(frozen=True)
class SensorOptions:
    """The sensor's options, alike in all commands; those that are None have a default that --clean changes."""

    bits: Annotated[
        int | None, typer.Option("--bits", help="Bit depth: 8, 10, 12 or 16; 8 if not given.", metavar="N")
    ] = None
    full_well: Annotated[
        float | None, typer.Option("--full-well", help="Electrons at full scale; 10000 if not given.", metavar="N")
    ] = None
    read_noise: Annotated[
        float | None, typer.Option("--read-noise", help="Electrons rms; 2.5 if not given.", metavar="N")
    ] = None
    exposure: Annotated[float, typer.Option("--exposure", help="Factor on the brightness; clips above white.")] = 1.0
    sub_pixel: Annotated[
        bool,
        typer.Option("--sub-pixel", help="Each polarizer sees its own point (docs/simulator.md)."),
    ] = False
    extinction: Annotated[
        float | None,
        typer.Option("--extinction", help="Extinction ratio of the polarizers, such as 300; ideal if not given."),
    ] = None
    shutter: Annotated[
        float | None,
        typer.Option(
            "--shutter", help="Share of the frame interval that the shutter is open: motion blur; 0 for none."
        ),
    ] = None
    clean: Annotated[
        bool,
        typer.Option("--clean", help="No noise, no motion blur, ideal polarizers; 16 bits unless --bits is given."),
    ] = False
    seed: Annotated[int, typer.Option("--seed", help="Of the noise.")] = 0

    def sensor(self) -> Sensor:
        """The sensor that these describe; InputError where they contradict each other or are out of range."""
        from polarmap.data.sensor import SensorNoise
        from polarmap.synth.sensor import Sensor

        unclean = [name for name in _UNCLEAN if getattr(self, name) is not None]
        if self.clean and unclean:
            option = unclean[0].replace("_", "-")
            raise InputError(f"--clean and --{option} contradict each other; leave out one")
        if self.bits not in (None, 8, 10, 12, 16):
            raise InputError(f"--bits: {self.bits} is not one of 8, 10, 12 and 16")
        noise = SensorNoise(
            full_well=SensorNoise.full_well if self.full_well is None else self.full_well,
            read_noise=SensorNoise.read_noise if self.read_noise is None else self.read_noise,
        )
        return Sensor(
            bit_depth=self.bits or (16 if self.clean else 8),
            exposure=1.0 if self.exposure is None else self.exposure,
            noise=None if self.clean else noise,
            sub_pixel=self.sub_pixel,
            extinction_ratio=math.inf if self.extinction is None else self.extinction,
            shutter=self.shutter or 0.0,
            seed=self.seed,
        )
