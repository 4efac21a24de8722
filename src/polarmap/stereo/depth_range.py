"""Which views stereo uses, over which depths it searches, and whether what it finds lies at an end of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from polarmap.data.depth_search import DepthSearch
from polarmap.data.plane_field import PlaneField
from polarmap.geometry.camera import PinholeCamera
from polarmap.stereo.options import ConsistencyOptions, StereoOptions

LARGEST_DISPARITY = 0.3  # of the image width
SMALLEST_DISPARITY = 0.25  # pixels
PILED_UP = 0.01  # of the good pixels, at an end: at most 0.0007 if the range holds the scene, 0.006 if poses are wrong
LEAST_BASELINE = 1e-6  # metres; nearer cameras have not moved
LEAST_SHARE = 0.1  # of the longest baseline; nearer cameras match at almost any depth

_RAYS = (12, 9)  # of the image, across and down, that tell what two views share
_NEAREST = 30.0  # times nearer than cameras side by side allow, at most
_STEPS = 64  # of depth, from that to as much farther
_WELL_BEFORE = 0.75  # of the range of cameras side by side; for those, what they share begins at 0.8 of it or beyond
_LEAST_KNOWN = 30  # points, fewer say nothing
_LEFT_OUT = 2.0  # percent of the nearest and of the farthest points, which may be wrong
_ROOM = 1.5  # factor by which the range is wider than the other points
_MOST_WIDENED = 30.0  # times, at most, by points: beyond it they are wrong, or the poses are
_AT_END = 1.01  # factor of depth within which a pixel lies at an end of the range
_LEAST_GOOD = 100  # pixels, of fewer no share is told


def useful_views(baselines: Sequence[float]) -> list[int]:
    """Which views have moved far enough to tell depth, for these distances from the reference in metres."""
    least = max(LEAST_BASELINE, LEAST_SHARE * max(baselines, default=0.0))
    return [i for i, baseline in enumerate(baselines) if baseline > least]


def search_range(
    motions: Sequence[np.ndarray],
    camera: PinholeCamera,
    options: StereoOptions,
    known: Sequence[np.ndarray] = (),
) -> tuple[float, float]:
    """(nearest, farthest) depth in metres for these views, T_other_reference, float64 4×4 each.

    known: depths of points that the reference sees, any shape, NaN where unknown; one array for each source of them,
    such as odometry or another keyframe. The range holds those of every source, but for the few at either end.

    Nearer points would leave the other image, farther ones do not move by a quarter of a pixel. Only
    `useful_views` count, of which there must be one. Cameras that converge on a thing see it together nearer than
    cameras side by side would: there the range begins where they begin to see the same.
    """
    baselines = [float(np.linalg.norm(T[:3, 3])) for T in motions]
    chosen = useful_views(baselines)
    useful = [baselines[i] for i in chosen]
    near = camera.fx * min(useful) / (LARGEST_DISPARITY * camera.width)
    far = camera.fx * max(useful) / SMALLEST_DISPARITY
    near = min([near, *(_convergent_near(motions[i], camera, near) for i in chosen)])
    near, far = _widened(near, far, known)
    near = options.depth_min or min(near, 0.5 * (options.depth_max or np.inf))
    return near, options.depth_max or max(far, 2.0 * near)


def beyond_near_end(search: DepthSearch, options: StereoOptions) -> tuple[float, float] | None:
    """The range to search once more, since things seem to be nearer; None where they do not, or its end is given.

    It begins where cameras side by side cease to share anything, at a disparity of the whole width.
    """
    if options.depth_min is not None or search.at_near <= PILED_UP:
        return None
    return LARGEST_DISPARITY * search.near, search.far


def at_ends(
    planes: PlaneField, depth_range: tuple[float, float], options: ConsistencyOptions | None = None
) -> DepthSearch:
    """How much of what stereo has found with this (nearest, farthest) depth lies at its ends.

    Where things are beyond an end, the planes that match least badly pile up at it; where the range holds them, next to
    nothing lies there. Only pixels count whose depth is good by itself: of what is so far that it hardly moves none is.
    """
    options = options or ConsistencyOptions()
    near, far = depth_range
    q = planes.inverse_depth
    good = (q > 0) & (planes.score > options.min_score) & (planes.sigma < options.max_relative_sigma * q)
    count = int(np.count_nonzero(good))
    if count < _LEAST_GOOD:
        return DepthSearch(near, far)
    at_near = float(np.count_nonzero(good & (q * near > 1.0 / _AT_END)) / count)
    at_far = float(np.count_nonzero(good & (q * far < _AT_END)) / count)
    return DepthSearch(near, far, at_near, at_far)


def _widened(near: float, far: float, known: Sequence[np.ndarray]) -> tuple[float, float]:
    """The range with room for points of known depth; never narrower, since width costs stereo next to nothing."""
    nearest, farthest = near, far
    for depths in known:
        z = depths[np.isfinite(depths) & (depths > 0)]
        if z.size >= _LEAST_KNOWN:
            low, high = np.percentile(z, (_LEFT_OUT, 100.0 - _LEFT_OUT))
            nearest, farthest = min(nearest, float(low) / _ROOM), max(farthest, float(high) * _ROOM)
    return max(nearest, near / _MOST_WIDENED), min(farthest, far * _MOST_WIDENED)


def _convergent_near(T_other_reference: np.ndarray, camera: PinholeCamera, near: float) -> float:
    """From where on two cameras share nearly as much as they ever do, if that is well before `near`; else `near`.

    Only for cameras beside each other: of two behind each other one sees all that the other does, at any depth.
    """
    centre = -T_other_reference[:3, :3].T @ T_other_reference[:3, 3]
    if np.linalg.norm(centre[:2]) < abs(centre[2]):
        return near
    depths = near * np.geomspace(1.0 / _NEAREST, _NEAREST, _STEPS)
    shares = np.array([_shared(T_other_reference, camera, z) for z in depths])
    first = float(depths[(shares >= (1.0 - LARGEST_DISPARITY) * shares.max()).argmax()])
    return first if first < _WELL_BEFORE * near else near


def _shared(T_other_reference: np.ndarray, camera: PinholeCamera, depth: float) -> float:
    """Share of the image's rays whose points at a depth the other view sees."""
    sides = zip((camera.width, camera.height), _RAYS, strict=True)
    pixels = np.stack(np.meshgrid(*(np.linspace(0, size - 1, n) for size, n in sides)), axis=-1).reshape(-1, 2)
    points = depth * camera.unproject(pixels)
    x, y, z = T_other_reference[:3, :3] @ points.T + T_other_reference[:3, 3:]
    before = z > 0
    u, v = (f * a / np.where(before, z, 1.0) + c for f, a, c in ((camera.fx, x, camera.cx), (camera.fy, y, camera.cy)))
    return float(np.mean(before & (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)))
