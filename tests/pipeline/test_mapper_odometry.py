"""The mapper with poses that odometry finds: late, up to scale, adjusted afterwards, and lost at times."""

from __future__ import annotations

import logging
from dataclasses import dataclass

import numpy as np
import pytest
from fake_odometry import FakeOdometry
from room_recording import raw

from polarmap.data.codes import Status
from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map
from polarmap.data.odometry import OdometryUpdate
from polarmap.fusion.surface_map import SurfaceMap
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.geometry.sim3 import Sim3
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.found import OdometryPoses
from polarmap.sensing.front_end import FrontEnd, GivenImage
from polarmap.synth import Sensor, built_in_scene, render_sequence
from polarmap.synth.recording import camera_file
from polarmap.synth.rendering import SynthFrame

CAMERA = PinholeCamera(width=160, height=120, fx=120.0, fy=120.0, cx=79.5, cy=59.5)
SENSOR = Sensor(bit_depth=12, seed=1)
FRAMES = 20


@dataclass(frozen=True)
class Recording:
    frames: list[SynthFrame]
    images: list

    @property
    def poses(self) -> dict[int, np.ndarray]:
        return {frame.index: frame.T_world_camera for frame in self.frames}


@pytest.fixture(scope="module")
def recording() -> Recording:
    room = built_in_scene("room")
    frames = list(render_sequence(room.scene, CAMERA, *room.path(frames=FRAMES, step=0.06), SENSOR))
    front_end = FrontEnd(camera_file(CAMERA, SENSOR))
    return Recording(frames, [front_end.polarization(raw(frame)) for frame in frames])


@dataclass
class Run:
    """A mapper fed with a recording by odometry, and all that came out of it."""

    mapper: Mapper
    keyframes: list[Keyframe]
    final_poses: dict[int, Sim3]
    map: Map | None = None

    def final_pose(self, keyframe: Keyframe) -> np.ndarray:
        pose = self.final_poses.get(keyframe.index)
        return keyframe.T_world_camera if pose is None else pose.rigid


def start(odometry, config=None) -> Run:
    keyframes, final_poses = [], {}
    mapper = Mapper(CAMERA, OdometryPoses(odometry), None, config, keyframes.append, final_poses.__setitem__)
    return Run(mapper, keyframes, final_poses)


def feed(run: Run, recording: Recording, first=0, last=FRAMES) -> None:
    for frame, image in list(zip(recording.frames, recording.images, strict=True))[first:last]:
        run.mapper.process_image(image, None, frame.timestamp, frame.index)


def mapped(recording: Recording, odometry, config=None) -> Run:
    run = start(odometry, config)
    feed(run, recording)
    run.map = run.mapper.finish()
    return run


def error(run: Run, recording: Recording, scale: float) -> float:
    errors = [np.abs(scale * k.depth / recording.frames[k.index].truth.depth - 1) for k in run.keyframes]
    return float(np.mean([np.nanmean(e) for e in errors]))


def from_scratch(run: Run, segment: int, voxel_size: float) -> SurfaceMap:
    """A surface of a segment's keyframes, all at their final poses."""
    surface = SurfaceMap(Config().fusion.model_copy(update={"voxel_size": voxel_size}))
    for k in run.keyframes:
        if k.segment == segment:
            surface.integrate(k.depth, k.image.intensity, k.confidence, CAMERA, run.final_pose(k), k.index)
    return surface


def assert_same_mesh(a, b) -> None:
    np.testing.assert_array_equal(a.vertices, b.vertices)
    np.testing.assert_array_equal(a.faces, b.faces)


def test_the_room_is_mapped_without_poses(recording):
    run = mapped(recording, FakeOdometry(recording.poses, scale=2.5))
    assert [k.index for k in run.keyframes][:3] == [0, 5, 8]  # the first frame too, which became a keyframe later
    assert {k.index for k in run.keyframes} <= {0, *range(2, FRAMES, 3)} and len(run.keyframes) >= 5
    assert (run.map.frames, run.map.posed) == (FRAMES, FRAMES - 1)  # frame 1 never got a pose
    assert run.map.segment == 0 and run.map.others == ()
    assert error(run, recording, 2.5) < 0.08
    assert np.mean([k.density for k in run.keyframes]) > 0.6


@pytest.mark.slow
@pytest.mark.parametrize("scale", [128.0, 1 / 64])  # powers of two, so that rounding changes no random choice
def test_nothing_depends_on_the_unit_of_length(recording, scale):
    metres, units = (mapped(recording, FakeOdometry(recording.poses, scale=s)) for s in (1.0, scale))
    assert [k.index for k in units.keyframes] == [k.index for k in metres.keyframes]
    assert units.map.voxel_size == pytest.approx(metres.map.voxel_size / scale, rel=0.02)
    assert len(units.map.mesh.faces) == pytest.approx(len(metres.map.mesh.faces), rel=0.15)
    assert error(units, recording, scale) == pytest.approx(
        error(metres, recording, 1.0), rel=0.4
    )  # rounding decides some


def test_the_surface_is_that_of_the_final_poses(recording):
    """Keyframes come 8 cm off, and are put right by and by."""
    run = mapped(recording, FakeOdometry(recording.poses, error=(0.08, 0.0, 0.04)))
    world = inverse(recording.poses[0])
    moved = [np.abs(run.final_pose(k) - k.T_world_camera).max() for k in run.keyframes]
    assert max(moved) > 0.015
    assert_same_mesh(run.map.mesh, from_scratch(run, 0, run.map.voxel_size).mesh())
    for k in run.keyframes[-2:]:
        np.testing.assert_allclose(run.final_pose(k), world @ recording.poses[k.index], atol=1e-12)


def test_keyframes_are_mapped_at_their_present_poses(recording):
    """A keyframe waits for the next one, and has been moved by then."""
    run = mapped(recording, FakeOdometry(recording.poses, error=(0.08, 0.0, 0.0)))
    world = inverse(recording.poses[0])
    off = [np.linalg.norm((k.T_world_camera - world @ recording.poses[k.index])[:3, 3]) for k in run.keyframes[1:-1]]
    assert max(off) <= 0.04 + 1e-9


def test_final_poses_agree_with_the_trajectory(recording):
    run = mapped(recording, FakeOdometry(recording.poses, error=(0.05, 0.0, 0.0), lost={9, 10}))
    poses = {pose.index: pose for pose in run.map.trajectory}
    assert len(poses) == run.map.posed
    for k in run.keyframes:
        np.testing.assert_array_equal(run.final_pose(k), poses[k.index].T_world_camera)
        assert poses[k.index].segment == k.segment and poses[k.index].is_keyframe


def test_after_a_loss_a_new_segment_begins(recording):
    run = mapped(recording, FakeOdometry(recording.poses, error=(0.03, 0.0, 0.0), lost={6}))
    segments = [k.segment for k in run.keyframes]
    assert segments == sorted(segments) and set(segments) == {0, 1}
    assert all((k.index < 6) == (k.segment == 0) for k in run.keyframes)
    assert segments.count(1) > segments.count(0)
    assert run.map.segment == 1 and [other.segment for other in run.map.others] == [0]
    assert (run.map.keyframes, run.map.others[0].keyframes) == (len(segments), segments.count(0))
    assert_same_mesh(run.map.mesh, from_scratch(run, 1, run.map.voxel_size).mesh())
    assert_same_mesh(run.map.others[0].mesh, from_scratch(run, 0, run.map.others[0].voxel_size).mesh())


def test_a_segment_is_completed_when_the_next_begins(recording):
    run = start(FakeOdometry(recording.poses, lost={7}))
    feed(run, recording, last=7)
    waiting = [view.index for view in run.mapper._segment.pending]
    assert waiting
    feed(run, recording, first=7, last=8)
    assert [k.index for k in run.keyframes][-len(waiting) :] == waiting
    assert not run.mapper._segment.pending and not run.mapper._segment.mapped


def test_the_same_frames_give_the_same_segment_alone(recording):
    """Nothing of an earlier segment has a part in a later one."""
    after = mapped(recording, FakeOdometry(recording.poses, lost={6}))
    alone = start(FakeOdometry(recording.poses))
    feed(alone, recording, first=7)
    alone.map = alone.mapper.finish()
    ours = [k for k in after.keyframes if k.segment == 1]
    assert [k.index for k in ours] == [k.index for k in alone.keyframes]
    for a, b in zip(ours, alone.keyframes, strict=True):
        np.testing.assert_array_equal(a.depth, b.depth)


@pytest.mark.slow
def test_memory_is_that_of_the_window(recording):
    config = Config().with_settings(["keyframes.flow_weight=10"])
    run = start(FakeOdometry(recording.poses, every=1, error=(0.01, 0.0, 0.0)), config)
    held = []
    for i in range(FRAMES):
        feed(run, recording, i, i + 1)
        segment = run.mapper._segment
        images = len(segment.pending) + len(segment.mapped) + len(run.mapper._source._held)
        held.append((images, len(segment.surface.movable)))
    assert max(images for images, _ in held) <= 6 and max(maps for _, maps in held) <= 3
    assert held[6:] == held[6:7] * (FRAMES - 6)


def test_the_mapper_tells_what_is_known_of_a_frame(recording):
    run = start(FakeOdometry(recording.poses, lost={5}))
    states = []
    for i in range(8):
        feed(run, recording, i, i + 1)
        now = run.mapper.tracked
        assert (now.T_world_camera is not None) == (now.status is Status.TRACKED) == (not now.reason)
        states.append(now.status.value[0])
    assert "".join(states) == "ssttt" + "lss" and "parallax" in run.mapper.tracked.reason


def test_nothing_tracked_gives_an_empty_map(recording):
    run = mapped(recording, FakeOdometry(recording.poses, lost=range(FRAMES)))
    assert run.map.mesh is None and run.map.trajectory == ()
    assert (run.map.frames, run.map.posed, run.map.keyframes) == (FRAMES, 0, 0)


def test_finishing_twice_changes_nothing(recording):
    run = mapped(recording, FakeOdometry(recording.poses, lost={6}))
    again = run.mapper.finish()
    assert again.keyframes == run.map.keyframes == len(run.keyframes)
    assert [other.segment for other in again.others] == [0]
    assert_same_mesh(again.mesh, run.map.mesh)


class Careless:
    """Odometry that names as a keyframe what it did not hold, and holds more than it may."""

    def __init__(self, keyframe_at=20) -> None:
        self._keyframe_at = keyframe_at

    def process(self, grey, timestamp, index, exposure=None):
        if index < self._keyframe_at:
            held = tuple(range(index))
            return OdometryUpdate(index, timestamp, Status.STARTING, 0, reason="slow", held=held)
        poses = {0: np.eye(4), index: np.eye(4)}
        return OdometryUpdate(index, timestamp, Status.TRACKED, 0, np.eye(4), "", (0, index), poses)


def test_images_are_held_within_bounds(recording, caplog):
    source = OdometryPoses(Careless())
    for index in range(20):
        source.update(GivenImage(recording.images[0], 0.1 * index, index))
        assert len(source._held) <= 16
    with caplog.at_level(logging.WARNING):
        update = source.update(GivenImage(recording.images[0], 2.0, 20))
    assert [c.index for c in update.candidates] == [20]
    assert "frame 0: became a keyframe when its image was not kept any more" in caplog.text
