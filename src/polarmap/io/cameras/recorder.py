"""Writes what a camera sends as a sequence that `open_sequence` reads, at whatever moment the writing ends."""

from __future__ import annotations

import json
import os
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass, replace
from datetime import datetime, timezone
from pathlib import Path
from time import perf_counter
from typing import TextIO

from polarmap.data.camera_file import CameraFile
from polarmap.errors import InputError, PolarmapError
from polarmap.io.cameras.device import Device
from polarmap.io.cameras.features import number
from polarmap.io.cameras.feed import Feed, Taken
from polarmap.io.cameras.stream_format import expected_size
from polarmap.io.files import reason, write_bytes
from polarmap.io.folder_lock import LOCK_NAME, FolderLock
from polarmap.io.formats.images import write_image
from polarmap.io.formats.times import seconds_text
from polarmap.io.recording.camera_file import CAMERA_FILE_NAME, write_camera_file
from polarmap.version import package_version

RECORD_NAME = "recording.json"
_MEMORY = 1 << 29  # bytes of pictures that may wait to be written
_LEAST_BUFFER = 16
_BEHIND = 4  # of the room: where more waits than this part, pictures are written without compressing them
_HEADER = "# name seconds exposure[ms]\n"
_GAINS = ("Gain", "GainRaw")


@dataclass(frozen=True)
class Progress:
    """How far a recording is: pictures written, those that wait, those lost on the way, and those for lack of room."""

    written: int
    waiting: int
    lost: int
    missed: int
    seconds: float


class Recorder:
    """Records a device into a folder, which must be empty or not there.

    raw: write the camera's own bytes (raw/NNNNNN.raw) in place of PNG files, which take less room and more work;
    without it, that is done where writing is behind. camera.yaml is right for both. Frames are numbered from 0, those
    that were lost included. timestamps.txt has a frame's line before its picture is there, so that what is on disk is
    a sequence whatever ends the program.

    Raises InputError where the folder holds something, PolarmapError where it cannot be made.
    """

    def __init__(self, folder: Path, device: Device, camera_file: CameraFile, raw: bool = False) -> None:
        self.folder = folder
        self._device = device
        self._camera_file = replace(camera_file, images=None)
        self._raw = raw
        self._written = 0
        self._workers = min(4, os.cpu_count() or 1)
        _require_empty(folder)
        try:
            (folder / "raw").mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise PolarmapError(f"{folder}: cannot be created ({reason(error)})") from None

    def record(
        self,
        frames: int | None = None,
        seconds: float | None = None,
        stopped: Callable[[], bool] = lambda: False,
        on_frame: Callable[[Progress], None] | None = None,
    ) -> Progress:
        """Record until so many frames are written, or so many seconds since the first, or `stopped` is true.

        What came until then is written. Raises what `Feed` does, and PolarmapError where a file cannot be written; what
        came before that is kept.
        """
        feed = Feed(self._device, self._camera_file, self._buffer(), keep=True)
        feed.ended = lambda: (
            stopped() or (seconds is not None and feed.first is not None and perf_counter() - feed.first >= seconds)
        )
        started = datetime.now(timezone.utc).isoformat(timespec="seconds")
        with FolderLock(self.folder):
            try:
                self._write_all(feed, frames, on_frame)
            finally:
                self._write_record(feed, started)
        return self._progress(feed)

    def _write_all(self, feed: Feed, frames: int | None, on_frame: Callable[[Progress], None] | None) -> None:
        pending: deque[Future] = deque()
        path = self.folder / "timestamps.txt"
        pictures = feed.__iter__()
        try:
            with open(path, "w", encoding="utf-8", buffering=1) as times, ThreadPoolExecutor(self._workers) as pool:
                times.write(_HEADER)
                try:
                    for taken in pictures:
                        self._submit(taken, times, pool, pending, self._raw or feed.waiting > feed.buffer // _BEHIND)
                        if on_frame:
                            on_frame(self._progress(feed))
                        if self._written + len(pending) == frames:
                            break
                finally:
                    pictures.close()
                    while pending:
                        self._finish(pending)
        except OSError as error:
            raise PolarmapError(f"{path}: cannot be written ({reason(error)})") from None

    def _submit(self, taken: Taken, times: TextIO, pool: ThreadPoolExecutor, pending: deque[Future], raw: bool) -> None:
        if not self._written and not pending:
            write_camera_file(self.folder / CAMERA_FILE_NAME, taken.form.camera_file)
        while len(pending) >= 2 * self._workers or (pending and pending[0].done()):
            self._finish(pending)
        exposure = 1000 * taken.arrived.exposure
        times.write(f"{taken.index:06d} {seconds_text(taken.timestamp)} {exposure:.6g}\n")
        pending.append(pool.submit(self._write, taken, raw))

    def _finish(self, pending: deque[Future]) -> None:
        pending.popleft().result()
        self._written += 1

    def _write(self, taken: Taken, raw: bool) -> None:
        path = self.folder / "raw" / f"{taken.index:06d}"
        if raw:
            write_bytes(path.with_suffix(".raw"), taken.form.packed(taken.arrived))
        else:
            write_image(path.with_suffix(".png"), taken.form.unpacked(taken.arrived))

    def _buffer(self) -> int:
        width, height = expected_size(self._camera_file)
        return max(_LEAST_BUFFER, _MEMORY // (2 * width * height))

    def _progress(self, feed: Feed) -> Progress:
        seconds = 0.0 if feed.first is None else perf_counter() - feed.first
        return Progress(self._written, feed.waiting, feed.lost, feed.missed, seconds)

    def _write_record(self, feed: Feed, started: str) -> None:
        gain = next((value for name in _GAINS if (value := number(self._device, name)) == value), None)
        record = {
            "camera": self._device.name,
            "pixel_format": self._device.feature("PixelFormat"),
            "gain": gain,
            "started": started,
            "frames": self._written,
            "lost_on_the_way": feed.lost,
            "lost_for_lack_of_room": feed.missed,
            "jumps_of_the_clock": feed.clock.jumps,
            "polarmap": package_version(),
        }
        write_bytes(self.folder / RECORD_NAME, json.dumps(record, indent=2).encode() + b"\n")


def _require_empty(folder: Path) -> None:
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is a file; name a folder to write")
        if folder.is_dir() and any(path.name != LOCK_NAME for path in folder.iterdir()):
            raise InputError(f"{folder}: is not empty; name another folder, so that no recording is replaced")
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({reason(error)})") from None
