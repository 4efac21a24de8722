"""The sequences that benchmarks of odometry run on: grey images with true positions."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.trajectory import Trajectory
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.sensing.front_end import FrontEnd

FRAME_RATE = 30.0
_OFFICE = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)
_REDWOOD = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
_MIRROR = np.diag([1.0, -1.0, 1.0, 1.0])  # of ICL-NUIM's y axis


@dataclass(frozen=True)
class Video:
    """Frames in the order in which they are tracked, counted from 0 at `FRAME_RATE`, and their truth."""

    sequence: Sequence
    truth: Trajectory

    @property
    def camera(self) -> PinholeCamera:
        return self.sequence.camera_file.camera

    @property
    def count(self) -> int:
        return len(self.sequence)

    @property
    def positions(self) -> dict[int, np.ndarray]:
        """True position, float64 (3,), by the number of the frame."""
        poses = enumerate(self.truth.at(time) for time in self.sequence.timestamps.tolist())
        return {number: pose[:3, 3] for number, pose in poses if pose is not None}

    def images(self) -> Iterator[tuple[int, float, np.ndarray]]:
        """Number of the frame, time in seconds, and image, float32 H×W in [0, 1]."""
        front_end = FrontEnd(self.sequence.camera_file)
        for number, frame in enumerate(self.sequence):
            yield number, number / FRAME_RATE, front_end.grey(frame)

    def strided(self, stride: int) -> Video:
        """Every so-manieth frame; backwards where negative."""
        return replace(self, sequence=self.sequence[::stride])


def office(data: Path, frames: int) -> Video:
    folder = data / "icl_office_kt0"
    truth = read_trajectory(folder / "traj0.gt.freiburg", "tum")
    poses = _MIRROR @ truth.poses @ _MIRROR
    sequence = open_sequence(folder, _plain(_OFFICE))[:frames]
    return Video(sequence, Trajectory(truth.timestamps / FRAME_RATE, poses))


def redwood(data: Path) -> Video:
    folder = data / "redwood_livingroom1"
    sequence = open_sequence(folder, _plain(_REDWOOD))
    return Video(sequence, read_trajectory(folder / "trajectory.log", timestamps=sequence.timestamps.tolist()))


def livingroom(data: Path) -> Video:
    sequence = open_sequence(data / "livingroom")
    return Video(sequence, sequence.truth_trajectory())


VIDEOS: dict[str, Callable[[Path], Video]] = {
    "office300": lambda data: office(data, 300),
    "office450": lambda data: office(data, 450),
    "redwood": redwood,
    "livingroom": livingroom,
}


def load(data: Path, name: str) -> Video:
    """The video of a name such as `redwood`, `redwood/2` or `redwood/-1`."""
    base, _, stride = name.partition("/")
    return VIDEOS[base](data).strided(int(stride or 1))


def _plain(camera: PinholeCamera) -> CameraFile:
    return CameraFile(camera, layout=None, angle_direction=None, bit_depth=8, frame_rate=FRAME_RATE)
