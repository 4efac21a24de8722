"""Voxel size from the scale of the depth."""

from __future__ import annotations

import numpy as np

from polarmap.errors import InputError
from polarmap.fusion.depth_view import prepare_view
from polarmap.fusion.integration import touched_blocks
from polarmap.fusion.volume import TRUNCATION_VOXELS
from polarmap.geometry.camera import PinholeCamera

PIXELS_PER_VOXEL = 2.0
RELATIVE_RESOLUTION = 0.005


def choose_voxel_size(depth: np.ndarray, camera: PinholeCamera, max_blocks_per_view: int = 20_000) -> float:
    """Voxel size in metres that suits a depth map, float32 H×W with NaN where none.

    At the median depth a voxel is 2 pixels wide, but at least 0.5 % of that depth, since depth from images is seldom
    better, however many pixels there are. Where one such depth map would touch more than `max_blocks_per_view` blocks
    (far points touch many) it is larger, until it does not.

    Raises InputError where there is no depth, or `max_blocks_per_view` is below 1000.
    """
    if max_blocks_per_view < 1000:
        raise InputError(f"fusion: max_blocks_per_view must be at least 1000, not {max_blocks_per_view}")
    view = prepare_view(depth, np.zeros(camera.shape, np.float32), None, camera, np.eye(4))
    if not view.depth.any():
        raise InputError("fusion: no voxel size can be chosen from a depth map without depth")
    pixel = 2.0 / (camera.fx + camera.fy)
    median = float(np.median(view.depth[view.depth > 0]))
    voxel_size = median * max(PIXELS_PER_VOXEL * pixel, RELATIVE_RESOLUTION)
    while touched_blocks(view, voxel_size, TRUNCATION_VOXELS * voxel_size, max_blocks_per_view) is None:
        voxel_size *= 1.25
    return voxel_size
