"""Depth, normals and points of another camera or program on the camera of a sequence."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse

_FOCAL_TOLERANCE = 0.1  # of the sequence's focal length; a calibration of its own may differ by a little
_LEAST_SHARED = 0.5  # of the sequence's pixels that the other camera must see


def on_camera(path: Path, values: np.ndarray, source: PinholeCamera, target: PinholeCamera) -> np.ndarray:
    """An image of one camera as another at the same place sees it: the nearest pixel of each ray, NaN outside.

    values: float H×W or H×W×C; depth along the optical axis and normals stay as they are.
    Raises InputError where the two differ by more than a scaled image and a calibration of its own explain.
    """
    for name, ours, theirs in (("fx", target.fx, source.fx), ("fy", target.fy, source.fy)):
        scale = source.width / target.width if name == "fx" else source.height / target.height
        share = _crop_free(theirs / ours, scale)
        if abs(share - 1.0) > _FOCAL_TOLERANCE:
            raise InputError(
                f"{path}: is of another camera: {name} is {theirs:.6g} at {source.width}x{source.height}, the "
                f"sequence's {ours:.6g} at {target.width}x{target.height}"
            )
    u, seen_u = _nearest(np.arange(target.width), target.fx, target.cx, source.fx, source.cx, source.width)
    v, seen_v = _nearest(np.arange(target.height), target.fy, target.cy, source.fy, source.cy, source.height)
    if seen_u.mean() * seen_v.mean() < _LEAST_SHARED:
        raise InputError(f"{path}: is of another camera: it sees less than half of what the sequence's sees")
    resampled = values[np.ix_(v, u)].astype(np.float32)
    resampled[~seen_v] = np.nan
    resampled[:, ~seen_u] = np.nan
    return resampled


def resized(path: Path, camera: PinholeCamera, shape: tuple[int, int]) -> PinholeCamera:
    """The camera of its image scaled to `shape`, (height, width); InputError where the proportions are others.

    path: the image's file, for messages.
    """
    sx, sy = shape[1] / camera.width, shape[0] / camera.height
    if abs(sx * camera.height - shape[0]) > 1.0 and abs(sy * camera.width - shape[1]) > 1.0:
        raise InputError(
            f"{path}: depth of {shape[1]}x{shape[0]} pixels, which is no scaled image of {camera.width}x{camera.height}"
        )
    if (sx, sy) == (1.0, 1.0):
        return camera
    cx, cy = (camera.cx + 0.5) * sx - 0.5, (camera.cy + 0.5) * sy - 0.5
    return PinholeCamera(shape[1], shape[0], camera.fx * sx, camera.fy * sy, cx, cy)


def toward_camera(normal: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Normals, float H×W×3 of any length and sign, toward the camera and of unit length; NaN where they have none."""
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    away = np.einsum("hwc,hwc->hw", normal, camera.rays())[..., None] > 0
    return (normal / np.where(length > 0.5, np.where(away, -length, length), np.nan)).astype(np.float32)


def project_points(points: np.ndarray, camera: PinholeCamera, T_world_camera: np.ndarray) -> np.ndarray:
    """Depth of world points N×3 at the pixels they fall on, the nearest of each pixel; float32 H×W with NaN."""
    T = inverse(T_world_camera)
    local = points @ T[:3, :3].T + T[:3, 3]
    local = local[local[:, 2] > 0]
    z = local[:, 2]
    pixels = np.floor(local[:, :2] / z[:, None] * [camera.fx, camera.fy] + [camera.cx + 0.5, camera.cy + 0.5])
    inside = ((pixels >= 0) & (pixels < [camera.width, camera.height])).all(axis=1)
    u, v = pixels[inside].astype(np.int64).T
    depth = np.full(camera.shape, np.inf, np.float32)
    np.minimum.at(depth, (v, u), z[inside].astype(np.float32))
    depth[np.isinf(depth)] = np.nan
    return depth


def _crop_free(focal_ratio: float, size_ratio: float) -> float:
    """The ratio of focal lengths for images of one size; a crop without scaling counts as none."""
    return min(focal_ratio / size_ratio, focal_ratio, key=lambda ratio: abs(ratio - 1.0))


def _nearest(
    pixels: np.ndarray, f: float, c: float, other_f: float, other_c: float, size: int
) -> tuple[np.ndarray, np.ndarray]:
    """Where pixels of one camera fall on an axis of the other, and whether inside it."""
    found = np.floor((pixels - c) / f * other_f + other_c + 0.5).astype(np.int64)
    return np.clip(found, 0, size - 1), (found >= 0) & (found < size)
