"""The frames of an image topic: where they are in a bag, found once, and what is in them, read when asked for."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise
from pathlib import Path
from threading import Lock
from typing import Any

import cv2
import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.times import nanoseconds_of
from polarmap.errors import InputError
from polarmap.io.files import MAX_LINES
from polarmap.io.formats.images import ImageHeader, decode_image, decode_picture, picture_header
from polarmap.io.formats.times import from_nanoseconds
from polarmap.io.recording.frame_files import FrameFiles
from polarmap.io.recording.pixels import aligned, require_bits, require_size
from polarmap.io.recording.ros.bag import Bag, Message, Topic, readable
from polarmap.io.recording.ros.encodings import Encoding, encoding_of, pixels_of
from polarmap.io.recording.ros.stamped import stamp_of
from polarmap.io.recording.sequence import Sequence

log = logging.getLogger(__name__)

RAW, COMPRESSED = "sensor_msgs/msg/Image", "sensor_msgs/msg/CompressedImage"
_FIRST_CLOCK = 10**18  # nanoseconds; clocks since 1970 are beyond
_PNG, _JPEG = b"\x89PNG\r\n\x1a\n", b"\xff\xd8"


@dataclass(frozen=True)
class BagFrame(FrameFiles):
    """A frame that is not read yet: the message of this number of its topic, recorded at this time (nanoseconds),
    after so many others of the same time."""

    number: int = 0
    recorded: int = 0
    before: int = 0


class FrameReader:
    """Messages of a topic by their number. What comes next costs least. Threads may share it."""

    def __init__(self, bag: Bag, topic: str) -> None:
        self._bag = bag
        self._topic = topic
        self._lock = Lock()
        self._stream: Iterator[Message] = iter(())
        self._next = -1

    def message(self, frame: BagFrame) -> Any:
        """The fields of a frame's message; InputError where the bag has become unreadable."""
        with self._lock:
            if frame.number != self._next:
                self._stream = self._bag.messages(self._topic, frame.recorded)
                left = frame.before
            else:
                left = 0
            self._next = -1  # unless it is found
            for message in self._stream:
                if message.recorded != frame.recorded:
                    continue
                if left == 0:
                    self._next = frame.number + 1
                    return message.fields
                left -= 1
        raise InputError(f"{frame.paths[0]}: is no longer there; the bag was changed while it was read")


@dataclass(frozen=True, eq=False)
class BagSequence(Sequence):
    """The frames of an image topic of a ROS bag, as of a recorded sequence.

    Frames are numbered from 0 in the order of their times; reading one raises InputError, naming the message.
    frame_id: the coordinate frame of the camera by the messages' headers; "" where they name none.
    """

    reader: FrameReader
    topic: str
    frame_id: str

    def _read(self, files: FrameFiles) -> Frame:
        assert isinstance(files, BagFrame)
        message = self.reader.message(files)
        frame = Frame(files.index, files.timestamp, files.name, files.paths[0])
        try:
            return replace(frame, **_pixels(message, self.camera_file))
        except InputError as problem:
            where = str(frame.path)
            raise problem if str(problem).startswith(where) else InputError(f"{where}: {problem}") from None


@dataclass(frozen=True)
class ImageTopic:
    """An image topic: its frames, what its first message says of pictures, and its coordinate frame."""

    name: str
    frames: tuple[BagFrame, ...]
    header: ImageHeader
    kind: str
    frame_id: str


def find_images(bag: Bag, name: str | None) -> ImageTopic:
    """The frames of an image topic of a bag, in order of time; the only one where no name is given.

    All messages are read once, one at a time, for the times in their headers; where one is not set, a frame's time is
    that of its recording. What stops being readable ends there, with a warning. Raises InputError where the topic is
    not there or to be chosen, or its first message cannot be used.
    """
    topic = _chosen(bag, name)
    first: Any = None
    times: list[tuple[int, int]] = []  # in the header, and of recording
    for message in readable(bag, topic.name):
        first = message.fields if first is None else first
        times.append((stamp_of(message.fields.header), message.recorded))
        if len(times) > MAX_LINES:
            raise InputError(f"{bag.path}: {topic.name} has more than the {MAX_LINES} images that a recording may have")
    if first is None:
        raise InputError(f"{bag.path}: {topic.name} has no messages")
    try:
        header, kind = _header(first)
    except InputError as problem:
        raise InputError(f"{_where(bag, topic, 0)}: {problem}") from None
    frames = _in_order(bag, topic, _frames(bag, topic, times))
    return ImageTopic(topic.name, frames, header, kind, first.header.frame_id.strip("/"))


def _frames(bag: Bag, topic: Topic, times: list[tuple[int, int]]) -> list[BagFrame]:
    """The frames in the order of recording."""
    unset = 0 if _from_zero(times) else sum(stamp == 0 for stamp, _ in times)
    if unset:
        log.warning("%s: %d images of %s have no time; that of recording is taken", bag.path, unset, topic.name)
    frames: list[BagFrame] = []
    for number, (stamp, recorded) in enumerate(times):
        time = recorded if unset and stamp == 0 else stamp
        before = frames[-1].before + 1 if frames and frames[-1].recorded == recorded else 0
        where = _where(bag, topic, number)
        frames.append(
            BagFrame(number, from_nanoseconds(time), "", (where,), number=number, recorded=recorded, before=before)
        )
    return frames


def _from_zero(times: list[tuple[int, int]]) -> bool:
    """Whether a stamp of zero is a time, that at which a simulator's clock began, and not one that is not set."""
    stamps = [stamp for stamp, _ in times]
    return stamps.count(0) == 1 and len(stamps) > 1 and max(stamps) < _FIRST_CLOCK


def _where(bag: Bag, topic: Topic, number: int) -> Path:
    return Path(f"{bag.path}, {topic.name}, message {number + 1}")


def _in_order(bag: Bag, topic: Topic, frames: list[BagFrame]) -> tuple[BagFrame, ...]:
    """The frames by their times, numbered anew; of several at one time the first."""
    ordered = sorted(frames, key=_nanoseconds)
    kept = ordered[:1] + [b for a, b in pairwise(ordered) if _nanoseconds(a) != _nanoseconds(b)]
    if len(kept) < len(frames):
        left = len(frames) - len(kept)
        log.warning("%s: %d images of %s have the time of another and are left out", bag.path, left, topic.name)
    return tuple(replace(frame, index=i, name=f"{i:06d}") for i, frame in enumerate(kept))


def _nanoseconds(frame: BagFrame) -> int:
    return nanoseconds_of(frame.timestamp)


def _chosen(bag: Bag, name: str | None) -> Topic:
    topics = bag.of_type(RAW, COMPRESSED)
    if name is not None and name not in {topic.name for topic in topics}:
        there = f"{name} has no images but {bag.topics[name].type}" if name in bag.topics else f"no topic {name}"
        raise InputError(f"{bag.path}: {there}; {_told(bag, topics)}")
    if name is not None:
        return bag.topics[name]
    filled = [topic for topic in topics if topic.count]
    if len(filled) != 1:
        hint = "choose one with --topic: " if filled else ""
        raise InputError(f"{bag.path}: {hint}{_told(bag, topics)}")
    return filled[0]


def _told(bag: Bag, topics: list[Topic]) -> str:
    """The image topics of a bag with encodings and numbers of messages."""
    if not topics:
        others = ", ".join(f"{topic.name} ({topic.type})" for topic in bag.topics.values()) or "none"
        return f"no topic of images; its topics are {others}"
    return "its image topics are " + ", ".join(
        f"{topic.name} ({_encoding_name(bag, topic)}, {topic.count} messages)" for topic in topics
    )


def _encoding_name(bag: Bag, topic: Topic) -> str:
    try:
        first = next(bag.messages(topic.name), None)
    except InputError:
        return "unreadable"
    if first is None:
        return "empty"
    return str(first.fields.encoding if topic.type == RAW else first.fields.format)[:40]


def _header(message: Any) -> tuple[ImageHeader, str]:
    """What a message says of its picture, and of what kind it is."""
    if not hasattr(message, "encoding"):
        return picture_header(message.data.tobytes()), "compressed"
    encoding = encoding_of(message.encoding)
    pixels_of(message, encoding)
    grey = encoding.kind != "colours"
    return ImageHeader(int(message.width), int(message.height), encoding.bits, grey), encoding.kind


def _pixels(message: Any, camera_file: CameraFile) -> dict[str, np.ndarray]:
    """The pixel values of a message under the name that they have in a `Frame`."""
    if not hasattr(message, "encoding"):
        return _compressed_pixels(message.data.tobytes(), camera_file)
    encoding = encoding_of(message.encoding)
    pixels = pixels_of(message, encoding)
    camera = camera_file.camera
    whole = camera.width, camera.height
    name, size = ("mosaic", camera_file.mosaic_size) if camera_file.layout else ("channels", whole)
    if not camera_file.polarized:
        name, size = "grey", whole
        pixels = _grey(pixels, encoding, message.encoding)
    else:
        pixels = _raw(pixels, encoding, message.encoding, camera_file)
    require_size("image", pixels.shape[-2:][::-1], size, camera_file)
    require_bits("image", encoding.bits, camera_file)
    return {name: aligned("image", pixels, camera_file)}


def _compressed_pixels(data: bytes, camera_file: CameraFile) -> dict[str, np.ndarray]:
    bits = 8 if camera_file.bit_depth == 8 else 16
    camera = camera_file.camera
    if not camera_file.polarized:
        return {"grey": aligned("image", decode_picture(data, (camera.width, camera.height), bits), camera_file)}
    _require_lossless(data)
    if camera_file.layout is None:
        raise InputError("an image topic must have mosaics, but the camera file says mosaic: none")
    header = picture_header(data)
    require_size("image", (header.width, header.height), camera_file.mosaic_size, camera_file)
    require_bits("image", header.bits, camera_file)
    return {"mosaic": aligned("image", decode_image(data, camera_file.mosaic_size, bits), camera_file)}


def _require_lossless(data: bytes) -> None:
    """Raise InputError where the data of a CompressedImage are not a PNG file."""
    if data.startswith(_JPEG):
        raise InputError(
            "JPEG compression destroys polarization; record the raw topic (sensor_msgs/Image), or set the compressed "
            "transport's format to png"
        )
    if not data.startswith(_PNG):
        raise InputError("a compressed image that is no PNG file; record the raw topic (sensor_msgs/Image)")


def _raw(pixels: np.ndarray, encoding: Encoding, name: str, camera_file: CameraFile) -> np.ndarray:
    if encoding.kind == "colours":
        raise InputError(
            f"encoding {name}: conversion to colours destroys polarization; record the raw mosaic (mono8, mono16, "
            "bayer_*), or for a camera without polarizers write polarization: none in the camera file"
        )
    if encoding.kind == "angles":
        return np.ascontiguousarray(np.moveaxis(pixels, -1, 0))
    if camera_file.layout is None:
        raise InputError("an image topic must have mosaics, but the camera file says mosaic: none")
    return pixels


def _grey(pixels: np.ndarray, encoding: Encoding, name: str) -> np.ndarray:
    """The picture of a plain camera, of a colour one its luma."""
    if encoding.kind == "grey":
        return pixels
    if encoding.luma is None:
        raise InputError(
            f"encoding {name}: the raw mosaic of a camera that the camera file calls plain (polarization: none); "
            "write its mosaic, or record mono8 or rgb8"
        )
    return cv2.cvtColor(pixels, encoding.luma)
