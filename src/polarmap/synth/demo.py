"""The demo's recording: the built-in room, seen along a hand-held path."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

from polarmap.synth.recording import require_empty, write_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor
from polarmap.synth.sequence import DEFAULT_CAMERA, SynthFrame, render_sequence


def record_room(folder: Path, frames: int, force: bool = False, on_frame: Callable[[], None] | None = None) -> None:
    """Write `frames` frames of the room, 640×480 with sensor noise, and their truth to a folder.

    on_frame: called after each. Raises InputError where the folder is not empty, unless `force`.
    """
    require_empty(folder, force)
    scene = built_in_scene("room")
    sensor = Sensor()
    timestamps, poses = scene.path(frames)
    rendered = render_sequence(scene.scene, DEFAULT_CAMERA, timestamps, poses, sensor)
    write_sequence(folder, _reported(rendered, on_frame), DEFAULT_CAMERA, sensor)


def _reported(frames: Iterator[SynthFrame], on_frame: Callable[[], None] | None) -> Iterator[SynthFrame]:
    for frame in frames:
        yield frame
        if on_frame:
            on_frame()
