"""The names by which makers of polarization cameras call the pixel formats of raw mosaics.

PFNC, Basler, IDS, others   Mono8, Mono10p, Mono12p, Mono12Packed, Mono16, BayerRG8, BayerRG12p
Teledyne FLIR               Polarized8, Polarized10p, Polarized12p, Polarized16, BayerRGPolarized8, ...
Lucid                       PolarizeMono8, PolarizeMono12, PolarizeMono12p, PolarizeMono12Packed, PolarizeMono16
"""

from __future__ import annotations

import re
from typing import NamedTuple

from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError, quoted

_POLARIZED = "(?:[Pp]olari[sz]ed?)"
_NAME = re.compile(
    rf"(?=[A-Z]){_POLARIZED}?(?:Mono|Bayer(?P<colour>RG|BG|GR|GB))?{_POLARIZED}?"
    r"(?P<bits>8|10|12|16)(?P<packing>p|Packed)?"
)
_PATTERNS = {"RG": "RGGB", "BG": "BGGR", "GR": "GRBG", "GB": "GBRG"}


class NamedFormat(NamedTuple):
    """How pixels are stored, and the Bayer pattern over them, None for a grey sensor or where it is not said."""

    pixel_format: PixelFormat
    colour: str | None


def format_of(name: str) -> NamedFormat:
    """What a camera's name of a pixel format stands for; InputError where it is none of a raw mosaic."""
    found = _NAME.fullmatch(name)
    label = found and f"Mono{found['bits']}{found['packing'] or ''}"
    if not found or label not in {known.label for known in PixelFormat}:
        raise InputError(
            f"PixelFormat {quoted(name)} is not that of a raw mosaic; set the camera to one such as Mono8, Mono12p, "
            "Polarized12p or PolarizeMono12Packed (--feature PixelFormat=Mono12p)"
        )
    return NamedFormat(PixelFormat.from_name(label), _PATTERNS.get(found["colour"] or ""))
