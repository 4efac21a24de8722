"""Whether the poses of an RGB-D recording fit its depth: points carried from one frame to another must meet it."""

from __future__ import annotations

import numpy as np

from polarmap.geometry.pose import inverse
from polarmap.geometry.warp import transfer_depth
from polarmap.io.recording.rgbd.recording import RgbdSequence

_PAIRS = 4
_GAP = 10  # frames between the two of a pair


def reprojection_error(sequence: RgbdSequence, poses: np.ndarray | None = None) -> float:
    """Median distance in metres between depth carried into another frame and the depth found there.

    Over a few pairs of frames some ten apart, spread over the sequence; NaN where there is one frame only or nothing
    overlaps. poses: used in place of the sequence's own, T_world_camera N×4×4.
    """
    poses = sequence.poses if poses is None else poses
    gap = min(_GAP, len(sequence) - 1)
    if gap < 1:
        return float("nan")
    firsts = np.unique(np.linspace(0, len(sequence) - 1 - gap, _PAIRS).round().astype(int))
    differences = [_differences(sequence, poses, int(first), int(first) + gap) for first in firsts]
    found = np.concatenate(differences)
    return float(np.median(found)) if found.size else float("nan")


def _differences(sequence: RgbdSequence, poses: np.ndarray, first: int, second: int) -> np.ndarray:
    depth, other = sequence.read_depth(first), sequence.read_depth(second)
    T_second_first = inverse(poses[second]) @ poses[first]
    expected, found = transfer_depth(depth, other, sequence.camera, T_second_first)
    difference = np.abs(expected - found)
    return difference[np.isfinite(difference)]
