"""Where odometry has no poses."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import groupby

from polarmap.data.odometry import OdometryResult


@dataclass(frozen=True)
class Gap:
    """Frames one after the other that have no pose, by index of the first and the last, all for the same reason."""

    first: int
    last: int
    frames: int
    reason: str


def gaps(result: OdometryResult) -> tuple[Gap, ...]:
    """Where the trajectory has gaps, in order of time."""
    reasons = dict.fromkeys((frame.index for frame in result.frames), "") | dict(result.without_pose)
    runs = [(reason, list(items)) for reason, items in groupby(sorted(reasons.items()), key=lambda item: item[1])]
    posed = {frame.index for frame in result.frames}
    return tuple(
        Gap(items[0][0], items[-1][0], len(items), reason) for reason, items in runs if items[0][0] not in posed
    )
