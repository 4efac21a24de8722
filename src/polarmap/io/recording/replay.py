"""A recording played as a camera would send it: each frame at its time, whether or not anybody is ready for it."""

from __future__ import annotations

from collections.abc import Iterator
from queue import Empty, Full, Queue
from threading import Event, Thread
from time import perf_counter, sleep

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.errors import InputError
from polarmap.io.recording.sequence import Sequence
from polarmap.niceness import SOON, give_way

BUFFER = 32  # frames that a driver keeps for who is late; what comes while it is full is lost
_AHEAD = 8  # frames that are read from disk before their time
_LOOK = 0.05  # seconds, after which a thread that waits looks whether it should end


class Replay:
    """Frames of a `Sequence` at their own times, as a `FrameSource`.

    Reading and decoding, which a camera does not need, is done ahead by a thread. Frames are exposed at their time from
    the first one, kept as long as there is room, and lost where there is none.

    begun: when the first frame was exposed; exposed: when the frame was that was given last; both in seconds of
    `time.perf_counter`. missed: how many frames were lost.
    Raises InputError where a frame has no time.
    """

    def __init__(self, sequence: Sequence, buffer: int = BUFFER) -> None:
        self._sequence = sequence
        self._buffer = buffer
        self._first = _first_time(sequence)
        self.begun = self.exposed = perf_counter()
        self.missed = 0

    @property
    def camera_file(self) -> CameraFile:
        """Of the sequence."""
        return self._sequence.camera_file

    def when(self, timestamp: float) -> float:
        """When a frame of this time was exposed, on the clock of `begun`."""
        return self.begun + float(timestamp) - self._first

    def __iter__(self) -> Iterator[Frame]:
        """Raises InputError, at the frame's turn, where one cannot be read."""
        read: Queue[Frame | Exception | None] = Queue(_AHEAD)
        sent: Queue[Frame | Exception | None] = Queue()
        ended = Event()
        reader = Thread(target=self._read, args=(read, ended), name="polarmap-reader", daemon=True)
        sender = Thread(target=self._send, args=(read, sent, ended), name="polarmap-camera", daemon=True)
        reader.start()
        while not read.full() and reader.is_alive():
            sleep(0.002)
        self.begun = perf_counter()
        sender.start()
        try:
            while (item := sent.get()) is not None:
                if isinstance(item, Exception):
                    raise item
                self.exposed = self.when(item.timestamp)
                yield item
        finally:
            ended.set()
            sender.join()
            reader.join()

    def _read(self, read: Queue, ended: Event) -> None:
        give_way(SOON)  # a camera decodes nothing
        try:
            for frame in self._sequence:
                if not _put(read, frame, ended):
                    return
            _put(read, None, ended)
        except Exception as problem:  # told by the thread that takes the frames
            _put(read, problem, ended)

    def _send(self, read: Queue, sent: Queue, ended: Event) -> None:
        while not ended.is_set():
            try:
                item = read.get(timeout=_LOOK)
            except Empty:
                continue
            if isinstance(item, Frame):
                if ended.wait(max(0.0, self.when(item.timestamp) - perf_counter())):
                    return
                if sent.qsize() >= self._buffer:
                    self.missed += 1
                    continue
            sent.put(item)
            if not isinstance(item, Frame):
                return


def _first_time(sequence: Sequence) -> float:
    timestamps = sequence.timestamps
    if np.isnan(timestamps).any():
        raise InputError(
            f"{sequence.path}: the frames have no times at which to play them; "
            "add timestamps.txt to the sequence or frame_rate to its camera file"
        )
    return float(timestamps[0]) if len(timestamps) else 0.0


def _put(queue: Queue, item: object, ended: Event) -> bool:
    """Put an item as soon as there is room; False where the end came first."""
    while not ended.is_set():
        try:
            queue.put(item, timeout=_LOOK)
            return True
        except Full:
            continue
    return False
