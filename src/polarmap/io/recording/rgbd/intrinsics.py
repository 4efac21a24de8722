"""Intrinsics of RGB-D cameras: defaults of the data sets, JSON files of Open3D and Replica, and camera.yaml."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.json_text import read_json
from polarmap.io.recording.camera_file import read_camera_file

_MAX_JSON_BYTES = 1 << 16
_MAX_SIDE = 1 << 14
_EXPECTED = (
    "expected {width, height, intrinsic_matrix} as Open3D writes it, or {camera: {w, h, fx, fy, cx, cy, scale}} "
    "as Replica has it"
)


@dataclass(frozen=True)
class RgbdCamera:
    """Intrinsics, and pixel values of depth per metre, None where the file does not say."""

    camera: PinholeCamera
    depth_scale: float | None = None


def read_intrinsics(path: Path) -> RgbdCamera:
    """The camera in a JSON file (Open3D, Replica) or a camera.yaml with `polarization: none`.

    Raises InputError where it is neither, a number is missing, or the lens is distorted.
    """
    path = Path(path)
    if path.suffix.lower() == ".json":
        return _read_json(path)
    camera_file = read_camera_file(path)
    if camera_file.distortion is not None:
        raise InputError(f"{path}: distortion; RGB-D pictures must be undistorted before")
    return RgbdCamera(camera_file.camera, camera_file.depth_scale)


def _read_json(path: Path) -> RgbdCamera:
    try:
        values = read_json(path, _MAX_JSON_BYTES)
    except InputError as problem:
        raise InputError(f"{problem}; {_EXPECTED}") from None
    try:
        if isinstance(values, dict) and "camera" in values:
            return _replica(values["camera"])
        return RgbdCamera(_open3d(values))
    except (KeyError, TypeError, ValueError, IndexError, OverflowError):
        raise InputError(f"{path}: a value is missing or no number; {_EXPECTED}") from None
    except InputError as problem:
        raise InputError(f"{path}: {problem}") from None


def _replica(values: dict[str, Any]) -> RgbdCamera:
    scale = _number(values["scale"]) if "scale" in values else None
    if scale is not None and not 0 < scale < 1e9:
        raise InputError(f"scale: {scale} is not positive")
    return RgbdCamera(_camera(*(values[key] for key in ("w", "h", "fx", "fy", "cx", "cy"))), scale)


def _open3d(values: dict[str, Any]) -> PinholeCamera:
    """Open3D writes K column by column."""
    fx, _, _, _, fy, _, cx, cy, _ = values["intrinsic_matrix"]
    return _camera(values["width"], values["height"], fx, fy, cx, cy)


def _camera(width, height, fx, fy, cx, cy) -> PinholeCamera:
    width, height = _number(width), _number(height)
    if max(width, height) > _MAX_SIDE:
        raise InputError(f"camera: {width:g}x{height:g} is more than {_MAX_SIDE} a side")
    if width % 1 or height % 1:
        raise InputError(f"camera: {width:g}x{height:g} are no whole numbers of pixels")
    return PinholeCamera(int(width), int(height), *map(_number, (fx, fy, cx, cy)))


def _number(value: Any) -> float:
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise TypeError("not a number")
    return float(value)
