"""A scene together with the paths on which it is looked at."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from polarmap.errors import InputError
from polarmap.synth.path import Arc, Loop, arc_path, handheld_path
from polarmap.synth.scene import Scene
from polarmap.synth.scenes.placement import Point

PathKind = Literal["hand-held", "arc"]
"""Ways to look at a scene; few scenes have an arc."""

_FOV = float(np.degrees(2.0 * np.arctan(2.0 / 3.0)))  # a focal length of 480 at 640 pixels


@dataclass(frozen=True, eq=False)
class BuiltInScene:
    """A scene and from where to look at it.

    up: upward in the image. loop: where the hand-held path leads from `eye`. step: metres a frame on it, where none is
    named. arc: about what stands in the scene, None where there is no room for one.
    depth_scale: pixel values per metre of depth files, so that the farthest surface fits into 16 bits.
    """

    scene: Scene
    eye: Point
    target: Point
    up: Point = (0.0, 0.0, 1.0)
    loop: Loop = Loop()  # noqa: RUF009
    step: float = 0.025
    arc: Arc | None = None
    depth_scale: float = 5000.0

    def path(
        self,
        frames: int = 24,
        step: float | None = None,
        frame_rate: float = 30.0,
        seed: int = 0,
        kind: PathKind = "hand-held",
    ) -> tuple[np.ndarray, np.ndarray]:
        """Timestamps and T_world_camera of a path through the scene, see `handheld_path` and `arc_path`.

        Raises InputError where the scene has no arc and one is asked for.
        """
        step = self.step_of(kind) if step is None else step
        if kind == "arc":
            return arc_path(self._arc(), self.up, frames, step, frame_rate, seed)
        return handheld_path(self.eye, self.target, self.up, frames, step, frame_rate, seed, self.loop)

    def step_of(self, kind: PathKind) -> float:
        """Metres a frame of the scene's own on such a path; InputError where it has none."""
        return self._arc().step if kind == "arc" else self.step

    def fov_of(self, kind: PathKind) -> float:
        """Horizontal field of view, degrees, that suits such a path; InputError where the scene has none."""
        return self._arc().fov if kind == "arc" else _FOV

    def _arc(self) -> Arc:
        if self.arc is None:
            raise InputError("synthetic scene: no arc leads about this one; take the hand-held path")
        return self.arc
