"""Which stereo depths can be defended: by their own match, and by the depth maps of other keyframes."""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from polarmap.data.plane_field import PlaneField
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.warp import transfer_depth
from polarmap.stereo.options import ConsistencyOptions, InlierOptions


def photometric_filter(planes: PlaneField, options: ConsistencyOptions | None = None) -> np.ndarray:
    """Depth of the pixels whose match is good and well localized, float32 H×W, NaN elsewhere."""
    options = options or ConsistencyOptions()
    before = planes.inverse_depth > 0  # a plane taken over from a coarser level may reach behind the camera
    depth = np.divide(1.0, planes.inverse_depth, out=np.full_like(planes.inverse_depth, np.nan), where=before)
    kept = (planes.score > options.min_score) & (planes.sigma * depth < options.max_relative_sigma)
    depth = np.where(kept, depth, np.float32(np.nan))
    return drop_islands(depth, options.min_region, options.max_step)


def drop_islands(depth: np.ndarray, min_region: int, max_step: float) -> np.ndarray:
    """Remove connected regions of smooth depth with fewer than `min_region` pixels.

    Neighbours belong together where their depths differ by less than `max_step` of the depth.
    """
    steps_per_unit = 8.0 / max_step
    none = -32768
    levels = np.full(depth.shape, none, np.int16)
    known = np.isfinite(depth)
    log_depth = np.log(depth[known])
    levels[known] = np.clip((log_depth - np.median(log_depth)) * steps_per_unit if known.any() else 0, -32000, 32000)
    cv2.filterSpeckles(levels, none, min_region - 1, 8)
    return np.where(levels == none, np.float32(np.nan), depth)


def agreement(
    depth: np.ndarray,
    others: Sequence[tuple[np.ndarray, np.ndarray]],
    camera: PinholeCamera,
    tolerance: np.ndarray | float,
) -> tuple[np.ndarray, np.ndarray]:
    """Count the views that see each point: (agreeing, disagreeing), uint8 H×W each.

    others: (depth map, T_other_this) pairs. tolerance: largest |difference| of depth, in its unit.
    A view that has no depth there says nothing.
    """
    agreeing = np.zeros(depth.shape, np.uint8)
    disagreeing = np.zeros(depth.shape, np.uint8)
    for other_depth, T_other_this in others:
        expected, found = transfer_depth(depth, other_depth, camera, T_other_this)
        close = np.abs(expected - found) <= tolerance
        agreeing += close
        disagreeing += np.isfinite(found) & ~close
    return agreeing, disagreeing


def inliers(
    depth: np.ndarray,
    score: np.ndarray,
    others: Sequence[tuple[np.ndarray, np.ndarray]],
    camera: PinholeCamera,
    options: InlierOptions | None = None,
) -> np.ndarray:
    """Stereo points that another keyframe confirms, or that match well and none contradicts.

    depth, score: float32 H×W, of `photometric_filter` and stereo. others: (depth map, T_other_this) of keyframes
    that are done. Returns float32 H×W, NaN where rejected.
    """
    options = options or InlierOptions()
    agreeing, disagreeing = agreement(depth, others, camera, options.tolerance * depth)
    unseen = (agreeing == 0) & (disagreeing == 0) & (score > options.min_score_unseen)
    return np.where((agreeing > 0) | unseen, depth, np.float32(np.nan))
