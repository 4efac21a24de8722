"""Given poses: which frames have none, and why."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pytest

from polarmap.data.camera_file import CameraFile
from polarmap.data.codes import Status
from polarmap.data.frame import Frame
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.data.trajectory import Trajectory
from polarmap.geometry.camera import PinholeCamera
from polarmap.pipeline.mapper import Mapper
from polarmap.pipeline.poses.given import GivenPoses

CAMERA_FILE = CameraFile(
    PinholeCamera(8, 6, 8.0, 8.0, 3.5, 2.5), SensorLayout.SONY_POLARSENS, AngleDirection.CLOCKWISE, 8
)


@pytest.fixture
def ten_hertz():
    """Poses from 0.2 to 2 s, ten a second, but none at 1.0, 1.1 and 1.2 s."""
    times = np.delete(np.arange(2, 21), [8, 9, 10]) / 10
    return Trajectory(times, np.tile(np.eye(4), (len(times), 1, 1)))


def test_frames_without_a_pose_say_why(ten_hertz):
    mapper = Mapper(CAMERA_FILE, GivenPoses(ten_hertz.at, ten_hertz.why_unknown))
    reasons: Counter[str] = Counter()
    for i in range(66):
        if ten_hertz.at(i / 30) is None:
            mapper.process(Frame(i, i / 30, f"{i}", Path(f"{i}.png")))  # its picture is not looked at
            assert mapper.tracked.status is Status.LOST and mapper.tracked.T_world_camera is None
            reasons[mapper.tracked.reason] += 1
    assert reasons == {
        "its time is outside the trajectory's times": 6 + 5,
        "its time is in a gap of the trajectory": 11,
    }
    assert mapper.finish().frames == 22


def test_without_a_trajectory_there_is_still_a_reason():
    assert GivenPoses(lambda time: None).unseen(1.0).reason == "no pose is given at its time"
