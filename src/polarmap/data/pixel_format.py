"""How raw buffers store pixels: the GenICam pixel formats that polarization cameras record."""

from __future__ import annotations

from enum import Enum

from polarmap.errors import InputError


class PixelFormat(Enum):
    """A GenICam pixel format: its name, significant bits, and how many pixels fill how many bytes."""

    MONO8 = ("Mono8", 8, 1, 1)
    MONO10 = ("Mono10", 10, 1, 2)
    MONO12 = ("Mono12", 12, 1, 2)
    MONO16 = ("Mono16", 16, 1, 2)
    MONO10_PACKED = ("Mono10Packed", 10, 2, 3)
    MONO12_PACKED = ("Mono12Packed", 12, 2, 3)
    MONO10P = ("Mono10p", 10, 4, 5)
    MONO12P = ("Mono12p", 12, 2, 3)

    def __init__(self, label: str, bits: int, group_pixels: int, group_bytes: int) -> None:
        self.label = label
        self.bits = bits
        self.group_pixels = group_pixels
        self.group_bytes = group_bytes

    @classmethod
    def from_name(cls, name: object) -> PixelFormat:
        """The format of this name; InputError where there is none."""
        for pixel_format in cls:
            if pixel_format.label == name:
                return pixel_format
        known = ", ".join(pixel_format.label for pixel_format in cls)
        raise InputError(f"pixel_format: {name!r} is not known; write one of {known}")

    @classmethod
    def unpacked(cls, bits: int) -> PixelFormat:
        """The format that stores `bits` bits (8, 10, 12 or 16) in whole bytes."""
        return cls.from_name(f"Mono{bits}")

    def byte_count(self, shape: tuple[int, int]) -> int:
        """Bytes of an image of this (height, width); InputError where they do not fill whole groups."""
        pixels = shape[0] * shape[1]
        if pixels % self.group_pixels:
            raise InputError(f"{self.label}: {shape[1]}x{shape[0]} pixels are no multiple of {self.group_pixels}")
        return pixels // self.group_pixels * self.group_bytes
