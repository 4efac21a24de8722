"""The polarization sensors that cameras carry, one table: sizes, layout, colour, noise, and cameras that have them.

Sources. Effective pixels: lists of Sony's Polarsens sensors (IMX250MZR/MYR, IMX253MZR/MYR, IMX264MZR/MYR). Those that
cameras record, 16 columns and 8 rows less: specifications of FLIR's Blackfly S, Baumer's VCXU-50MP and PixeLINK's
PL-D755MU-POL. Order of the block: JAI's manual of the GO-5100MP-USB, whose effective area begins with the line 90 45;
pictures of 2448×2048 of a BFS-U3-51S5P-C begin so too. Bayer pattern: the pixel format BayerRG8 of the
BFS-U3-51S5PC-C. Noise: no maker publishes figures of the polarization sensors; those of the grey siblings IMX250 and
IMX264 are 10 400 electrons and 2.1 rms (EMVA 1288, data sheets of Allied Vision's Alvium 1800 C-508 and C-507), None
where no figure is known. Cameras: pages and manuals of FLIR, PixeLINK, Teledyne DALSA, JAI and Baumer; Lucid's by
programs that name camera and sensor, their colour models by Lucid's naming (P grey, Q colour).

The direction of the angles is that measured on a BFS-U3-51S5P-C (docs/camera.md); the other sensors are labelled alike.
"""

from __future__ import annotations

import difflib
from dataclasses import dataclass

from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError, quoted

_ALVIUM = SensorNoise(full_well=10_400.0, read_noise=2.1)
_FIVE_MEGAPIXELS = ((2448, 2048), (2464, 2056))
_TWELVE_MEGAPIXELS = ((4096, 3000), (4112, 3008))


@dataclass(frozen=True)
class SensorPreset:
    """A sensor as its maker describes it.

    sizes: (width, height) of the whole mosaic, first the one that cameras record, then all effective pixels.
    layout: polarizers of the first block, row by row. colour: Bayer pattern over the blocks, None for a grey sensor.
    bit_depths: that its cameras put out. noise: at gain 0; None where no figure is published.
    cameras: names of cameras that carry it.
    """

    name: str
    sizes: tuple[tuple[int, int], ...]
    cameras: tuple[str, ...] = ()
    colour: str | None = None
    noise: SensorNoise | None = None
    layout: SensorLayout = SensorLayout.SONY_POLARSENS
    angle_direction: AngleDirection = AngleDirection.COUNTERCLOCKWISE
    bit_depths: tuple[int, ...] = (8, 10, 12)


SENSOR_PRESETS = (
    SensorPreset(
        "IMX250MZR",
        _FIVE_MEGAPIXELS,
        (
            "FLIR BFS-U3-51S5P-C", "FLIR BFS-PGE-51S5P-C", "Lucid PHX050S-P", "Lucid TRI050S-P",
            "Basler acA2440-75umPOL", "JAI GO-5100MP-USB", "Baumer VCXU-50MP", "Baumer VCXG-50MP",
            "Allied Vision Alvium 1800 C-508 Pol", "PixeLINK PL-D755MU-POL",
            "Teledyne DALSA Genie Nano M2450-Polarized",
        ),
        noise=_ALVIUM,
    ),
    SensorPreset(
        "IMX250MYR",
        _FIVE_MEGAPIXELS,
        ("FLIR BFS-U3-51S5PC-C", "FLIR BFS-PGE-51S5PC-C", "Lucid PHX050S-Q", "Lucid TRI050S-Q"),
        colour="RGGB",
        noise=_ALVIUM,
    ),
    SensorPreset("IMX253MZR", _TWELVE_MEGAPIXELS, ("FLIR BFS-PGE-123S6P-C",)),
    SensorPreset("IMX253MYR", _TWELVE_MEGAPIXELS, colour="RGGB"),
    SensorPreset(
        "IMX264MZR",
        _FIVE_MEGAPIXELS,
        ("Lucid PHX050S1-P", "Lucid TRI050S1-P", "Allied Vision Alvium 1800 C-507 Pol"),
        noise=_ALVIUM,
    ),
    SensorPreset("IMX264MYR", _FIVE_MEGAPIXELS, ("Lucid TRI050S1-Q",), colour="RGGB", noise=_ALVIUM),
)  # fmt: skip


def find_preset(name: str) -> SensorPreset:
    """The preset of a sensor or of a camera that carries it, whatever the case and with or without the maker's name.

    Raises InputError, with names that are near, where there is none.
    """
    known = {key: preset for preset in SENSOR_PRESETS for key in (preset.name, *preset.cameras)}
    short = {key.split(maxsplit=1)[-1]: preset for key, preset in known.items()}
    by_key = {_plain(key): preset for key, preset in (known | short).items()}
    if _plain(name) in by_key:
        return by_key[_plain(name)]
    near = difflib.get_close_matches(name.upper(), [key.upper() for key in known | short], n=2)
    hint = f"did you mean {' or '.join(near)}?" if near else f"known are {', '.join(p.name for p in SENSOR_PRESETS)}"
    raise InputError(f"--layout: {quoted(name)} is no sensor or camera that is known here; {hint}")


def region_of(preset: SensorPreset, offset: tuple[int, int]) -> tuple[SensorLayout, str | None]:
    """Layout and Bayer pattern of a region whose first pixel is this (x, y) of the sensor's.

    An odd offset begins within a block, and exchanges its columns or rows; an offset of an odd number of blocks does so
    with the Bayer pattern. Raises InputError for an odd offset on a colour sensor: its blocks of one colour would
    be cut.
    """
    x, y = offset
    if min(x, y) < 0:
        raise InputError(f"--offset: {x},{y} is negative")
    if preset.colour is None:
        return SensorLayout(_shifted(preset.layout.value, x, y)), None
    if x % 2 or y % 2:
        raise InputError(
            f"--offset: {x},{y} cuts the 2x2 polarizer blocks of the colour sensor {preset.name}, each under one "
            "colour; record with even offsets"
        )
    return preset.layout, "".join(_shifted(tuple(preset.colour), x // 2, y // 2))


def _shifted(block: tuple, x: int, y: int) -> tuple:
    """The four of a 2×2 pattern, as they are seen from (x, y) on."""
    return tuple(block[2 * ((row + y) % 2) + (column + x) % 2] for row in (0, 1) for column in (0, 1))


def _plain(name: str) -> str:
    return "".join(character for character in name.casefold() if character.isalnum())
