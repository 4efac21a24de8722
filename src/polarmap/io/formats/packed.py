"""Raw sensor buffers: the GenICam pixel formats that polarization cameras record, and their packing.

Two pixels a, b of Mono10Packed and Mono12Packed (GigE Vision) fill three bytes, the low bits in the middle:

    Mono10Packed   a[9:2]    00 b[1:0] 00 a[1:0]   b[9:2]
    Mono12Packed   a[11:4]   b[3:0] a[3:0]         b[11:4]

Mono10p and Mono12p (GenICam PFNC, USB3 Vision) are one bit stream, least significant bit first: four pixels
of 10 bits in five bytes, two pixels of 12 bits in three. Rows are not padded. Mono10, Mono12 and Mono16 hold
a pixel in two bytes, little-endian.
"""

from __future__ import annotations

import numpy as np

from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError


def unpack(data: bytes, pixel_format: PixelFormat, shape: tuple[int, int]) -> np.ndarray:
    """The image in a raw buffer, H×W, uint8 for Mono8 and uint16 else; read-only where nothing is unpacked.

    shape: (height, width). Raises InputError where the buffer is not exactly as large as the image.
    """
    expected = pixel_format.byte_count(shape)
    if len(data) != expected:
        width, height = shape[1], shape[0]
        raise InputError(f"{len(data)} bytes, but {width}x{height} pixels of {pixel_format.label} take {expected}")
    if pixel_format is PixelFormat.MONO8:
        return np.frombuffer(data, np.uint8).reshape(shape)
    if pixel_format.group_pixels == 1:
        return np.frombuffer(data, "<u2").astype(np.uint16, copy=False).reshape(shape)
    columns = np.frombuffer(data, np.uint8).reshape(-1, pixel_format.group_bytes).T.astype(np.uint16)
    pixels = np.empty((columns.shape[1], pixel_format.group_pixels), np.uint16)
    decode = _unpack_gige if pixel_format.label.endswith("Packed") else _unpack_stream
    decode(columns, pixel_format.bits, pixels)
    return pixels.reshape(shape)


def pack(image: np.ndarray, pixel_format: PixelFormat) -> bytes:
    """The raw buffer of an image, H×W integers; InputError where a value exceeds the format's bits."""
    pixel_format.byte_count(image.shape)
    if image.size and not 0 <= int(image.min()) <= int(image.max()) < 1 << pixel_format.bits:
        raise InputError(f"{pixel_format.label}: pixel values must be in [0, {(1 << pixel_format.bits) - 1}]")
    if pixel_format.group_pixels == 1:
        return image.astype("u1" if pixel_format is PixelFormat.MONO8 else "<u2").tobytes()
    pixels = image.astype(np.uint16).reshape(-1, pixel_format.group_pixels)
    groups = np.zeros((len(pixels), pixel_format.group_bytes), np.uint8)
    encode = _pack_gige if pixel_format.label.endswith("Packed") else _pack_stream
    encode(pixels, pixel_format.bits, groups)
    return groups.tobytes()


def _unpack_gige(columns: np.ndarray, bits: int, pixels: np.ndarray) -> None:
    first, low, second = columns
    mask = (1 << bits - 8) - 1
    pixels[:, 0] = first << bits - 8 | low & mask
    pixels[:, 1] = second << bits - 8 | low >> 4 & mask


def _pack_gige(pixels: np.ndarray, bits: int, groups: np.ndarray) -> None:
    a, b = pixels.T
    mask = (1 << bits - 8) - 1
    groups[:, 0] = a >> bits - 8
    groups[:, 1] = (b & mask) << 4 | a & mask
    groups[:, 2] = b >> bits - 8


def _unpack_stream(columns: np.ndarray, bits: int, pixels: np.ndarray) -> None:
    for k in range(pixels.shape[1]):
        byte, shift = divmod(k * bits, 8)
        pixels[:, k] = (columns[byte] | columns[byte + 1] << 8) >> shift & (1 << bits) - 1


def _pack_stream(pixels: np.ndarray, bits: int, groups: np.ndarray) -> None:
    for k, values in enumerate(pixels.T):
        byte, shift = divmod(k * bits, 8)
        groups[:, byte] |= (values << shift & 0xFF).astype(np.uint8)
        groups[:, byte + 1] |= (values << shift >> 8).astype(np.uint8)
