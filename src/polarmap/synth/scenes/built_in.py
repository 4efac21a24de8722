"""A scene together with the paths on which it is looked at."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.synth.path import Loop, handheld_path
from polarmap.synth.scene import Scene
from polarmap.synth.scenes.placement import Point


@dataclass(frozen=True, eq=False)
class BuiltInScene:
    """A scene and from where to look at it.

    up: upward in the image. loop: where the path leads from `eye`. step: metres a frame, where a path names none.
    depth_scale: pixel values per metre of depth files, so that the farthest surface fits into 16 bits.
    """

    scene: Scene
    eye: Point
    target: Point
    up: Point = (0.0, 0.0, 1.0)
    loop: Loop = Loop()  # noqa: RUF009
    step: float = 0.025
    depth_scale: float = 5000.0

    def path(
        self, frames: int = 24, step: float | None = None, frame_rate: float = 30.0, seed: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Timestamps and T_world_camera of a `handheld_path` through the scene."""
        step = self.step if step is None else step
        return handheld_path(self.eye, self.target, self.up, frames, step, frame_rate, seed, self.loop)
