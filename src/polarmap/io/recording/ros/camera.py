"""The camera file of an image topic: a file, or camera_info together with what is said of the sensor."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from polarmap.data.camera_file import CameraFile
from polarmap.errors import InputError
from polarmap.io.recording.calibration import CAMERA_FILE_NAME, camera_info_values, find_camera_file
from polarmap.io.recording.camera_file import camera_file_of, read_camera_file
from polarmap.io.recording.pixels import taken_apart
from polarmap.io.recording.ros.bag import Bag, readable
from polarmap.io.recording.ros.images import ImageTopic

CAMERA_INFO = "sensor_msgs/msg/CameraInfo"
_COMPRESSED = "/compressed"


@dataclass(frozen=True)
class CameraSource:
    """Where the camera of a bag's images is described.

    file: a camera file, or another program's calibration. Without one it is the camera.yaml in the bag's folder or
        beside it; without that, or where `info` is given, a camera_info topic and `sensor`.
    info: the topic of camera_info; that beside the images if None.
    sensor: keys of a camera file that are not of the lens, such as mosaic, angle_direction and bit_depth.
    """

    file: Path | CameraFile | None = None
    info: str | None = None
    sensor: Mapping[str, Any] = field(default_factory=dict)


def find_camera(bag: Bag, images: ImageTopic, source: CameraSource) -> CameraFile:
    """The camera of an image topic. Raises InputError where nothing tells its lens or its sensor."""
    return _fitting(bag, images, _camera(bag, images, source))


def _camera(bag: Bag, images: ImageTopic, source: CameraSource) -> CameraFile:
    file = source.file
    if file is None and source.info is None:
        file = find_camera_file(bag.path) or find_camera_file(bag.path.parent)
    if file is None:
        return _by_camera_info(bag, images, source)
    if source.info is not None or source.sensor:
        raise InputError(
            f"{file if isinstance(file, Path) else 'the camera file'}: describes the camera already; leave out "
            "--camera-info, --layout, --angle-direction and --bit-depth"
        )
    return file if isinstance(file, CameraFile) else read_camera_file(file, bag.path, images.header)


def _by_camera_info(bag: Bag, images: ImageTopic, source: CameraSource) -> CameraFile:
    topic = _info_topic(bag, images, source.info)
    sensor = _sensor(bag, images, source, topic)
    first = next(readable(bag, topic), None)
    if first is None:
        raise InputError(f"{bag.path}: {topic} has no messages; name a camera file with --camera")
    where = f"{bag.path}, {topic}"
    values = _printed(first.fields)
    if not any(values["K"]):
        raise InputError(
            f"{where}: says that the camera is not calibrated (K is zero); name a camera file with --camera"
        )
    return camera_file_of(where, camera_info_values(where, values, sensor, images.header), bag.path.parent)


def _info_topic(bag: Bag, images: ImageTopic, wanted: str | None) -> str:
    known = [topic.name for topic in bag.of_type(CAMERA_INFO)]
    if wanted is None:
        wanted = f"{images.name.removesuffix(_COMPRESSED).rpartition('/')[0]}/camera_info"
        if wanted not in known:
            others = f"; of others there are {', '.join(known)}, to be named with --camera-info" if known else ""
            raise InputError(
                f"{bag.path}: no {CAMERA_FILE_NAME} in or beside it, and no topic {wanted}{others}; name a camera file "
                "with --camera"
            )
    if wanted not in known:
        raise InputError(f"{bag.path}: no topic {wanted} of camera_info; there are {', '.join(known) or 'none'}")
    return wanted


def _sensor(bag: Bag, images: ImageTopic, source: CameraSource, topic: str) -> dict[str, Any]:
    """What is said of the sensor, complete; InputError that names the options where something is missing."""
    sensor = dict(source.sensor)
    if images.kind == "angles":
        sensor.setdefault("mosaic", "none")
    missing = []
    if "polarization" not in sensor:
        if "mosaic" not in sensor:
            missing.append("--layout 90,45,135,0 (the block's angles row by row, or none without polarizers)")
        if "angle_direction" not in sensor:
            missing.append("--angle-direction counterclockwise (or clockwise)")
    if "bit_depth" not in sensor and images.header.bits != 8:
        missing.append("--bit-depth 12 (or 10, 16)")
    if missing:
        raise InputError(
            f"{bag.path}: {topic} knows the lens but not the sensor; add {', '.join(missing)}; or name a camera file "
            "with --camera"
        )
    return sensor


def _printed(message: Any) -> dict[str, Any]:
    """A CameraInfo message with the names of ROS 1, as `rostopic echo` prints it."""
    roi = message.roi
    matrix, coefficients = (getattr(message, name, None) for name in ("K", "D"))
    return {
        "width": int(message.width),
        "height": int(message.height),
        "distortion_model": str(message.distortion_model),
        "K": [float(k) for k in (message.k if matrix is None else matrix)],
        "D": [float(k) for k in (message.d if coefficients is None else coefficients)],
        "binning_x": int(message.binning_x),
        "binning_y": int(message.binning_y),
        "roi": {"x_offset": int(roi.x_offset), "y_offset": int(roi.y_offset)},
    }


def _fitting(bag: Bag, images: ImageTopic, camera_file: CameraFile) -> CameraFile:
    """The camera file for images whose driver has sorted the pixels by angle already, where it has."""
    where = f"{bag.path}, {images.name}"
    return taken_apart(where, camera_file) if images.kind == "angles" and camera_file.polarized else camera_file
