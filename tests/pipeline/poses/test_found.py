"""Poses by odometry whose keyframes come late: each is a candidate once, with its own picture."""

from __future__ import annotations

import numpy as np
from odometry_scenes import CAMERA, OPTIONS, image_of, motion

from polarmap.odometry.odometry import Odometry
from polarmap.odometry.side_by_side import ThreadedOdometry
from polarmap.pipeline.poses.found import OdometryPoses

FRAMES = 24


class Seen:
    """A frame of the room, as far as odometry looks at one."""

    def __init__(self, index: int) -> None:
        self.index, self.timestamp, self.exposure = index, index / 30, float("nan")

    @property
    def grey(self) -> np.ndarray:
        k = self.index
        return image_of(motion(0.035 * k, 0.01 * k, 0.02 * k, 0.0, 0.012 * k, 0.0), noise=0.5, seed=k)


def told(odometry) -> tuple[list[int], set[int], OdometryPoses]:
    """Indices of all candidates in the order in which they came, and of the keyframes that became final."""
    source = OdometryPoses(odometry)
    updates = [source.update(Seen(index)) for index in range(FRAMES)]
    rest = source.rest()
    updates += [] if rest is None else [rest]
    candidates = [candidate for update in updates for candidate in update.candidates]
    for candidate in candidates:
        assert candidate.frame.index == candidate.index and candidate.T_world_camera.shape == (4, 4)
        assert len(candidate.known) > 50 and (candidate.known > 0).all()
    return [candidate.index for candidate in candidates], set().union(*(u.final for u in updates)), source


def test_keyframes_that_come_late_are_candidates_with_their_own_pictures():
    candidates, final, source = told(ThreadedOdometry(Odometry(CAMERA, OPTIONS)))
    frames = source.finish()
    assert candidates == [frame.index for frame in frames if frame.is_keyframe]
    assert len(candidates) > 4 and final < set(candidates)
    assert len(source._held) <= 2


def test_odometry_that_does_all_at_once_has_nothing_left_to_tell():
    candidates, _, source = told(Odometry(CAMERA, OPTIONS))
    assert source.rest() is None
    assert candidates == [frame.index for frame in source.finish() if frame.is_keyframe]
