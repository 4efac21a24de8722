"""An RGB-D recording of any format, read one frame at a time."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import read_text
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.images import read_picture
from polarmap.io.recording.recorded_frames import RecordedFrames

_MOST_CHARACTERS = 40  # of a number and the space after it
_BEYOND = 1e6  # metres: a ray that met nothing


@dataclass(frozen=True, eq=False)
class RgbdFiles:
    """A frame that is not read yet.

    timestamp: seconds. picture: grey or colour. depth: 16-bit PNG of z, or .depth text of ranges in metres.
    T_world_camera: float64 4×4, OpenCV axes.
    """

    timestamp: float
    picture: Path
    depth: Path
    T_world_camera: np.ndarray


@dataclass(frozen=True, eq=False)
class RgbdFrame:
    """A frame: its picture's luma, float32 H×W in [0, 1], and its depth z, float32 H×W metres, NaN where none."""

    timestamp: float
    picture: np.ndarray
    depth: np.ndarray
    T_world_camera: np.ndarray


@dataclass(frozen=True, eq=False)
class RgbdSequence(RecordedFrames[RgbdFiles, RgbdFrame]):
    """A recording: frames by position, read when asked for; slices are sequences.

    camera: of pictures and depth alike. depth_scale: pixel values per metre.
    without_pose: how many frames of the recording are left out because no pose is known for them.
    Reading a frame raises InputError, naming the file, where it is missing, truncated, or of another size or kind.
    """

    path: Path
    format: str
    camera: PinholeCamera
    depth_scale: float
    files: tuple[RgbdFiles, ...]
    without_pose: int = 0

    @property
    def timestamps(self) -> np.ndarray:
        """Seconds, float64 N."""
        return np.array([files.timestamp for files in self.files])

    @property
    def poses(self) -> np.ndarray:
        """T_world_camera, float64 N×4×4."""
        return np.stack([files.T_world_camera for files in self.files])

    def read_depth(self, position: int) -> np.ndarray:
        """Only the depth of a frame, float32 H×W metres, NaN where none."""
        return self._depth(self.files[position].depth)

    def _read(self, files: RgbdFiles) -> RgbdFrame:
        pixels = read_picture(files.picture, self._size)
        picture = pixels.astype(np.float32) / np.float32(np.iinfo(pixels.dtype).max)
        return RgbdFrame(files.timestamp, picture, self._depth(files.depth), files.T_world_camera)

    def _depth(self, path: Path) -> np.ndarray:
        if path.suffix == ".depth":
            return _read_range_text(path, self.camera)
        return read_depth_png(path, self.depth_scale, self._size)

    @property
    def _size(self) -> tuple[int, int]:
        return self.camera.width, self.camera.height


def _read_range_text(path: Path, camera: PinholeCamera) -> np.ndarray:
    """Depth from a text file of the distance along each pixel's ray in metres, row by row (POV-Ray, ICL-NUIM)."""
    values = read_text(path, _MOST_CHARACTERS * camera.width * camera.height + 4096).split()
    if len(values) != camera.width * camera.height:
        raise InputError(f"{path}: {len(values)} values, expected {camera.width}x{camera.height}")
    try:
        ranges = np.array(values, np.float64).reshape(camera.shape)
    except ValueError:
        raise InputError(f"{path}: holds something that is no number; expected a distance in metres a pixel") from None
    depth = ranges * camera.rays()[..., 2]
    depth[~((depth > 0) & (depth < _BEYOND))] = np.nan
    return depth.astype(np.float32)
