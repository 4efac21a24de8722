"""Glossy, curved things, mapped from views on a wide arc: what stereo searches, the map, and what polarization adds."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

import numpy as np
import pytest

from polarmap.data.frame import Frame
from polarmap.data.keyframe import Keyframe
from polarmap.data.plane_field import PlaneField
from polarmap.data.trajectory import Trajectory
from polarmap.evaluation.regions import region_metrics
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.methods import make_stereo
from polarmap.prior.priors import make_prior
from polarmap.stereo.depth_range import LARGEST_DISPARITY, search_range
from polarmap.stereo.method import StereoMethod
from polarmap.stereo.options import StereoOptions
from polarmap.synth import Rendering, Sensor, SynthFrame, built_in_scene, render, render_sequence
from polarmap.synth.recording import camera_file
from polarmap.synth.scene_recording import pinhole

SCENE = built_in_scene("things")
CAMERA = pinhole(320, 240, SCENE.arc.fov)
SENSOR = Sensor(bit_depth=12, seed=1)
SURROUNDINGS = ("wall", "floor", "print", "table cloth", "newspaper")
THINGS = [i for i, material in enumerate(SCENE.scene.materials) if material.name not in SURROUNDINGS]
APART = 0.24  # metres a frame, 14 degrees of the arc
VIEWS = 7  # from one end of it to the other
WITHOUT = {"surfaces": {"polarization": 0.0}, "patchmatch": {"polarization": 0.0}}
_MOST_APART = 30.0  # degrees; of two views farther apart each sees other sides of the things


def depths_of_things(view: Rendering) -> np.ndarray:
    return view.depth[np.isin(view.material, THINGS)]


def nearest_side_by_side(motion: np.ndarray, camera: PinholeCamera) -> float:
    """Where a point leaves the other image by 0.3 of its width, were the cameras parallel."""
    return camera.fx * float(np.linalg.norm(motion[:3, 3])) / (LARGEST_DISPARITY * camera.width)


@pytest.mark.parametrize("step", [0.05, 0.08, 0.12, 0.16, 0.2, 0.24, 0.3])
@pytest.mark.parametrize("seed", [0, 1])
def test_two_views_that_converge_search_where_the_things_are(step, seed):
    camera, too_far = CAMERA.scaled(0.4), 0
    _, poses = SCENE.path(frames=int(1.65 / step) + 1, step=step, seed=seed, kind="arc")
    for pose in poses[:: max(1, int(0.2 / step))]:
        things = depths_of_things(render(SCENE.scene, camera, pose))
        for other in poses:
            motion = inverse(other) @ pose
            if 1.0 < np.degrees(np.arccos(np.clip(motion[2, 2], -1.0, 1.0))) < _MOST_APART:
                near, far = search_range([motion], camera, StereoOptions())
                assert near < things.min() and far > things.max()
                too_far += nearest_side_by_side(motion, camera) > things.min()
    assert too_far >= 8


@dataclass
class Watched:
    """Stereo that notes the ranges in which it was asked to search."""

    stereo: StereoMethod
    ranges: list[tuple[float, float]] = field(default_factory=list)

    def __call__(self, reference, others, camera, depth_range, start=None) -> PlaneField:
        self.ranges.append(depth_range)
        return self.stereo(reference, others, camera, depth_range, start)


def recorded(frames: int, step: float) -> list[SynthFrame]:
    path = SCENE.path(frames=frames, step=step, kind="arc")
    return list(render_sequence(SCENE.scene, CAMERA, *path, SENSOR))


def mapped(frames: list[SynthFrame], config: Config) -> tuple[list[Keyframe], list[tuple[float, float]]]:
    """The keyframes with the true poses, and where stereo searched for each."""
    keyframes: list[Keyframe] = []
    poses = Trajectory(np.array([f.timestamp for f in frames]), np.array([f.T_world_camera for f in frames]))
    prior, stereo = make_prior("sparse", config.prior), Watched(make_stereo(config))
    mapper = Mapper(camera_file(CAMERA, SENSOR), poses, prior, config, keyframes.append, stereo=stereo)
    for frame in frames:
        name = f"{frame.index:06d}"
        mapper.process(Frame(frame.index, frame.timestamp, name, Path(f"{name}.png"), frame.mosaic))
    mapper.finish()
    return keyframes, stereo.ranges


def test_things_are_mapped_from_views_far_apart():
    arc = recorded(VIEWS, APART)
    keyframes, ranges = mapped(arc, Config())
    assert [keyframe.index for keyframe in keyframes] == list(range(VIEWS))
    within, errors = [], []
    for keyframe, (near, far) in zip(keyframes, ranges, strict=True):
        truth = arc[keyframe.index].truth
        assert near < depths_of_things(truth).min() and far > depths_of_things(truth).max()
        error = np.abs(keyframe.depth / truth.depth - 1.0)[np.isin(truth.material, THINGS)]
        within.append(np.mean(error < 0.05))
        errors.append(np.median(error))
        assert np.isfinite(keyframe.stages.stereo).mean() > 0.35
    assert np.mean(within) > 0.88 and min(within) > 0.8
    assert np.mean(errors) < 0.02


@pytest.mark.slow
def test_polarization_turns_the_normals_of_curved_surfaces():
    arc = recorded(8, SCENE.arc.step)

    def normals(config: Config) -> float:
        """Median error on curved pixels, degrees, mean over keyframes."""
        truths = ((keyframe, arc[keyframe.index].truth) for keyframe in mapped(arc, config)[0])
        return np.mean([region_metrics(k.depth, k.normal, t.depth, t.normal).curved_normals for k, t in truths])

    with_polarization, without = normals(Config()), normals(Config.model_validate(WITHOUT))
    assert with_polarization < 0.92 * without
    assert with_polarization < 13.0
