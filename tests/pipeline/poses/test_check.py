"""Which poses of a trajectory are left out, and where it falls into pieces."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import turned

from polarmap.pipeline.poses.check import judge_poses

RATE = 30.0


def walk(count: int = 60, step: float = 0.024, rate: float = RATE, noise: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """Times and poses of a camera that walks along a bent path and turns slowly."""
    poses = np.array(
        [turned((0.01, 0.004 * i + 1e-9, 0.0), (step * i, 0.3 * np.sin(0.05 * i), 1.0)) for i in range(count)]
    )
    poses[:, :3, 3] += noise * np.random.default_rng(0).standard_normal((count, 3))
    return np.arange(count) / rate, poses


def left_out(times, poses) -> list[int]:
    return [i for i, reason in enumerate(judge_poses(times, poses).reasons) if reason]


JUMPS = {"10 km": 1e4, "1 m": 1.0, "20 cm": 0.2}


@pytest.mark.parametrize("size", JUMPS)
@pytest.mark.parametrize("position", [0, 1, 6, 30, 58, 59])
@pytest.mark.parametrize("direction", [0, 1, 2])
def test_one_pose_that_jumps_is_left_out(size, position, direction):
    times, poses = walk()
    poses[position, direction, 3] += JUMPS[size]
    judged = judge_poses(times, poses)
    assert left_out(times, poses) == [position] and not judged.pieces.any()
    units = {"10 km": ["10.0 km"], "1 m": ["m", "cm"], "20 cm": ["cm"]}[size]
    assert judged.reasons[position].startswith("the pose jumps by") and judged.reasons[position].endswith("in 0.03 s")
    assert any(f"{unit} in" in judged.reasons[position] for unit in units)


@pytest.mark.parametrize("position", [0, 20, 59])
def test_one_pose_that_turns_is_left_out(position):
    times, poses = walk()
    poses[position] = poses[position] @ turned((0.0, 0.0, 0.3))
    assert left_out(times, poses) == [position]
    assert judge_poses(times, poses).reasons[position] == "the pose turns by 17 degrees in 0.03 s"


@pytest.mark.parametrize("length", [2, 5, 9])
@pytest.mark.parametrize("kind", ["shifted", "wandering"])
def test_a_burst_is_left_out_and_nothing_else(length, kind):
    times, poses = walk()
    wander = np.random.default_rng(1).uniform(-1.0, 1.0, (length, 3)) if kind == "wandering" else 0.0
    poses[20 : 20 + length, :3, 3] += np.array([2.0, 1.0, 0.0]) + wander
    judged = judge_poses(times, poses)
    assert left_out(times, poses) == list(range(20, 20 + length)) and not judged.pieces.any()
    assert len({judged.reasons[i] for i in range(20, 20 + length)}) == 1


@pytest.mark.parametrize("count", [6, 8, 12, 20])
def test_few_poses_tell_of_a_jump_too(count):
    times, poses = walk(count)
    poses[3, 0, 3] += 1.0
    assert left_out(times, poses) == [3]


def test_several_single_jumps_are_left_out():
    times, poses = walk(120)
    poses[[10, 40, 41, 90], 1, 3] += [3.0, -2.0, 5.0, 0.5]
    assert left_out(times, poses) == [10, 40, 41, 90]


@pytest.mark.parametrize("size", [0.3, 1.0, 1e4])
def test_a_jump_that_lasts_begins_a_piece(size):
    times, poses = walk()
    poses[25:, 0, 3] += size
    judged = judge_poses(times, poses)
    assert left_out(times, poses) == []
    np.testing.assert_array_equal(judged.pieces, np.arange(60) >= 25)


def still_then_moving(count=90):
    """Stands, walks off within two frames, and stands again; with jitter of a millimetre."""
    times, poses = walk(count, 0.0, noise=1e-3)
    speed = np.zeros(count)
    speed[30:60] = 0.05
    poses[:, 0, 3] += np.cumsum(speed)
    return times, poses


def lost_frames():
    times, poses = walk(90)
    keep = np.r_[0:20, 45:60, 62:90]
    return times[keep], poses[keep]


def zigzag():
    """Every frame from the other side, as pictures for photogrammetry are at times taken."""
    times, poses = walk()
    poses[::2, 1, 3] += 0.5
    return times, poses


def shake():
    """A fast movement to and fro, three frames each way."""
    times, poses = walk()
    poses[30:37, 1, 3] += 0.15 * np.array([1, 2, 3, 3, 2, 1, 0])
    return times, poses


def scaled(factor):
    times, poses = walk()
    poses[:, :3, 3] *= factor
    return times, poses


LEGITIMATE = {
    "walk": walk(),
    "noisy": walk(noise=2e-3),
    "fast": walk(step=0.5),
    "200 Hz": walk(400, 0.004, 200.0),
    "5 Hz": walk(30, 0.15, 5.0),
    "still": walk(step=0.0),
    "stop and go": still_then_moving(),
    "lost frames": lost_frames(),
    "zigzag": zigzag(),
    "shake": shake(),
    "kilometres": scaled(1e-3),
    "millimetres": scaled(1e3),
    "few": walk(4),
    "one": walk(1),
}


@pytest.mark.parametrize("kind", LEGITIMATE)
def test_real_motion_is_kept(kind):
    assert judge_poses(*LEGITIMATE[kind]).sound


def test_far_from_the_origin_rounding_is_no_jump():
    times, poses = walk(step=0.0)
    poses[:, :3, 3] += [4.5e5, 5.2e6, 100.0]
    assert judge_poses(times, poses).sound
    poses[30, 0, 3] += 1.0
    assert left_out(times, poses) == [30]


def test_a_long_trajectory_is_judged_as_a_short_one():
    times, poses = walk(6000, 0.004, 200.0)
    poses[777, 1, 3] += 0.3
    poses[5000:5004, 0, 3] -= 2.0
    assert left_out(times, poses) == [777, 5000, 5001, 5002, 5003]
