"""Pixel values where they belong: in the low bits."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.errors import InputError


def aligned(where: Path | str, pixels: np.ndarray, camera_file: CameraFile) -> np.ndarray:
    """Pixels shifted down to `bit_depth` bits; InputError, naming their source, if the bits in use are others."""
    if camera_file.bit_depth in (8, 16):
        return pixels
    padding = 16 - camera_file.bit_depth
    if camera_file.bit_alignment == "lsb":
        if (highest := int(pixels.max())) > camera_file.white_level:
            raise InputError(
                f"{where}: value {highest} is more than {camera_file.bit_depth} bits hold; correct bit_depth "
                "in the camera file, or write bit_alignment: msb there if the values are shifted up"
            )
        return pixels
    if (pixels & (1 << padding) - 1).any():
        raise InputError(
            f"{where}: uses the low {padding} bits that {camera_file.bit_depth}-bit data shifted up leave "
            "zero; correct bit_depth or bit_alignment in the camera file"
        )
    return pixels >> padding
