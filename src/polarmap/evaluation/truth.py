"""The true depth and normals of a keyframe."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_depth
from polarmap.io.formats.normal_png import read_normal_png
from polarmap.io.recording.sequence import Sequence
from polarmap.io.run_folder.keyframe_file import KeyframeResult

_TIME_TOLERANCE = 1e-3  # seconds
_INTRINSICS_TOLERANCE = 0.01  # pixels


@dataclass(frozen=True)
class Truth:
    """depth: float32 H×W z in metres. normal: float32 H×W×3, camera frame. NaN where none."""

    depth: np.ndarray
    normal: np.ndarray


def normal_source(sequence: Sequence) -> str:
    """What the true normals of a sequence are from."""
    return "normal/NAME.png" if (sequence.path / "normal").is_dir() else "the true depth"


def read_truth(sequence: Sequence, keyframe: KeyframeResult) -> Truth | None:
    """The truth of a keyframe's frame; None without true depth.

    Raises InputError where the sequence is not the one that was mapped, or a file is malformed.
    """
    _check_frame(sequence, keyframe)
    return read_frame_truth(sequence, keyframe.index)


def read_frame_truth(sequence: Sequence, index: int) -> Truth | None:
    """The truth of the frame with an index; None without true depth.

    Normals come from normal/NAME.png where that is there, else from the true depth.
    Raises InputError where the sequence has no such frame, or a file is malformed.
    """
    camera = sequence.camera_file.camera
    depth = sequence.truth_depth(index)
    if depth is None:
        return None
    name = next(files.name for files in sequence.files if files.index == index)
    path = sequence.path / "normal" / f"{name}.png"
    if path.exists():
        return Truth(depth, read_normal_png(path, (camera.width, camera.height)))
    return Truth(depth, normals_from_depth(depth, camera))


def _check_frame(sequence: Sequence, keyframe: KeyframeResult) -> None:
    """InputError where the sequence has no such frame, or has it of another time or camera."""
    wrong, index = f"{sequence.path}: is not the sequence of this run", keyframe.index
    files = next((files for files in sequence.files if files.index == index), None)
    if files is None:
        raise InputError(f"{wrong}: it has no frame {index}")
    if abs(files.timestamp - keyframe.timestamp) > _TIME_TOLERANCE:
        raise InputError(f"{wrong}: its frame {index} is of {files.timestamp} s, not of {keyframe.timestamp} s")
    if not _same_camera(sequence.camera_file.camera, keyframe.camera):
        raise InputError(f"{wrong}: its camera file has another size, fx, fy, cx or cy than keyframe {index}")


def _same_camera(a: PinholeCamera, b: PinholeCamera) -> bool:
    return a.shape == b.shape and bool(np.allclose(a.matrix, b.matrix, rtol=0.0, atol=_INTRINSICS_TOLERANCE))
