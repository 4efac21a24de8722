"""Which earlier keyframes are remembered, which are asked about a view, and that its depth hears of them."""

from __future__ import annotations

from concurrent.futures import Future
from dataclasses import replace

import numpy as np
import pytest
from room_recording import FILE, Recording, raw, recorded_room
from scenes import WIDE, moved, turned

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.trajectory import Trajectory
from polarmap.data.view import View, Witness
from polarmap.densify.surfaces.method import BySurfaces
from polarmap.geometry.sim3 import Sim3
from polarmap.pipeline.config import Config
from polarmap.pipeline.keyframe_depth import DepthJob
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.witnesses import Witnesses

DEPTH = 2.0  # of a wall that all look at, at z = 2 in the world
KEPT, CALLED = 32, 10


def witness(index: int, T_world_camera: np.ndarray, depth: float = DEPTH) -> Witness:
    return Witness(np.full((30, 40), depth, np.float32), T_world_camera, index)


def witnesses(*poses: np.ndarray) -> Witnesses:
    """Of keyframes 0, 1, 2, ..."""
    store = Witnesses(WIDE)
    for index, pose in enumerate(poses):
        store.add(witness(index, pose))
    return store


def view(T_world_camera: np.ndarray | None = None, depth: float | None = DEPTH) -> View:
    """At the origin if no pose is given; mapped, unless `depth` is None."""
    T = np.eye(4) if T_world_camera is None else T_world_camera
    mapped = None if depth is None else np.full(WIDE.shape, depth, np.float32)
    return View(PolarizationImage.unpolarized(np.ones(WIDE.shape, np.float32)), T, 1000, depth=mapped)


def called(store: Witnesses, of: View | None = None, last: View | None = None) -> list[int]:
    return [w.index for w in store.called(of or view(), last or view())]


def around(degrees: float) -> np.ndarray:
    """A camera that looks at the middle of the wall from a circle about it; the origin's is at 0 degrees."""
    R = turned((0.0, np.radians(degrees), 0.0))[:3, :3] if degrees else np.eye(3)
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, np.array([0.0, 0.0, DEPTH]) - R @ [0.0, 0.0, DEPTH]
    return T


def kept(store: Witnesses) -> list[int]:
    return [w.index for w in store._kept]


def test_as_many_are_kept_as_there_is_room_for():
    store = Witnesses(WIDE)
    for index in range(3 * KEPT):
        store.add(witness(index, moved(0.1 * index)))
        assert len(store) == min(index + 1, KEPT)
        assert kept(store)[-1] == index  # the newest always


def test_of_two_that_see_the_same_from_the_same_place_one_goes():
    poses = [moved(0.2 * i) for i in range(KEPT)]
    poses[12] = moved(0.2 * 11 + 0.01)
    store = witnesses(*poses, moved(0.0, 2.0))
    assert len({11, 12} & set(kept(store))) == 1
    assert set(range(KEPT + 1)) - set(kept(store)) < {11, 12}


def test_what_the_newest_repeats_goes():
    store = witnesses(*(moved(0.2 * i) for i in range(KEPT)), moved(0.2 * 20 + 0.01))
    assert kept(store) == [i for i in range(KEPT + 1) if i != 20]
    store.add(witness(KEPT + 1, moved(0.2 * 5 + 0.01), 2 * DEPTH))  # it sees farther, so it is less apart itself
    assert kept(store) == [i for i in range(KEPT + 2) if i not in (5, 20)]


def test_from_one_place_views_of_other_directions_are_not_the_same():
    """Turned by 6 degrees each, but for one by 1 degree only."""
    poses = [turned((0.0, np.radians(6.0 * (i + 1)), 0.0)) for i in range(KEPT)]
    store = witnesses(*poses, turned((0.0, np.radians(6.0 * 8 + 1.0), 0.0)))
    assert kept(store) == [i for i in range(KEPT + 1) if i != 7]


def test_what_is_far_away_looks_the_same_from_farther_apart():
    """Two of a near wall, and two of a distant one from places twice as far apart."""
    store = witnesses(*(moved(0.0, 2.0 * i) for i in range(KEPT - 4)))
    for index, (x, depth) in enumerate([(10.0, 1.0), (10.2, 1.0), (20.0, 100.0), (20.4, 100.0), (30.0, 1.0)]):
        store.add(witness(KEPT - 4 + index, moved(x), depth))
    gone = set(range(KEPT + 1)) - set(kept(store))
    assert gone < {KEPT - 2, KEPT - 1} and len(gone) == 1


def test_on_a_long_way_those_that_are_kept_are_spread_over_it():
    rng = np.random.default_rng(0)
    store = witnesses(*(moved(x) for x in np.sort(rng.uniform(0.0, 20.0, 120))))
    places = np.sort([w.T_world_camera[0, 3] for w in store._kept])
    assert places[0] < 1.0 and places[-1] > 19.0 and np.diff(places).max() < 2.0


def test_only_those_that_see_what_the_view_shows_are_called():
    """They stand aside, behind the wall, look away, and at 15 degrees of it."""
    away = turned((0.0, np.pi, 0.0))
    store = witnesses(moved(10.0), moved(0.0, 0.0, 2 * DEPTH), away, around(15.0), moved(0.3))
    assert sorted(called(store)) == [3, 4]


def test_a_tenth_of_what_the_view_shows_must_be_seen():
    """Shifted cameras that look at a wall at a depth of 2: the shared columns are 1 - fx x/(z width)."""
    shares = np.array([0.07, 0.2, 0.6])
    store = witnesses(*(moved((1 - share) * WIDE.width * DEPTH / WIDE.fx) for share in shares))
    assert sorted(called(store)) == [1, 2]


def test_what_the_view_shows_is_known_by_the_keyframe_before_it():
    store = witnesses(moved(0.3))
    assert not store.called(view(), None)
    assert called(store, last=view(depth=None)) == []
    unknown = replace(view(), depth=np.full(WIDE.shape, np.nan, np.float32))
    assert called(store, last=unknown) == []
    assert called(store, last=view(moved(5.0))) == []
    assert called(store, of=view(depth=None)) == [0]
    assert called(Witnesses(WIDE)) == []


def test_those_that_are_called_look_from_all_directions_that_there_are():
    """Thirty within 4 degrees beside the view, and two from elsewhere: both are called, and few of the thirty."""
    near = np.linspace(-4.0, 4.0, KEPT - 2)
    store = witnesses(*(around(degrees) for degrees in near), around(30.0), around(-45.0))
    found = called(store)
    assert len(found) == len(set(found)) == CALLED
    assert found[-1] == KEPT - 1 and abs(near[found[0]]) == np.abs(near).min()
    turns = np.abs([*near, 30.0, -45.0])[found]
    assert (np.diff(turns) >= 0).all()


def test_by_the_angle_every_few_are_called():
    angles = np.linspace(1.0, 30.0, 28)
    store = witnesses(*np.random.default_rng(2).permutation([around(degrees) for degrees in angles]))
    turns = sorted(np.degrees(np.arccos(w.T_world_camera[2, 2])) for w in store.called(view(), view()))
    np.testing.assert_allclose(turns, angles[::3], atol=1e-6)


def test_with_few_all_are_called():
    store = witnesses(*(around(degrees) for degrees in (20.0, -5.0, 10.0)))
    assert called(store) == [1, 2, 0]


def test_they_move_with_their_keyframes():
    store = witnesses(moved(0.3), moved(10.0), moved(0.5))
    growth = Sim3(1.5, np.eye(3), np.array([0.2, 0.0, 0.0]))
    store.move({1: growth, 77: Sim3.from_matrix(moved(9.0))})
    assert sorted(called(store)) == [0, 1, 2]
    found = {w.index: w for w in store.called(view(), view())}
    np.testing.assert_array_equal(found[1].T_world_camera, growth.rigid)
    np.testing.assert_array_equal(found[1].nearest, np.full((30, 40), 3.0, np.float32))
    np.testing.assert_array_equal(found[0].T_world_camera, moved(0.3))
    store.move({0: Sim3.from_matrix(moved(10.0))})
    assert sorted(called(store)) == [1, 2]


class Noted:
    """Does jobs at once, and keeps them."""

    def __init__(self) -> None:
        self.jobs: list[DepthJob] = []

    def submit(self, work, job) -> Future:
        self.jobs.append(job)
        done: Future = Future()
        done.set_result(work(job))
        return done


class Overheard:
    """The usual densification, which notes what it is told that others have seen."""

    def __init__(self) -> None:
        self.usual, self.sightings = BySurfaces(), []

    def __call__(self, sparse, clock):
        self.sightings.append(sparse.sightings)
        return self.usual(sparse, clock)


@pytest.fixture(scope="module")
def recording() -> Recording:
    return recorded_room()


@pytest.mark.parametrize("past", [1, 2])
def test_jobs_are_given_the_keyframes_that_are_no_neighbours_any_more(recording, past):
    jobs, heard, keyframes = Noted(), Overheard(), []
    config = Config().with_settings([f"stereo.past={past}"])
    poses = Trajectory(np.array(list(recording.poses)), np.array(list(recording.poses.values())))
    mapper = Mapper(FILE, poses, None, config, keyframes.append, densifier=heard, executor=jobs)
    for frame in recording.frames:
        mapper.process(raw(frame))
    mapper.finish()
    indices = [keyframe.index for keyframe in keyframes]
    assert len(indices) >= 4 and [job.view.index for job in jobs.jobs] == indices
    for position, (job, sightings) in enumerate(zip(jobs.jobs, heard.sightings, strict=True)):
        before = [v.index for v in job.neighbours if v.depth is not None]
        assert before == indices[max(position - past, 0) : position]
        assert sorted(w.index for w in job.witnesses) == indices[: max(position - past, 0)]
        assert len(sightings) == position  # of both, each once
        for w in job.witnesses:
            motion = np.linalg.inv(w.T_world_camera) @ job.view.T_world_camera
            assert any(np.allclose(s.T_other_this, motion, atol=1e-4) and s.nearest is w.nearest for s in sightings)
            assert np.isfinite(w.nearest).mean() > 0.2


def mapped(recording: Recording, **seams) -> Mapper:
    """With one neighbour before each keyframe; all frames are in, and the last keyframes wait."""
    poses = Trajectory(np.array(list(recording.poses)), np.array(list(recording.poses.values())))
    mapper = Mapper(FILE, poses, config=Config().with_settings(["stereo.past=1"]), **seams)
    for frame in recording.frames:
        mapper.process(raw(frame))
    return mapper


def test_a_loop_that_closes_moves_the_witnesses_of_its_segment(recording):
    segment = mapped(recording)._segment
    before = list(segment.witnesses._kept)
    assert before
    pose = Sim3(1.25, np.eye(3), np.array([0.1, 0.2, 0.3]))
    segment.move({w.index: replace(pose, translation=pose.translation + w.index) for w in before})
    for ours, w in zip(segment.witnesses._kept, before, strict=True):
        centred = pose.translation + w.index - recording.frames[0].T_world_camera[:3, 3]
        np.testing.assert_allclose(ours.T_world_camera[:3, 3], centred, atol=1e-6)
        np.testing.assert_array_equal(ours.nearest, np.float32(1.25) * w.nearest)


def test_a_new_segment_knows_nothing_of_the_witnesses_before(recording):
    mapper = mapped(recording)
    mapper.finish()
    assert len(mapper._segment.witnesses) >= 2
    assert len(mapper._new_segment(1).witnesses) == 0
