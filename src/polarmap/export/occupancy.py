"""Which voxels are free, occupied or unknown, by rays from the cameras to what they saw.

The evidence is OctoMap's (Hornung et al., 2013): log odds of 0.85 where a keyframe sees a surface in a voxel, -0.4
where it sees through it, a surface coming before free space in one keyframe; the sum is kept between -2 and 3.5.
"""

from __future__ import annotations

import numpy as np

from polarmap.export.grid import Grid
from polarmap.export.source import MapSource
from polarmap.geometry.pose import inverse
from polarmap.jit import njit

UNKNOWN, FREE, OCCUPIED = 0, 1, 2

_PASSED, _HIT = 1, 2
_FOR, _AGAINST, _LEAST, _MOST = 85, -40, -200, 350  # hundredths
_SIGMAS = 2.0  # before a surface, where a ray is not believed to be free any more

_GRAZING = 0.1  # the least cosine between a ray and a normal that is reckoned with
_STEEPEST = 0.1  # share by which depth may change within a pixel
_MOST_RAYS = 8  # along either side of a pixel


def occupancy(source: MapSource, grid: Grid, min_confidence: float) -> np.ndarray:
    """uint8 of the grid's shape, [x, y, z]: UNKNOWN, FREE or OCCUPIED."""
    evidence = np.zeros(grid.shape, np.int16)
    marks = np.zeros(grid.shape, np.uint8)
    T_grid_world = inverse(grid.T_world_grid)
    for keyframe in source.keyframes("casting rays"):
        T = T_grid_world @ keyframe.T_world_camera
        T[:3, 3] -= grid.corner
        T[:3] /= grid.voxel_size
        sigma = np.where(keyframe.confidence >= min_confidence, keyframe.sigma, np.float32(np.nan))
        camera, scale = keyframe.camera, 1.0 / grid.voxel_size
        pixel = 1.0 / camera.fx, 1.0 / camera.fy
        _cast(marks, camera.normalized(), pixel, keyframe.depth, sigma, keyframe.normal, T, scale)
        _add(evidence, marks)
    state = np.full(grid.shape, UNKNOWN, np.uint8)
    state[evidence < 0] = FREE
    state[evidence > 0] = OCCUPIED
    return state


@njit
def _add(evidence: np.ndarray, marks: np.ndarray) -> None:
    """One keyframe's marks are added to the evidence and wiped."""
    flat, of_keyframe = evidence.reshape(-1), marks.reshape(-1)
    for i in range(flat.size):
        if of_keyframe[i]:
            step = _FOR if of_keyframe[i] == _HIT else _AGAINST
            flat[i] = min(max(flat[i] + step, _LEAST), _MOST)
            of_keyframe[i] = 0


@njit
def _cast(
    marks: np.ndarray,
    normalized: np.ndarray,
    pixel: tuple[float, float],
    depth: np.ndarray,
    sigma: np.ndarray,
    normal: np.ndarray,
    T: np.ndarray,
    scale: float,
) -> None:
    """Mark the voxels that the rays of a depth map pass, and those that they end in.

    normalized: H×W×2. pixel: the size of one there. sigma: share of the depth, NaN where a pixel is not believed.
    normal: H×W×3. T: camera to voxels, 4×4, where a voxel has the size 1 and the first one's corner is the origin; its
    upper three rows are a motion times `scale`. Where a pixel covers more than a voxel of the plane that its normal
    stands on, it has several rays.
    """
    for v in range(depth.shape[0]):
        for u in range(depth.shape[1]):
            z = depth[v, u]
            if not (z > 0 and sigma[v, u] >= 0):
                continue
            x, y = normalized[v, u, 0], normalized[v, u, 1]
            nx, ny, nz = normal[v, u, 0], normal[v, u, 1], normal[v, u, 2]
            toward = -(nx * x + ny * y + nz)
            cosine = toward / np.sqrt(x * x + y * y + 1.0)
            if not cosine > _GRAZING:  # nor NaN
                _ray(marks, x, y, z, sigma[v, u], _GRAZING, T)
                continue
            rays = min(_MOST_RAYS, max(1, int(np.ceil(z * scale * max(pixel) / cosine))))
            for i in range(rays * rays):
                beside = ((i % rays + 0.5) / rays - 0.5) * pixel[0]
                below = ((i // rays + 0.5) / rays - 0.5) * pixel[1]
                share = toward / (toward - nx * beside - ny * below)
                if abs(share - 1.0) < _STEEPEST:
                    _ray(marks, x + beside, y + below, z * share, sigma[v, u], cosine, T)


@njit
def _ray(marks: np.ndarray, x: float, y: float, z: float, sigma: float, cosine: float, T: np.ndarray) -> None:
    """One ray to the point (x, y, 1)·z of a surface that it meets at an angle to its normal of this cosine.

    It is not believed to be free from one voxel before the surface on, across it: along a wall it would wipe it out.
    """
    origin, direction = np.empty(3), np.empty(3)
    for axis in range(3):
        origin[axis] = T[axis, 3]
        direction[axis] = z * (T[axis, 0] * x + T[axis, 1] * y + T[axis, 2])
    length = np.sqrt(direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2)
    free = 1.0 - max(1.0 / (length * cosine), _SIGMAS * sigma)
    if free > 0:
        _pass(marks, origin, direction, free)
    i = int(np.floor(origin[0] + direction[0]))
    j = int(np.floor(origin[1] + direction[1]))
    k = int(np.floor(origin[2] + direction[2]))
    if 0 <= i < marks.shape[0] and 0 <= j < marks.shape[1] and 0 <= k < marks.shape[2]:
        marks[i, j, k] = _HIT


@njit
def _pass(marks: np.ndarray, origin: np.ndarray, direction: np.ndarray, until: float) -> None:
    """Mark the voxels on origin + t·direction, t from 0 to `until`, one after the other (Amanatides and Woo, 1987)."""
    begin, end = 0.0, until
    for axis in range(3):
        d = direction[axis]
        if d == 0.0:
            if origin[axis] < 0 or origin[axis] >= marks.shape[axis]:
                return
            continue
        near, far = -origin[axis] / d, (marks.shape[axis] - origin[axis]) / d
        begin, end = max(begin, min(near, far)), min(end, max(near, far))
    if begin >= end:
        return
    voxel = np.empty(3, np.int64)
    step = np.empty(3, np.int64)
    following = np.full(3, np.inf)
    width = np.full(3, np.inf)
    for axis in range(3):
        d = direction[axis]
        at = origin[axis] + begin * d
        voxel[axis] = min(max(int(np.floor(at)), 0), marks.shape[axis] - 1)
        step[axis] = 1 if d > 0 else -1
        if d != 0.0:
            width[axis] = 1.0 / abs(d)
            following[axis] = (voxel[axis] + (1 if d > 0 else 0) - origin[axis]) / d
    while True:
        if marks[voxel[0], voxel[1], voxel[2]] == 0:
            marks[voxel[0], voxel[1], voxel[2]] = _PASSED
        axis = int(np.argmin(following))
        if following[axis] >= end:
            return
        voxel[axis] += step[axis]
        if voxel[axis] < 0 or voxel[axis] >= marks.shape[axis]:
            return
        following[axis] += width[axis]
