"""Recordings of the built-in scenes, each seen along a path of its own."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.synth.recording import require_empty, write_sequence
from polarmap.synth.rendering import DEFAULT_CAMERA, render_sequence
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.scenes.built_in import PathKind
from polarmap.synth.sensor import Sensor

LARGEST_SIDE = 8192  # pixels, of the image after the split

_DEPTH_SCALES = (5000.0, 1000.0, 200.0)


def record_scene(
    folder: Path,
    name: str,
    frames: int,
    camera: PinholeCamera = DEFAULT_CAMERA,
    sensor: Sensor | None = None,
    step: float | None = None,
    frame_rate: float = 30.0,
    path_seed: int = 0,
    supersample: int = 2,
    force: bool = False,
    on_frame: Callable[[], None] | None = None,
    path: PathKind = "hand-held",
) -> None:
    """Write `frames` frames of the built-in scene `name` and their truth to a folder.

    step: metres a frame; the scene's own where None. path_seed: of the path; the sensor has its own.
    supersample: see `render_sequence`. on_frame: called after each. path: which of the scene's paths.
    Raises InputError where there is no such scene or path, a value is out of range, or the folder is not empty; with
    `force` it may hold a sequence that was made before (see `require_empty`).
    """
    built_in = built_in_scene(name)
    sensor = sensor or Sensor()
    step = built_in.step_of(path) if step is None else step
    timestamps, poses = built_in.path(frames, step, frame_rate, path_seed, path)
    require_empty(folder, force)
    rendered = render_sequence(built_in.scene, camera, timestamps, poses, sensor, supersample)
    parameters = {
        "scene": name,
        "frames": frames,
        "step": float(step),
        "frame_rate": float(frame_rate),
        "path": path,
        "path_seed": path_seed,
        "supersample": supersample,
    }
    write_sequence(folder, rendered, camera, sensor, parameters, built_in.depth_scale, on_frame)


def pinhole(width: int, height: int, fov: float) -> PinholeCamera:
    """A camera with square pixels and the principal point in the middle; fov: horizontal field of view, degrees.

    Raises InputError where a side is not 1 to 8192 pixels or fov not between 1 and 170.
    """
    if not (1 <= width <= LARGEST_SIDE and 1 <= height <= LARGEST_SIDE):
        raise InputError(f"image size {width}x{height}: both sides must be 1 to {LARGEST_SIDE} pixels")
    if not 1.0 <= fov <= 170.0:
        raise InputError(f"field of view of {fov} degrees: it must be between 1 and 170")
    focal = 0.5 * width / math.tan(math.radians(fov) / 2)
    return PinholeCamera(width, height, focal, focal, (width - 1) / 2, (height - 1) / 2)


def depth_scale_of(depth: np.ndarray) -> float:
    """Pixel values per metre for depth files of a scene like this view: 5000 if 16 bits hold twice its depth, or less.

    depth: metres, NaN for none.
    """
    farthest = 2.0 * float(np.nanmax(depth, initial=0.0))
    return next((scale for scale in _DEPTH_SCALES if farthest * scale <= 65535), _DEPTH_SCALES[-1])
