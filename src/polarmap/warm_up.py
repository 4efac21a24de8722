"""Compiles, or loads, all that a run will need, so that a camera does not wait for it."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

from polarmap.data.frame import Frame
from polarmap.data.polarizers import PolarizerCalibration
from polarmap.data.trajectory import Trajectory
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.found import odometry_poses
from polarmap.pipeline.workers import Workers
from polarmap.prior.names import DEFAULT_PRIOR
from polarmap.prior.priors import make_prior
from polarmap.report.preview import render_map
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth.recording import camera_file
from polarmap.synth.rendering import render_sequence
from polarmap.synth.scene_recording import pinhole
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.sensor import Sensor

_SCENE = "room"
_FRAMES = 14
_STEP = 0.03  # metres; several keyframes come of it
_SIZE = 240, 180  # pixels; code does not depend on it
_FIELD_OF_VIEW = 65.0  # degrees


def warm_up(config: Config | None = None) -> tuple[int, int]:
    """Map a few small rendered frames; how many keyframes came of it with given poses, and with odometry.

    Takes seconds where the kernels were compiled before, and some minutes where they were not.
    """
    config = config or Config()
    sensor, built_in = Sensor(), built_in_scene(_SCENE)
    camera = pinhole(*_SIZE, _FIELD_OF_VIEW)
    recorded = camera_file(camera, sensor)
    timestamps, poses = built_in.path(_FRAMES, _STEP)
    rendered = render_sequence(built_in.scene, camera, timestamps, poses, sensor, supersample=1)
    frames = [Frame(f.index, f.timestamp, str(f.index), Path(str(f.index)), mosaic=f.mosaic) for f in rendered]
    keyframes = []
    for source in (Trajectory(timestamps, poses), odometry_poses(recorded, config)):
        mapper = Mapper(recorded, source, make_prior(DEFAULT_PRIOR, config.prior), config)
        for frame in frames:
            mapper.process(frame)
        result = mapper.finish()
        keyframes.append(result.keyframes)
        if result.mesh is not None:
            render_map(result.mesh, poses)
    calibrated = replace(recorded, polarizers=PolarizerCalibration((0.0, 45.0, 90.0, 135.0)))
    FrontEnd(calibrated).polarization(frames[0])
    with Workers():
        pass
    given, found = keyframes
    return given, found
