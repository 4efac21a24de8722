"""What a camera sends, taken at once by a thread of its own and kept for who is late; what is lost is counted."""

from __future__ import annotations

import logging
from collections.abc import Callable, Generator, Iterator
from dataclasses import dataclass
from queue import Empty, Queue
from threading import Event, Thread
from time import perf_counter

from polarmap.data.camera_file import CameraFile
from polarmap.data.times import Timestamp
from polarmap.io.cameras.camera_clock import CameraClock
from polarmap.io.cameras.device import Arrived, Device
from polarmap.io.cameras.stream_format import StreamFormat, expected_size
from polarmap.io.formats.times import from_nanoseconds

log = logging.getLogger(__name__)

BUFFER = 32  # pictures that are kept for who is late; what comes while so many wait is lost
_LOOK = 0.05  # seconds, after which a thread that waits looks whether it should end
_SILENCE = 5.0  # seconds without a picture, after which the user is told
_RESTART = 1_000_000  # so many numbers left out are no loss: the camera counts anew
_SHORT_COUNT = 0xFFFF  # GigE Vision 1 counts to this, and begins again with 1


@dataclass(frozen=True, eq=False)
class Taken:
    """A whole picture: its number from 0, those that were lost included, its time, and how it is to be read."""

    index: int
    timestamp: Timestamp
    arrived: Arrived
    form: StreamFormat


class Feed:
    """Pictures of a device in their order, for one pass.

    buffer: how many are kept. ended: asked often; once it is true no more are taken. With `keep` those that wait by
    then are still given, else they are left.

    came: pictures that arrived. lost: those that did not, by the numbers left out, or in parts. missed: those that came
    while `buffer` waited. waiting: how many wait now. first: when the first one came, in seconds of `perf_counter`.

    Iterating raises InputError where pictures are not as the camera file says, Unplugged where the device has gone:
    after what came before.
    """

    def __init__(
        self,
        device: Device,
        camera_file: CameraFile,
        buffer: int = BUFFER,
        ended: Callable[[], bool] = lambda: False,
        keep: bool = False,
    ) -> None:
        self.device = device
        self.clock = CameraClock(device.name)
        self.came = self.lost = self.missed = 0
        self.first: float | None = None
        self._camera_file = camera_file
        self._form: StreamFormat | None = None
        self.buffer = buffer
        self.ended = ended
        self._keep = keep
        self._queue: Queue[Taken | Exception] = Queue()
        self._number: int | None = None
        self._index = -1

    @property
    def waiting(self) -> int:
        """How many pictures wait to be given."""
        return self._queue.qsize()

    def __iter__(self) -> Generator[Taken, None, None]:
        over = Event()
        with self.device:
            taker = Thread(target=self._take, args=(over,), name="polarmap-camera", daemon=True)
            taker.start()
            try:
                yield from self._until_ended()
                over.set()
                taker.join()
                if self._keep:
                    yield from self._rest()
            finally:
                over.set()
                taker.join()

    def _until_ended(self) -> Iterator[Taken]:
        while not self.ended():
            try:
                item = self._queue.get(timeout=_LOOK)
            except Empty:
                continue
            yield _given(item)

    def _rest(self) -> Iterator[Taken]:
        while not self._queue.empty():
            yield _given(self._queue.get())

    def _take(self, over: Event) -> None:
        last, told = perf_counter(), False
        try:
            while not over.is_set():
                arrived = self.device.fetch(_LOOK)
                if arrived is not None:
                    self._add(arrived)
                    last, told = perf_counter(), False
                elif not told and perf_counter() - last > _SILENCE:
                    told = True
                    log.warning("%s: %s", self.device.name, self._why_silent())
        except Exception as problem:  # told by the thread that takes the pictures
            self._queue.put(problem)

    def _add(self, arrived: Arrived) -> None:
        left_out = _left_out(self._number, arrived.number)
        self._number = arrived.number
        self._index += 1 + left_out
        if self._form is None or not (arrived.data is None or self._form.fits(arrived)):
            self._form = self._form_of(arrived)
        whole = self._form.whole(arrived)
        self._note_lost(left_out + (not whole))
        if not whole:
            return
        self.came += 1
        self.first = arrived.came if self.first is None else self.first
        time = self.clock.time(arrived.clock, arrived.came)
        if self._queue.qsize() >= self.buffer:
            self.missed += 1
        else:
            self._queue.put(Taken(self._index, from_nanoseconds(time), arrived, self._form))

    def _form_of(self, arrived: Arrived) -> StreamFormat:
        """Of a picture that is whole; what came of another one says nothing of its size."""
        size = expected_size(self._camera_file) if arrived.data is None else (arrived.width, arrived.height)
        return StreamFormat(self._camera_file, self.device.name, size, arrived.pixel_format)

    def _note_lost(self, count: int) -> None:
        if count and not self.lost:
            where = f"frames were lost on the way, until frame {self._index}"
            log.warning("%s: %s; all such are counted, causes: docs/live.md", self.device.name, where)
        self.lost += count

    def _why_silent(self) -> str:
        trigger = (self.device.feature("TriggerMode") or "").lower() in ("on", "true", "1")
        if trigger:
            return "no frame came for some seconds; its TriggerMode is On: trigger it, or --feature TriggerMode=Off"
        if self.lost and not self.came:
            return "no frame comes whole; check the cable, and jumbo frames or a lower frame rate"
        return "no frame came for some seconds; still waiting (Ctrl-C ends it)"


def _given(item: Taken | Exception) -> Taken:
    if isinstance(item, Exception):
        raise item
    return item


def _left_out(before: int | None, now: int | None) -> int:
    """Pictures between two numbers; 0 where a number is missing or the camera began to count anew."""
    if before is None or now is None:
        return 0
    if now > before:
        return now - before - 1 if now - before < _RESTART else 0
    if before <= _SHORT_COUNT and before - now > _SHORT_COUNT // 2:
        return now + _SHORT_COUNT - before - 1
    return 0
