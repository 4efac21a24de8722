"""What is to be exchanged can be, without a change elsewhere: stereo, the camera, where jobs are done, the poses."""

from __future__ import annotations

import threading
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import replace

import cv2
import numpy as np
import pytest
from room_recording import CAMERA, FILE, Recording, raw, recorded_room

from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map
from polarmap.data.plane_field import PlaneField
from polarmap.data.trajectory import PosedFrame, Trajectory
from polarmap.fusion.depth_store import DiskStore
from polarmap.fusion.surface_map import SurfaceMap
from polarmap.geometry.sim3 import Sim3
from polarmap.io.run_folder.folder import read_keyframes, read_results
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.source import Candidate, PoseUpdate
from polarmap.report.run_writer import RunWriter
from polarmap.run import run_sequence

CONFIG = Config()


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded_room()


def trajectory_of(recording: Recording) -> Trajectory:
    return Trajectory(np.array(list(recording.poses)), np.array(list(recording.poses.values())))


def mapped(recording: Recording, config=CONFIG, **seams) -> tuple[list[Keyframe], Map]:
    keyframes: list[Keyframe] = []
    mapper = Mapper(FILE, trajectory_of(recording), config=config, on_keyframe=keyframes.append, **seams)
    for frame in recording.frames:
        mapper.process(raw(frame))
    return keyframes, mapper.finish()


@pytest.fixture(scope="module")
def usual(recording) -> tuple[list[Keyframe], Map]:
    return mapped(recording)


def assert_same(found: tuple[list[Keyframe], Map], expected: tuple[list[Keyframe], Map]) -> None:
    assert [k.index for k in found[0]] == [k.index for k in expected[0]]
    for ours, theirs in zip(found[0], expected[0], strict=True):
        np.testing.assert_array_equal(ours.depth, theirs.depth)
        np.testing.assert_array_equal(ours.normal, theirs.normal)
    np.testing.assert_array_equal(found[1].mesh.vertices, expected[1].mesh.vertices)


class PlaneSweep:
    """The simplest other stereo method: planes parallel to the image, the best of some dozens for each pixel."""

    def __init__(self) -> None:
        self.calls = 0

    def __call__(self, reference, others, camera, depth_range, start=None) -> PlaneField:
        self.calls += 1
        inverse_depths = np.linspace(1 / depth_range[1], 1 / depth_range[0], 160, dtype=np.float32)
        costs = np.array([min_of(reference, others, camera, q) for q in inverse_depths])
        best = costs.argmin(axis=0)
        least = np.take_along_axis(costs, best[None], axis=0)[0]
        zero = np.zeros(camera.shape, np.float32)
        step = float(inverse_depths[1] - inverse_depths[0]) / np.sqrt(12.0)
        sigma = np.where(np.median(costs, axis=0) > 4.0 * least, step, np.inf)
        score = np.clip(1.0 - 20.0 * least, 0.0, 1.0).astype(np.float32)
        return PlaneField(inverse_depths[best], zero, zero, score, sigma.astype(np.float32), window=5)


def min_of(reference, others, camera, q: float) -> np.ndarray:
    """Mean difference of √intensity in 5×5 pixels, in the view where it is least, at an inverse depth."""
    rays = np.concatenate([camera.normalized(), np.ones((*camera.shape, 1), np.float32)], axis=-1)
    differences = []
    for other in others:
        T = reference.motion_to(other).astype(np.float32)
        x, y, z = np.moveaxis((rays / q) @ T[:3, :3].T + T[:3, 3], -1, 0)
        u, v = camera.fx * x / z + camera.cx, camera.fy * y / z + camera.cy
        seen = cv2.remap(other.image.stable, u, v, cv2.INTER_LINEAR, borderValue=10.0)
        differences.append(cv2.blur(np.abs(seen - reference.image.stable), (5, 5)))
    return np.min(differences, axis=0)


def test_another_stereo_method_maps_the_room(recording, usual):
    stereo = PlaneSweep()
    near, far = (pick([pick(frame.truth.depth) for frame in recording.frames]) for pick in (np.nanmin, np.nanmax))
    config = CONFIG.with_settings([f"stereo.depth_min={0.9 * near}", f"stereo.depth_max={1.1 * far}"])
    keyframes, _ = mapped(recording, config, stereo=stereo)
    assert stereo.calls == len(keyframes) == len(usual[0])
    errors = [np.abs(k.depth / recording.frames[k.index].truth.depth - 1) for k in keyframes]
    assert np.nanmean(errors) < 0.1 and np.mean([k.density for k in keyframes]) > 0.95


class FakeCamera:
    """A camera on a cable: it can be looped over once, and nobody knows for how long."""

    camera_file = FILE

    def __init__(self, recording: Recording) -> None:
        self._frames = (raw(frame) for frame in recording.frames)

    def __iter__(self):
        return self._frames


def test_a_camera_is_mapped_into_a_folder(recording, usual, tmp_path):
    with RunWriter(tmp_path / "out", CONFIG, CAMERA) as writer:
        result = run_sequence(FakeCamera(recording), trajectory_of(recording), writer, config=CONFIG)
    results = read_results(tmp_path / "out")
    assert results.status == "complete" and results.frames == len(recording.frames)
    keyframes = list(read_keyframes(tmp_path / "out", results.camera.size))
    for ours, theirs in zip(keyframes, usual[0], strict=True):
        np.testing.assert_array_equal(ours.depth, theirs.depth)
    np.testing.assert_array_equal(result.mesh.vertices, usual[1].mesh.vertices)


class Patient:
    """A thread that is waited for."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(1)
        self.names: set[str] = set()

    def submit(self, work, job) -> Future:
        future = self._threads.submit(self._noted, work, job)
        future.exception()
        return future

    def _noted(self, work, job):
        self.names.add(threading.current_thread().name)
        return work(job)


def test_jobs_done_in_a_thread_give_the_same_map(recording, usual):
    executor = Patient()
    assert_same(mapped(recording, executor=executor), usual)
    assert executor.names and threading.current_thread().name not in executor.names


class Gate:
    """A thread whose jobs wait until they are let go."""

    def __init__(self) -> None:
        self._threads = ThreadPoolExecutor(1)
        self.open = threading.Event()
        self.jobs = []

    def submit(self, work, job) -> Future:
        self.jobs.append(job)
        return self._threads.submit(lambda: self.open.wait(60) and work(job))


def test_frames_do_not_wait_for_jobs(recording):
    """While the first keyframe's job is under way all other frames come in; then each keyframe has its turn."""
    gate, keyframes = Gate(), []
    mapper = Mapper(FILE, trajectory_of(recording), config=CONFIG, on_keyframe=keyframes.append, executor=gate)
    for frame in recording.frames:
        mapper.process(raw(frame))
        assert mapper.tracked.T_world_camera is not None
    assert not keyframes and len(gate.jobs) == 1
    gate.open.set()
    result = mapper.finish()
    assert [k.index for k in keyframes] == [job.view.index for job in gate.jobs]
    assert [k.index for k in keyframes] == sorted(k.index for k in keyframes) and len(keyframes) >= 3
    assert result.keyframes == len(keyframes) and result.frames == len(recording.frames)
    errors = [np.abs(k.depth / recording.frames[k.index].truth.depth - 1) for k in keyframes]
    assert np.nanmean(errors) < 0.08


def test_what_a_job_raises_is_raised_where_it_is_collected(recording):
    class Broken:
        def __call__(self, *what):
            raise ValueError("no stereo today")

    with pytest.raises(ValueError, match="no stereo today"), ThreadPoolExecutor(1) as executor:
        mapped(recording, stereo=Broken(), executor=executor)


class Growing:
    """A source of poses that closes a loop with the last frame: all keyframes move, in a world that is larger."""

    step = "odometry"
    given = False
    front_end = None

    def __init__(self, recording: Recording, growth: float) -> None:
        self._poses = [frame.T_world_camera for frame in recording.frames]
        self._growth = growth
        self.corrected: dict[int, Sim3] = {}

    def needs(self, timestamp: float) -> bool:
        return True

    def unseen(self, timestamp: float) -> PoseUpdate:
        raise NotImplementedError

    def update(self, frame) -> PoseUpdate:
        T = self._poses[frame.index]
        candidates = (Candidate(frame, T),)
        moved = {i: Sim3.from_matrix(pose) for i, pose in enumerate(self._poses[: frame.index + 1])}
        if frame.index < len(self._poses) - 1:
            return PoseUpdate(T, candidates=candidates, moved=moved)
        self.corrected = {
            i: replace(pose, scale=self._growth, translation=self._growth * pose.translation)
            for i, pose in moved.items()
        }
        return PoseUpdate(T, moved=self.corrected)

    def rest(self) -> None:
        return None

    def finish(self) -> tuple[PosedFrame, ...] | None:
        return None


@pytest.mark.parametrize("disk", [False, True])
def test_a_loop_that_closes_scales_keyframes_depth_and_surface(recording, tmp_path, disk):
    source, final = Growing(recording, 1.25), {}
    store = DiskStore() if disk else None
    keyframes: list[Keyframe] = []
    mapper = Mapper(FILE, source, None, CONFIG, keyframes.append, final.__setitem__, depth_store=store)
    for frame in recording.frames:
        mapper.process(raw(frame))
    before = len(keyframes)
    assert all(view.scale == 1.25 for view in mapper._segment.mapped)
    np.testing.assert_array_equal(mapper._segment.mapped[-1].depth, np.float32(1.25) * keyframes[-1].depth)
    result = mapper.finish()
    assert before >= 2 and len(keyframes) > before and final.keys() == {k.index for k in keyframes}
    expected = SurfaceMap(CONFIG.fusion.model_copy(update={"voxel_size": result.voxel_size}))
    for position, k in enumerate(keyframes):
        # those that were mapped after the loop was closed are of the larger world already
        assert final[k.index].scale == (1.25 if position < before else 1.0)
        depth = np.float32(final[k.index].scale) * k.depth
        expected.integrate(depth, k.image.intensity, k.confidence, CAMERA, final[k.index].rigid, k.index)
    np.testing.assert_allclose(result.mesh.vertices, expected.mesh().vertices, atol=2e-3)


def test_the_folder_of_a_run_is_scaled_with_its_keyframes(recording, tmp_path):
    source = Growing(recording, 1.25)
    with RunWriter(tmp_path / "out", CONFIG, CAMERA, poses="odometry") as writer:
        added = []
        mapper = Mapper(
            FILE, source, None, CONFIG, lambda k: (added.append(k), writer.add_keyframe(k)), writer.add_pose
        )
        for frame in recording.frames:
            mapper.process(raw(frame))
        before = len(added)
        writer.add_map(mapper.finish())
    written = list(read_keyframes(tmp_path / "out", (CAMERA.width, CAMERA.height)))
    for position, (ours, k) in enumerate(zip(written, added, strict=True)):
        np.testing.assert_array_equal(ours.T_world_camera, source.corrected[k.index].rigid)
        growth = np.float32(1.25) if position < before else np.float32(1.0)
        np.testing.assert_array_equal(ours.depth, growth * k.depth)
