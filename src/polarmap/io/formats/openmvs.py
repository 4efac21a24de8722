"""OpenMVS's raw depth maps (`depthNNNN.dmap`): a frame's depth with the camera it is of.

Little-endian and unpadded: `DR`, uint8 of what follows (1 depth, 2 normals, 4 confidence, 8 views), uint8 unused;
uint32 image width and height, depth map width and height; float32 least and greatest depth; uint16 length of the
image's name and the name; uint32 count and as many uint32 view ids; float64 K, R (3×3, by row) and C (3); then
float32 depth, normals (3 a pixel, camera frame), confidence, and 4 uint8 of views, row by row. A world point X is
R (X - C) in the camera. The first pixel's centre is at (0, 0).

Newer versions write `D2`: in place of the unused byte int8 e, after the range of depth float32 of confidence; then
float16 depth in units of 2^e, normals as two int16 in octahedral projection (-32768 twice: none), confidence as uint8.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse, is_rigid
from polarmap.io.formats.binary import ByteReader
from polarmap.io.formats.images import MAX_PIXELS

_DEPTH, _NORMAL, _CONFIDENCE, _VIEWS = 1, 2, 4, 8
_NO_NORMAL = -32768
_FARTHEST = 1e12  # that a camera may be from the origin


@dataclass(frozen=True, eq=False)
class DepthMapFile:
    """A `.dmap` file.

    image_name: as the file has it, with folders. camera: of the depth map. T_world_camera: float64 4×4.
    depth: float32 H×W in the scene's unit, NaN where none. normal: float32 H×W×3 in the camera frame, or None.
    """

    image_name: str
    camera: PinholeCamera
    T_world_camera: np.ndarray
    depth: np.ndarray
    normal: np.ndarray | None


@dataclass(frozen=True, eq=False)
class DepthMapHeader:
    """What a `.dmap` says before its pixels."""

    packed: bool
    content: int
    depth_unit: float
    image_name: str
    camera: PinholeCamera
    T_world_camera: np.ndarray


def read_dmap(path: Path) -> DepthMapFile:
    """The depth map in a file.

    Raises InputError where it is none, has no depth, its camera or pose is none, or it ends too early.
    """
    reader = ByteReader(Path(path))
    header = _read_header(reader)
    height, width = header.camera.shape
    count, what = width * height, f"its {width}x{height} depths"
    depth = reader.array("f2" if header.packed else "f4", count, what).reshape(height, width).astype(np.float32)
    depth *= np.float32(header.depth_unit)
    normal = None
    if header.content & _NORMAL:
        normal = _read_normals(reader, header.packed, count).reshape(height, width, 3)
    for part, size in ((_CONFIDENCE, 1 if header.packed else 4), (_VIEWS, 4)):
        if header.content & part:
            reader.array("u1", size * count, "its confidence or views")
    depth = np.where(np.isfinite(depth) & (depth > 0), depth, np.float32(np.nan)).astype(np.float32)
    return DepthMapFile(header.image_name, header.camera, header.T_world_camera, depth, normal)


def read_dmap_header(path: Path) -> DepthMapHeader:
    """The name, camera and pose of a depth map. Raises as `read_dmap` does, but for what is wrong with the pixels."""
    return _read_header(ByteReader(Path(path)))


def _read_header(reader: ByteReader) -> DepthMapHeader:
    path = reader.path
    kind = bytes(reader.array("u1", 2, "its first bytes"))
    if kind not in (b"DR", b"D2"):
        raise InputError(f"{path}: not an OpenMVS depth map; such a file begins with DR or D2")
    packed = kind == b"D2"
    content, exponent = reader.numbers("Bb", "its header")
    if not content & _DEPTH:
        raise InputError(f"{path}: holds no depth")
    image_width, image_height, width, height = reader.numbers("4I", "its sizes")
    if not 0 < width * height <= MAX_PIXELS or not 0 < image_width * image_height <= MAX_PIXELS:
        raise InputError(f"{path}: claims a depth map of {width}x{height}, an image of {image_width}x{image_height}")
    reader.numbers("3f" if packed else "2f", "its range of depth")
    image_name = reader.text(*reader.numbers("H", "the image's name"), "the image's name")
    (views,) = reader.numbers("I", "its views")
    reader.array("u4", views, "its views")
    K, R, C = (reader.array("f8", n, "its camera") for n in (9, 9, 3))
    camera = _camera(path, K.reshape(3, 3), (image_width, image_height), (width, height))
    unit = 2.0**exponent if packed else 1.0
    return DepthMapHeader(packed, content, unit, image_name, camera, _pose(path, R.reshape(3, 3), C))


def _read_normals(reader: ByteReader, packed: bool, count: int) -> np.ndarray:
    """Normals float32 N×3; 0 where there is none."""
    if not packed:
        return reader.array("f4", 3 * count, "its normals").reshape(count, 3).astype(np.float32)
    codes = reader.array("i2", 2 * count, "its normals").reshape(count, 2)
    x, y = codes.T.astype(np.float32) / 32767.0
    z = 1.0 - np.abs(x) - np.abs(y)
    fold = np.maximum(-z, 0.0)  # the half that looks back is folded over the diagonals
    normal = np.stack([x - np.copysign(fold, x), y - np.copysign(fold, y), z], axis=1)
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)
    normal[(codes == _NO_NORMAL).all(axis=1)] = 0.0
    return normal


def _camera(path: Path, K: np.ndarray, image_size: tuple[int, int], size: tuple[int, int]) -> PinholeCamera:
    """The depth map's camera, from intrinsics that are its own or the image's, whichever centre they are nearer to."""
    own, image = (np.abs(K[:2, 2] / np.array(s) - 0.5).max() for s in (size, image_size))
    sx, sy = (1.0, 1.0) if own <= image else (size[0] / image_size[0], size[1] / image_size[1])
    cx, cy = (K[0, 2] + 0.5) * sx - 0.5, (K[1, 2] + 0.5) * sy - 0.5
    try:
        return PinholeCamera(*size, float(K[0, 0] * sx), float(K[1, 1] * sy), float(cx), float(cy))
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def _pose(path: Path, R: np.ndarray, C: np.ndarray) -> np.ndarray:
    if not ((np.abs(R) < 2.0).all() and (np.abs(C) < _FARTHEST).all()):  # nor NaN
        raise InputError(f"{path}: its pose is no rigid motion")
    T_camera_world = np.eye(4)
    T_camera_world[:3, :3] = R
    T_camera_world[:3, 3] = -R @ C
    if not is_rigid(T_camera_world):
        raise InputError(f"{path}: its pose is no rigid motion")
    T_world_camera = inverse(T_camera_world)
    T_world_camera[:3, 3] = C  # which -R' (-R C) is not where R is a rotation but for rounding, and C is far away
    return T_world_camera
