"""Whether what a camera sends is what its camera file says, and the pixels of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError
from polarmap.io.cameras.device import Arrived
from polarmap.io.cameras.pixel_names import NamedFormat, format_of
from polarmap.io.formats.packed import unpack
from polarmap.io.recording.pixels import aligned


class StreamFormat:
    """How a camera sends its pictures. Made once, and again where a picture is of another kind.

    camera_file: of the stream: its pixel format is the camera's. size: (width, height) of a picture in pixels.
    Raises InputError, naming the camera, where the camera file is another camera's, or this one set otherwise.
    """

    def __init__(self, camera_file: CameraFile, camera: str, size: tuple[int, int], name: str) -> None:
        self.size, self.name = size, name
        self._camera = camera
        try:
            named = format_of(name)
            _require_size(camera_file, size)
            _require_pixels(camera_file, named, name)
            self.camera_file = _of_stream(camera_file, named.pixel_format)
            self._bytes = named.pixel_format.byte_count(size[::-1])
        except InputError as problem:
            raise InputError(f"{camera}: {problem}") from None

    def fits(self, arrived: Arrived) -> bool:
        """Whether a picture is of this size and pixel format."""
        return (arrived.width, arrived.height) == self.size and arrived.pixel_format == self.name

    def whole(self, arrived: Arrived) -> bool:
        """Whether all of a picture is there."""
        padding = arrived.padding * (self.size[1] - 1)
        return arrived.data is not None and len(arrived.data) >= self._bytes + padding

    def packed(self, arrived: Arrived) -> bytes:
        """The picture's own bytes: no padding of its rows, and nothing of what follows it."""
        data, height = arrived.data or b"", self.size[1]
        if not arrived.padding:
            return data[: self._bytes]
        row = self._bytes // height
        rows = (
            data[start : start + row] for start in range(0, height * (row + arrived.padding), row + arrived.padding)
        )
        return b"".join(rows)

    def pixels(self, arrived: Arrived) -> np.ndarray:
        """The pixel values, H×W uint8 or uint16, in [0, white_level]; InputError where more bits are in use."""
        return aligned(self._camera, self.unpacked(arrived), self.camera_file)

    def unpacked(self, arrived: Arrived) -> np.ndarray:
        """The pixel values as they were sent, H×W uint8 or uint16."""
        pixel_format = self.camera_file.pixel_format
        assert pixel_format is not None
        return unpack(self.packed(arrived), pixel_format, self.size[::-1])


def expected_size(camera_file: CameraFile) -> tuple[int, int]:
    """(width, height) in pixels of what a camera sends."""
    return camera_file.mosaic_size if camera_file.polarized else (camera_file.camera.width, camera_file.camera.height)


def of_pictures(camera_file: CameraFile) -> CameraFile:
    """The camera file of pictures of whole bytes whose values are in the low bits."""
    return replace(camera_file, pixel_format=None, bit_alignment="lsb")


def _of_stream(camera_file: CameraFile, pixel_format: PixelFormat) -> CameraFile:
    alignment = camera_file.bit_alignment if pixel_format is PixelFormat.MONO16 else "lsb"
    return replace(camera_file, pixel_format=pixel_format, bit_alignment=alignment)


def _require_size(camera_file: CameraFile, size: tuple[int, int]) -> None:
    if camera_file.polarized and camera_file.layout is None:
        raise InputError("sends mosaics, but the camera file says mosaic: none; write the four angles of its 2x2 block")
    width, height = expected_size(camera_file)
    if size == (width, height):
        return
    if camera_file.polarized and size == (camera_file.camera.width, camera_file.camera.height):
        raise InputError(
            f"sends {size[0]}x{size[1]} pixels, which the camera file gives as the size of one channel; write width: "
            f"{size[0] // 2} and height: {size[1] // 2}, with fx, fy, cx and cy of a channel"
        )
    mosaic = (
        f" (mosaics of twice width and height, {width}x{height})" if camera_file.polarized else f" ({width}x{height})"
    )
    raise InputError(
        f"sends {size[0]}x{size[1]} pixels, not what the camera file says{mosaic}; correct the camera file, or the "
        f"camera's Width and Height (--feature Width={width} --feature Height={height}; binning off)"
    )


def _require_pixels(camera_file: CameraFile, named: NamedFormat, name: str) -> None:
    bits = named.pixel_format.bits
    if bits != camera_file.bit_depth and not (named.pixel_format is PixelFormat.MONO16 and camera_file.bit_depth > 8):
        raise InputError(
            f"sends {name}, {bits} bits, but the camera file says bit_depth: {camera_file.bit_depth}; correct it "
            f"there, or set the camera (--feature PixelFormat=Mono{camera_file.bit_depth})"
        )
    if named.colour is not None and named.colour != camera_file.colour:
        raise InputError(
            f"sends {name}, of a colour sensor, but the camera file says colour: {camera_file.colour or 'none'}; "
            f"write colour: {named.colour} there"
        )
