"""How the image messages of ROS store pixels, by the names of their encodings.

mono8, 8UC1, mono16, 16UC1                   of a polarization camera its raw mosaic
bayer_rggb8 and the others, also with 16     the same, of colour sensors
Mono12, Polarized8, BayerRGPolarized8 ...    GenICam's names, which some drivers keep
polarized_angles_0d_45d_90d_135d_mono8       LUCID's: four channels a pixel, by angle
rgb8, bgr8, rgba8, bgra8, rgb16 ...          plain cameras only: conversion to colours destroys polarization

16-bit pixels may be big-endian, and rows may have bytes after their last pixel.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Any, Literal

import cv2
import numpy as np

from polarmap.errors import InputError, quoted
from polarmap.io.formats.images import MAX_PIXELS

Kind = Literal["grey", "mosaic", "angles", "colours"]

_GREY = re.compile(r"mono(8|16)|(8|16)uc1|mono(10|12)")
_MOSAIC = re.compile(r"bayer_(?:rggb|bggr|gbrg|grbg)(8|16)|(?:bayer(?:rg|bg|gb|gr))?polarized(8|10|12|16)"
                     r"|bayer(?:rg|bg|gb|gr)(8|10|12|16)")  # fmt: skip
_ANGLES = "polarized_angles_0d_45d_90d_135d_mono8"
_COLOURS = {
    "rgb": (3, cv2.COLOR_RGB2GRAY), "bgr": (3, cv2.COLOR_BGR2GRAY), "rgba": (4, cv2.COLOR_RGBA2GRAY),
    "bgra": (4, cv2.COLOR_BGRA2GRAY),
}  # fmt: skip
_COLOUR = re.compile(r"(rgba?|bgra?)(8|16)")
_PACKED = re.compile(r"\w*(10|12)(p|packed)")


@dataclass(frozen=True)
class Encoding:
    """How pixels are stored. kind: what they are. bits: of a sample as stored, 8 or 16. channels: samples a pixel.

    luma: OpenCV's code that makes grey of colours.
    """

    kind: Kind
    bits: int
    channels: int = 1
    luma: int | None = None


def encoding_of(name: str) -> Encoding:
    """The encoding of this name. Raises InputError, saying what to record, for one that is not read."""
    lower = name.lower()
    kinds: tuple[tuple[Kind, re.Pattern], ...] = (("grey", _GREY), ("mosaic", _MOSAIC))
    for kind, pattern in kinds:
        if found := pattern.fullmatch(lower):
            return Encoding(kind, 8 if next(filter(None, found.groups())) == "8" else 16)
    if lower == _ANGLES:
        return Encoding("angles", 8, 4)
    if found := _COLOUR.fullmatch(lower):
        return Encoding("colours", int(found[2]), *_COLOURS[found[1]])
    if _PACKED.fullmatch(lower):
        raise InputError(f"encoding {quoted(name)} is packed; let the driver send mono16")
    raise InputError(f"encoding {quoted(name)} is not read; record the sensor's raw pixels as mono8 or mono16")


def pixels_of(message: Any, encoding: Encoding) -> np.ndarray:
    """The samples of a sensor_msgs/Image, uint8 or uint16 H×W, or H×W×channels where there are several.

    Raises InputError where the message has fewer bytes than its size and row step ask for.
    """
    width, height, data = int(message.width), int(message.height), np.asarray(message.data)
    if min(width, height) < 1 or width * height > MAX_PIXELS:
        raise InputError(f"{width}x{height} pixels is no usable image size")
    row = width * encoding.channels * encoding.bits // 8
    step = int(message.step) or row
    if step < row or step * (height - 1) + row > data.size:
        raise InputError(
            f"{data.size} bytes in rows of {step}, but {width}x{height} pixels of {message.encoding} take {row} a row"
        )
    data = data.view(np.uint8)
    if data.size < step * height:  # the last row alone is not padded
        data = np.concatenate([data, np.zeros(step * height - data.size, np.uint8)])
    rows = data[: step * height].reshape(height, step)[:, :row].copy()
    order = ">" if message.is_bigendian else "<"
    samples = rows if encoding.bits == 8 else rows.view(f"{order}u2").astype(np.uint16)
    return samples if encoding.channels == 1 else samples.reshape(height, width, encoding.channels)
