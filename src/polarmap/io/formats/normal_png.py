"""Normals as 16-bit RGB PNG files: each channel is (n + 1)/2 · 65535 of x, y and z, black where there is none."""

from __future__ import annotations

import struct
from pathlib import Path

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import read_bytes

_SIGNATURE = b"\x89PNG\r\n\x1a\n"
_END = b"\0\0\0\0IEND\xaeB`\x82"
_RGB = 2


def read_normal_png(path: Path, size: tuple[int, int]) -> np.ndarray:
    """Unit normals in the camera frame, float32 H×W×3, NaN where none. size: the (width, height) expected.

    Raises InputError where the file is no complete 16-bit RGB PNG of that size.
    """
    data = read_bytes(Path(path))
    if not (data.startswith(_SIGNATURE) and len(data) > 45):
        raise InputError(f"{path}: not a PNG image")
    width, height, bits, colour = struct.unpack_from(">IIBB", data, 16)
    if (width, height, bits, colour) != (*size, 16, _RGB):
        raise InputError(f"{path}: {width}x{height} pixels, expected {size[0]}x{size[1]} of 16-bit RGB")
    levels = cv2.imdecode(np.frombuffer(data, np.uint8), cv2.IMREAD_UNCHANGED) if data.endswith(_END) else None
    if levels is None:
        raise InputError(f"{path}: truncated or corrupt; copy or render the file again")
    normal = levels[..., ::-1].astype(np.float32) * np.float32(2 / 65535) - 1.0
    normal[~levels.any(axis=-1)] = np.nan
    return normal / np.linalg.norm(normal, axis=-1, keepdims=True)
