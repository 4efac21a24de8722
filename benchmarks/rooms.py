"""The built-in room as a camera sees it, for benchmarks that are given no recording."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import cycle, islice
from pathlib import Path

from polarmap.data.camera_file import CameraFile
from polarmap.data.frame import Frame
from polarmap.data.trajectory import Trajectory
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.recording.camera_file import CAMERA_FILE_NAME, write_camera_file
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.synth.recording import camera_file
from polarmap.synth.rendering import SynthFrame, render_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor

FRAME_RATE = 30.0

_ROOM = built_in_scene("room")
_SENSOR = Sensor()  # 8 bits


def rendered_room(width: int, height: int, frames: int) -> tuple[CameraFile, list[Frame], Trajectory]:
    """Frames in memory, 4 cm from one to the next, and their true poses."""
    timestamps, poses = _ROOM.path(frames)
    rendered = _rendered(width, height, Trajectory(timestamps, poses))
    made = [Frame(f.index, f.timestamp, f"{f.index:06d}", Path(f"{f.index:06d}"), mosaic=f.mosaic) for f in rendered]
    return camera_file(_camera(width, height), _SENSOR), made, Trajectory(timestamps, poses)


def recorded_room(folder: Path, width: int, height: int, frames: int, step: float) -> Sequence:
    """A recording in a new folder, with `step` metres from frame to frame.

    Frames are raw buffers, which cost as little to read as those of a camera's driver: decoding a PNG file of 2448x2048
    pixels takes nearly as long as a frame.
    """
    (folder / "raw").mkdir(parents=True)
    write_camera_file(folder / CAMERA_FILE_NAME, camera_file(_camera(width, height), _SENSOR))
    path = Trajectory(*_ROOM.path(frames, step, FRAME_RATE))
    for frame in _rendered(width, height, path):
        (folder / "raw" / f"{frame.index:06d}.raw").write_bytes(frame.mosaic.tobytes())
    return open_sequence(folder)


def forth_and_back(sequence: Sequence, frames: int, rate: float) -> Sequence:
    """So many frames of a recording played forth and back without end, numbered and timed anew at `rate` a second.

    The picture at either end is not shown twice. Files are read again at each turn.
    """
    files = cycle([*sequence.files, *sequence.files[-2:0:-1]])
    played = (replace(f, index=n, timestamp=n / rate) for n, f in enumerate(islice(files, frames)))
    return replace(sequence, files=tuple(played))


def _camera(width: int, height: int) -> PinholeCamera:
    """One of the same field of view, 67 degrees, at every size."""
    focal = 0.75 * width
    return PinholeCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def _rendered(width: int, height: int, path: Trajectory) -> Iterator[SynthFrame]:
    camera = _camera(width, height)
    return render_sequence(_ROOM.scene, camera, path.timestamps, path.poses, _SENSOR, supersample=1)
