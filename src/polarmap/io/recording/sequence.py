"""Recorded sequences, read one frame at a time: `for frame in open_sequence("livingroom"): ...`"""

from __future__ import annotations

import math
import os
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.io.files import read_bytes
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.images import read_image, read_picture, read_picture_header
from polarmap.io.formats.packed import unpack
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.calibration import find_camera_file
from polarmap.io.recording.camera_file import CAMERA_FILE_NAME, MINIMAL_CAMERA_FILE, read_camera_file
from polarmap.io.recording.frame_files import ANGLES, RAW_SUFFIXES, FrameFiles, find_frames
from polarmap.io.recording.pixels import aligned
from polarmap.io.recording.recorded_frames import RecordedFrames


@dataclass(frozen=True)
class Sequence(RecordedFrames[FrameFiles, Frame]):
    """A recorded sequence: frames by position, read when asked for; slices are sequences.

    Reading a frame raises InputError, naming the file, where it is truncated, corrupt, or not as the camera
    file says.
    """

    path: Path
    camera_file: CameraFile
    files: tuple[FrameFiles, ...]

    @property
    def timestamps(self) -> np.ndarray:
        """Seconds of every frame, float64 N; NaN where the sequence has no times."""
        return np.array([files.timestamp for files in self.files])

    @property
    def exposures(self) -> np.ndarray:
        """Seconds that every frame was exposed, float64 N; NaN where it is not known."""
        return np.array([files.exposure for files in self.files])

    def truth_depth(self, index: int) -> np.ndarray | None:
        """True depth z of the frame of this index, float32 H×W metres, NaN where none; None without a file.

        It is that of the undistorted camera. Raises InputError where the file or the index is bad.
        """
        name = next((files.name for files in self.files if files.index == index), None)
        if name is None:
            raise InputError(f"{self.path}: no frame has the index {index}")
        path = self.path / "depth" / f"{name}.png"
        if not path.exists():
            return None
        if self.camera_file.depth_scale is None:
            raise InputError(f"{path}: needs depth_scale, its values per metre, in the camera file")
        camera = self.camera_file.camera
        return read_depth_png(path, self.camera_file.depth_scale, (camera.width, camera.height))

    def truth_trajectory(self) -> Trajectory | None:
        """True poses, from groundtruth.txt, or None without it."""
        path = self.path / "groundtruth.txt"
        return self.read_poses(path) if path.exists() else None

    def read_poses(self, path: Path) -> Trajectory:
        """The trajectory in a file, in the times of this sequence.

        The poses of a KITTI or log file, which has no times, are those of the frames one by one; a file may give the
        frames' numbers in place of times. Raises InputError as `read_trajectory` does, and where there are not as many
        poses as frames.
        """
        times = [files.timestamp for files in self.files]
        if any(math.isnan(time) for time in times):
            return read_trajectory(path)
        return read_trajectory(path, timestamps=times, indices=[files.index for files in self.files])

    def _read(self, files: FrameFiles) -> Frame:
        frame = Frame(files.index, files.timestamp, files.name, files.paths[0], exposure=files.exposure)
        camera_file = self.camera_file
        if not camera_file.polarized:
            return replace(frame, grey=_read_pixels(frame.path, camera_file, read_picture))
        if len(files.paths) == 1:
            return replace(frame, mosaic=_read_pixels(frame.path, camera_file, read_image, camera_file.mosaic_size))
        pictures = [_read_pixels(path, camera_file, read_image) for path in files.paths]
        return replace(frame, channels=np.stack(pictures))


def open_sequence(path: Path | str, camera_file: CameraFile | None = None) -> Sequence:
    """The sequence in a folder, or of one mosaic or plain picture; no frame is read yet. Layouts: docs/formats.md.

    camera_file: used in place of the folder's camera.yaml (for a single file: of that beside it, or in the
    folder above). Raises InputError where there is no camera file, a picture or frame is missing, or the files
    of times or exposures do not fit.
    """
    path = Path(path)
    if not os.path.exists(path):  # unlike Path.exists, False where a folder may not be entered
        raise InputError(f"{path}: no such file or folder")
    if camera_file is None:
        camera_file = read_camera_file(_find_camera_file(path), path)
    if path.is_dir():
        files = find_frames(path, camera_file)
        if len(files[0].paths) == len(ANGLES):
            camera_file = _taken_apart(path, camera_file)
        return Sequence(path, camera_file, files)
    if camera_file.polarized and camera_file.layout is None:
        raise InputError(f"{path}: a single file must be a mosaic, but the camera file says mosaic: none")
    return Sequence(path, camera_file, (FrameFiles(0, float("nan"), path.stem, (path,)),))


def _taken_apart(path: Path, camera_file: CameraFile) -> CameraFile:
    """The camera of mosaics that were split into one picture per angle before."""
    if camera_file.colour is not None:
        raise InputError(f"{path}: pictures of one angle must be grey; use the colour sensor's raw mosaics instead")
    return replace(camera_file, layout=None)


def _find_camera_file(path: Path) -> Path:
    found = find_camera_file(path)
    if found is not None:
        return found
    folder = path if path.is_dir() else path.parent
    raise InputError(
        f"{folder}: no {CAMERA_FILE_NAME}; write one, for example {MINIMAL_CAMERA_FILE} "
        "with width and height of a channel (half the mosaic's); for a camera without polarizers, "
        "polarization: none in place of mosaic and angle_direction"
    )


def _read_pixels(
    path: Path,
    camera_file: CameraFile,
    read: Callable[..., np.ndarray],
    size: tuple[int, int] | None = None,
) -> np.ndarray:
    """The pixel values of one file, uint8 or uint16, in [0, white_level]; its size by default the camera's."""
    size = size or (camera_file.camera.width, camera_file.camera.height)
    if path.suffix.lower() not in RAW_SUFFIXES:
        bits = 8 if camera_file.bit_depth == 8 else 16
        try:
            pixels = read(path, size, bits)
        except InputError:
            _require_header(path, size, bits, camera_file)  # which can say more
            raise
    else:
        data = read_bytes(path)
        try:
            pixels = unpack(data, camera_file.pixel_format, size[::-1])
        except InputError as problem:
            if len(data) == camera_file.pixel_format.byte_count(camera_file.camera.shape):
                _require_size(path, (camera_file.camera.width, camera_file.camera.height), size, camera_file)
            raise InputError(f"{path}: {problem}") from None
    return aligned(path, pixels, camera_file)


def _require_header(path: Path, size: tuple[int, int], bits: int, camera_file: CameraFile) -> None:
    """Raise InputError, naming the camera file's keys, where a picture that can be read has another size or depth."""
    try:
        header = read_picture_header(path)
    except InputError:
        return
    _require_size(path, (header.width, header.height), size, camera_file)
    if header.bits != bits:
        raise InputError(
            f"{path}: {header.bits} bits per pixel, expected {bits} by bit_depth: {camera_file.bit_depth} in the "
            "camera file; correct it, or write the sensor's data without conversion"
        )


def _require_size(path: Path, found: tuple[int, int], size: tuple[int, int], camera_file: CameraFile) -> None:
    """Raise InputError, telling what the camera file's size means, where a picture has another (width, height)."""
    if found == size:
        return
    camera = camera_file.camera
    pixels = f"{path}: {found[0]}x{found[1]} pixels, expected {size[0]}x{size[1]}"
    if camera_file.layout is not None and found == (camera.width, camera.height):
        raise InputError(
            f"{pixels}: the camera file's width and height are those of one channel, half the mosaic's; if this is a "
            f"raw mosaic, write width: {found[0] // 2} and height: {found[1] // 2}, with fx, fy, cx and cy of a channel"
        )
    if camera_file.polarized and camera_file.layout is None and found == (2 * camera.width, 2 * camera.height):
        raise InputError(
            f"{pixels} of pictures of one angle; for a raw mosaic write its layout in place of mosaic: none"
        )
    of_channel = " of a channel, half the mosaic's," if camera_file.layout is not None else ""
    raise InputError(
        f"{pixels}; correct width and height{of_channel} in the camera file, and fx, fy, cx and cy with them where "
        "pictures were cut or resized"
    )
