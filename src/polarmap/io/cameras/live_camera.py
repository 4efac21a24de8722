"""A camera on a cable as a source of frames that come at their times."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from itertools import islice
from pathlib import Path
from time import perf_counter

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.times import nanoseconds_of
from polarmap.io.cameras.device import Device
from polarmap.io.cameras.feed import BUFFER, Feed, Taken
from polarmap.io.cameras.stream_format import of_pictures


class LiveCamera:
    """The frames of an open `Device`, as a `LiveSource`, for one pass.

    Frames are numbered from 0, those that were lost included. frames: after how many it ends; None for no end.
    buffer, ended: see `Feed`, whose `came`, `lost` and `missed` are here too. Iterating raises what `Feed` does.
    """

    def __init__(
        self,
        device: Device,
        camera_file: CameraFile,
        buffer: int = BUFFER,
        ended: Callable[[], bool] = lambda: False,
        frames: int | None = None,
    ) -> None:
        self.camera_file = of_pictures(camera_file)
        self.feed = Feed(device, camera_file, buffer, ended)
        self.exposed = self._made = perf_counter()
        self._frames = frames

    @property
    def begun(self) -> float:
        """When the first frame came; before that, when this was made."""
        return self._made if self.feed.first is None else self.feed.first

    @property
    def missed(self) -> int:
        """Frames that came while too many waited."""
        return self.feed.missed

    @property
    def lost(self) -> int:
        """Frames that never came, or in parts."""
        return self.feed.lost

    def when(self, timestamp: float) -> float:
        """See `CameraClock.when`."""
        return self.feed.clock.when(nanoseconds_of(timestamp))

    def __iter__(self) -> Iterator[Frame]:
        pictures = self.feed.__iter__()
        try:
            for taken in islice(pictures, self._frames):
                self.exposed = self.when(taken.timestamp)
                yield frame_of(taken, self.camera_file)
        finally:
            pictures.close()


def frame_of(taken: Taken, camera_file: CameraFile) -> Frame:
    """The frame of a picture; InputError where values use more bits than the camera file says."""
    name = f"{taken.index:06d}"
    pixels = taken.form.pixels(taken.arrived)
    mosaic, grey = (pixels, None) if camera_file.polarized else (None, pixels)
    return Frame(
        taken.index, taken.timestamp, name, Path(name), mosaic=mosaic, grey=grey, exposure=taken.arrived.exposure
    )
