"""Over which depths stereo searched for a keyframe, and how much of what it found lies at the ends."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class DepthSearch:
    """near, far: the range that was searched, z in metres (or units of the poses).

    at_near, at_far: share of the well matched pixels whose depth lies at that end of it, from 0 to 1.
    """

    near: float
    far: float
    at_near: float = 0.0
    at_far: float = 0.0
