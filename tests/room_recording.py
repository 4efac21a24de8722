"""A short recording of the built-in room in memory, raw and as polarization images."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from polarmap.data.frame import Frame
from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth import Sensor, SynthFrame, built_in_scene, render_sequence
from polarmap.synth.recording import camera_file

CAMERA = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
SENSOR = Sensor(bit_depth=12, seed=1)
FILE = camera_file(CAMERA, SENSOR)


@dataclass(frozen=True)
class Recording:
    """A few frames of the room, raw and as polarization images."""

    frames: list[SynthFrame]
    images: list[PolarizationImage]

    @property
    def poses(self) -> dict[float, np.ndarray]:
        return {frame.timestamp: frame.T_world_camera for frame in self.frames}


def raw(frame: SynthFrame) -> Frame:
    return Frame(frame.index, frame.timestamp, f"{frame.index:06d}", Path(f"raw/{frame.index:06d}.png"), frame.mosaic)


def recorded_room(frames: int = 11) -> Recording:
    room = built_in_scene("room")
    rendered = list(render_sequence(room.scene, CAMERA, *room.path(frames=frames, step=0.06), SENSOR))
    front_end = FrontEnd(FILE)
    return Recording(rendered, [front_end.polarization(raw(frame)) for frame in rendered])
