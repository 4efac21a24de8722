"""A frame as it was recorded, and what gives frames."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import numpy as np

from polarmap.data.camera_file import CameraFile


@dataclass(frozen=True, eq=False)
class Frame:
    """One frame as recorded: a mosaic, four pictures, or the picture of a plain camera.

    index: the number in its file's name, or its position in the sequence where names are not numbered.
    timestamp: seconds, a `polarmap.data.times.Timestamp` where a file gives them; NaN where the sequence has no times.
    name: the file's name without suffix and angle. path: the (first) file, for messages.
    mosaic: uint8 or uint16 2H×2W, or None.
    channels: uint8 or uint16 4×H×W, what the files label 0, 45, 90 and 135 degrees, or None.
    grey: uint8 or uint16 H×W, the picture of a camera without polarization (of a colour one its luma), or None.
    exposure: seconds; NaN where it is not known.
    H×W is the camera's shape; values are at most the camera file's white_level, black not subtracted.
    """

    index: int
    timestamp: float
    name: str
    path: Path
    mosaic: np.ndarray | None = None
    channels: np.ndarray | None = None
    grey: np.ndarray | None = None
    exposure: float = float("nan")

    @property
    def raw(self) -> np.ndarray | None:
        """The pixel values of a polarization camera as recorded: the mosaic 2H×2W, or the four pictures 4×H×W."""
        return self.channels if self.mosaic is None else self.mosaic


class FrameSource(Protocol):
    """What gives frames in order of time: a recorded sequence, a camera, a list.

    camera_file: what its frames are like. One that has a length tells how many frames will come.
    """

    @property
    def camera_file(self) -> CameraFile: ...
    def __iter__(self) -> Iterator[Frame]: ...


class LiveSource(FrameSource, Protocol):
    """A `FrameSource` whose frames come at their times, taken or not.

    begun: when the first frame was exposed; exposed: when the frame was that was given last; both in seconds of
    `time.perf_counter`. missed: frames that were lost since too many waited.
    """

    @property
    def begun(self) -> float: ...
    @property
    def exposed(self) -> float: ...
    @property
    def missed(self) -> int: ...
    def when(self, timestamp: float) -> float:
        """When a frame of this time was exposed, on the clock of `begun`."""
        ...
