from __future__ import annotations

import pytest
from room_recording import FILE, raw, recorded_room

from polarmap.data.trajectory import Trajectory
from polarmap.pipeline.mapper import Mapper
from polarmap.report.keyframe_pictures import picture_ranges


@pytest.fixture(scope="session")
def room_run():
    """The keyframes of a small rendered room, and its map."""
    recording, keyframes = recorded_room(frames=16), []
    trajectory = Trajectory(list(recording.poses), list(recording.poses.values()))
    mapper = Mapper(FILE, trajectory, on_keyframe=keyframes.append)
    for frame in recording.frames:
        mapper.process(raw(frame))
    return keyframes, mapper.finish()


@pytest.fixture
def mapped_keyframe(room_run):
    return room_run[0][-1]


@pytest.fixture
def ranges(mapped_keyframe):
    return picture_ranges(mapped_keyframe)
