"""Whether two pictures agree with the poses they are said to be taken from."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.pipeline.keyframe_rule import track_corners

_TOLERANCE = 1.5  # pixels of a 640×480 image from the epipolar line
_LEAST_TOLERANCE = 1.0  # pixels
_LEAST_PARALLAX = 0.3  # pixels, below which there is no depth
ENOUGH = 30  # corners
_AGREEING = 0.7  # of the corners
_CONTRADICTING = 0.8  # of the usual share; that of good pictures stays above 0.94 of it
_OTHER_DEPTH = 4.0  # times
_SAME_DEPTH = 2.5  # times; scenes seen one after the other are about as deep


@dataclass(frozen=True)
class Agreement:
    """Of two pictures. corners: that were found in both. share: of these, on their epipolar lines and, where there is
    parallax, before both cameras. depth: median of these with parallax, in the poses' unit; NaN if there are too few.
    """

    corners: int
    share: float
    depth: float


def agreement(before: np.ndarray, after: np.ndarray, T_after_before: np.ndarray, camera: PinholeCamera) -> Agreement:
    """How well corners followed from one picture to the next fit a motion. before, after: intensity, float32 H×W."""
    first, second = track_corners(before, after)
    if len(first) == 0:
        return Agreement(0, 0.0, np.nan)
    inverse_matrix = np.linalg.inv(camera.matrix)
    x, y = (np.column_stack([p, np.ones(len(p))]) @ inverse_matrix.T for p in (first, second))
    R, t = T_after_before[:3, :3], T_after_before[:3, 3]
    turned, focal = x @ R.T, 0.5 * (camera.fx + camera.fy)
    tolerance = max(_TOLERANCE * (camera.width + camera.height) / (640 + 480), _LEAST_TOLERANCE)
    on_line = focal * _off_line(x, y, R, t) < tolerance
    parallax = focal * np.linalg.norm(y[:, :2] - turned[:, :2] / turned[:, 2:], axis=1)
    depth = _depth(turned, y, t)
    ahead = (depth > 0) & (turned[:, 2] * depth + t[2] > 0)
    fits = on_line & (ahead | (parallax < tolerance))
    known = fits & ahead & (parallax > _LEAST_PARALLAX)
    enough = np.count_nonzero(known) >= ENOUGH
    return Agreement(len(first), float(fits.mean()), float(np.median(depth[known])) if enough else np.nan)


def confirms(doubtful: Agreement, usual: Agreement) -> bool:
    """Whether pictures confirm a motion that is doubtful, `usual` being the agreement of pictures before it.

    A motion much too long has the corners on their lines if it has the right direction, but then makes the scene
    as much too deep.
    """
    if doubtful.corners < ENOUGH or doubtful.share < _AGREEING:
        return False
    ratio = doubtful.depth / usual.depth
    return bool(1.0 / _SAME_DEPTH < ratio < _SAME_DEPTH)


def contradicts(now: Agreement, usual: list[Agreement]) -> bool:
    """Whether two pictures fit their poses far worse than others of the recording do, which is `usual`."""
    known = [other for other in usual if other.corners >= ENOUGH]
    if not known or now.corners < ENOUGH:
        return False
    share, depth = (float(np.median([getattr(o, name) for o in known])) for name in ("share", "depth"))
    if share < _AGREEING:
        return False
    ratio = now.depth / depth
    return now.share < _CONTRADICTING * share or ratio > _OTHER_DEPTH or ratio < 1.0 / _OTHER_DEPTH


def _off_line(x: np.ndarray, y: np.ndarray, R: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Sampson distances from the epipolar geometry, normalized; without translation, those from where x turns to."""
    if np.linalg.norm(t) < 1e-12:
        turned = x @ R.T
        return np.linalg.norm(y[:, :2] - turned[:, :2] / turned[:, 2:], axis=1)
    E = np.cross(np.eye(3), t / np.linalg.norm(t)).T @ R
    lines, back = x @ E.T, y @ E
    gradient = lines[:, 0] ** 2 + lines[:, 1] ** 2 + back[:, 0] ** 2 + back[:, 1] ** 2
    return np.abs((y * lines).sum(axis=1)) / np.sqrt(np.maximum(gradient, 1e-30))


def _depth(turned: np.ndarray, y: np.ndarray, t: np.ndarray) -> np.ndarray:
    """z in the first camera at which the rays come nearest; y × (z turned + t) = 0."""
    across, shift = np.cross(y, turned), np.cross(y, t)
    return -(across * shift).sum(axis=1) / np.maximum((across**2).sum(axis=1), 1e-30)
