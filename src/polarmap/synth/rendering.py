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
from polarmap.synth.shutter import shutter_poses

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
    exposures: int = 8,
) -> Iterator[SynthFrame]:
    """Frames of a scene seen by `camera` (of the image after the 2×2 split) from each pose, one at a time.

    timestamps: seconds, N. poses: T_world_camera, N×4×4. sensor: `Sensor()` where None.
    supersample: rays along either side of a pixel (of a mosaic's pixel where the sensor is `sub_pixel`).
    exposures: moments over which the open shutter is averaged, where the sensor has motion blur.
    The truth, its Stokes vectors too, is that of the frame's own time and without blur.
    Raises InputError where timestamps and poses differ in number.
    """
    if len(timestamps) != len(poses):
        raise InputError(f"synthetic sequence: {len(timestamps)} timestamps for {len(poses)} poses")
    sensor = sensor or Sensor()
    return (
        _render_frame(scene, camera, index, timestamps, poses, sensor, supersample, exposures)
        for index in range(len(poses))
    )


def _render_frame(scene, camera, index, timestamps, poses, sensor, supersample, exposures) -> SynthFrame:
    truth = render(scene, camera, poses[index], supersample)
    stokes = truth.stokes
    if sensor.sub_pixel or sensor.shutter > 0.0:
        seen_by = camera.scaled(2.0) if sensor.sub_pixel else camera
        moments = shutter_poses(poses, index, sensor.shutter, exposures if sensor.shutter > 0.0 else 1)
        stokes = np.mean([render(scene, seen_by, pose, supersample).stokes for pose in moments], axis=0)
    return SynthFrame(index, float(timestamps[index]), poses[index], sensor.capture(stokes, index), truth)
