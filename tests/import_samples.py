"""Files of other programs, written byte by byte as their formats are described."""

from __future__ import annotations

import struct
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse

NO_POINTS = np.empty((0, 3))


def colmap_map_bytes(values: np.ndarray) -> bytes:
    """values: H×W or H×W×C. Channel by channel, rows from top to bottom, x fastest."""
    height, width = values.shape[:2]
    channels = 1 if values.ndim == 2 else values.shape[2]
    data = b""
    for c in range(channels):
        for y in range(height):
            for x in range(width):
                value = values[y, x] if values.ndim == 2 else values[y, x, c]
                data += struct.pack("<f", 0.0 if np.isnan(value) else value)
    return f"{width}&{height}&{channels}&".encode() + data


def colmap_pose(T_world_camera: np.ndarray) -> tuple[list[float], list[float]]:
    """(qw, qx, qy, qz), (tx, ty, tz) of world to camera."""
    T = inverse(T_world_camera)
    x, y, z, w = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return [w, x, y, z], T[:3, 3].tolist()


def write_colmap_model(
    folder: Path,
    camera: PinholeCamera,
    poses: dict[str, np.ndarray],
    points: np.ndarray = NO_POINTS,
    binary: bool = True,
    model: tuple[int, str, list[float]] | None = None,
) -> None:
    """One camera (number 7), an image for every name, each of which sees all points; the points' ids are 11, 12, ...

    model: number, name and parameters, by default PINHOLE.
    """
    folder.mkdir(parents=True, exist_ok=True)
    number, name, parameters = model or (
        1,
        "PINHOLE",
        [camera.fx, camera.fy, camera.cx + 0.5, camera.cy + 0.5],
    )
    observed = [(float(i), 2.0 * i, 11 + i) for i in range(len(points))] + [(3.0, 4.0, -1)]
    if binary:
        data = struct.pack("<Q", 1) + struct.pack("<iiQQ", 7, number, camera.width, camera.height)
        (folder / "cameras.bin").write_bytes(data + struct.pack(f"<{len(parameters)}d", *parameters))
        data = struct.pack("<Q", len(poses))
        for i, (image, pose) in enumerate(poses.items()):
            q, t = colmap_pose(pose)
            data += struct.pack("<i4d3di", i + 1, *q, *t, 7) + image.encode() + b"\0"
            data += struct.pack("<Q", len(observed)) + b"".join(struct.pack("<ddq", *o) for o in observed)
        (folder / "images.bin").write_bytes(data)
        data = struct.pack("<Q", len(points))
        for i, point in enumerate(points):
            track = [(j + 1, i) for j in range(len(poses))]
            data += struct.pack("<Q3d3Bd", 11 + i, *point, 10, 20, 30, 0.5)
            data += struct.pack("<Q", len(track)) + b"".join(struct.pack("<ii", *t) for t in track)
        (folder / "points3D.bin").write_bytes(data)
        return
    values = " ".join(map(repr, parameters))
    (folder / "cameras.txt").write_text(f"# cameras\n7 {name} {camera.width} {camera.height} {values}\n")
    lines = ["# images"]
    for i, (image, pose) in enumerate(poses.items()):
        q, t = colmap_pose(pose)
        lines.append(f"{i + 1} {' '.join(map(repr, q + t))} 7 {image}")
        lines.append(" ".join(f"{x} {y} {p}" for x, y, p in observed) if len(points) else "")
    (folder / "images.txt").write_text("\n".join(lines) + "\n")
    lines = [f"{11 + i} {x!r} {y!r} {z!r} 10 20 30 0.5 1 {i}" for i, (x, y, z) in enumerate(points.tolist())]
    (folder / "points3D.txt").write_text("\n".join(lines) + "\n")


def dmap_bytes(
    name: str,
    depth: np.ndarray,
    K: np.ndarray,
    T_world_camera: np.ndarray,
    image_size: tuple[int, int] | None = None,
    normal: np.ndarray | None = None,
    confidence: np.ndarray | None = None,
) -> bytes:
    """A .dmap: image_size (width, height) is the depth map's if not given."""
    height, width = depth.shape
    content = 1 + (2 if normal is not None else 0) + (4 if confidence is not None else 0)
    data = b"DR" + struct.pack("<BB", content, 0)
    data += struct.pack("<4I", *(image_size or (width, height)), width, height)
    data += struct.pack("<2f", 0.1, 10.0)
    data += struct.pack("<H", len(name)) + name.encode() + struct.pack("<I2I", 2, 0, 1)
    R = T_world_camera[:3, :3].T
    data += struct.pack("<9d", *K.ravel()) + struct.pack("<9d", *R.ravel())
    data += struct.pack("<3d", *T_world_camera[:3, 3])
    data += np.nan_to_num(depth).astype("<f4").tobytes()
    for values in (normal, confidence):
        if values is not None:
            data += values.astype("<f4").tobytes()
    return data
