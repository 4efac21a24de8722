"""Sizes of mosaic and channel, by the first picture of a sequence."""

from __future__ import annotations

import os
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polarmap.errors import InputError
from polarmap.io.formats.images import PICTURE_SUFFIXES, ImageHeader, read_picture_header

_FOLDERS = ("raw", "images", "image", "gray", "grey", "rgb", "cam0/data", "mav0/cam0/data", ".", "0", "raw/0")
_ANGLE = re.compile(r"(?:.*[_-])?(?:(?:i|pol|angle|deg)[_-]?)?(?:0{1,3}|0?45|0?90|135)(?:deg)?", re.IGNORECASE)
_LONGEST_NAME = 40  # characters, in messages


@dataclass(frozen=True)
class PictureSizes:
    """The (width, height) of a channel or plain picture, and of the mosaic where pictures are mosaics; bits a pixel.

    name: of the picture that tells.
    """

    name: str
    channel: tuple[int, int]
    mosaic: tuple[int, int] | None
    polarized: bool
    bits: int

    @property
    def doubled(self) -> tuple[int, int] | None:
        """The size of the mosaic that pictures of one angle were taken from."""
        return (2 * self.channel[0], 2 * self.channel[1]) if self.polarized else None

    @property
    def told(self) -> str:
        """The sizes in words."""
        channel = "x".join(map(str, self.channel))
        return channel if self.mosaic is None else f"{'x'.join(map(str, self.mosaic))} and a channel of it {channel}"


def picture_sizes(sequence: Path, keys: Mapping[str, Any]) -> PictureSizes | None:
    """The sizes in a sequence of the camera that these keys are of; None where no picture is found."""
    found = _first_picture(sequence, keys.get("images"))
    if found is None:
        return None
    path, header, of_one_angle = found
    return sizes_of(path.name[:_LONGEST_NAME], header, keys, of_one_angle)


def sizes_of(name: str, header: ImageHeader, keys: Mapping[str, Any], of_one_angle: bool = False) -> PictureSizes:
    """The sizes that a picture of this header tells, for the camera that these keys are of."""
    size, polarized = (header.width, header.height), keys.get("polarization") != "none"
    if not polarized or keys.get("mosaic") == "none" or of_one_angle:
        return PictureSizes(name, size, None, polarized, header.bits)
    return PictureSizes(name, (size[0] // 2, size[1] // 2), size, polarized, header.bits)


def _first_picture(sequence: Path, images: Any) -> tuple[Path, ImageHeader, bool] | None:
    """A picture of a sequence, of its first folder that has some, its header, and whether it is of one angle.

    That is told by its folder, or by the names of all: 45/NAME.png, NAME_45.png.
    """
    if sequence.is_file():
        return _with_header(sequence, False)
    for name in [images] if isinstance(images, str) else _FOLDERS:
        with suppress(OSError, ValueError):
            names = [entry.name for entry in os.scandir(sequence / name) if _is_picture(entry.name)]
            if names:
                of_one_angle = Path(name).name == "0" or all(_ANGLE.fullmatch(Path(each).stem) for each in names)
                return _with_header(sequence / name / min(names), of_one_angle)
    return None


def _is_picture(name: str) -> bool:
    return not name.startswith(".") and Path(name).suffix.lower() in PICTURE_SUFFIXES


def _with_header(path: Path, of_one_angle: bool) -> tuple[Path, ImageHeader, bool] | None:
    with suppress(InputError):
        return path, read_picture_header(path), of_one_angle
    return None
