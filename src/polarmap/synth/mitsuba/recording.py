"""Recordings of Mitsuba scenes along a trajectory or a hand-held path."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.synth.mitsuba.view import MitsubaScene, centre_distance, geometry, render_stokes, rendering
from polarmap.synth.path import Loop, handheld_path
from polarmap.synth.rendering import SynthFrame
from polarmap.synth.sensor import Sensor
from polarmap.synth.shutter import shutter_poses

_BRIGHTNESS = 0.7  # median S0 that an exposure not given aims at; 2 fills the scale
_BLUR_MOMENTS = 8
_SEEDS_PER_FRAME = 100_000


def path_around(
    loaded: MitsubaScene, frames: int, step: float | None, frame_rate: float, seed: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """Timestamps and T_world_camera of a hand-held path about the scene's own sensor.

    The loop, and the step where None, are in proportion to the distance of what the sensor looks at, 2 m if nothing.
    Nothing is known of the free space there: look at the result.
    """
    distance = centre_distance(loaded) or 2.0
    T = loaded.T_world_camera
    loop = Loop(sideways=0.2 * distance, forward=0.08 * distance, sway=0.006 * distance, gaze_drift=0.03)
    step = 0.01 * distance if step is None else step
    return handheld_path(T[:3, 3], T[:3, 3] + distance * T[:3, 2], -T[:3, 1], frames, step, frame_rate, seed, loop)


def render_frames(
    loaded: MitsubaScene,
    camera: PinholeCamera,
    timestamps: np.ndarray,
    poses: np.ndarray,
    sensor: Sensor,
    spp: int = 256,
    max_depth: int = 8,
) -> Iterator[SynthFrame]:
    """Frames of a scene from each pose, one at a time; arguments as in `polarmap.synth.render_sequence`.

    spp: paths a pixel (of the mosaic where the sensor is `sub_pixel`), shared out over the open shutter if there is
    motion blur. max_depth: of a path, in segments. The same arguments give the same frames.
    """
    for index, pose in enumerate(poses):
        depth, normal = geometry(loaded, camera, pose)
        seed = (sensor.seed * 1009 + index) * _SEEDS_PER_FRAME % 2**31
        own = render_stokes(loaded, camera, pose, spp, max_depth, seed)
        seen = own
        if sensor.sub_pixel or sensor.shutter > 0.0:
            seen = _through_shutter(loaded, camera, poses, index, sensor, spp, max_depth, seed)
        mosaic = sensor.capture(seen, index)
        truth = rendering(own, depth, normal, camera)
        yield SynthFrame(index, float(timestamps[index]), np.asarray(pose), mosaic, truth)


def exposed(loaded: MitsubaScene, camera: PinholeCamera, pose: np.ndarray, sensor: Sensor) -> Sensor:
    """The sensor with the exposure at which the median of a coarse view from `pose` is 35 % of full scale.

    Raises InputError where the view is black.
    """
    coarse = camera.scaled(min(1.0, 96.0 / camera.width))
    median = float(np.median(render_stokes(loaded, coarse, pose, 32, 8, seed=0)[0]))
    if not median > 0.0:
        raise InputError("the scene is dark where the path begins; check its lights, or give --exposure")
    return replace(sensor, exposure=_BRIGHTNESS / median)


def _through_shutter(loaded, camera, poses, index, sensor, spp, max_depth, seed) -> np.ndarray:
    seen_by = camera.scaled(2.0) if sensor.sub_pixel else camera
    moments = shutter_poses(poses, index, sensor.shutter, _BLUR_MOMENTS if sensor.shutter > 0.0 else 1)
    share = max(1, spp // len(moments))
    views = [
        render_stokes(loaded, seen_by, pose, share, max_depth, (seed + (i + 1) * 9973) % 2**31)
        for i, pose in enumerate(moments)
    ]
    return np.mean(views, axis=0)
