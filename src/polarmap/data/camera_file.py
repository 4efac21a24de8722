"""What a camera file says: calibration and sensor of a polarization or plain camera, and how its files store pixels."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from pathlib import Path

from polarmap.data.pixel_format import PixelFormat
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.sensor import AngleDirection, SensorLayout, SensorNoise
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.distortion import Distortion

BIT_DEPTHS = (8, 10, 12, 16)
BAYER_PATTERNS = ("RGGB", "BGGR", "GRBG", "GBRG")
DEMOSAIC_METHODS = ("split", "bilinear", "edge-aware")
_MAX_SIDE = 1 << 14  # of a channel, in pixels
_LEAST, _MOST = 1e-6, 1e9  # frames per second, and values per metre


@dataclass(frozen=True)
class PhotometricFiles:
    """Where a camera's photometric calibration is kept; `polarmap.io.recording.photometric` reads it.

    response: text file of the inverse response. vignette: picture of what the lens lets through. None for what
    is not known; relative paths are made absolute.
    """

    response: Path | None = None
    vignette: Path | None = None

    def __post_init__(self) -> None:
        for key in ("response", "vignette"):
            if (path := getattr(self, key)) is not None:
                object.__setattr__(self, key, Path(os.path.abspath(path)))


@dataclass(frozen=True)
class CameraFile:
    """A polarization camera, or a plain one: its calibration, its sensor, and how its files store pixels.

    camera: intrinsics of one polarization channel (a mosaic has twice its width and height) or of a plain
        camera's picture, still distorted where there is a `distortion`, whose undoing keeps K.
    layout: polarizer angles of the mosaic's 2×2 block; None for one picture per angle, and for a plain camera.
    angle_direction: which way the labelled angles turn, as displayed; None makes it a plain camera.
    bit_depth: significant bits of a pixel, 8, 10, 12 or 16.
    bit_alignment: "msb" where 16-bit pixels hold 10 or 12 bits shifted to the top, else "lsb".
    pixel_format: how raw files store pixels; None stands for whole bytes and is replaced by that format.
    black_level: the pixel value of no light.
    colour: Bayer pattern that the 2×2 polarizer blocks of a colour sensor lie under; None for a grey one.
    demosaic: how four channels are made of a mosaic.
    noise: shot and read noise.
    frame_rate: frames per second, for sequences without timestamps.
    depth_scale: pixel values per metre in the PNG files of a sequence's true depth.
    images: folder of the pictures inside the sequence's, such as "cam0/data"; None for the usual ones.
    photometric: files of the photometric calibration, which odometry uses.
    polarizers: what was measured of the polarizers, the file's `calibration`; None for ideal ones.

    Raises InputError where a value is out of range or two contradict each other.
    """

    camera: PinholeCamera
    layout: SensorLayout | None
    angle_direction: AngleDirection | None
    bit_depth: int
    bit_alignment: str = "lsb"
    pixel_format: PixelFormat | None = None
    black_level: float = 0.0
    colour: str | None = None
    demosaic: str = "split"
    distortion: Distortion | None = None
    noise: SensorNoise = field(default_factory=SensorNoise)
    frame_rate: float | None = None
    depth_scale: float | None = None
    images: str | None = None
    photometric: PhotometricFiles | None = None
    polarizers: PolarizerCalibration | None = None

    def __post_init__(self) -> None:
        self._check_pixels()
        self._check_sensor()
        self._check_images()
        for key, value in (("frame_rate", self.frame_rate), ("depth_scale", self.depth_scale)):
            if value is not None:
                _require(value > 0, f"{key}: {value} is not positive")
                _require(_LEAST <= value <= _MOST, f"{key}: {value} is not in [{_LEAST:g}, {_MOST:g}]")

    @property
    def polarized(self) -> bool:
        """Whether the pictures have polarization channels."""
        return self.angle_direction is not None

    @property
    def white_level(self) -> int:
        """The pixel value of full scale."""
        return (1 << self.bit_depth) - 1

    @property
    def mosaic_size(self) -> tuple[int, int]:
        """(width, height) of the raw mosaic in pixels."""
        return 2 * self.camera.width, 2 * self.camera.height

    def _check_pixels(self) -> None:
        _require(self.bit_depth in BIT_DEPTHS, f"bit_depth: {self.bit_depth} is not one of 8, 10, 12 and 16")
        msb = self.bit_alignment == "msb"
        _require(msb or self.bit_alignment == "lsb", f"bit_alignment: {self.bit_alignment!r} is not lsb or msb")
        _require(not msb or self.bit_depth in (10, 12), "bit_alignment: msb is for a bit_depth of 10 or 12")
        if self.pixel_format is None:
            object.__setattr__(self, "pixel_format", PixelFormat.unpacked(16 if msb else self.bit_depth))
        padded = self.pixel_format is PixelFormat.MONO16 and self.bit_depth > 8
        _require(
            padded or (self.pixel_format.bits == self.bit_depth and not msb),
            f"pixel_format: {self.pixel_format.label} is not for {self.bit_depth} bits, {self.bit_alignment}",
        )
        _require(
            0 <= self.black_level < self.white_level,
            f"black_level: {self.black_level} is not in [0, {self.white_level})",
        )

    def _check_sensor(self) -> None:
        width, height = self.camera.width, self.camera.height
        _require(max(width, height) <= _MAX_SIDE, f"camera: {width}x{height} is more than {_MAX_SIDE} a side")
        _require(
            self.demosaic in DEMOSAIC_METHODS,
            f"demosaic: {self.demosaic!r} is not one of {', '.join(DEMOSAIC_METHODS)}",
        )
        _require(self.polarized or self.layout is None, "mosaic: a camera without polarization has none")
        _require(self.polarized or self.polarizers is None, "calibration: a camera without polarization has none")
        self.noise.check("noise")
        if self.colour is not None:
            known = ", ".join(BAYER_PATTERNS)
            _require(self.colour in BAYER_PATTERNS, f"colour: {self.colour!r} is not one of {known}")
            _require(self.layout is not None, "colour: only a mosaic sensor may have a Bayer pattern")
            _require(width % 2 == height % 2 == 0, "colour: width and height must be even")

    def _check_images(self) -> None:
        if self.images is not None:
            parts = self.images.replace("\\", "/").split("/")
            inside = all(part not in ("", ".", "..") and part.isprintable() and ":" not in part for part in parts)
            _require(inside, f"images: {self.images[:40]!r} is not the name of a folder inside the sequence's")


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise InputError(message)
