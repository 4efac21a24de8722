"""Frames and poses that are wrong for a moment: what is mapped without them is as good as if they had not come."""

from __future__ import annotations

import json
from dataclasses import replace

import cv2
import numpy as np
import pytest
from room_recording import CAMERA, FILE, SENSOR, Recording, raw

from polarmap.data.codes import Status
from polarmap.data.frame import Frame
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.data.trajectory import PosedFrame, Trajectory
from polarmap.errors import PolarmapError
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.found import OdometryPoses
from polarmap.prior.options import PriorOptions
from polarmap.prior.priors import make_prior
from polarmap.report.run_writer import RunWriter
from polarmap.run import run_sequence
from polarmap.synth import built_in_scene, render_sequence

FRAMES = 8
BAD = 3  # a keyframe, if it were good


@pytest.fixture(scope="module")
def recording() -> Recording:
    room = built_in_scene("room")
    frames = list(render_sequence(room.scene, CAMERA, *room.path(frames=FRAMES, step=0.06), SENSOR))
    return Recording(frames, [])


@pytest.fixture(scope="module")
def trajectory(recording) -> Trajectory:
    times = np.array([frame.timestamp for frame in recording.frames])
    return Trajectory(times, np.array([frame.T_world_camera for frame in recording.frames]))


def fed(mapper: Mapper, frames: list[Frame]) -> list[str]:
    """The reasons for which frames were left out as they came, "" where they were not."""
    reasons = []
    for frame in frames:
        mapper.process(frame)
        assert (mapper.tracked.T_world_camera is None) == bool(mapper.tracked.reason)
        reasons.append(mapper.tracked.reason)
    return reasons


def mapped(frames: list[Frame], poses) -> tuple[list, list[str], Mapper]:
    keyframes = []
    prior = make_prior("sparse", PriorOptions())
    mapper = Mapper(FILE, poses, prior, on_keyframe=keyframes.append)
    reasons = fed(mapper, frames)
    mapper.finish()
    return keyframes, reasons, mapper


@pytest.fixture(scope="module")
def without_it(recording, trajectory) -> list:
    frames = [raw(frame) for frame in recording.frames if frame.index != BAD]
    return mapped(frames, trajectory)[0]


def black(mosaic):
    return 0 * mosaic


def saturated(mosaic):
    return np.full_like(mosaic, 2**SENSOR.bit_depth - 1)


def noise(mosaic):
    return np.random.default_rng(0).integers(0, 2**SENSOR.bit_depth, mosaic.shape).astype(mosaic.dtype)


def half(mosaic):
    return np.where(np.arange(len(mosaic))[:, None] < len(mosaic) // 2, mosaic, 0).astype(mosaic.dtype)


PICTURES = {
    black: "the picture is black",
    saturated: "the picture is saturated",
    noise: "the picture is nothing but noise",
    half: "a part of the picture has gone black",
}


def assert_same(keyframes, others) -> None:
    assert [k.index for k in keyframes] == [k.index for k in others]
    for ours, theirs in zip(keyframes, others, strict=True):
        np.testing.assert_array_equal(ours.depth, theirs.depth)
        assert ours.segment == theirs.segment


@pytest.mark.parametrize("spoil", PICTURES, ids=lambda spoil: spoil.__name__)
def test_an_unfit_picture_does_no_harm(recording, trajectory, without_it, spoil):
    frames = [raw(frame) for frame in recording.frames]
    frames[BAD] = replace(frames[BAD], mosaic=spoil(frames[BAD].mosaic))
    keyframes, reasons, mapper = mapped(frames, trajectory)
    assert_same(keyframes, without_it)
    assert mapper.left_out == {PICTURES[spoil]: 1}
    assert [i for i, reason in enumerate(reasons) if reason] == [BAD]


@pytest.mark.parametrize("size", [1e4, 0.9])
def test_a_pose_that_jumps_does_no_harm(recording, trajectory, without_it, size):
    poses = trajectory.poses.copy()
    poses[BAD, 0, 3] += size
    keyframes, reasons, mapper = mapped(
        [raw(frame) for frame in recording.frames], Trajectory(trajectory.timestamps, poses)
    )
    assert_same(keyframes, without_it)
    assert [i for i, reason in enumerate(reasons) if reason] == [BAD] and reasons[BAD].startswith("the pose jumps by")
    assert sum(mapper.left_out.values()) == 1


def test_the_first_picture_may_turn_out_to_be_the_odd_one(recording, trajectory):
    """It waits for others to be mapped, and is withdrawn; the second is spared to learn which of them is odd."""
    frames = [raw(frame) for frame in recording.frames]
    expected = mapped(frames[2:], trajectory)[0]
    frames[0] = replace(frames[0], mosaic=half(frames[0].mosaic))
    keyframes, _, mapper = mapped(frames, trajectory)
    assert keyframes[0].index in (1, 2) and len(keyframes) >= len(expected)
    assert mapper.left_out["a part of the picture has gone black"] >= 1


class OdometrySpy:
    """Has a pose for every frame, each of which is a keyframe, and notes what it is shown."""

    def __init__(self, poses) -> None:
        self.poses, self.seen, self.frames = poses, [], []

    def process(self, grey, timestamp, index, exposure=None) -> OdometryUpdate:
        self.seen.append(index)
        pose = self.poses[index]
        self.frames.append(PosedFrame(index, timestamp, 0, pose, True))
        return OdometryUpdate(index, timestamp, Status.TRACKED, 0, pose, "", (index,), {index: pose})

    def wait(self) -> None: ...

    def finish(self) -> None: ...

    def result(self) -> OdometryResult:
        return OdometryResult(tuple(self.frames), None, (), {})


def blurred(mosaic):
    planes = [cv2.GaussianBlur(mosaic[y::2, x::2], (0, 0), 4.0) for y in (0, 1) for x in (0, 1)]
    out = np.empty_like(mosaic)
    out[::2, ::2], out[::2, 1::2], out[1::2, ::2], out[1::2, 1::2] = planes
    return out


def test_odometry_sees_all_that_can_be_tracked_and_stereo_what_is_fit(recording):
    frames = [raw(frame) for frame in recording.frames[:5]]
    frames[2] = replace(frames[2], mosaic=black(frames[2].mosaic))
    frames[3] = replace(frames[3], mosaic=blurred(frames[3].mosaic))
    spy = OdometrySpy({frame.index: frame.T_world_camera for frame in recording.frames})
    mapper = Mapper(FILE, OdometryPoses(spy), make_prior("sparse", PriorOptions()), Config())
    for frame in frames:
        mapper.process(frame)
        assert mapper.tracked.segment == 0
    assert spy.seen == [0, 1, 3, 4]
    assert 3 not in [view.index for view in mapper._segment.pending] and mapper.tracked.T_world_camera is not None
    assert (
        mapper.left_out["the picture is black"] == 1
        and mapper.left_out["the picture is blurred, unlike its neighbours"] == 1
    )


def test_a_keyframe_of_odometry_must_fit_the_pictures_before_it(recording):
    """The lower half is from elsewhere, which odometry may survive."""
    frames = [raw(frame) for frame in recording.frames]
    other = np.roll(frames[0].mosaic, 40, axis=1)
    mixed = np.where(np.arange(len(other))[:, None] < len(other) // 3, frames[5].mosaic, other).astype(other.dtype)
    frames[5] = replace(frames[5], mosaic=mixed)
    spy = OdometrySpy({frame.index: frame.T_world_camera for frame in recording.frames})
    keyframes = []
    mapper = Mapper(FILE, OdometryPoses(spy), make_prior("sparse", PriorOptions()), on_keyframe=keyframes.append)
    for frame in frames:
        mapper.process(frame)
    mapper.finish()
    indices = [keyframe.index for keyframe in keyframes]
    assert spy.seen == list(range(FRAMES)) and 5 not in indices and len(indices) >= 2
    assert sum(mapper.left_out.values()) == 1


class Recorded(list):
    """Frames as a sequence for a run."""

    path = "recording"
    camera_file = FILE

    @property
    def timestamps(self):
        return np.array([frame.timestamp for frame in self])


@pytest.mark.parametrize("spoil", [black, saturated, noise], ids=lambda spoil: spoil.__name__)
def test_where_no_picture_is_fit_the_run_fails_and_says_why(recording, trajectory, tmp_path, spoil):
    rng = np.random.default_rng(0)
    frames = Recorded(raw(frame) for frame in recording.frames)
    for i, frame in enumerate(frames):
        mosaic = rng.permuted(noise(frame.mosaic).ravel()).reshape(frame.mosaic.shape)
        frames[i] = replace(frame, mosaic=mosaic if spoil is noise else spoil(frame.mosaic))
    writer = RunWriter(tmp_path / "out", Config(), CAMERA)
    with pytest.raises(PolarmapError, match=f"no frame could be tracked: {PICTURES[spoil]}") as failure:
        run_sequence(frames, trajectory, writer, make_prior("sparse", PriorOptions()))
    assert failure.value.exit_status == 1


def test_after_a_jump_that_lasts_a_segment_of_its_own_is_written(tmp_path):
    """The second world has more keyframes than the first, so its files are those without a segment in their name."""
    room = built_in_scene("room")
    frames = list(render_sequence(room.scene, CAMERA, *room.path(frames=48, step=0.02), SENSOR))
    poses = np.array([frame.T_world_camera for frame in frames])
    poses[18:, 0, 3] += 3.0
    trajectory = Trajectory(np.array([frame.timestamp for frame in frames]), poses)
    writer = RunWriter(tmp_path / "out", Config(), CAMERA)
    result = run_sequence(Recorded(map(raw, frames)), trajectory, writer, make_prior("sparse", PriorOptions()))
    assert result.segment == 1 and [other.segment for other in result.others] == [0]
    written = {
        name: len((tmp_path / "out" / name).read_text().splitlines()) - 1
        for name in ("trajectory.txt", "trajectory_segment0.txt")
    }
    assert written == {"trajectory.txt": 30, "trajectory_segment0.txt": 18}
    assert {path.name for path in (tmp_path / "out").glob("mesh*")} == {"mesh.ply", "mesh_segment0.ply"}
    results = json.loads((tmp_path / "out" / "results.json").read_text())
    assert results["posed"] == 48 and [s["segment"] for s in results["segments"]] == [1, 0]
