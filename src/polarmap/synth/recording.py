"""Synthetic sequences as files, in the layout that every recorded sequence has, with the truth."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from polarmap.errors import PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.camera_file import CAMERA_FILE_NAME, CameraFile, write_camera_file
from polarmap.io.depth_png import write_depth_png
from polarmap.io.files import reason, write_bytes
from polarmap.io.images import write_image
from polarmap.io.trajectory import Trajectory, write_trajectory
from polarmap.polarization.types import SensorNoise
from polarmap.synth.sensor import Sensor
from polarmap.synth.sequence import SynthFrame

DEPTH_SCALE = 5000.0  # pixel values per metre

_NO_NOISE = SensorNoise(full_well=1e9, read_noise=0.0)  # a camera file wants finite numbers
_FARTHEST = 65535 / DEPTH_SCALE


def write_sequence(folder: Path, frames: Iterable[SynthFrame], camera: PinholeCamera, sensor: Sensor) -> None:
    """Write frames, as `render_sequence` gives them with this camera and sensor, to a folder.

    camera.yaml, timestamps.txt, groundtruth.txt (TUM), and for frame NNNNNN raw/NNNNNN.png (the mosaic),
    depth/NNNNNN.png (16 bits, 5000 per metre, 0 where none or beyond 13.1 m) and normal/NNNNNN.png (see
    `encode_normals`). Files of the same name are replaced. The text files with times and poses are written last.
    Raises PolarmapError where a file cannot be written, InputError where the sensor's bit depth is none of a camera
    file's or there is no frame.
    """
    folder = Path(folder)
    _make_folders(folder)
    write_camera_file(folder / CAMERA_FILE_NAME, camera_file(camera, sensor))
    timestamps, poses = [], []
    for frame in frames:
        _write_frame(folder, frame)
        timestamps.append(frame.timestamp)
        poses.append(frame.T_world_camera)
    write_trajectory(folder / "groundtruth.txt", Trajectory(np.array(timestamps), np.array(poses), str(folder)))
    write_bytes(folder / "timestamps.txt", "".join(f"{t!r}\n" for t in timestamps).encode())


def camera_file(camera: PinholeCamera, sensor: Sensor) -> CameraFile:
    """The camera file that describes such a sensor behind such a lens."""
    return CameraFile(
        camera=camera,
        layout=sensor.layout,
        angle_direction=sensor.angle_direction,
        bit_depth=sensor.bit_depth,
        demosaic="bilinear" if sensor.sub_pixel else "split",
        noise=sensor.noise or _NO_NOISE,
        depth_scale=DEPTH_SCALE,
    )


def encode_normals(normal: np.ndarray) -> np.ndarray:
    """Unit normals, float32 H×W×3, as uint16 H×W×3: (n + 1)/2·65535 rounded, and 0, 0, 0 where there is none."""
    levels = np.rint((normal + 1.0) * (65535 / 2))
    return np.where(np.isfinite(normal), levels, 0.0).astype(np.uint16)


def _make_folders(folder: Path) -> None:
    try:
        for name in ("raw", "depth", "normal"):
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PolarmapError(f"{folder}: cannot be created ({reason(error)})") from None


def _write_frame(folder: Path, frame: SynthFrame) -> None:
    name = f"{frame.index:06d}.png"
    depth = np.where(frame.truth.depth <= _FARTHEST, frame.truth.depth, np.nan)
    write_image(folder / "raw" / name, frame.mosaic)
    write_depth_png(folder / "depth" / name, depth, DEPTH_SCALE)
    bgr = np.ascontiguousarray(encode_normals(frame.truth.normal)[..., ::-1])  # so that the file is RGB
    write_image(folder / "normal" / name, bgr)
