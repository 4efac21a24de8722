"""Makers' names of pixel formats."""

from __future__ import annotations

import pytest

from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError
from polarmap.io.cameras.pixel_names import format_of


@pytest.mark.parametrize(
    "name, label, colour",
    [
        *((label, label, None) for label in ("Mono8", "Mono10", "Mono12", "Mono16", "Mono10p", "Mono12p")),
        ("Mono10Packed", "Mono10Packed", None),
        ("Mono12Packed", "Mono12Packed", None),
        ("Polarized8", "Mono8", None),
        ("Polarized10p", "Mono10p", None),
        ("Polarized12p", "Mono12p", None),
        ("Polarized16", "Mono16", None),
        ("BayerRGPolarized8", "Mono8", "RGGB"),
        ("BayerRGPolarized12p", "Mono12p", "RGGB"),
        ("PolarizeMono8", "Mono8", None),
        ("PolarizeMono12", "Mono12", None),
        ("PolarizeMono12p", "Mono12p", None),
        ("PolarizeMono12Packed", "Mono12Packed", None),
        ("BayerGB12", "Mono12", "GBRG"),
        ("BayerRG12p", "Mono12p", "RGGB"),
    ],
)
def test_raw_mosaics_are_known_by_every_makers_name(name, label, colour):
    assert format_of(name) == (PixelFormat.from_name(label), colour)


@pytest.mark.parametrize(
    "name",
    ["RGBa8", "RGB8", "Mono14", "Mono8p", "PolarizedAngles_0d_45d_90d_135d_Mono8", "PolarizedDolp_Mono8", "", "8",
     "PolarizedStokes_S0_S1_S2_S3_Mono8", "YUV422_8", "Mono8Packed", "unknown"],
)  # fmt: skip
def test_what_is_no_raw_mosaic_is_refused(name):
    with pytest.raises(InputError, match="not that of a raw mosaic"):
        format_of(name)
