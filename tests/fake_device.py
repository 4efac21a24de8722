"""A camera in memory: it sends what a test lays out, and then nothing, or goes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from time import perf_counter, sleep

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.pixel_format import PixelFormat
from polarmap.errors import InputError
from polarmap.io.cameras.device import Arrived, Unplugged
from polarmap.io.formats.packed import pack
from polarmap.synth import Sensor
from polarmap.synth.recording import camera_file

MS = 1_000_000  # nanoseconds


def camera(width: int = 8, height: int = 6, bits: int = 8) -> CameraFile:
    from polarmap.geometry.camera import PinholeCamera

    lens = PinholeCamera(width, height, 10.0, 10.0, width / 2 - 0.5, height / 2 - 0.5)
    return camera_file(lens, Sensor(bit_depth=bits))


def mosaic(i: int, shape: tuple[int, int] = (12, 16), bits: int = 8) -> np.ndarray:
    values = np.random.default_rng(i).integers(0, 1 << bits, shape)
    return values.astype(np.uint8 if bits == 8 else np.uint16)


def picture(i: int, number: int | None = None, clock: int | None = None, **changes) -> Arrived:
    """The picture `mosaic(i)`, which came just now."""
    values = {
        "number": i if number is None else number, "came": perf_counter(), "clock": clock, "width": 16, "height": 12,
        "pixel_format": "Mono8", "data": mosaic(i).tobytes(), "exposure": 0.002,
    }  # fmt: skip
    return Arrived(**values | changes)


def packed_picture(i: int, name: str, pixel_format: PixelFormat, behind: bytes = b"") -> Arrived:
    """A picture of 12 or 10 bits in a packed format, with chunk data behind it."""
    data = pack(mosaic(i, bits=pixel_format.bits), pixel_format)
    return picture(i, pixel_format=name, data=data + behind)


@dataclass
class FakeDevice:
    """Sends `pictures` one after the other; `goes` makes it vanish then. started, stopped: how often."""

    pictures: Sequence[Arrived]
    goes: bool = False
    pace: float = 0.0
    features: dict[str, str] = field(default_factory=dict)
    name: str = "Fake 42"
    started: int = 0
    stopped: int = 0

    def __post_init__(self) -> None:
        self._left = list(self.pictures)

    def __enter__(self) -> FakeDevice:
        self.started += 1
        return self

    def __exit__(self, *what: object) -> None:
        self.stopped += 1

    @property
    def empty(self) -> bool:
        return not self._left

    def feature(self, name: str) -> str | None:
        return self.features.get(name)

    def set_feature(self, name: str, value: str) -> None:
        if name not in self.features:
            raise InputError(f"{self.name}: has no feature {name}")
        self.features[name] = value

    def fetch(self, seconds: float) -> Arrived | None:
        if self._left:
            sleep(self.pace)
            return self._left.pop(0)
        if self.goes:
            raise Unplugged(f"{self.name}: does not answer any more (gone)")
        sleep(min(seconds, 0.005))
        return None
