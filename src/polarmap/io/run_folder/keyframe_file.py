"""Keyframes as `.npz` files without pickle: one array a member, checked before any memory is taken for it."""

from __future__ import annotations

import io
import re
import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import is_rigid
from polarmap.io.files import write_bytes
from polarmap.io.formats.images import MAX_PIXELS
from polarmap.io.formats.npz_reader import NpzReader, open_npz

if TYPE_CHECKING:
    from polarmap.data.keyframe import Keyframe

STAGES = ("stereo", "inliers", "first")

_IMAGES = {
    "normal": (np.float32, (3,)),
    "azimuth": (np.float32, ()),
    "zenith": (np.float32, ()),
    "label": (np.uint8, ()),
    "origin": (np.uint8, ()),
    "sigma": (np.float32, ()),
    "confidence": (np.float32, ()),
}
_HIGHEST_CODES = {"label": 3, "origin": 3}


@dataclass(frozen=True)
class KeyframeResult:
    """A keyframe as a run wrote it; arrays H×W as in `polarmap.data.keyframe.Keyframe`, not writable.

    index: the frame's. timestamp: seconds. T_world_camera: float64 4×4.
    stages: depth before the keyframe was done, float32 H×W with NaN, by name: stereo, inliers, first; empty
        where the run did not keep them.
    """

    index: int
    timestamp: float
    T_world_camera: np.ndarray
    camera: PinholeCamera
    depth: np.ndarray
    normal: np.ndarray
    azimuth: np.ndarray
    zenith: np.ndarray
    label: np.ndarray
    origin: np.ndarray
    sigma: np.ndarray
    confidence: np.ndarray
    stages: dict[str, np.ndarray]


def write_keyframe(path: Path, keyframe: Keyframe, stages: bool = False) -> None:
    """Write a keyframe's arrays, with `stages` those of its stages too; not compressed, which floats hardly gain by.

    Raises PolarmapError where the file cannot be written.
    """
    arrays = {"depth": np.asarray(keyframe.depth, np.float32)}
    arrays |= {name: np.asarray(getattr(keyframe, name), dtype) for name, (dtype, _) in _IMAGES.items()}
    if stages:
        arrays |= {name: np.asarray(getattr(keyframe.stages, name), np.float32) for name in STAGES}
    arrays["K"] = np.asarray(keyframe.camera.matrix, np.float64)
    arrays["T_world_camera"] = np.asarray(keyframe.T_world_camera, np.float64)
    arrays["timestamp"] = np.float64(keyframe.timestamp)
    buffer = io.BytesIO()
    np.savez(buffer, **arrays)
    write_bytes(path, buffer.getbuffer())


def replace_pose(path: Path, T_world_camera: np.ndarray, scale: float = 1.0) -> None:
    """Give a keyframe that `write_keyframe` wrote another pose, float64 4×4, and its depths times `scale`.

    Raises InputError where the file cannot be read, PolarmapError where it cannot be written.
    """
    buffer = io.BytesIO()
    with _open(path) as old, zipfile.ZipFile(buffer, "w") as new:
        for member in old.members:
            name = member.filename.removesuffix(".npy")
            if name == "T_world_camera":
                data = _npy(np.asarray(T_world_camera, np.float64))
            elif scale != 1.0 and name in ("depth", *STAGES):
                data = _npy(np.float32(scale) * old.array(name, np.float32, (None, None)))
            else:
                data = old.raw(member)
            new.writestr(member, data)
    write_bytes(path, buffer.getbuffer())


def _npy(array: np.ndarray) -> bytes:
    buffer = io.BytesIO()
    np.save(buffer, array, allow_pickle=False)
    return buffer.getvalue()


def read_keyframe(path: Path, size: tuple[int, int] | None = None) -> KeyframeResult:
    """The keyframe in a file NNNNNN.npz, NNNNNN its frame's index.

    size: the (width, height) that its arrays must have, if known. Raises InputError where the file is no such
    archive, an array is missing, or has another type, shape or range.
    """
    path = Path(path)
    if not re.fullmatch(r"[0-9]{1,18}", path.stem):
        raise InputError(f"{path}: a keyframe's file must be named by its frame's index, such as 000042.npz")
    with _open(path) as archive:
        return _read(archive, int(path.stem), (None, None) if size is None else size[::-1])


@contextmanager
def _open(path: Path) -> Iterator[NpzReader]:
    try:
        with open_npz(path) as archive:
            yield archive
    except InputError as problem:
        raise InputError(f"{problem}; run the mapping again") from None


def _read(archive: NpzReader, index: int, shape: tuple[int | None, int | None]) -> KeyframeResult:
    depth = archive.array("depth", np.float32, shape)
    _check(0 < depth.size <= MAX_PIXELS, f"'depth' has {depth.size} pixels, which no image has")
    images = {name: archive.array(name, dtype, (*depth.shape, *rest)) for name, (dtype, rest) in _IMAGES.items()}
    stages = {name: archive.array(name, np.float32, depth.shape) for name in STAGES if name in archive.names}
    for name, values in {"depth": depth, **stages}.items():
        _check(not (np.isinf(values) | (values <= 0)).any(), f"{name} has values that are no depth")
    for name in ("normal", "azimuth", "zenith"):
        _check(not np.isinf(images[name]).any(), f"{name} has infinite values")
    for name, highest in _HIGHEST_CODES.items():
        _check(images[name].max(initial=0) <= highest, f"{name} has codes above {highest}")
    confidence = images["confidence"]
    _check(bool(((confidence >= 0) & (confidence <= 1)).all()), "confidence is not in [0, 1]")
    _check(not (images["sigma"] < 0).any(), "sigma has negative values")
    timestamp = float(archive.array("timestamp", np.float64, ()))
    _check(not np.isinf(timestamp), "timestamp is infinite")
    return KeyframeResult(
        index=index,
        timestamp=timestamp,
        T_world_camera=_read_pose(archive),
        camera=_read_camera(archive, *depth.shape),
        depth=depth,
        stages=stages,
        **images,
    )


def _read_pose(archive: NpzReader) -> np.ndarray:
    T = archive.array("T_world_camera", np.float64, (4, 4))
    _check(is_rigid(T), "T_world_camera is no rigid motion")
    return T


def _read_camera(archive: NpzReader, height: int, width: int) -> PinholeCamera:
    K = archive.array("K", np.float64, (3, 3))
    return PinholeCamera(width, height, *(float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))


def _check(condition: bool, problem: str) -> None:
    if not condition:
        raise InputError(problem)
