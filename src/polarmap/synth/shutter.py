"""Motion blur: where the camera is while the shutter is open."""

from __future__ import annotations

import numpy as np

from polarmap.geometry.lie import se3_exp, se3_log
from polarmap.geometry.pose import inverse


def shutter_poses(poses: np.ndarray, index: int, shutter: float, count: int) -> np.ndarray:
    """T_world_camera at `count` moments spread evenly over the open shutter of frame `index`, float64 count×4×4.

    poses: T_world_camera of the frames, N×4×4. shutter: share of the interval between frames, centred on the frame.
    Between frames the camera moves along the screw that takes one pose to the next; before the first and after the
    last it keeps its motion. One moment, or a single frame, gives the frame's own pose.
    """
    shares = shutter * ((np.arange(count) + 0.5) / count - 0.5)
    before, after = _motions(np.asarray(poses, float), index)
    steps = [se3_exp(share * (after if share >= 0 else before)) for share in shares]
    return np.stack([poses[index] @ step for step in steps])


def _motions(poses: np.ndarray, index: int) -> tuple[np.ndarray, np.ndarray]:
    """Motion per interval from the frame before and to the frame after, increments in the camera's frame."""
    here, last = poses[index], len(poses) - 1
    before = -se3_log(inverse(here) @ poses[index - 1]) if index > 0 else None
    after = se3_log(inverse(here) @ poses[index + 1]) if index < last else None
    still = np.zeros(6)
    if before is None:
        before = still if after is None else after
    return before, before if after is None else after
