"""Writes COLMAP's sparse models, binary and text, and dense maps (colmap.github.io/format.html).

One camera, PINHOLE. Poses are written world to camera, quaternions w first; COLMAP's first pixel has its centre at
(0.5, 0.5), so half a pixel is added to intrinsics and pixels. Ids of images and points count from 1.
"""

from __future__ import annotations

import struct
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse, to_quaternion
from polarmap.io.files import write_bytes

_CAMERA_ID = 1
_PINHOLE = 1


@dataclass(frozen=True, eq=False)
class SparseModel:
    """A model to be written.

    names: of the image files, ASCII. poses: T_world_camera, float64 K×4×4. points: float64 N×3, world.
    grey: uint8 N. observations: int64 M×2, (image, point) by their places in these lists. pixels: float64 M×2,
    (u, v) of each observation, the first pixel's centre at (0, 0). remarks: comments of the text files.
    """

    camera: PinholeCamera
    names: Sequence[str]
    poses: np.ndarray
    points: np.ndarray
    grey: np.ndarray
    observations: np.ndarray
    pixels: np.ndarray
    remarks: Sequence[str] = ()


def write_binary_model(folder: Path, model: SparseModel) -> None:
    """Write cameras.bin, images.bin and points3D.bin; PolarmapError where that fails."""
    camera = struct.pack("<QiiQQ4d", 1, _CAMERA_ID, _PINHOLE, *_size_and_parameters(model.camera))
    write_bytes(folder / "cameras.bin", camera)
    images, tracks = _by_image(model), _tracks(model)
    data = [struct.pack("<Q", len(model.names))]
    for i, (name, chosen) in enumerate(zip(model.names, images, strict=True)):
        found = np.empty(len(chosen), [("xy", "<f8", 2), ("id", "<i8")])
        found["xy"], found["id"] = model.pixels[chosen] + 0.5, model.observations[chosen, 1] + 1
        data.append(struct.pack("<i7di", i + 1, *_pose(model.poses[i]), _CAMERA_ID) + name.encode() + b"\0")
        data.append(struct.pack("<Q", len(found)) + found.tobytes())
    write_bytes(folder / "images.bin", b"".join(data))
    data = [struct.pack("<Q", len(model.points))]
    for i, (point, grey, track) in enumerate(zip(model.points.tolist(), model.grey.tolist(), tracks, strict=True)):
        data.append(struct.pack("<Q3d3BdQ", i + 1, *point, grey, grey, grey, 0.0, len(track)) + track.tobytes())
    write_bytes(folder / "points3D.bin", b"".join(data))


def write_text_model(folder: Path, model: SparseModel) -> None:
    """Write cameras.txt, images.txt and points3D.txt; PolarmapError where that fails."""
    remarks = [f"# {line}" for line in model.remarks]
    width, height, *parameters = _size_and_parameters(model.camera)
    camera = f"{_CAMERA_ID} PINHOLE {width} {height} {_numbers(parameters)}"
    _write_lines(folder / "cameras.txt", [*remarks, "# CAMERA_ID MODEL WIDTH HEIGHT FX FY CX CY", camera])
    lines = [*remarks, "# IMAGE_ID QW QX QY QZ TX TY TZ CAMERA_ID NAME", "# then (X Y POINT3D_ID) of each point"]
    for i, (name, chosen) in enumerate(zip(model.names, _by_image(model), strict=True)):
        lines.append(f"{i + 1} {_numbers(_pose(model.poses[i]))} {_CAMERA_ID} {name}")
        found = zip((model.pixels[chosen] + 0.5).tolist(), model.observations[chosen, 1].tolist(), strict=True)
        lines.append(" ".join(f"{x!r} {y!r} {point + 1}" for (x, y), point in found))
    _write_lines(folder / "images.txt", lines)
    lines = [*remarks, "# POINT3D_ID X Y Z R G B ERROR (IMAGE_ID POINT2D_IDX) ..."]
    rows = zip(model.points.tolist(), model.grey.tolist(), _tracks(model), strict=True)
    for i, (point, grey, track) in enumerate(rows):
        seen = " ".join(f"{image} {place}" for image, place in track.tolist())
        lines.append(f"{i + 1} {_numbers(point)} {grey} {grey} {grey} 0 {seen}")
    _write_lines(folder / "points3D.txt", lines)


def write_colmap_map(path: Path, values: np.ndarray) -> None:
    """Write a dense map: depth H×W, NaN where none, or normals H×W×3; as float32, 0 where there is none."""
    planes = values[None] if values.ndim == 2 else np.moveaxis(values, -1, 0)
    channels, height, width = planes.shape
    data = np.ascontiguousarray(np.nan_to_num(planes, nan=0.0), "<f4").tobytes()
    write_bytes(path, f"{width}&{height}&{channels}&".encode() + data)


def _size_and_parameters(camera: PinholeCamera) -> tuple:
    return camera.width, camera.height, camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5


def _pose(T_world_camera: np.ndarray) -> tuple[float, ...]:
    """qw, qx, qy, qz, tx, ty, tz of T_camera_world."""
    translation, (x, y, z, w) = to_quaternion(inverse(T_world_camera))
    return tuple(float(number) for number in (w, x, y, z, *translation))


def _by_image(model: SparseModel) -> list[np.ndarray]:
    """The observations of each image, in the order of their points."""
    image, point = model.observations.T
    order = np.lexsort((point, image))
    return np.split(order, np.searchsorted(image[order], np.arange(1, len(model.names))))


def _tracks(model: SparseModel) -> list[np.ndarray]:
    """Of each point, the id of each image that sees it and its place among that image's points, int32 L×2."""
    image, point = model.observations.T
    entries = np.empty((len(image), 2), "<i4")
    entries[:, 0] = image + 1
    for chosen in _by_image(model):
        entries[chosen, 1] = np.arange(len(chosen))
    order = np.lexsort((image, point))
    return np.split(entries[order], np.searchsorted(point[order], np.arange(1, len(model.points))))


def _numbers(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def _write_lines(path: Path, lines: list[str]) -> None:
    write_bytes(path, ("\n".join(lines) + "\n").encode())
