"""Times of frames from a camera's clock and from their arrival."""

from __future__ import annotations

import time
from itertools import pairwise

import pytest

from polarmap.io.cameras.camera_clock import CameraClock

MS = 1_000_000


def times(steps: list[tuple[int | None, float]], clock: CameraClock | None = None) -> list[int]:
    clock = clock or CameraClock("Fake 42")
    return [clock.time(*step) for step in steps]


def test_steps_are_those_of_the_camera_and_the_beginning_is_now():
    came = time.perf_counter()
    late = [0.0, 0.012, 0.001, 0.4, 0.4]  # the last two came late, one after the other
    found = times([(7_000 + 33 * MS * i, came + 0.033 * i + late[i]) for i in range(5)])
    assert [b - a for a, b in pairwise(found)] == [33 * MS] * 4
    assert abs(found[0] - time.time_ns()) < 1000 * MS


def test_a_clock_that_is_set_by_the_network_is_taken_as_it_is():
    now = time.time_ns() + 37_000 * MS  # TAI
    assert times([(now, time.perf_counter()), (now + 5 * MS, time.perf_counter())]) == [now, now + 5 * MS]


@pytest.mark.parametrize("jump", [-1_000 * MS, 3_600_000 * MS, -(10**18)])
def test_a_clock_that_jumps_is_said_once_and_bridged_by_arrival(jump, caplog):
    clock, came = CameraClock("Fake 42"), 100.0
    steps = [
        (2 * 10**18 + 33 * MS * i + (jump if i >= 3 else 0) + (jump if i >= 5 else 0), came + 0.033 * i)
        for i in range(8)
    ]
    found = times(steps, clock)
    assert all(20 * MS < b - a < 50 * MS for a, b in pairwise(found))
    assert clock.jumps == 2 and caplog.text.count("clock jumped") == 1


def test_without_a_clock_arrival_counts_which_is_said_once(caplog):
    found = times([(None, 10.0), (None, 10.03), (None, 10.03), (None, 10.1)])
    assert found[1] - found[0] == pytest.approx(30 * MS, abs=2)
    assert found[2] == found[1] + 1 and caplog.text.count("tells no times") == 1


def test_when_is_that_of_the_fastest_frame():
    clock = CameraClock("Fake 42")
    late = [0.02, 0.005, 0.03]
    found = times([(10**15 + 100 * MS * i, 50 + 0.1 * i + late[i]) for i in range(3)], clock)
    assert [clock.when(t) for t in found] == pytest.approx([50.005, 50.105, 50.205], abs=1e-4)
