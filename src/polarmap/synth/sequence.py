"""Synthetic sequences in memory: what the sensor records of each frame, with the truth beside it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.synth.scene import Scene
from polarmap.synth.sensor import Sensor
from polarmap.synth.shading import Rendering, render

DEFAULT_CAMERA = PinholeCamera(width=640, height=480, fx=480.0, fy=480.0, cx=319.5, cy=239.5)


@dataclass(frozen=True)
class SynthFrame:
    """One frame of a synthetic sequence.

    mosaic: what the sensor gives, uint8 or uint16 2H×2W.
    timestamp: seconds.
    T_world_camera: float64 4×4.
    truth: geometry, materials and noise-free Stokes vectors, H×W (see `Rendering`).
    """

    index: int
    timestamp: float
    T_world_camera: np.ndarray
    mosaic: np.ndarray
    truth: Rendering


def render_sequence(
    scene: Scene,
    camera: PinholeCamera,
    timestamps: np.ndarray,
    poses: np.ndarray,
    sensor: Sensor | None = None,
    supersample: int = 2,
) -> Iterator[SynthFrame]:
    """Frames of a scene seen by `camera` (of the image after the 2×2 split) from each pose, one at a time.

    timestamps: seconds, N. poses: T_world_camera, N×4×4. sensor: `Sensor()` where None.
    supersample: rays along either side of a pixel (of a mosaic's pixel where the sensor is `sub_pixel`).
    Raises InputError where timestamps and poses differ in number.
    """
    if len(timestamps) != len(poses):
        raise InputError(f"synthetic sequence: {len(timestamps)} timestamps for {len(poses)} poses")
    sensor = sensor or Sensor()
    return (
        _render_frame(scene, camera, index, float(timestamp), pose, sensor, supersample)
        for index, (timestamp, pose) in enumerate(zip(timestamps, poses, strict=True))
    )


def _render_frame(scene, camera, index, timestamp, T_world_camera, sensor, supersample) -> SynthFrame:
    truth = render(scene, camera, T_world_camera, supersample)
    stokes = truth.stokes
    if sensor.sub_pixel:
        stokes = render(scene, camera.scaled(2.0), T_world_camera, supersample).stokes
    mosaic = sensor.capture(stokes, index)
    return SynthFrame(index, timestamp, T_world_camera, mosaic, truth)
