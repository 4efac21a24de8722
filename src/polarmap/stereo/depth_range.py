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

_RAYS = (12, 9)  # of the image, across and down, that tell what two views share
_NEAREST = 30.0  # times nearer than cameras side by side allow, at most
_STEPS = 64  # of depth, from that to as much farther
_WELL_BEFORE = 0.75  # of the range of cameras side by side; for those, what they share begins at 0.8 of it or beyond


def useful_views(baselines: Sequence[float]) -> list[int]:
    """Which views have moved far enough to tell depth, for these distances from the reference in metres."""
    least = max(LEAST_BASELINE, LEAST_SHARE * max(baselines, default=0.0))
    return [i for i, baseline in enumerate(baselines) if baseline > least]


def search_range(motions: Sequence[np.ndarray], camera: PinholeCamera, options: StereoOptions) -> tuple[float, float]:
    """(nearest, farthest) depth in metres for these views, T_other_reference, float64 4×4 each.

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
    near = options.depth_min or min(near, 0.5 * (options.depth_max or np.inf))
    return near, options.depth_max or max(far, 2.0 * near)


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
