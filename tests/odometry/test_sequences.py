"""Odometry on the recorded sequences beside the repository, against their true poses."""

from __future__ import annotations

import importlib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from polarmap.data.odometry import OdometryResult
from polarmap.evaluation.alignment import umeyama
from polarmap.odometry.odometry import Odometry

BENCHMARKS = Path(__file__).resolve().parents[2] / "benchmarks"


@pytest.fixture
def video(shared_data, monkeypatch):
    """Makes a recorded sequence from its name, the frames of it to take, and what to do with their order."""
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    videos = importlib.import_module("videos")

    def make(name: str, frames: slice):
        whole = videos.load(shared_data, name)
        return replace(whole, sequence=whole.sequence[frames])

    return make


def track(video) -> OdometryResult:
    odometry = Odometry(video.camera)
    for index, timestamp, image in video.images():
        odometry.process(image, timestamp, index)
    odometry.finish()
    return odometry.result()


def errors(video, result: OdometryResult) -> np.ndarray:
    """Distance of each frame from its true position, metres, after the best similarity."""
    positions = video.positions
    frames = [frame for frame in result.frames if frame.index in positions]
    found = np.array([frame.T_world_camera[:3, 3] for frame in frames])
    true = np.array([positions[frame.index] for frame in frames])
    return np.linalg.norm(umeyama(found, true).apply(found) - true, axis=1)


@pytest.mark.parametrize(
    ("name", "frames", "rms", "worst"),
    [
        ("office450", slice(250, 330), 0.002, 0.004),
        pytest.param("office450", slice(0, 120), 0.003, 0.007, marks=pytest.mark.slow),
        pytest.param("office450", slice(120, 0, -3), 0.002, 0.004, marks=pytest.mark.slow),
        pytest.param("redwood", slice(0, 80), 0.004, 0.008, marks=pytest.mark.slow),
        pytest.param("livingroom", slice(None), 0.003, 0.012, marks=pytest.mark.slow),
        pytest.param("livingroom", slice(None, None, -2), 0.0015, 0.003, marks=pytest.mark.slow),
    ],
)
def test_every_frame_is_tracked_in_one_piece_and_close_to_the_truth(video, name, frames, rms, worst):
    """rms, worst: gates in metres, about twice what was measured."""
    recorded = video(name, frames)
    result = track(recorded)
    assert result.segments == (0,)
    assert len(result.frames) == recorded.count
    error = errors(recorded, result)
    assert np.sqrt(np.mean(error**2)) < rms
    assert error.max() < worst
