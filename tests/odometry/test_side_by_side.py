"""Odometry whose back end runs beside it: the same poses where it is waited for, and all frames tracked where not."""

from __future__ import annotations

from collections import deque
from concurrent.futures import Future
from itertools import pairwise

import numpy as np
import pytest
from odometry_scenes import CAMERA, OPTIONS, image_of, motion

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.errors import InputError
from polarmap.evaluation.alignment import umeyama
from polarmap.geometry.pose import inverse
from polarmap.odometry import odometry as odometry_module
from polarmap.odometry import side_by_side
from polarmap.odometry.back_end import BackEnd
from polarmap.odometry.odometry import Odometry
from polarmap.odometry.side_by_side import ThreadedOdometry
from polarmap.odometry.start.starter import Starter
from polarmap.odometry.work import StartWork, Work

FRAMES = 26
POSES = [
    motion(0.035 * k, 0.02 * np.sin(0.5 * k), 0.02 * k, 0.0, 0.012 * k, 0.0) for k in range(FRAMES)
]  # camera_world


def image(number: int) -> np.ndarray:
    return image_of(POSES[number], noise=0.5, seed=number)


class AtOnce:
    """An executor that does each job when it is given."""

    def submit(self, work, job):
        done: Future = Future()
        done.set_result(work(job))
        return done


class Waiting:
    """An executor that does its jobs when it is told, so that a back end that lags does so the same way every time.

    lag: frames' jobs that wait; those of a start are done as soon as they are the next. told: none is done but on
    demand.
    """

    def __init__(self, lag: int = 0, told: bool = False) -> None:
        self.lag = lag
        self.told = told
        self.jobs: deque = deque()
        self.most = 0

    def submit(self, work, job):
        done = _OnDemand(self)
        self.jobs.append((done, work, job))
        self.most = max(self.most, len(self.jobs))
        while not self.told and self.jobs and (len(self.jobs) > self.lag or not isinstance(self.jobs[0][2], Work)):
            self.do_next()
        return done

    def do_next(self) -> None:
        done, work, job = self.jobs.popleft()
        try:
            done.set_result(work(job))
        except ZeroDivisionError as error:
            done.set_exception(error)

    def do_all(self) -> None:
        while self.jobs:
            self.do_next()


class _OnDemand(Future):
    """A job that is done at the latest when somebody waits for it."""

    def __init__(self, executor: Waiting) -> None:
        super().__init__()
        self.executor = executor

    def exception(self, timeout=None):
        while not self.done():
            self.executor.do_next()
        return super().exception(timeout)


def follow(odometry, numbers=range(FRAMES)) -> list[OdometryUpdate]:
    return [odometry.process(image(k), k / 30, k) for k in numbers]


def check_tracked(result: OdometryResult, numbers=range(FRAMES), rms: float = 0.004) -> None:
    """Every frame has a pose in one segment, true but for a similarity; rms in metres on a path of one."""
    assert [frame.index for frame in result.frames] == list(numbers)
    assert result.segments == (0,)
    found = np.array([frame.T_world_camera[:3, 3] for frame in result.frames])
    true = np.array([inverse(POSES[k])[:3, 3] for k in numbers])
    distance = np.linalg.norm(umeyama(found, true).apply(found) - true, axis=1)
    assert np.sqrt(np.mean(distance**2)) < rms


def check_keyframes(updates: list[OdometryUpdate], result: OdometryResult) -> None:
    """Each keyframe is handed out once, in order, with its pose and depths, and was held until then."""
    handed_out = [index for update in updates for index in update.keyframes]
    assert handed_out == [frame.index for frame in result.frames if frame.is_keyframe]
    for update in updates:
        assert set(update.keyframes) <= set(update.keyframe_poses)
        assert set(update.keyframes) == set(update.keyframe_depths)
        assert not set(update.held) & set(update.keyframes)
    for earlier, later in pairwise(updates):
        assert set(later.keyframes) - {later.index} <= {*earlier.held, earlier.index}


def test_a_back_end_that_is_waited_for_gives_the_same_bytes():
    plain, beside = Odometry(CAMERA, OPTIONS), ThreadedOdometry(Odometry(CAMERA, OPTIONS), AtOnce())
    for one, other in zip(follow(plain), follow(beside), strict=True):
        assert (one.status, one.keyframes, one.held, one.segment) == (
            other.status, other.keyframes, other.held, other.segment,
        )  # fmt: skip
        assert (one.T_world_camera is None) == (other.T_world_camera is None)
        np.testing.assert_array_equal(one.T_world_camera, other.T_world_camera)
        assert one.keyframe_poses.keys() == other.keyframe_poses.keys()
        for index, pose in one.keyframe_poses.items():
            np.testing.assert_array_equal(pose, other.keyframe_poses[index])
        for index, depths in one.keyframe_depths.items():
            np.testing.assert_array_equal(depths, other.keyframe_depths[index])
    assert beside.wait() is None and beside.untraced == 0
    plain.finish()
    beside.finish()
    first, second = plain.result(), beside.result()
    for one, other in zip(first.frames, second.frames, strict=True):
        np.testing.assert_array_equal(one.T_world_camera, other.T_world_camera)
    np.testing.assert_array_equal(first.points.position, second.points.position)


def test_with_a_thread_every_frame_is_tracked():
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS))
    updates = follow(odometry)
    last = odometry.wait()
    odometry.finish()
    result = odometry.result()
    check_tracked(result)
    check_keyframes([*updates, *([last] if last else [])], result)


@pytest.mark.parametrize("lag", [1, 3, 6])
def test_a_back_end_that_lags_makes_keyframes_later(lag):
    executor = Waiting(lag)
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS), executor)
    updates = follow(odometry)
    last = odometry.wait()
    odometry.finish()
    check_tracked(odometry.result())
    check_keyframes([*updates, *([last] if last else [])], odometry.result())
    begun = next(k for k, update in enumerate(updates) if update.keyframes)
    late = [update.index - index for update in updates[begun + 1 :] for index in update.keyframes]
    assert set(late) == {lag}
    assert odometry.untraced == 0


def test_no_more_frames_wait_than_the_bounds_say(monkeypatch):
    monkeypatch.setattr(side_by_side, "_MOST_TRACED", 2)
    monkeypatch.setattr(side_by_side, "_MOST_QUEUED", 4)
    executor = Waiting(lag=100)
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS), executor)
    traced = []
    trace = BackEnd.trace
    monkeypatch.setattr(BackEnd, "trace", lambda *work: (traced.append(work[2].frame.index), trace(*work))[1])
    updates = follow(odometry)
    odometry.finish()
    assert executor.most <= 4
    assert odometry.untraced > 0
    tracked = [update.index for update in updates if update.status is Status.TRACKED][1:]  # but the one that begins
    assert len(traced) == len(tracked) - odometry.untraced
    check_tracked(odometry.result(), rms=0.01)


def test_a_frame_that_needs_the_keyframe_under_way_waits_for_it():
    """Without it nothing is in view that is mapped, or too little."""
    executor = Waiting(lag=100)
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS), executor)
    follow(odometry, range(20))
    update = odometry.process(np.full(CAMERA.shape, 0.5, np.float32), 1.0, 30)
    assert update.status is Status.LOST
    assert not executor.jobs
    assert update.keyframes and set(update.keyframes) <= set(update.keyframe_poses)


def test_what_goes_wrong_beside_is_raised_by_every_later_call(monkeypatch):
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS))
    follow(odometry, range(14))
    assert odometry.result().frames

    def broken(*work):
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(BackEnd, "trace", broken)
    with pytest.raises(ZeroDivisionError, match="broken"):
        follow(odometry, range(14, FRAMES))
        odometry.wait()
    monkeypatch.undo()
    with pytest.raises(ZeroDivisionError, match="broken"):
        odometry.process(image(25), 2.0, 40)
    with pytest.raises(ZeroDivisionError, match="broken"):
        odometry.result()
    with pytest.raises(ZeroDivisionError, match="broken"):
        odometry.finish()


def test_a_refused_frame_changes_nothing():
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS), Waiting(lag=3))
    follow(odometry, range(16))
    with pytest.raises(InputError, match="does not fit"):
        odometry.process(np.zeros((3, 3), np.float32), 1.0, 30)
    follow(odometry, range(16, FRAMES))
    odometry.finish()
    check_tracked(odometry.result())


def test_images_may_be_overwritten_once_they_were_taken():
    plain, beside = (ThreadedOdometry(Odometry(CAMERA, OPTIONS), Waiting(lag=4)) for _ in range(2))
    follow(plain)
    buffer = np.empty(CAMERA.shape, np.float32)
    for k in range(FRAMES):
        buffer[:] = image(k)
        beside.process(buffer, k / 30, k)
        buffer[:] = 0.0
    for odometry in (plain, beside):
        odometry.finish()
    for one, other in zip(plain.result().frames, beside.result().frames, strict=True):
        np.testing.assert_array_equal(one.T_world_camera, other.T_world_camera)


def told_until_start() -> tuple[ThreadedOdometry, Waiting, list[OdometryUpdate]]:
    """Odometry in whose executor the job waits that will begin a map, with the second keyframe as the latest frame."""
    plain = Odometry(CAMERA, OPTIONS)
    second = next(k for k in range(FRAMES) if plain.process(image(k), k / 30, k).keyframes)
    executor = Waiting(told=True)
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS), executor)
    updates = []
    for k in range(second):
        updates += follow(odometry, [k])
        executor.do_all()
    return odometry, executor, [*updates, *follow(odometry, [second])]


def finished(odometry: ThreadedOdometry, executor: Waiting, updates: list[OdometryUpdate]) -> OdometryResult:
    """The result after the last jobs, and all keyframes told."""
    last = odometry.wait()
    odometry.finish()
    assert not executor.jobs
    result = odometry.result()
    check_keyframes([*updates, *([last] if last else [])], result)
    return result


def test_frames_that_come_during_a_start_wait_and_are_tracked_after_it():
    odometry, executor, updates = told_until_start()
    second = updates[-1].index
    during = range(second + 1, second + 6)
    updates += follow(odometry, during)
    assert {update.status for update in updates} == {Status.STARTING}
    assert {0, *range(second, second + 5)} <= set(updates[-1].held)
    assert [isinstance(job, StartWork) for _, _, job in executor.jobs] == [True]
    executor.do_all()
    after = follow(odometry, [during.stop])
    assert after[0].status is Status.STARTING  # two of the five before it are tracked now
    assert after[0].keyframes == (0, second)
    executor.do_all()
    after += follow(odometry, range(during.stop + 1, FRAMES))
    assert {update.status for update in after[1:3]} == {Status.STARTING}
    assert {update.status for update in after[3:]} == {Status.TRACKED}
    result = finished(odometry, executor, [*updates, *after])
    check_tracked(result)
    assert result.without_pose == ()


def test_a_back_end_that_is_behind_does_not_keep_frames_from_being_tracked(monkeypatch):
    """They are not traced, and soon frames have poses as they come."""
    monkeypatch.setattr(side_by_side, "_MOST_TRACED", 2)
    odometry, executor, updates = told_until_start()
    updates += follow(odometry, range(updates[-1].index + 1, updates[-1].index + 6))
    executor.do_all()
    after = follow(odometry, range(updates[-1].index + 1, FRAMES))
    assert Status.STARTING not in {update.status for update in after[3:]}
    result = finished(odometry, executor, [*updates, *after])
    assert odometry.untraced > 0
    check_tracked(result, rms=0.02)


def test_no_more_images_wait_for_a_start_than_the_bound_says(monkeypatch):
    monkeypatch.setattr(side_by_side, "_MOST_WAITING", 4)
    executor = Waiting(told=True)
    inner = Odometry(CAMERA, OPTIONS)
    odometry = ThreadedOdometry(inner, executor)
    updates, waiting = [], []
    for k in range(FRAMES):
        updates += follow(odometry, [k])
        waiting.append(inner.waiting)
    assert max(waiting) == 4
    check_tracked(finished(odometry, executor, updates), rms=0.01)


def test_nothing_that_came_before_a_start_is_lost_when_there_is_no_more():
    odometry, executor, updates = told_until_start()
    second = updates[-1].index
    updates += follow(odometry, range(second + 1, second + 4))
    check_tracked(finished(odometry, executor, updates), range(second + 4), rms=0.02)


def test_what_goes_wrong_in_a_start_is_raised_by_every_later_call(monkeypatch):
    odometry, executor, _ = told_until_start()

    def broken(*work):
        raise ZeroDivisionError("broken")

    monkeypatch.setattr(Starter, "add", broken)
    executor.do_all()
    for call in (lambda: odometry.process(image(25), 2.0, 40), odometry.wait, odometry.result, odometry.finish):
        with pytest.raises(ZeroDivisionError, match="broken"):
            call()


def test_a_map_that_is_found_again_goes_on_though_a_start_is_under_way():
    """The start is given up, and what it would have begun."""
    odometry, executor, updates = told_until_start()
    executor.do_all()
    updates += follow(odometry, range(updates[-1].index + 1, 16))
    odometry.wait()
    blank = np.full(CAMERA.shape, 0.5, np.float32)
    lost = odometry.process(blank, 16 / 30, 100)
    assert lost.status is Status.LOST
    assert any(isinstance(job, StartWork) for _, _, job in executor.jobs)
    again = [odometry.process(image(k), 1.0 + k / 30, 200 + k) for k in range(16, FRAMES)]
    assert {update.status for update in again} == {Status.TRACKED}
    executor.do_all()
    odometry.finish()
    result = odometry.result()
    assert result.segments == (0,)
    assert [index for index, _ in result.without_pose] == [100]


@pytest.mark.parametrize("patience", [60, 3])
def test_a_new_map_begins_beside_the_frames_that_come(monkeypatch, patience):
    """From one frame on the room is mirrored; with little patience the first map is given up before."""
    monkeypatch.setattr(odometry_module, "_PATIENCE", patience)
    images = [image(k) for k in range(16)] + [np.ascontiguousarray(image(k)[:, ::-1]) for k in range(FRAMES)]
    plain = Odometry(CAMERA, OPTIONS)
    expected = [plain.process(each, k / 30, k) for k, each in enumerate(images)]
    second = next(update.index for update in expected if update.keyframes and update.segment == 1)
    executor = Waiting(told=True)
    odometry = ThreadedOdometry(Odometry(CAMERA, OPTIONS), executor)
    updates = []
    for k, each in enumerate(images):
        updates.append(odometry.process(each, k / 30, k))
        if not second <= k < second + 4:
            executor.do_all()
    during = updates[second : second + 6]
    assert all(update.T_world_camera is None for update in during)
    assert [update.segment for update in during] == [0, 0, 0, 0, 0, 1]
    assert during[-1].keyframes == (16, second) == tuple(during[-1].keyframe_poses)
    result = finished(odometry, executor, updates)
    plain.finish()
    assert [frame.index for frame in result.frames] == [frame.index for frame in plain.result().frames]
    assert [frame.segment for frame in result.frames] == [frame.segment for frame in plain.result().frames]
    assert {frame.segment for frame in result.frames} == {0, 1}
    assert set(result.points.segment) == {0, 1}
