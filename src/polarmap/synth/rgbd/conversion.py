"""RGB-D recordings as polarization sequences: frame by frame, in memory and as files."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.io.recording.rgbd.recording import RgbdFrame, RgbdSequence
from polarmap.synth.recording import DEPTH_SCALE, require_empty, write_sequence
from polarmap.synth.rendering import SynthFrame
from polarmap.synth.rgbd.blur import blurred
from polarmap.synth.rgbd.models import Model
from polarmap.synth.rgbd.shading import Shader
from polarmap.synth.sensor import Sensor
from polarmap.synth.shading import Rendering
from polarmap.synth.shutter import shutter_poses

_METERED = 8  # frames that exposure and distance are taken from
_BRIGHT = 97.0  # percentile of the brightest channel that
_BRIGHT_LEVEL = 0.9  # shall be at this share of full scale
_VIEWS = 8  # of a blurred frame
_SAME_SURFACE = 0.03  # relative difference of depth within a block of pixels


def record_rgbd(
    source: RgbdSequence,
    folder: Path,
    model: Model,
    sensor: Sensor | None = None,
    force: bool = False,
    on_frame: Callable[[], None] | None = None,
) -> None:
    """Write the polarization sequence of an RGB-D recording, with its truth, to a folder (see `write_sequence`).

    synth.yaml there states all parameters. on_frame: called after each frame.
    Raises InputError as `render_rgbd`, and where the folder is not empty; with `force` it may hold a sequence that was
    made before (see `require_empty`).
    """
    require_empty(folder, force)
    sensor = sensor or Sensor()
    camera = sequence_camera(source, sensor)
    shader = metered(source, model)
    parameters = {**_source_parameters(source), "model": model.parameters(), **_shader_parameters(shader)}
    depth_scale = min(source.depth_scale, DEPTH_SCALE)
    write_sequence(folder, _frames(source, shader, sensor), camera, sensor, parameters, depth_scale, on_frame)


def render_rgbd(source: RgbdSequence, model: Model, sensor: Sensor | None = None) -> Iterator[SynthFrame]:
    """Polarization frames of an RGB-D recording, one at a time, as `sensor` (`Sensor()` where None) sees them.

    Brightness is the same for all frames: the 97th percentile of the brightest channel, over eight frames spread
    over the recording, is at 0.9 of full scale times the sensor's exposure. Each pixel of the recording makes a 2×2
    block of the mosaic; with `sub_pixel` it is one pixel of the mosaic, so that channels and truth have half its size.
    Raises InputError where a file is bad, there is no depth at all, or `sub_pixel` meets an odd width or height.
    """
    sensor = sensor or Sensor()
    sequence_camera(source, sensor)
    return _frames(source, metered(source, model), sensor)


def sequence_camera(source: RgbdSequence, sensor: Sensor) -> PinholeCamera:
    """The camera of one polarization channel: the recording's, or with `sub_pixel` that of its 2×2 blocks."""
    camera = source.camera
    if not sensor.sub_pixel:
        return camera
    if camera.width % 2 or camera.height % 2:
        raise InputError(f"{source.path}: {camera.width}x{camera.height} pixels do not divide into 2x2 blocks")
    return camera.scaled(0.5)


def metered(source: RgbdSequence, model: Model) -> Shader:
    """The shader for a recording: typical distance and gain from eight frames spread over it."""
    if not len(source):
        raise InputError(f"{source.path}: no frames; --frames leaves none")
    step = 1.0 / source.depth_scale
    shader = Shader(source.camera, model, depth_step=step)
    frames = [source[i] for i in np.unique(np.linspace(0, len(source) - 1, _METERED).round().astype(int))]
    lights = [_light(source, model, frame) for frame in frames]
    distances = [
        shader.light_distance(f.depth, light) for f, light in zip(frames, lights, strict=True) if _has_depth(f)
    ]
    if not distances:
        raise InputError(f"{source.path}: no depth in any of {len(frames)} frames; is depth_scale right?")
    shader = replace(shader, typical_distance=max(float(np.median(distances)), 1e-6))
    brightest = [_brightest(shader.render(f.picture, f.depth, light)) for f, light in zip(frames, lights, strict=True)]
    bright = float(np.percentile(np.stack(brightest), _BRIGHT))
    if not bright > 0:
        raise InputError(f"{source.path}: the pictures are black")
    return replace(shader, gain=_BRIGHT_LEVEL / bright)


def _frames(source: RgbdSequence, shader: Shader, sensor: Sensor) -> Iterator[SynthFrame]:
    return (_frame(source, shader, sensor, index, frame) for index, frame in enumerate(source))


def _frame(source: RgbdSequence, shader: Shader, sensor: Sensor, index: int, frame: RgbdFrame) -> SynthFrame:
    truth = shader.render(frame.picture, frame.depth, _light(source, shader.model, frame))
    stokes = truth.stokes
    if sensor.shutter > 0:
        poses = shutter_poses(source.poses, index, sensor.shutter, _VIEWS)
        stokes = blurred(stokes, frame.depth, source.camera, frame.T_world_camera, poses)
    mosaic = sensor.capture(stokes, index)
    truth = blocks(truth) if sensor.sub_pixel else truth
    return SynthFrame(index, frame.timestamp, frame.T_world_camera, mosaic, truth)


def _light(source: RgbdSequence, model: Model, frame: RgbdFrame) -> np.ndarray:
    """The light, which stands still in the first frame's camera frame, in that of a frame."""
    T_frame_first = inverse(frame.T_world_camera) @ source.files[0].T_world_camera
    return T_frame_first[:3, :3] @ model.light + T_frame_first[:3, 3]


def _has_depth(frame: RgbdFrame) -> bool:
    return bool(np.isfinite(frame.depth).any())


def _brightest(rendering: Rendering) -> np.ndarray:
    """What the brightest polarizer could pass, a share of full scale, every second pixel."""
    s0, s1, s2 = rendering.stokes[:, ::2, ::2]
    return 0.5 * (s0 + np.hypot(s1, s2))


def blocks(rendering: Rendering) -> Rendering:
    """The rendering of 2×2 blocks of pixels: the nearest surface in each, averaged over its pixels in the block.

    Inverse depth is averaged, which is exact on planes.
    """
    depth = _by_block(rendering.depth)
    nearest = np.nanmin(np.where(np.isfinite(depth), depth, np.inf), axis=0)
    share = (depth <= nearest * (1.0 + _SAME_SURFACE)).astype(np.float32)
    share /= np.maximum(share.sum(axis=0), 1.0)
    inverse_depth = np.where(share > 0, share / depth, 0.0).sum(axis=0)
    normal = np.stack([_by_block(rendering.normal[..., k]) for k in range(3)], axis=-1)
    known = (share > 0)[..., None] & np.isfinite(normal)
    mean = np.where(known, normal, 0.0).sum(axis=0)
    length = np.linalg.norm(mean, axis=-1, keepdims=True)
    with np.errstate(divide="ignore", invalid="ignore"):
        return Rendering(
            stokes=np.stack([_by_block(s).mean(axis=0) for s in rendering.stokes]),
            depth=np.where(inverse_depth > 0, 1.0 / inverse_depth, np.nan).astype(np.float32),
            normal=np.where(length > 0, mean / length, np.nan).astype(np.float32),
            material=_by_block(rendering.material).max(axis=0),
            reflection=_by_block(rendering.reflection)[0],
        )


def _by_block(image: np.ndarray) -> np.ndarray:
    """The four pixels of each 2×2 block, 4×H/2×W/2."""
    return np.stack([image[j::2, i::2] for j in (0, 1) for i in (0, 1)])


def _source_parameters(source: RgbdSequence) -> dict[str, Any]:
    first, last = source.files[0], source.files[-1]
    camera = source.camera
    return {
        "source": source.path.resolve().name,
        "format": source.format,
        "frames": len(source),
        "first_picture": first.picture.name,
        "last_picture": last.picture.name,
        "source_camera": {key: float(getattr(camera, key)) for key in ("fx", "fy", "cx", "cy")},
        "source_depth_scale": float(source.depth_scale),
    }


def _shader_parameters(shader: Shader) -> dict[str, float]:
    return {"gain": float(shader.gain), "typical_distance": float(shader.typical_distance)}
