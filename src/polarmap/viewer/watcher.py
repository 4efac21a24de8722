"""What a run tells of itself while it goes on."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

import numpy as np

from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map
from polarmap.geometry.sim3 import Sim3


@dataclass(frozen=True, eq=False)
class Tracking:
    """A frame that was followed.

    T_world_camera: float64 4×4, None where its pose is not known. segment: which world and scale it is in.
    keyframes: how many were mapped until now. late: milliseconds from its exposure to its pose, None where frames do
    not come at their times; waiting: keyframes that wait to be mapped; skipped, missed: keyframes that were not mapped
    and frames that were not taken, until now.
    """

    T_world_camera: np.ndarray | None
    segment: int
    keyframes: int
    late: float | None = None
    waiting: int = 0
    skipped: int = 0
    missed: int = 0


class Watcher(Protocol):
    """Is told what happens, on the thread that frames are followed on: it must return at once."""

    def frame(self, tracking: Tracking) -> None:
        """A frame was followed."""

    def keyframe(self, keyframe: Keyframe) -> None:
        """A keyframe was mapped; its arrays do not change any more."""

    def pose(self, index: int, pose: Sim3) -> None:
        """A keyframe's final pose; its depth has grown by the pose's scale."""

    def map(self, result: Map) -> None:
        """The map is done."""
