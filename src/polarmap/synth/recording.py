"""Synthetic sequences as files, in the layout that every recorded sequence has, with the truth."""

from __future__ import annotations

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import yaml

from polarmap.data.camera_file import CameraFile
from polarmap.data.sensor import SensorNoise
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import reason, remove_parts, write_bytes
from polarmap.io.folder_lock import LOCK_NAME, FolderLock
from polarmap.io.formats.depth_png import write_depth_png
from polarmap.io.formats.images import write_image
from polarmap.io.formats.trajectory import write_trajectory
from polarmap.io.recording.camera_file import CAMERA_FILE_NAME, write_camera_file
from polarmap.synth.rendering import SynthFrame
from polarmap.synth.sensor import Sensor
from polarmap.version import package_version

DEPTH_SCALE = 5000.0  # pixel values per metre
PARAMETERS_FILE_NAME = "synth.yaml"

_NO_NOISE = SensorNoise(full_well=1e9, read_noise=0.0)  # a camera file wants finite numbers
_LARGEST = 65535
_FRAME_FOLDERS = ("raw", "depth", "normal")


def write_sequence(
    folder: Path,
    frames: Iterable[SynthFrame],
    camera: PinholeCamera,
    sensor: Sensor,
    parameters: dict[str, Any] | None = None,
    depth_scale: float = DEPTH_SCALE,
    on_frame: Callable[[], None] | None = None,
) -> None:
    """Write frames, as `render_sequence` gives them with this camera and sensor, to a folder.

    camera.yaml, timestamps.txt, groundtruth.txt (TUM), and for frame NNNNNN raw/NNNNNN.png (the mosaic),
    depth/NNNNNN.png (16 bits, `depth_scale` per metre, 0 where none or beyond what 16 bits hold) and
    normal/NNNNNN.png (see `encode_normals`). Files of the same name are replaced, and where synth.yaml says that the
    folder holds a sequence made before, all of its frames are removed first. The text files with times and poses are
    written last.
    parameters: how the frames were made, in plain values; they go to synth.yaml with those of the sensor.
    on_frame: called after each frame that is written.
    Raises PolarmapError where a file cannot be written, InputError where the sensor's bit depth is none of a camera
    file's, there is no frame, or another program is writing there.
    """
    folder = Path(folder)
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PolarmapError(f"{folder}: cannot be created ({reason(error)})") from None
    with FolderLock(folder):
        _write_sequence(folder, frames, camera, sensor, parameters, depth_scale, on_frame)


def _write_sequence(folder, frames, camera, sensor, parameters, depth_scale, on_frame) -> None:
    _make_folders(folder)
    if parameters is not None:  # first, since it marks the folder as one that may be replaced
        write_parameters(folder / PARAMETERS_FILE_NAME, parameters, sensor)
    write_camera_file(folder / CAMERA_FILE_NAME, camera_file(camera, sensor, depth_scale))
    timestamps, poses = [], []
    for frame in frames:
        _write_frame(folder, frame, depth_scale)
        timestamps.append(frame.timestamp)
        poses.append(frame.T_world_camera)
        if on_frame:
            on_frame()
    write_trajectory(folder / "groundtruth.txt", Trajectory(np.array(timestamps), np.array(poses), str(folder)))
    write_bytes(folder / "timestamps.txt", "".join(f"{t!r}\n" for t in timestamps).encode())


def camera_file(camera: PinholeCamera, sensor: Sensor, depth_scale: float = DEPTH_SCALE) -> CameraFile:
    """The camera file that describes such a sensor behind such a lens."""
    return CameraFile(
        camera=camera,
        layout=sensor.layout,
        angle_direction=sensor.angle_direction,
        bit_depth=sensor.bit_depth,
        demosaic="bilinear" if sensor.sub_pixel else "split",
        noise=sensor.noise or _NO_NOISE,
        depth_scale=depth_scale,
    )


def write_parameters(path: Path, parameters: dict[str, Any], sensor: Sensor) -> None:
    """Write how a sequence was made as YAML: these values, the sensor's and this program's version, null if unknown."""
    values = {**parameters, "sensor": sensor_parameters(sensor), "polarmap": package_version()}
    write_bytes(path, yaml.safe_dump(values, sort_keys=False, default_flow_style=None, allow_unicode=True).encode())


def sensor_parameters(sensor: Sensor) -> dict[str, Any]:
    """The sensor's values as plain ones, all that tell two sensors apart."""
    noise = sensor.noise
    return {
        "layout": list(sensor.layout.value),
        "angle_direction": sensor.angle_direction.value,
        "bit_depth": sensor.bit_depth,
        "exposure": float(sensor.exposure),
        "noise": noise and {"full_well": float(noise.full_well), "read_noise": float(noise.read_noise)},
        "sub_pixel": sensor.sub_pixel,
        "extinction_ratio": float(sensor.extinction_ratio),
        "shutter": float(sensor.shutter),
        "seed": sensor.seed,
    }


def require_empty(folder: Path, force: bool = False) -> None:
    """Raise InputError where a folder holds anything, or where it is a file.

    With `force` the folder may hold a sequence with synth.yaml, which is replaced; nothing else, so that no recording
    is ever lost.
    """
    folder = Path(folder)
    try:
        if folder.exists() and not folder.is_dir():
            raise InputError(f"{folder}: is a file; name a folder to write")
        if not (folder.is_dir() and any(path.name != LOCK_NAME for path in folder.iterdir())):
            return
        if not (folder / PARAMETERS_FILE_NAME).is_file():
            raise InputError(f"{folder}: is not empty, and not made by 'polarmap synth'; name another folder")
        if not force:
            raise InputError(f"{folder}: is not empty; name another folder, or add --force to replace the sequence")
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({reason(error)})") from None


def encode_normals(normal: np.ndarray) -> np.ndarray:
    """Unit normals, float32 H×W×3, as uint16 H×W×3: (n + 1)/2·65535 rounded, and 0, 0, 0 where there is none."""
    levels = np.rint((normal + 1.0) * (65535 / 2))
    return np.where(np.isfinite(normal), levels, 0.0).astype(np.uint16)


def _make_folders(folder: Path) -> None:
    try:
        if (folder / PARAMETERS_FILE_NAME).is_file():
            _remove_made(folder)
        for name in _FRAME_FOLDERS:
            (folder / name).mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PolarmapError(f"{folder}: cannot be created ({reason(error)})") from None


def _remove_made(folder: Path) -> None:
    """Remove a sequence's frames, times and poses: a shorter one must not keep what was at the end of a longer."""
    frames = (path for name in _FRAME_FOLDERS for path in (folder / name).glob("[0-9]" * 6 + ".png"))
    for parts in (folder, *(folder / name for name in _FRAME_FOLDERS)):
        remove_parts(parts)
    for path in (*frames, folder / "timestamps.txt", folder / "groundtruth.txt"):
        path.unlink(missing_ok=True)


def _write_frame(folder: Path, frame: SynthFrame, depth_scale: float) -> None:
    name = f"{frame.index:06d}.png"
    depth = np.where(frame.truth.depth <= _LARGEST / depth_scale, frame.truth.depth, np.nan)
    write_image(folder / "raw" / name, frame.mosaic)
    write_depth_png(folder / "depth" / name, depth, depth_scale)
    bgr = np.ascontiguousarray(encode_normals(frame.truth.normal)[..., ::-1])  # so that the file is RGB
    write_image(folder / "normal" / name, bgr)
