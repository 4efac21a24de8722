"""What is true of a sequence, of its files or of arrays: depth and normals by frame, and the camera's poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import cached_property, partial

import numpy as np

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.trajectories import poses_at
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_depth
from polarmap.io.formats.normal_png import read_normal_png
from polarmap.io.recording.sequence import Sequence

_FROM_DEPTH = "the true depth"


@dataclass(frozen=True, eq=False)
class TrueFrame:
    """A frame, and what is true of it once it is asked for.

    timestamp: seconds, NaN where the sequence has no times. depth: gives float32 H×W z in metres, NaN where none; None
    where the frame has no true depth. normal: gives float32 H×W×3, unit, in the camera frame, NaN where none; None
    where they follow from the depth. Both raise InputError where a file is malformed.
    """

    index: int
    timestamp: float
    depth: Callable[[], np.ndarray] | None = field(default=None, repr=False)
    normal: Callable[[], np.ndarray] | None = field(default=None, repr=False)


@dataclass(frozen=True, eq=False)
class TrueImage:
    """depth: float32 H×W z in metres. normal: float32 H×W×3, camera frame. NaN where none."""

    depth: np.ndarray
    normal: np.ndarray


@dataclass(frozen=True, eq=False)
class Truth:
    """What is true of a sequence. Poses are kept once they were read; depth is not, of which there may be much.

    source: the sequence, for messages and reports. camera: of the depth. frames: all of the sequence, in its order.
    read_trajectory: gives the true poses over time, None where there are none. normal_source: what normals are from.
    """

    source: str
    camera: PinholeCamera
    frames: tuple[TrueFrame, ...]
    read_trajectory: Callable[[], Trajectory | None] = field(repr=False)
    normal_source: str = _FROM_DEPTH

    @cached_property
    def trajectory(self) -> Trajectory | None:
        """The true poses over time; None where there are none."""
        return self.read_trajectory()

    @cached_property
    def poses(self) -> dict[int, np.ndarray]:
        """T_world_camera, float64 4×4, by index of the frames that have a true pose at their time."""
        return poses_at(self.trajectory, {frame.index: frame.timestamp for frame in self.frames})

    @cached_property
    def by_index(self) -> dict[int, TrueFrame]:
        """The frames by their index."""
        return {frame.index: frame for frame in self.frames}

    def depth(self, index: int) -> np.ndarray | None:
        """True depth of the frame of this index, float32 H×W metres; None where it has none.

        Raises InputError where there is no such frame, or its file is malformed.
        """
        read = self._frame(index).depth
        return None if read is None else read()

    def image(self, index: int) -> TrueImage | None:
        """Depth and normals of the frame of this index; None where it has no depth. Raises InputError as `depth`."""
        depth = self.depth(index)
        if depth is None:
            return None
        read = self._frame(index).normal
        return TrueImage(depth, normals_from_depth(depth, self.camera) if read is None else read())

    def _frame(self, index: int) -> TrueFrame:
        if index not in self.by_index:
            raise InputError(f"{self.source}: no frame has the index {index}")
        return self.by_index[index]


def truth_of(sequence: Sequence, trajectory: Trajectory | None = None) -> Truth:
    """The truth in a sequence's folder: depth/NAME.png, normal/NAME.png and groundtruth.txt, none of them read yet.

    trajectory: the true poses where they are not the sequence's own.
    """
    camera, normals = sequence.camera_file.camera, sequence.path / "normal"
    read_normal = partial(read_normal_png, size=(camera.width, camera.height))

    def frame(index: int, timestamp: float, name: str) -> TrueFrame:
        depth, normal = sequence.path / "depth" / f"{name}.png", normals / f"{name}.png"
        return TrueFrame(
            index,
            timestamp,
            partial(sequence.truth_depth, index) if depth.exists() else None,
            partial(read_normal, normal) if normal.exists() else None,
        )

    return Truth(
        source=str(sequence.path),
        camera=camera,
        frames=tuple(frame(files.index, files.timestamp, files.name) for files in sequence.files),
        read_trajectory=sequence.truth_trajectory if trajectory is None else lambda: trajectory,
        normal_source="normal/NAME.png" if normals.is_dir() else _FROM_DEPTH,
    )
