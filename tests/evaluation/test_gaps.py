"""Where a trajectory has gaps, and why."""

from __future__ import annotations

import numpy as np

from polarmap.data.odometry import OdometryResult
from polarmap.data.trajectory import PosedFrame
from polarmap.evaluation.gaps import Gap, gaps


def test_gaps_are_told_apart_by_reason():
    frames = tuple(PosedFrame(i, 0.1 * i, 0, np.eye(4), False) for i in (2, 3, 9))
    without = ((0, "dark"), (1, "dark"), (4, "blurred"), (6, "blurred"), (8, "dark"), (10, "dark"))
    result = OdometryResult(frames, None, without, {})
    assert gaps(result) == (
        Gap(0, 1, 2, "dark"),
        Gap(4, 6, 2, "blurred"),
        Gap(8, 8, 1, "dark"),
        Gap(10, 10, 1, "dark"),
    )
