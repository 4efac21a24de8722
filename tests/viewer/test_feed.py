"""The thread between a run and its page."""

from __future__ import annotations

import logging
from threading import Event

import numpy as np

from polarmap.geometry.sim3 import Sim3
from polarmap.viewer.feed import Feed
from polarmap.viewer.watcher import Tracking


class Stub:
    """Takes down what it is told; holds the first call until it may go on."""

    def __init__(self, held: bool = False) -> None:
        self.go, self.entered = Event(), Event()
        self.tracked, self.positions, self.added, self.moved, self.maps = [], [], [], {}, []
        if not held:
            self.go.set()

    def track(self, tracking, positions):
        self.entered.set()
        assert self.go.wait(60)
        self.tracked.append(tracking)
        self.positions += positions

    def add(self, patch):
        self.added.append(patch.index)

    def move(self, index, pose):
        self.moved[index] = pose

    def show_map(self, result):
        self.maps.append(result)

    def refresh(self):
        pass


def tracking(x: float) -> Tracking:
    T = np.eye(4)
    T[0, 3] = x
    return Tracking(T, 0, 1)


def test_all_that_is_told_is_shown(room_run):
    keyframes, result = room_run
    stub = Stub()
    with Feed(stub) as feed:
        for i, keyframe in enumerate(keyframes[:4]):
            feed.frame(tracking(i))
            feed.keyframe(keyframe)
        feed.pose(keyframes[0].index, Sim3.from_matrix(np.eye(4)))
        feed.map(result)
    assert [position[0] for position in stub.positions] == [0, 1, 2, 3]
    assert stub.added == [keyframe.index for keyframe in keyframes[:4]]
    assert list(stub.moved) == [keyframes[0].index] and stub.maps == [result]


def test_a_run_never_waits_for_a_page_and_what_waits_is_bounded(mapped_keyframe):
    """The display is held by the test, which could not go on if any call waited for it."""
    stub = Stub(held=True)
    with Feed(stub) as feed:
        feed.frame(tracking(-1.0))
        assert stub.entered.wait(60)
        for i in range(10_000):
            feed.frame(tracking(i))
            feed.keyframe(mapped_keyframe)
        assert feed.not_shown == 10_000 - 8 and len(feed._keyframes) == 8 and len(feed._positions) <= 4096
        stub.go.set()
    assert stub.tracked[-1].T_world_camera[0, 3] == 9999
    assert len(stub.added) == 8


def test_a_page_that_fails_ends_no_run(mapped_keyframe, caplog):
    class Failing(Stub):
        def add(self, patch):
            raise ConnectionError("the browser has gone")

    with caplog.at_level(logging.WARNING), Feed(Failing()) as feed:
        feed.keyframe(mapped_keyframe)
        feed._thread.join(60)
        for i in range(100):
            feed.frame(tracking(i))
            feed.keyframe(mapped_keyframe)
            feed.pose(i, Sim3.from_matrix(np.eye(4)))
        assert not feed._poses
    assert caplog.text.count("the browser has gone") == 1
