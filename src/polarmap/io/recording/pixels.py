"""Whether pixels are as the camera file says: their size, their bits, and how these are aligned."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.errors import InputError


def require_size(where: Path | str, found: tuple[int, int], size: tuple[int, int], camera_file: CameraFile) -> None:
    """Raise InputError, telling what the camera file's size means, where a picture has another (width, height)."""
    if found == size:
        return
    camera = camera_file.camera
    pixels = f"{where}: {found[0]}x{found[1]} pixels, expected {size[0]}x{size[1]}"
    if camera_file.layout is not None and found == (camera.width, camera.height):
        raise InputError(
            f"{pixels}: the camera file's width and height are those of one channel, half the mosaic's; if this is a "
            f"raw mosaic, write width: {found[0] // 2} and height: {found[1] // 2}, with fx, fy, cx and cy of a channel"
        )
    if camera_file.polarized and camera_file.layout is None and found == (2 * camera.width, 2 * camera.height):
        raise InputError(
            f"{pixels} of pictures of one angle; for a raw mosaic write its layout in place of mosaic: none"
        )
    of_channel = " of a channel, half the mosaic's," if camera_file.layout is not None else ""
    raise InputError(
        f"{pixels}; correct width and height{of_channel} in the camera file, and fx, fy, cx and cy with them where "
        "pictures were cut or resized"
    )


def require_bits(where: Path | str, bits: int, camera_file: CameraFile) -> None:
    """Raise InputError, naming the camera file's key, where a picture has other bits per pixel, 8 or 16."""
    expected = 8 if camera_file.bit_depth == 8 else 16
    if bits != expected:
        raise InputError(
            f"{where}: {bits} bits per pixel, expected {expected} by bit_depth: {camera_file.bit_depth} in the "
            "camera file; correct it, or write the sensor's data without conversion"
        )


def aligned(where: Path | str, pixels: np.ndarray, camera_file: CameraFile) -> np.ndarray:
    """Pixels shifted down to `bit_depth` bits; InputError where the bits in use are others."""
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


def taken_apart(where: Path | str, camera_file: CameraFile) -> CameraFile:
    """The camera of mosaics that were split into one picture per angle before."""
    if camera_file.colour is not None:
        raise InputError(f"{where}: pictures of one angle must be grey; use the colour sensor's raw mosaics instead")
    return replace(camera_file, layout=None)
