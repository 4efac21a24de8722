"""Keyframes as `.npz` files without pickle: one array a member, checked before any memory is taken for it."""

from __future__ import annotations

import io
import math
import zipfile
import zlib
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import reason, write_bytes
from polarmap.io.images import MAX_PIXELS

if TYPE_CHECKING:
    from polarmap.results import Keyframe

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
_POSE_MEMBER = "T_world_camera.npy"
_HIGHEST_CODES = {"label": 3, "origin": 3}
_BROKEN = (
    OSError,
    EOFError,
    ValueError,
    NotImplementedError,  # compression or encryption that zipfile does not know
    RuntimeError,
    zipfile.BadZipFile,
    zlib.error,
)


@dataclass(frozen=True)
class KeyframeResult:
    """A keyframe as a run wrote it; arrays H×W as in `polarmap.results.Keyframe`, not writable.

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


def replace_pose(path: Path, T_world_camera: np.ndarray) -> None:
    """Give a keyframe that `write_keyframe` wrote another pose, float64 4×4; all else stays as it is.

    Raises InputError where the file cannot be read, PolarmapError where it cannot be written.
    """
    pose, buffer = io.BytesIO(), io.BytesIO()
    np.save(pose, np.asarray(T_world_camera, np.float64), allow_pickle=False)
    try:
        with zipfile.ZipFile(path) as old, zipfile.ZipFile(buffer, "w") as new:
            for member in old.infolist():
                new.writestr(member, pose.getvalue() if member.filename == _POSE_MEMBER else old.read(member))
    except _BROKEN as error:
        raise InputError(f"{path}: not a readable keyframe file ({reason(error)}); run the mapping again") from None
    write_bytes(path, buffer.getbuffer())


def read_keyframe(path: Path) -> KeyframeResult:
    """The keyframe in a file NNNNNN.npz, NNNNNN its frame's index.

    Raises InputError where the file is no such archive, an array is missing, or has another type, shape or range.
    """
    path = Path(path)
    if not path.stem.isdigit():
        raise InputError(f"{path}: a keyframe's file must be named by its frame's index, such as 000042.npz")
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(archive, int(path.stem))
    except InputError as problem:
        raise InputError(f"{path}: {problem}; run the mapping again") from None
    except _BROKEN as error:
        raise InputError(f"{path}: not a readable keyframe file ({reason(error)}); run the mapping again") from None


def _read(archive: zipfile.ZipFile, index: int) -> KeyframeResult:
    depth = _read_array(archive, "depth", np.float32, (None, None))
    images = {name: _read_array(archive, name, dtype, (*depth.shape, *rest)) for name, (dtype, rest) in _IMAGES.items()}
    members = set(archive.namelist())
    stages = {name: _read_array(archive, name, np.float32, depth.shape) for name in STAGES if f"{name}.npy" in members}
    for name, values in {"depth": depth, **stages}.items():
        _check(not (np.isinf(values) | (values <= 0)).any(), f"{name} has values that are no depth")
    for name, highest in _HIGHEST_CODES.items():
        _check(images[name].max(initial=0) <= highest, f"{name} has codes above {highest}")
    confidence = images["confidence"]
    _check(bool(((confidence >= 0) & (confidence <= 1)).all()), "confidence is not in [0, 1]")
    return KeyframeResult(
        index=index,
        timestamp=float(_read_array(archive, "timestamp", np.float64, ())),
        T_world_camera=_read_pose(archive),
        camera=_read_camera(archive, *depth.shape),
        depth=depth,
        stages=stages,
        **images,
    )


def _read_pose(archive: zipfile.ZipFile) -> np.ndarray:
    T = _read_array(archive, "T_world_camera", np.float64, (4, 4))
    R = T[:3, :3]
    _check(
        bool(np.isfinite(T).all()) and np.allclose(R @ R.T, np.eye(3), atol=1e-3), "T_world_camera is no rigid motion"
    )
    return T


def _read_camera(archive: zipfile.ZipFile, height: int, width: int) -> PinholeCamera:
    K = _read_array(archive, "K", np.float64, (3, 3))
    return PinholeCamera(width, height, *(float(K[i]) for i in ((0, 0), (1, 1), (0, 2), (1, 2))))


def _read_array(archive: zipfile.ZipFile, name: str, dtype: type, shape: tuple[int | None, ...]) -> np.ndarray:
    """A member as an array of this type and shape (None: any length); InputError where it is anything else."""
    try:
        member = archive.open(f"{name}.npy")
    except KeyError:
        raise InputError(f"lacks the array '{name}'") from None
    with member:
        found, fortran_order, found_dtype = _read_header(member)
        fits = len(found) == len(shape) and all(want in (None, n) for n, want in zip(found, shape, strict=True))
        _check(
            fits and found_dtype == np.dtype(dtype) and not fortran_order,
            f"'{name}' is {found_dtype} {found}, expected {np.dtype(dtype)} {_described(shape)}",
        )
        count = math.prod(found)
        _check(count <= 3 * MAX_PIXELS, f"'{name}' claims {count} values, more than an image may have")
        size = count * np.dtype(dtype).itemsize
        data = member.read(size)
        _check(len(data) == size and not member.read(1), f"'{name}' does not hold what its header says")
    return np.frombuffer(data, dtype).reshape(found)


def _read_header(member: zipfile.ZipExtFile) -> tuple[tuple[int, ...], bool, np.dtype]:
    version = np.lib.format.read_magic(member)
    if version == (1, 0):
        return np.lib.format.read_array_header_1_0(member)
    return np.lib.format.read_array_header_2_0(member)


def _described(shape: tuple[int | None, ...]) -> str:
    return "x".join("N" if n is None else str(n) for n in shape) or "scalar"


def _check(condition: bool, problem: str) -> None:
    if not condition:
        raise InputError(problem)
