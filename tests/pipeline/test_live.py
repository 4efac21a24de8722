"""Runs whose frames come at their times: what is late, what is left out, and that nothing waits for the map."""

from __future__ import annotations

import os
import sys
import threading
import time
from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from threading import Event

import numba
import numpy as np
import pytest
from fake_device import FakeDevice, picture
from room_recording import FILE, Recording, raw, recorded_room

from polarmap.data.trajectory import Trajectory
from polarmap.errors import PolarmapError
from polarmap.geometry.sim3 import Sim3
from polarmap.io.cameras.live_camera import LiveCamera
from polarmap.io.recording.replay import Replay
from polarmap.io.run_folder.folder import read_results
from polarmap.niceness import give_way
from polarmap.pipeline.config import Config
from polarmap.pipeline.live_log import LatencyCount, LiveLog
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.workers import Workers
from polarmap.report.run_writer import RunWriter
from polarmap.run import run_live


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded_room(frames=24)


@pytest.fixture(scope="module")
def trajectory(recording) -> Trajectory:
    return Trajectory(np.array(list(recording.poses)), np.array(list(recording.poses.values())))


@dataclass
class Slowly:
    """The frames of a recording, at another pace."""

    recording: Recording
    trajectory: Trajectory
    pace: float = 1.0
    camera_file = FILE

    @property
    def timestamps(self) -> np.ndarray:
        return self.trajectory.timestamps * self.pace

    def __len__(self) -> int:
        return len(self.recording.frames)

    def __iter__(self):
        return (raw(frame) for frame in self.recording.frames)


class Held:
    """A thread whose jobs wait for `go`."""

    def __init__(self) -> None:
        self._thread = ThreadPoolExecutor(1)
        self.go = Event()

    def submit(self, work, job):
        return self._thread.submit(lambda: self.go.wait(60) and work(job))


def test_quantiles_of_latency_are_exact_to_a_bin():
    late = np.random.default_rng(0).gamma(2.0, 20.0, 5000)
    count = LatencyCount()
    assert count.latency() is None
    for milliseconds in late:
        count.add(milliseconds)
    found = count.latency()
    assert found.count == 5000 and found.largest == late.max()
    assert found.median == pytest.approx(np.median(late), abs=0.5)
    assert found.p99 == pytest.approx(np.quantile(late, 0.99), abs=1.5)


def test_an_hour_takes_no_more_room_than_a_minute_and_no_count_is_lost():
    log, skipped = LiveLog(), 0
    for i in range(3600 * 30):
        skipped += i % 50 == 0
        log.frame(i / 30, i / 30 + 0.02, waiting=i % 3, missed=i // 1000, skipped=skipped)
        if i % 15 == 0:
            log.surface(i / 30 - 1.0, i / 30)
    figures = log.figures(3601.0, hurried=4, untraced=5)
    assert 100 < len(figures.moments) <= 600
    assert sum(moment.skipped for moment in figures.moments) == figures.skipped == skipped
    assert sum(moment.missed for moment in figures.moments) == figures.missed == (3600 * 30 - 1) // 1000
    assert np.all(np.diff([moment.seconds for moment in figures.moments]) > 0)
    assert max(moment.surface for moment in figures.moments) == pytest.approx(1000.0)
    assert figures.pose.median == pytest.approx(20.0, abs=0.5)
    assert figures.after == pytest.approx(1.0, abs=0.05)


def test_keyframes_that_show_least_are_skipped_where_mapping_is_behind(recording, trajectory):
    """All but those under way and those that may wait; frames are tracked on, and every change is told."""
    held, keyframes, fused = Held(), [], []
    mapper = Mapper(
        FILE, trajectory, on_keyframe=keyframes.append, executor=held, most_waiting=1, on_fused=fused.append
    )
    for frame in recording.frames:
        mapper.process(raw(frame))
        assert mapper.tracked.T_world_camera is not None
        assert mapper.backlog <= 2
    assert mapper.skipped > 0
    held.go.set()
    result = mapper.finish()
    usual = Mapper(FILE, trajectory)
    for frame in recording.frames:
        usual.process(raw(frame))
    assert result.keyframes + mapper.skipped == usual.finish().keyframes == len(keyframes) + mapper.skipped
    assert [change.keyframe for change in fused] == [keyframe.index for keyframe in keyframes]
    assert keyframes[-1].index == usual_last(recording, trajectory)  # the newest is never skipped


def usual_last(recording, trajectory) -> int:
    last = deque(maxlen=1)
    mapper = Mapper(FILE, trajectory, on_keyframe=lambda keyframe: last.append(keyframe.index))
    for frame in recording.frames:
        mapper.process(raw(frame))
    mapper.finish()
    return last[0]


def test_of_waiting_keyframes_the_one_between_close_neighbours_goes(recording, trajectory):
    mapper = Mapper(FILE, trajectory, executor=Held())
    for frame in recording.frames:
        mapper.process(raw(frame))
    segment = mapper._segment
    waiting = [view.index for view in segment.pending]
    assert len(waiting) > 3
    segment._novelty.update(zip(waiting, [5.0, 1.5, 1.5, *[4.0] * len(waiting)], strict=False))
    assert segment.skip_one() == waiting[1]
    assert [view.index for view in segment.pending] == [waiting[0], *waiting[2:]]
    assert segment.skip_one() == waiting[2]  # 3 and 4 are less than 5 and 3, or 4 and 4


def test_a_skipped_keyframe_is_matched_with_all_the_same(recording, trajectory):
    """From both sides, where it is now."""
    mapper = Mapper(FILE, trajectory, executor=Held())
    for frame in recording.frames:
        mapper.process(raw(frame))
    segment = mapper._segment
    segment.complete(*finished(mapper))
    before, skipped, after, *_ = [view.index for view in segment.pending]
    segment._novelty.update({before: 9.0, skipped: 0.1, after: 0.1})
    assert segment.skip_one() == skipped
    moved = np.eye(4)
    moved[:3, 3] = 0.1, 0.2, 0.3
    segment.move({skipped: Sim3.from_matrix(moved)})
    for index in (before, after):
        job = segment.next_job()
        assert job.view.index == index
        neighbours = {view.index: view for view in job.neighbours}
        assert skipped in neighbours and neighbours[skipped].depth is None
        np.testing.assert_allclose(neighbours[skipped].T_world_camera[:3, 3], moved[:3, 3] - segment._centre)
        segment.complete(job, mapper.steps(job))


def finished(mapper: Mapper):
    """The job that is under way, and what comes of it."""
    job, _ = mapper._under_way
    return job, mapper.steps(job)


def test_no_keyframe_waits_for_later_ones_where_few_may_wait(recording, trajectory):
    """But the first, which would have none to be matched with."""

    def later_neighbours(**seams) -> list[int]:
        mapper, found = Mapper(FILE, trajectory, **seams), []
        steps = mapper.steps

        def spy(job):
            found.append(sum(other.index > job.view.index for other in job.neighbours))
            return steps(job)

        mapper.steps = spy
        for frame in recording.frames:
            mapper.process(raw(frame))
        mapper.finish()
        return found

    usual = later_neighbours()
    assert usual[0] == 2 and set(usual[1:-1]) == {1} and usual[-1] == 0
    prompt = later_neighbours(most_waiting=1)
    assert len(prompt) == len(usual)  # in line none is late
    assert prompt[0] == 2 and prompt[1] == 1 and set(prompt[2:]) == {0}


def test_the_prior_takes_one_look_where_keyframes_are_skipped(recording, trajectory):
    looks, held = [], Held()
    mapper = Mapper(
        FILE, trajectory, config=Config.model_validate({"prior": {"looks": 3}}), executor=held, most_waiting=1
    )
    prior = mapper.steps.prior
    mapper.steps.prior = lambda *image, hurry: looks.append(hurry) or prior(*image, hurry=hurry)
    for frame in recording.frames:
        mapper.process(raw(frame))
    held.go.set()
    mapper.finish()
    assert mapper.skipped and looks[0] is False and looks[1] is True and sum(looks) == mapper.hurried == 1


def test_fusing_elsewhere_gives_the_same_surface(recording, trajectory):
    def mesh(**seams):
        mapper = Mapper(FILE, trajectory, **seams)
        for frame in recording.frames:
            mapper.process(raw(frame))
        return mapper.finish().mesh

    with ThreadPoolExecutor(1) as fusing:
        np.testing.assert_array_equal(mesh(fusing=fusing).vertices, mesh().vertices)


def test_a_live_run_tracks_every_frame_and_tells_how_it_kept_up(recording, trajectory, tmp_path):
    replay = Replay(Slowly(recording, trajectory, pace=2.0))
    with_times = Trajectory(trajectory.timestamps, trajectory.poses)
    writer = RunWriter(tmp_path / "out", Config(), FILE.camera)
    result = run_live(replay, with_times, writer)
    found = read_results(tmp_path / "out")
    assert found.status == "complete" and found.posed == len(recording.frames) and result.mesh is not None
    assert found.live.missed == 0 and found.live.pose.count == len(recording.frames)
    assert found.live.surface.count == len(found.keyframes) == result.keyframes
    assert found.live.skipped + result.keyframes >= 4
    assert any("keyframes were skipped" in line.text for line in found.summary)
    assert "Live" in (tmp_path / "out" / "report.html").read_text()


@pytest.mark.parametrize("goes", [False, True])
def test_what_a_camera_sent_is_mapped_also_where_it_is_unplugged(recording, trajectory, tmp_path, goes):
    """Its clock is set over the network, so that poses can be given."""
    start = time.time_ns()
    size = {"width": 2 * FILE.camera.width, "height": 2 * FILE.camera.height}
    device = FakeDevice(
        [
            picture(
                frame.index, clock=start + round(1e9 * frame.timestamp), pixel_format="Mono12", **size,
                data=frame.mosaic.astype("<u2").tobytes(),
            )
            for frame in recording.frames
        ],
        goes, pace=0.1,
    )  # fmt: skip
    source = LiveCamera(device, FILE, frames=None if goes else len(recording.frames))
    poses = Trajectory(start / 1e9 + trajectory.timestamps, trajectory.poses)
    writer = RunWriter(tmp_path / "out", Config(), FILE.camera)
    if goes:
        with pytest.raises(PolarmapError, match="does not answer any more"):
            run_live(source, poses, writer)
    else:
        run_live(source, poses, writer)
    found = read_results(tmp_path / "out")
    assert found.status == ("interrupted" if goes else "complete")
    assert found.posed == found.live.pose.count == len(recording.frames) and found.map.faces > 0
    assert source.lost == source.missed == 0 and device.stopped == 1


@pytest.mark.skipif(sys.platform != "linux", reason="threads have a niceness of their own on Linux alone")
def test_a_thread_that_gives_way_is_the_only_one():
    def niceness() -> int:
        return os.getpriority(os.PRIO_PROCESS, threading.get_native_id())

    before = niceness()
    with ThreadPoolExecutor(1, initializer=give_way) as polite, ThreadPoolExecutor(1) as usual:
        assert polite.submit(niceness).result() == min(before + 10, 19)
        assert usual.submit(niceness).result() == niceness() == before


def test_workers_leave_the_threads_as_they_were():
    before = numba.get_num_threads()
    with Workers() as workers:
        if not workers.beside:
            pytest.skip("this machine has only Numba's workqueue layer")
        assert numba.get_num_threads() == 1
        assert workers.fusing.submit(numba.get_num_threads).result() == 1
        workers.no_more_frames()
        assert numba.get_num_threads() == before
    assert numba.get_num_threads() == before
