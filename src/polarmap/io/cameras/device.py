"""The seam to a camera's driver: what it is asked, and what a picture is when it arrives."""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import TracebackType
from typing import Protocol

from polarmap.errors import PolarmapError


class Unplugged(PolarmapError):
    """A camera does not answer any more."""


@dataclass(frozen=True, eq=False)
class Arrived:
    """A picture as it came over the cable, copied out of the driver's memory.

    number: what the camera or its driver counts pictures by; None where it does not. came: seconds of
    `time.perf_counter`. clock: nanoseconds of the camera's own clock at the exposure; None where it tells none.
    width, height: pixels. pixel_format: the camera's name of the format. data: the picture's bytes and whatever
    follows them, chunk data say; None for a picture of which a part was lost. padding: bytes that follow each row.
    exposure: seconds; NaN where it is not known.
    """

    number: int | None
    came: float
    clock: int | None
    width: int
    height: int
    pixel_format: str
    data: bytes | None
    padding: int = 0
    exposure: float = math.nan


class Device(Protocol):
    """An open camera. Entering it starts the acquisition, leaving it stops and closes; an error there is not raised.

    name: model and serial number, for messages.
    """

    name: str

    def __enter__(self) -> Device: ...
    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, traceback: TracebackType | None
    ) -> None: ...

    def feature(self, name: str) -> str | None:
        """The value of a GenICam feature as text; None where the camera has none of that name."""
        ...

    def set_feature(self, name: str, value: str) -> None:
        """Set a feature; InputError, naming both, where the camera does not take it."""
        ...

    def fetch(self, seconds: float) -> Arrived | None:
        """The next picture, None where none came for about so long. Raises Unplugged where the camera has gone."""
        ...
