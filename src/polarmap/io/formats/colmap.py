"""COLMAP's results: dense maps and sparse models, binary and text (colmap.github.io/format.html).

Dense maps (`stereo/depth_maps/NAME.geometric.bin`): `width&height&channels&` in ASCII, then float32, little-endian,
channel by channel, each row by row; 0 where there is no depth. Normals are in the camera frame.

Sparse models are folders of cameras, images and points3D (.bin or .txt). Poses are world to camera, quaternions w
first. COLMAP's first pixel has its centre at (0.5, 0.5); intrinsics and points are moved by half a pixel here.
"""

from __future__ import annotations

import itertools
import os
import re
from array import array
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from polarmap.errors import InputError, quoted
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import from_quaternion, inverse
from polarmap.io.files import open_input
from polarmap.io.formats.binary import ByteReader
from polarmap.io.formats.images import MAX_PIXELS

MODEL_PARTS = ("cameras", "images", "points3D")
_MAX_HEADER = 64
_MAX_SIZE = 1 << 20
_NO_POINT = -1
_LARGEST_ID = 1 << 63
_MAX_CAMERAS = 1 << 24
_MAX_TEXT = 1 << 28
_MAX_LINE = 1 << 22  # bytes; for some hundred thousand points in an image
_MOST_IMAGES = 1 << 17
_FARTHEST = 1e12  # that a camera may be from the origin

# Name, and of the parameters: how many focal lengths, how many in all. The centre follows the focal lengths.
_MODELS = {
    0: ("SIMPLE_PINHOLE", 1, 3),
    1: ("PINHOLE", 2, 4),
    2: ("SIMPLE_RADIAL", 1, 4),
    3: ("RADIAL", 1, 5),
    4: ("OPENCV", 2, 8),
    5: ("OPENCV_FISHEYE", 2, 8),
    6: ("FULL_OPENCV", 2, 12),
    7: ("FOV", 2, 5),
    8: ("SIMPLE_RADIAL_FISHEYE", 1, 4),
    9: ("RADIAL_FISHEYE", 1, 5),
    10: ("THIN_PRISM_FISHEYE", 2, 12),
    11: ("RAD_TAN_THIN_PRISM_FISHEYE", 2, 16),
}
_PERSPECTIVE = ("SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV")
_MODEL_IDS = {name: number for number, (name, _, _) in _MODELS.items()}
CAMERA_MODELS = tuple(_MODEL_IDS)


@dataclass(frozen=True)
class ColmapCamera:
    """A camera. pinhole: its intrinsics without the distortion. distortion: the model's further parameters."""

    model: str
    pinhole: PinholeCamera
    distortion: tuple[float, ...]

    @property
    def distorted(self) -> bool:
        """Whether images of it are anything but a pinhole camera's."""
        return self.model not in _PERSPECTIVE or any(self.distortion)


@dataclass(frozen=True, eq=False)
class ColmapImage:
    """An image with a pose, and the points that were found in it.

    name: its file's, with folders. T_world_camera: float64 4×4. pixels: float64 N×2, (u, v).
    point_ids: int64 N, of the model's points.
    """

    name: str
    T_world_camera: np.ndarray
    camera_id: int
    pixels: np.ndarray
    point_ids: np.ndarray


@dataclass(frozen=True, eq=False)
class ColmapModel:
    """A sparse model. point_ids: int64 N, ascending. points: float64 N×3, world frame, in the model's unit."""

    path: Path
    cameras: dict[int, ColmapCamera]
    images: tuple[ColmapImage, ...]
    point_ids: np.ndarray = field(default_factory=lambda: np.empty(0, np.int64))
    points: np.ndarray = field(default_factory=lambda: np.empty((0, 3)))

    def positions_of(self, ids: np.ndarray) -> np.ndarray:
        """World positions of points by their ids, float64 N×3; NaN for an id that the model lacks."""
        found = np.full((len(ids), 3), np.nan)
        if len(self.point_ids):
            place = np.minimum(np.searchsorted(self.point_ids, ids), len(self.point_ids) - 1)
            known = self.point_ids[place] == ids
            found[known] = self.points[place[known]]
        return found


def read_colmap_map(path: Path, channels: int = 1) -> np.ndarray:
    """A dense map, float32 H×W of depth with NaN where none, or with 3 channels H×W×3 of normals.

    Raises InputError where the file is none, has another number of channels, or is not as long as its header says.
    """
    reader = ByteReader(Path(path), 4 * 3 * MAX_PIXELS + _MAX_HEADER)
    width, height, found = (_header_number(reader) for _ in range(3))
    if found != channels:
        raise InputError(f"{path}: {found} channels, expected {channels}; a depth map has 1, a normal map 3")
    if width * height > MAX_PIXELS:
        raise InputError(f"{path}: claims {width}x{height} pixels, more than {MAX_PIXELS}")
    values = reader.array("f4", width * height * channels, f"its {width}x{height} values")
    reader.finish()
    planes = values.reshape(channels, height, width).astype(np.float32)
    if channels == 1:
        return np.where(np.isfinite(planes[0]) & (planes[0] > 0), planes[0], np.float32(np.nan))
    return np.ascontiguousarray(np.moveaxis(planes, 0, -1))


def has_colmap_model(folder: Path) -> bool:
    """Whether a folder holds cameras and images of a sparse model."""
    return any(
        all(os.path.isfile(folder / f"{part}{suffix}") for part in MODEL_PARTS[:2]) for suffix in (".bin", ".txt")
    )


def count_images(folder: Path) -> int:
    """How many images a sparse model has registered; InputError where that cannot be read."""
    path = Path(folder) / "images.bin"
    if os.path.isfile(path):
        return ByteReader(path).count(73, "images")
    rows = (line for _, line in _text_lines(path.with_suffix(".txt")) if not line.startswith("#"))
    last = max((number for number, line in enumerate(rows, start=1) if line.strip()), default=0)
    return (last + 1) // 2  # an image has two lines, the second of which may be empty


def read_colmap_model(folder: Path) -> ColmapModel:
    """The sparse model in a folder; binary files come before text files. points3D may be missing.

    Raises InputError, naming the file, where one is missing, truncated or malformed.
    """
    folder = Path(folder)
    suffix = ".bin" if os.path.isfile(folder / "cameras.bin") else ".txt"
    paths = [folder / f"{part}{suffix}" for part in MODEL_PARTS]
    if not has_colmap_model(folder):
        raise InputError(f"{folder}: no COLMAP model in it (cameras and images, as .bin or .txt)")
    readers = _BINARY if suffix == ".bin" else _TEXT
    cameras = dict(readers[0](paths[0]))
    images = tuple(itertools.islice(readers[1](paths[1]), _MOST_IMAGES + 1))
    if len(images) > _MOST_IMAGES:
        raise InputError(f"{paths[1]}: more than {_MOST_IMAGES} images")
    for image in images:
        if image.camera_id not in cameras:
            raise InputError(f"{paths[1]}: {image.name} is of camera {image.camera_id}, which {paths[0].name} lacks")
    if not os.path.exists(paths[2]):
        return ColmapModel(folder, cameras, images)
    ids, points = readers[2](paths[2])
    order = np.argsort(ids, kind="stable")
    return ColmapModel(folder, cameras, images, ids[order], points[order])


def _header_number(reader: ByteReader) -> int:
    text = reader.until(b"&", _MAX_HEADER, "its header; expected width&height&channels&")
    digits = bytes(text)
    if not digits.isdigit() or len(digits) > 9 or int(digits) < 1:
        raise InputError(f"{reader.path}: malformed in its header; expected width&height&channels&")
    return int(digits)


def _camera(where: str, model: str, width: int, height: int, parameters: tuple[float, ...]) -> ColmapCamera:
    if max(width, height) > _MAX_SIZE:
        raise InputError(f"{where}: claims images of {width}x{height} pixels")
    _, focal, _ = _MODELS[_MODEL_IDS[model]]
    fx, fy = parameters[0], parameters[focal - 1]
    cx, cy = parameters[focal : focal + 2]
    try:
        pinhole = PinholeCamera(width, height, fx, fy, cx - 0.5, cy - 0.5)
    except InputError as problem:
        raise InputError(f"{where}: {problem}") from None
    return ColmapCamera(model, pinhole, tuple(parameters[focal + 2 :]))


def _image(where: str, pose: tuple[float, ...], camera_id: int, name: str, found: np.ndarray, ids: np.ndarray):
    """found: (x, y) as the file has them; those without a point are left out."""
    w, x, y, z = pose[:4]
    if not all(abs(number) < _FARTHEST for number in pose):  # nor NaN
        raise InputError(f"{where}: {name}: its pose has numbers that are none or too large")
    try:
        T_camera_world = from_quaternion(np.array(pose[4:]), np.array([x, y, z, w]))
    except InputError as problem:
        raise InputError(f"{where}: {name}: {problem}") from None
    known = ids != _NO_POINT
    return ColmapImage(name, inverse(T_camera_world), camera_id, found[known] - 0.5, ids[known])


def _binary_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    reader = ByteReader(path, _MAX_CAMERAS)
    for _ in range(reader.count(48, "cameras")):
        camera_id, model_id, width, height = reader.numbers("iiQQ", "a camera")
        if model_id not in _MODELS:
            raise InputError(f"{path}: camera {camera_id} is of model {model_id}, which is not known here")
        model, _, count = _MODELS[model_id]
        parameters = reader.numbers(f"{count}d", f"camera {camera_id}")
        yield camera_id, _camera(f"{path}: camera {camera_id}", model, width, height, parameters)
    reader.finish()


def _binary_images(path: Path) -> Iterator[ColmapImage]:
    reader = ByteReader(path)
    record = np.dtype([("xy", "<f8", 2), ("id", "<i8")])
    for _ in range(reader.count(73, "images")):
        _, *pose = reader.numbers("i7d", "an image")
        (camera_id,) = reader.numbers("i", "an image")
        name = reader.name("an image's name")
        found = reader.array(record, reader.count(record.itemsize, "points of an image"), f"the points of {name}")
        yield _image(str(path), tuple(pose), camera_id, name, found["xy"], found["id"])
    reader.finish()


def _binary_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    reader = ByteReader(path)
    count = reader.count(51, "points")
    ids, points = np.empty(count, np.int64), np.empty((count, 3))
    for i in range(count):
        ids[i], *points[i] = reader.numbers("q3d", "a point")
        reader.numbers("3Bd", "a point")
        reader.array("i4", 2 * reader.count(8, "images of a point"), "the images of a point")
    reader.finish()
    return ids, points


def _text_cameras(path: Path) -> Iterator[tuple[int, ColmapCamera]]:
    for where, words in _text_rows(path, _MAX_CAMERAS):
        if len(words) < 4 or words[1] not in _MODEL_IDS:
            known = ", ".join(_MODEL_IDS)
            raise InputError(f"{where}: expected CAMERA_ID MODEL WIDTH HEIGHT PARAMS, MODEL one of {known}")
        camera_id, width, height = (_whole(where, words[i]) for i in (0, 2, 3))
        count = _MODELS[_MODEL_IDS[words[1]]][2]
        parameters = _numbers(where, words[4:], count, f"parameters of {words[1]}")
        yield camera_id, _camera(where, words[1], width, height, tuple(parameters.tolist()))


def _text_images(path: Path) -> Iterator[ColmapImage]:
    rows = ((number, line) for number, line in _text_lines(path) if not line.startswith("#"))
    for number, line in rows:
        where = f"{path}, line {number}"
        observed = next(rows, (0, ""))[1].split()
        if not line.strip() and not observed:
            continue  # empty lines at the end
        words = line.strip().split(maxsplit=9)
        if len(words) != 10:
            raise InputError(f"{where}: expected IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME")
        pose = tuple(_numbers(where, words[1:8], 7, "numbers of a pose").tolist())
        after = f"{path}, line {number + 1}"
        table = _numbers(after, observed, len(observed) // 3 * 3, "X Y POINT3D_ID").reshape(-1, 3)
        ids = np.array([_whole(after, word) for word in observed[2::3]], np.int64)
        yield _image(where, pose, _whole(where, words[8]), words[9], table[:, :2], ids)


def _text_points(path: Path) -> tuple[np.ndarray, np.ndarray]:
    ids, points = array("q"), array("d")
    for where, words in _text_rows(path):
        if len(words) < 8:
            raise InputError(f"{where}: expected POINT3D_ID X Y Z R G B ERROR TRACK")
        ids.append(_whole(where, words[0]))
        points.extend(_numbers(where, words[1:4], 3, "coordinates"))
    return np.array(ids, np.int64), np.array(points).reshape(-1, 3)


def _text_rows(path: Path, limit: int = _MAX_TEXT) -> Iterator[tuple[str, list[str]]]:
    for number, line in _text_lines(path, limit):
        if (words := line.split()) and not line.startswith("#"):
            yield f"{path}, line {number}", words


def _text_lines(path: Path, limit: int = _MAX_TEXT) -> Iterator[tuple[int, str]]:
    """(number from 1, text) of each line, one in memory at a time."""
    with open_input(path, limit) as file:
        for number in itertools.count(1):
            line = file.readline(_MAX_LINE)
            if not line:
                return
            if len(line) == _MAX_LINE:
                raise InputError(f"{path}, line {number}: longer than {_MAX_LINE} bytes")
            yield number, _decoded(path, number, line)


def _decoded(path: Path, number: int, line: bytes) -> str:
    try:
        return line.decode("utf-8-sig" if number == 1 else "utf-8")
    except UnicodeDecodeError:
        raise InputError(f"{path}, line {number}: not text in UTF-8") from None


def _whole(where: str, word: str) -> int:
    if not re.fullmatch(r"[+-]?[0-9]{1,19}", word) or not -_LARGEST_ID <= int(word) < _LARGEST_ID:
        raise InputError(f"{where}: {quoted(word)} is no whole number of at most 64 bits")
    return int(word)


def _numbers(where: str, words: list[str], count: int, what: str) -> np.ndarray:
    if len(words) != count:
        raise InputError(f"{where}: {len(words)} {what}, expected {count}")
    try:
        numbers = np.array(words, float)
    except ValueError:
        numbers = np.array([np.nan])
    if not np.isfinite(numbers).all():
        raise InputError(f"{where}: {what}: not all are finite numbers")
    return numbers


def read_text_cameras(path: Path) -> list[tuple[int, ColmapCamera]]:
    """Id and camera of each line of a cameras.txt. Raises InputError where it is malformed."""
    return list(_text_cameras(path))


_BINARY = (_binary_cameras, _binary_images, _binary_points)
_TEXT = (_text_cameras, _text_images, _text_points)
