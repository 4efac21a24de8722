"""Where stereo searches for a keyframe's depth: what is known beforehand, and what is noticed after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from fake_odometry import FakeOdometry
from room_recording import CAMERA as ROOM_CAMERA
from room_recording import FILE, Recording, raw, recorded_room
from scenes import TEXTURED, moved, stereo_views

from polarmap.data.depth_search import DepthSearch
from polarmap.data.keyframe import Keyframe
from polarmap.data.trajectory import Trajectory
from polarmap.data.view import View
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.sim3 import Sim3
from polarmap.io.run_folder.folder import read_results
from polarmap.io.run_folder.results import RunResults
from polarmap.pipeline.config import Config
from polarmap.pipeline.keyframe_depth import DepthJob, DepthSteps, KeyframeDepth
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.methods import make_densifier, make_stereo
from polarmap.pipeline.poses.found import OdometryPoses
from polarmap.prior.priors import make_prior
from polarmap.report.run_writer import RunWriter
from polarmap.run import run_sequence
from polarmap.stereo.depth_range import PILED_UP
from polarmap.synth import scenes

CAMERA = PinholeCamera(width=160, height=120, fx=150.0, fy=150.0, cx=79.5, cy=59.5)
APART = 0.8  # metres between views of a wall two metres away: a disparity of 60 pixels, more than usual ranges hold


def depth_of(job: DepthJob, **options: float) -> KeyframeDepth:
    config = Config().with_settings([f"stereo.{key}={value}" for key, value in options.items()])
    prior = make_prior("sparse", config.prior)
    return DepthSteps(make_stereo(config), prior, make_densifier(config), config.stereo)(job)


@pytest.fixture(scope="module")
def wall() -> tuple[np.ndarray, DepthJob]:
    """True depth, and the job of the middle one of three cameras before a wall."""
    poses = [moved(0.0), moved(-APART), moved(APART)]
    truth, views = stereo_views(scenes.plane(TEXTURED, tilt=0.1), CAMERA, poses)
    return truth.depth, DepthJob(CAMERA, views[0], tuple(views[1:]))


def share_right(found: KeyframeDepth, truth: np.ndarray) -> float:
    return float(np.mean(np.abs(found.inliers / truth - 1) < 0.01))


def test_what_is_nearer_than_the_range_is_searched_again(wall):
    truth, job = wall
    found = depth_of(job)
    assert found.search.near < truth.min() and found.search.at_near < PILED_UP
    assert share_right(found, truth) > 0.15


def test_a_near_end_that_is_given_stays_and_is_told(wall):
    truth, job = wall
    found = depth_of(job, depth_min=2.4)
    assert found.search.near == 2.4 and found.search.at_near > PILED_UP
    assert share_right(found, truth) < 0.01


def test_a_mapped_neighbour_tells_where_to_search(wall):
    """So the range need not be searched twice."""
    truth, job = wall
    near = depth_of(replace(job, neighbours=tuple(replace(v, stereo=truth) for v in job.neighbours))).search.near
    assert truth.min() / 2 < near < truth.min()


def test_points_that_the_pose_is_from_tell_where_to_search(wall):
    truth, job = wall
    view = replace(job.view, known=truth[::9, ::9].ravel())
    assert truth.min() / 2 < depth_of(replace(job, view=view)).search.near < truth.min()


def test_known_depths_grow_with_the_world():
    view = View(None, np.eye(4), known=np.float32([1.0, 2.0]))
    np.testing.assert_array_equal(view.moved(Sim3(1.5, np.eye(3), np.zeros(3))).known, np.float32([1.5, 3.0]))
    assert replace(view, known=None).moved(Sim3(1.5, np.eye(3), np.zeros(3))).known is None


def test_where_no_view_has_moved_nothing_is_searched(wall):
    _, job = wall
    assert depth_of(replace(job, neighbours=(job.view,))).search is None


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded_room()


def searches(recording: Recording, poses: OdometryPoses) -> list[DepthSearch]:
    """Of all keyframes of the room."""
    keyframes: list[Keyframe] = []
    mapper = Mapper(ROOM_CAMERA, poses, make_prior("sparse", Config().prior), None, keyframes.append)
    for frame, image in zip(recording.frames, recording.images, strict=True):
        mapper.process_image(image, None, frame.timestamp, frame.index)
    mapper.finish()
    assert len(keyframes) > 2
    return [keyframe.search for keyframe in keyframes]


def test_points_of_odometry_reach_stereo(recording):
    poses = [frame.T_world_camera for frame in recording.frames]
    known = np.linspace(0.2, 0.3, 100, dtype=np.float32)
    usual, told = (searches(recording, OdometryPoses(FakeOdometry(poses, known=k))) for k in (None, known))
    assert len(usual) == len(told)
    assert all(s.near > 0.3 for s in usual)
    assert all(s.near == pytest.approx(0.2 / 1.5, rel=0.1) for s in told)


class Camera:
    """The room as frames that come in."""

    camera_file = FILE

    def __init__(self, recording: Recording) -> None:
        self._frames = [raw(frame) for frame in recording.frames]

    def __iter__(self):
        return iter(self._frames)


def results_of(recording: Recording, out, **options: float) -> RunResults:
    """Of a run over the room with its true poses."""
    config = Config().with_settings([f"stereo.{key}={value}" for key, value in options.items()])
    poses = Trajectory(np.array(list(recording.poses)), np.array(list(recording.poses.values())))
    with RunWriter(out, config, ROOM_CAMERA) as writer:
        run_sequence(Camera(recording), poses, writer, make_prior("sparse", config.prior), config)
    results = read_results(out)
    assert len(results.keyframes) > 2
    return results


def warning_of(results: RunResults, end: str) -> bool:
    return any(f"at the {end} end of the range" in line.text for line in results.summary if line.level == "warning")


@pytest.mark.parametrize("end", ["near", "far", None])
def test_a_run_tells_that_its_range_leaves_the_room_out(recording, tmp_path, end):
    depths = np.concatenate([frame.truth.depth.ravel() for frame in recording.frames])
    nearest, farthest = np.nanpercentile(depths, (1, 99))
    options = {"near": {"depth_min": 2 * nearest}, "far": {"depth_max": 0.7 * farthest}, None: {}}[end]
    results = results_of(recording, tmp_path / "out", **options)
    for other in ("near", "far"):
        shares = [getattr(keyframe.search, f"at_{other}") for keyframe in results.keyframes]
        assert all(share > PILED_UP if other == end else share < 0.2 * PILED_UP for share in shares)
        assert warning_of(results, other) == (other == end)
