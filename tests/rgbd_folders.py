"""Small RGB-D recordings of the built-in room, written in each format that is read."""

from __future__ import annotations

import json
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

from polarmap.data.camera_file import CameraFile
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import range_factor
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.synth import Sensor, built_in_scene, render_sequence

CAMERA = PinholeCamera(width=80, height=60, fx=60.0, fy=62.0, cx=39.5, cy=29.5)
COUNT = 12
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])

_room = built_in_scene("room")
_clean = Sensor(noise=None, bit_depth=16)
FRAMES = list(render_sequence(_room.scene, CAMERA, *_room.path(COUNT, step=0.06), _clean, supersample=1))
POSES = np.stack([frame.T_world_camera for frame in FRAMES])
DEPTHS = np.stack([frame.truth.depth for frame in FRAMES])
PICTURES = [np.clip(frame.truth.stokes[0] * 110, 0, 255).astype(np.uint8) for frame in FRAMES]


def write_intrinsics(folder: Path, depth_scale: float | None = None) -> Path:
    """A camera.yaml of CAMERA for --camera."""
    path = folder.parent / f"{folder.name}_camera.yaml"
    write_camera_file(path, CameraFile(CAMERA, None, None, 8, depth_scale=depth_scale))
    return path


def write_icl(folder: Path, y_up: bool = True, associations: bool = False, first: int = 0) -> Path:
    """ICL-NUIM; the trajectory begins with the second frame, as the published ones may."""
    pictures = "rgb" if associations else "gray"
    for i in range(COUNT):
        write_picture(folder / pictures / f"{i + first}.png", PICTURES[i])
        write_depth(folder / "depth" / f"{i + first}.png", DEPTHS[i], 5000)
    if associations:
        lines = [f"{i + first} depth/{i + first}.png {i + first} rgb/{i + first}.png" for i in range(COUNT)]
        (folder / "associations.txt").write_text("\n".join(lines))
    poses = _MIRROR @ POSES @ _MIRROR if y_up else POSES
    rows = [tum_row(i + first, poses[i]) for i in range(1, COUNT)]
    (folder / "traj0.gt.freiburg").write_text("\n".join(rows))
    return folder


def write_icl_pov(folder: Path) -> Path:
    """ICL-NUIM as POV-Ray wrote it."""
    for i in range(COUNT):
        write_picture(folder / f"scene_00_{i:04d}.png", np.stack([PICTURES[i]] * 3, axis=-1))
        ranges = DEPTHS[i] * range_factor(CAMERA)
        (folder / f"scene_00_{i:04d}.depth").write_text(" ".join(f"{r:.5f}" for r in ranges.ravel()))
        T = _MIRROR @ POSES[i] @ _MIRROR
        vectors = {"cam_pos": T[:3, 3], "cam_dir": T[:3, 2], "cam_up": T[:3, 1]}
        lines = [f"{key:12s} = [{', '.join(map(repr, vector.tolist()))}]';" for key, vector in vectors.items()]
        (folder / f"scene_00_{i:04d}.txt").write_text("\n".join(lines))
    return folder


def write_tum(folder: Path) -> Path:
    """TUM RGB-D: depth 5 ms after the pictures, one picture more, poses ten times as often."""
    times = 100.0 + np.arange(COUNT) / 30
    for time, picture, depth in zip(times, PICTURES, DEPTHS, strict=True):
        write_picture(folder / "rgb" / f"{time:.6f}.png", picture)
        write_depth(folder / "depth" / f"{time + 0.005:.6f}.png", depth, 5000)
    write_picture(folder / "rgb" / "101.000000.png", PICTURES[0])
    rgb = [f"{t:.6f} rgb/{t:.6f}.png" for t in [*times, 101.0]]
    (folder / "rgb.txt").write_text("\n".join(["# color images", *rgb]))
    (folder / "depth.txt").write_text("\n".join(f"{t + 0.005:.6f} depth/{t + 0.005:.6f}.png" for t in times))
    rows = [tum_row(t + 0.005, T) for t, T in zip(times, POSES, strict=True)]
    (folder / "groundtruth.txt").write_text("\n".join(["# ground truth trajectory", *rows]))
    return folder


def write_redwood(folder: Path, pictures: str = "color") -> Path:
    """Redwood/Open3D, with the camera in JSON."""
    for i in range(COUNT):
        write_picture(folder / pictures / f"{i:05d}.jpg", np.stack([PICTURES[i]] * 3, axis=-1))
        write_depth(folder / "depth" / f"{i:05d}.png", DEPTHS[i], 1000)
    text = "".join(f"{i} {i} {i + 1}\n" + matrix_text(POSES[i]) for i in range(COUNT))
    (folder / "trajectory.log").write_text(text)
    K = [CAMERA.fx, 0, 0, 0, CAMERA.fy, 0, CAMERA.cx, CAMERA.cy, 1]
    intrinsics = {"width": CAMERA.width, "height": CAMERA.height, "intrinsic_matrix": K}
    (folder / "camera_intrinsic.json").write_text(json.dumps(intrinsics))
    return folder


def write_replica(folder: Path) -> Path:
    """Replica as NICE-SLAM has it."""
    for i in range(COUNT):
        write_picture(folder / "results" / f"frame{i:06d}.jpg", PICTURES[i])
        write_depth(folder / "results" / f"depth{i:06d}.png", DEPTHS[i], 6553.5)
    (folder / "traj.txt").write_text("".join(" ".join(map(repr, T.ravel().tolist())) + "\n" for T in POSES))
    camera = {"w": CAMERA.width, "h": CAMERA.height, "fx": CAMERA.fx, "fy": CAMERA.fy, "cx": CAMERA.cx,
              "cy": CAMERA.cy, "scale": 6553.5}  # fmt: skip
    (folder / "cam_params.json").write_text(json.dumps({"camera": camera}))
    return folder


def write_picture(path: Path, picture: np.ndarray) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), picture)


def write_depth(path: Path, depth: np.ndarray, scale: float) -> None:
    write_picture(path, np.rint(np.nan_to_num(depth) * scale).astype(np.uint16))


def tum_row(time: float, T: np.ndarray) -> str:
    quaternion = Rotation.from_matrix(T[:3, :3]).as_quat().tolist()
    return " ".join(map(repr, [float(time), *T[:3, 3].tolist(), *quaternion]))


def matrix_text(T: np.ndarray) -> str:
    return "".join(" ".join(map(repr, row)) + "\n" for row in T.tolist())
