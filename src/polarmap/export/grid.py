"""A grid of voxels around what the keyframes saw, its z axis upward; its size is checked before it takes memory."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.export.source import MapSource
from polarmap.export.upright import upright

MOST_VOXELS = 40_000_000
BYTES_A_VOXEL = 30
"""What is needed at once while distances are computed; most are the indices of the nearest voxels."""

_MOST_POINTS = 2_000_000
_OUTLIERS = 0.1  # percent of the points at either end of each axis that the grid need not reach
_MARGIN = 2  # voxels
_LEVEL = math.cos(math.radians(20.0))
_LEAST_PEAK = 0.2  # of the fullest height, that another has to be a floor
_LEAST_LEVEL = 200  # points, below which there is no floor to be seen


@dataclass(frozen=True, eq=False)
class Grid:
    """T_world_grid: float64 4×4, a rotation; world coordinates are counted from the map's origin.

    corner: float64 (3,), of the first voxel, not its centre, in the grid's axes. shape: voxels along x, y and z.
    floor: the height of the lowest level surface, or of the lowest points where none is level.
    eye: median height of the cameras.
    """

    T_world_grid: np.ndarray
    corner: np.ndarray
    voxel_size: float
    shape: tuple[int, int, int]
    floor: float
    eye: float

    @property
    def heights(self) -> np.ndarray:
        """Of the centres of the voxels' layers, float64."""
        return self.corner[2] + self.voxel_size * (np.arange(self.shape[2]) + 0.5)


def make_grid(source: MapSource, up: np.ndarray, voxel_size: float, min_confidence: float) -> Grid:
    """The grid that holds the surely seen points and the cameras.

    Raises InputError where there is no such point, or the grid would take too much memory; that says what fits.
    """
    T_world_grid = upright(up)
    points, level, cameras = _points(source, T_world_grid[:3, :3], min_confidence)
    if not len(points):
        raise InputError(f"{source.folder}: no point is as sure as {min_confidence:g}; lower --min-confidence")
    low, high = np.percentile(points, (_OUTLIERS, 100.0 - _OUTLIERS), axis=0)
    low, high = np.minimum(low, cameras.min(axis=0)), np.maximum(high, cameras.max(axis=0))
    sizes = np.ceil((high - low) / voxel_size) + 2 * _MARGIN
    _require_memory(sizes, voxel_size)
    floor = _floor(points[:, 2], level, voxel_size)
    corner = voxel_size * (np.floor(low / voxel_size) - _MARGIN)
    x, y, z = (int(size) + 1 for size in sizes)
    return Grid(T_world_grid, corner, voxel_size, (x, y, z), floor, float(np.median(cameras[:, 2])))


def _points(source: MapSource, R: np.ndarray, min_confidence: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """In the grid's axes: points N×3, whether each is on a surface that faces up, and the cameras."""
    source.require_keyframes()
    camera = source.camera
    step = max(1, math.ceil(math.sqrt(camera.width * camera.height * len(source.files) / _MOST_POINTS)))
    chosen = (slice(None, None, step), slice(None, None, step))
    points, level, cameras = [], [], []
    rays = np.concatenate([camera.normalized(), np.ones((*camera.shape, 1), np.float32)], axis=-1)[chosen]
    for keyframe in source.keyframes("measuring"):
        T = keyframe.T_world_camera
        sure = np.isfinite(keyframe.depth[chosen]) & (keyframe.confidence[chosen] >= min_confidence)
        local = rays[sure] * keyframe.depth[chosen][sure][:, None].astype(np.float64)
        points.append((local @ T[:3, :3].T + T[:3, 3]) @ R)
        level.append(keyframe.normal[chosen][sure] @ T[:3, :3].T @ R[:, 2] > _LEVEL)
        cameras.append(T[:3, 3] @ R)
    return np.concatenate(points), np.concatenate(level), np.array(cameras)


def _floor(heights: np.ndarray, level: np.ndarray, voxel_size: float) -> float:
    found = heights[level]
    low, high = np.percentile(heights, (_OUTLIERS, 100.0 - _OUTLIERS))
    if len(found) < _LEAST_LEVEL or high - low <= voxel_size:
        return float(low)
    counts, edges = np.histogram(found, math.ceil((high - low) / voxel_size), (low, high))
    full = np.flatnonzero(counts >= _LEAST_PEAK * counts.max())[0]
    return float(np.median(found[(found >= edges[full]) & (found <= edges[full + 1])]))


def _require_memory(sizes: np.ndarray, voxel_size: float) -> None:
    count = float(np.prod(sizes + 1))
    if count <= MOST_VOXELS:
        return
    fitting = 1.02 * voxel_size * float(np.prod(np.cbrt(sizes + 1)) / np.cbrt(MOST_VOXELS))
    digit = 10.0 ** (math.floor(math.log10(fitting)) - 1)
    shape = "x".join(f"{size:.0f}" for size in sizes)
    raise InputError(
        f"a grid of {shape} voxels of {voxel_size:g} would take {count * BYTES_A_VOXEL / 1e9:.1f} GB; "
        f"--voxel-size {math.ceil(fitting / digit) * digit:.6g} fits"
    )
