"""ROS bags of a few messages, written by rosbags itself: ROS 1, and ROS 2 as SQLite and MCAP."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

pytest.importorskip("rosbags", reason="rosbags, of the extra bags, is not installed")

from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import CompressionFormat, CompressionMode, StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

KINDS = ("ros1", "sqlite3", "mcap", "mcap file", "db3 file")
IMAGES = "/camera/image_raw"
FRAME = "camera_optical_frame"

_ROS2 = get_typestore(Stores.ROS2_JAZZY)
_ROS1 = get_typestore(Stores.ROS1_NOETIC)
_ROS1.register(get_types_from_msg("geometry_msgs/TransformStamped[] transforms", "tf2_msgs/msg/TFMessage"))


class Sent(NamedTuple):
    """A message: its topic, type (`sensor_msgs/msg/Image`), nanoseconds of recording, and fields by their names."""

    topic: str
    kind: str
    recorded: int
    fields: dict[str, Any]


def write_bag(path: Path, kind: str, messages: Iterable[Sent], compression: str = "NONE") -> Path:
    """A bag of one of the `KINDS` beside a path without suffix; where it is."""
    ordered = sorted(messages, key=lambda sent: sent.recorded)
    if kind == "ros1":
        path = path.with_suffix(".bag")
        with Writer1(path) as writer:
            _write(writer, ordered, _ROS1, ros1=True)
        return path
    plugin = StoragePlugin.MCAP if kind.startswith("mcap") else StoragePlugin.SQLITE3
    writer = Writer2(path, version=9, storage_plugin=plugin)
    writer.set_compression(CompressionMode[compression], CompressionFormat.ZSTD)
    with writer:
        _write(writer, ordered, _ROS2, ros1=False)
    return next(path.glob("*.mcap" if plugin is StoragePlugin.MCAP else "*.db3")) if kind.endswith("file") else path


def _write(writer, messages: list[Sent], store, ros1: bool) -> None:
    connections = {}
    for sent in messages:
        if sent.topic not in connections:
            connections[sent.topic] = writer.add_connection(sent.topic, sent.kind, typestore=store)
        message = _made(store, sent.kind, sent.fields)
        serialize = store.serialize_ros1 if ros1 else store.serialize_cdr
        writer.write(connections[sent.topic], sent.recorded, serialize(message, sent.kind))


def _made(store, kind: str, values: dict[str, Any]):
    """A message of a type, its fields as they are given and else empty; names of ROS 1 and of ROS 2 are the same."""
    values = {name.lower(): value for name, value in values.items()}
    fields = {name: _field(store, spec, values.get(name.lower())) for name, spec in store.fielddefs[kind][1]}
    return store.types[kind](**fields)


def _field(store, spec, value):
    node, detail = spec
    if node.name == "BASE":
        return value if value is not None else {"string": "", "bool": False}.get(detail[0], 0)
    if node.name == "NAME":
        return _made(store, detail, value or {})
    (inner_node, inner), length = detail
    if inner_node.name == "NAME":
        return [_made(store, inner, item) for item in value or []]
    empty = np.zeros(length if node.name == "ARRAY" else 0, inner[0])
    return empty if value is None else np.asarray(value, inner[0])


def stamp(nanoseconds: int) -> dict[str, int]:
    return {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9}


def header(nanoseconds: int, frame: str) -> dict[str, Any]:
    return {"stamp": stamp(nanoseconds), "frame_id": frame}


def image(pixels: np.ndarray, nanoseconds: int, encoding: str, **changes: Any) -> Sent:
    """A sensor_msgs/Image, recorded a little later than it was taken."""
    height, width = pixels.shape[:2]
    fields = {
        "header": header(nanoseconds, FRAME),
        "height": height,
        "width": width,
        "encoding": encoding,
        "is_bigendian": 0,
        "step": pixels.nbytes // height,
        "data": np.frombuffer(pixels.tobytes(), np.uint8),
    } | changes
    return Sent(IMAGES, "sensor_msgs/msg/Image", nanoseconds + 3_000_000, fields)


def quaternion(T: np.ndarray) -> dict[str, float]:
    return dict(zip("xyzw", Rotation.from_matrix(T[:3, :3]).as_quat().tolist(), strict=True))


def vector(T: np.ndarray) -> dict[str, float]:
    return dict(zip("xyz", T[:3, 3].tolist(), strict=True))


def pose(T: np.ndarray) -> dict[str, Any]:
    return {"position": vector(T), "orientation": quaternion(T)}


def transform(T_parent_child: np.ndarray, parent: str, child: str, nanoseconds: int) -> dict[str, Any]:
    """The fields of a geometry_msgs/TransformStamped."""
    return {
        "header": header(nanoseconds, parent),
        "child_frame_id": child,
        "transform": {"translation": vector(T_parent_child), "rotation": quaternion(T_parent_child)},
    }


def tf(*transforms: dict[str, Any], topic: str = "/tf", recorded: int = 0) -> Sent:
    return Sent(topic, "tf2_msgs/msg/TFMessage", recorded, {"transforms": list(transforms)})
