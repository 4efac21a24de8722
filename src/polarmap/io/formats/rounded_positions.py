"""A word on trajectories whose positions were rounded far from the origin, as single precision or `%g` does."""

from __future__ import annotations

import logging

from polarmap.data.trajectory import Trajectory
from polarmap.geometry.origin import lost_precision

log = logging.getLogger(__name__)


def warn_of_rounding(trajectory: Trajectory) -> None:
    """Warn where a trajectory's positions have lost the digits that motion is in, see `lost_precision`."""
    step = lost_precision(trajectory.poses[:, :3, 3])
    if step:
        log.warning(
            "%s: its positions are whole multiples of %.3g along an axis: single precision or too few digits have "
            "rounded them; write them with more digits or as double",
            trajectory.source, step,
        )  # fmt: skip
