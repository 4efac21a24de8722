"""The topics of a ROS bag and their messages, by way of rosbags.

Messages are read by the standard definitions that come with rosbags. Those in the bag are not compiled: reader code
would be made of them, which a file from elsewhere should not have a say in, and one odd type of a driver's would make
the whole bag unreadable.
"""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

from polarmap.errors import InputError, PolarmapError
from polarmap.io.recording.ros.recognize import require_bag

log = logging.getLogger(__name__)

_ALIASES = {"tf/msg/tfMessage": "tf2_msgs/msg/TFMessage"}  # of ROS 1 before tf2
_TF_OF_ROS1 = "geometry_msgs/TransformStamped[] transforms"


class DamagedBag(InputError):
    """A bag cannot be read on from here."""


@dataclass(frozen=True)
class Topic:
    """A topic: its name, the type of its messages (`sensor_msgs/msg/Image`), and how many there are."""

    name: str
    type: str
    count: int


class Message(NamedTuple):
    """A message: when it was recorded, nanoseconds, and its fields as rosbags gives them."""

    recorded: int
    fields: Any


class Bag:
    """An open bag. Raises InputError, in one line, where it cannot be opened or the extra is missing.

    One thread at a time may use it.
    """

    def __init__(self, path: Path) -> None:
        require_bag(path)
        require_rosbags()
        self.path = path
        _say_what_is_not_read(path)
        self._ros1 = path.suffix.lower() == ".bag" and not path.is_dir()
        with _one_line(path, self._hint()):
            self._reader = _reader(path, self._ros1)
            self._reader.open()
            self.topics = {name: _topic(name, info) for name, info in self._reader.topics.items()}
        self._types = _typestore(self._ros1)

    def __enter__(self) -> Bag:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        with suppress(Exception):  # of a damaged database, say: nothing was to be written
            self._reader.close()

    def of_type(self, *types: str) -> list[Topic]:
        """The topics whose messages have one of these types, such as `sensor_msgs/msg/Image`."""
        return [topic for topic in self.topics.values() if topic.type in types]

    def topic(self, name: str) -> Topic:
        """The topic of this name; InputError, which names those that there are, where there is none."""
        if name not in self.topics:
            known = ", ".join(self.topics) or "none"
            raise InputError(f"{self.path}: no topic {name}; its topics are {known}")
        return self.topics[name]

    def messages(self, topic: str, start: int | None = None) -> Iterator[Message]:
        """The messages of a topic in order of recording, from `start` nanoseconds on.

        Raises DamagedBag where the next one cannot be read.
        """
        kind = self.topic(topic).type
        connections = [each for each in self._reader.connections if each.topic == topic]
        self._require_standard(topic, kind, connections)
        read: Callable = self._types.deserialize_ros1 if self._ros1 else self._types.deserialize_cdr
        with _one_line(self.path, self._hint(), DamagedBag):
            for _, recorded, data in self._reader.messages(connections, start=start):
                yield Message(recorded, read(data, kind))

    def _require_standard(self, topic: str, kind: str, connections: list) -> None:
        """InputError where a topic's messages are laid out in another way than the standard type of their name."""
        if not kind:
            raise InputError(f"{self.path}: {topic} has messages of several types")
        for digest in {each.digest for each in connections if each.digest}:
            if digest != self._digest(kind):
                raise InputError(f"{self.path}: {topic} has a {kind} that is not the standard one, which alone is read")

    def _digest(self, kind: str) -> str:
        return self._types.generate_msgdef(kind)[1] if self._ros1 else self._types.hash_rihs01(kind)

    def _hint(self) -> str:
        commands = {".bag": "rosbag reindex {}", ".mcap": "mcap recover {}", ".db3": "sqlite3 {} .recover"}
        command = "ros2 bag reindex {}" if self.path.is_dir() else commands[self.path.suffix.lower()]
        return f"record it again, or try '{command.format(self.path.name)}'"


def readable(bag: Bag, topic: str) -> Iterator[Message]:
    """The messages of a topic until the bag is damaged, which is logged as a warning.

    Raises InputError where the first one cannot be read already.
    """
    count = 0
    try:
        for message in bag.messages(topic):
            count += 1
            yield message
    except DamagedBag as problem:
        if count == 0:
            raise
        log.warning("%s; the %d messages of %s before that are used", problem, count, topic)


def require_rosbags() -> None:
    """Raise InputError where rosbags, of the extra `bags`, is not installed."""
    try:
        import rosbags.rosbag1
        import rosbags.rosbag2  # noqa: F401
    except ImportError:
        raise InputError("ROS bags are read by rosbags; get it with: pip install 'polarmap[bags]'") from None


@contextmanager
def _one_line(path: Path, hint: str, error: type[InputError] = InputError) -> Iterator[None]:
    """What the library raises for bad files, which is anything from ReaderError to IndexError, as one line."""
    try:
        yield
    except (PolarmapError, GeneratorExit):
        raise
    except MemoryError:
        raise error(f"{path}: claims more data than memory holds, as damaged files do; {hint}") from None
    except Exception as problem:
        said = str(problem).strip().rstrip(".") or type(problem).__name__
        raise error(f"{path}: cannot be read ({said}); {hint}") from None


def _topic(name: str, info: Any) -> Topic:
    kind = str(info.msgtype or "")
    return Topic(str(name), _ALIASES.get(kind, kind), int(info.msgcount))


def _reader(path: Path, ros1: bool) -> Any:
    from rosbags.rosbag1 import Reader as Reader1
    from rosbags.rosbag2 import Reader as Reader2

    return (Reader1 if ros1 else Reader2)(path)


def _typestore(ros1: bool) -> Any:
    from rosbags.typesys import Stores, get_types_from_msg, get_typestore

    if not ros1:
        return get_typestore(Stores.LATEST)
    store = get_typestore(Stores.ROS1_NOETIC)
    store.register(get_types_from_msg(_TF_OF_ROS1, "tf2_msgs/msg/TFMessage"))
    return store


def _say_what_is_not_read(path: Path) -> None:
    """A warning where SQLite has left the last messages in a journal, which is not looked at."""
    journal = path.with_name(path.name + "-wal")
    if path.suffix.lower() == ".db3" and journal.is_file() and os.stat(journal).st_size:
        log.warning(
            "%s: was not closed; messages in %s are not read before 'sqlite3 %s \"PRAGMA wal_checkpoint\"'",
            path, journal.name, path.name,
        )  # fmt: skip
