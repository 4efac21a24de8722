"""Which views stereo uses, and over which depths it searches."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.stereo.options import StereoOptions

LARGEST_DISPARITY = 0.3  # of the image width
SMALLEST_DISPARITY = 0.25  # pixels
LEAST_BASELINE = 1e-6  # metres; nearer cameras have not moved
LEAST_SHARE = 0.1  # of the longest baseline; nearer cameras match at almost any depth


def useful_views(baselines: Sequence[float]) -> list[int]:
    """Which views have moved far enough to tell depth, for these distances from the reference in metres."""
    least = max(LEAST_BASELINE, LEAST_SHARE * max(baselines, default=0.0))
    return [i for i, baseline in enumerate(baselines) if baseline > least]


def search_range(baselines: Sequence[float], camera: PinholeCamera, options: StereoOptions) -> tuple[float, float]:
    """(nearest, farthest) depth in metres for these distances between the cameras.

    Nearer points would leave the other image, farther ones do not move by a quarter of a pixel. Only
    `useful_views` count, of which there must be one.
    """
    useful = [baselines[i] for i in useful_views(baselines)]
    near = camera.fx * min(useful) / (LARGEST_DISPARITY * camera.width)
    far = camera.fx * max(useful) / SMALLEST_DISPARITY
    near = options.depth_min or min(near, 0.5 * (options.depth_max or np.inf))
    return near, options.depth_max or max(far, 2.0 * near)
