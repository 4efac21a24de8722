"""What changes from a keyframe to a later frame of known pose, by which DSO's rule makes that one a keyframe."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.keyframe_rule import ViewChange

_MAX_POINTS = 600
_MIN_POINTS = 12
_DARK = 1e-4  # of full scale; below it there is no light to compare


def view_change(
    keyframe_image: np.ndarray,
    image: np.ndarray,
    T_image_keyframe: np.ndarray,
    camera: PinholeCamera,
    points: np.ndarray | None = None,
) -> ViewChange | None:
    """Flow and brightness change between a keyframe and a later image; None where the views share too little.

    keyframe_image, image: intensity, float32 H×W. points: N×3 in the keyframe's camera frame, whose projections are
    the flow; without them (no depth is known yet) corners are tracked instead.
    """
    if points is not None and len(points) >= _MIN_POINTS:
        moved = points @ T_image_keyframe[:3, :3].T + T_image_keyframe[:3, 3]
        before, after = _project(points, camera), _project(moved, camera)
    else:
        before, after = track_corners(keyframe_image, image)
        if len(before) < _MIN_POINTS:  # nothing to track: what the rotation alone does is known all the same
            before, after = _turn_grid(T_image_keyframe, camera)
    inside = _inside(before, camera) & _inside(after, camera)
    if np.count_nonzero(inside) < _MIN_POINTS:
        return None
    before, after = before[inside], after[inside]
    K = camera.matrix
    unturned = _homogeneous(after) @ (K @ T_image_keyframe[:3, :3].T @ np.linalg.inv(K)).T
    ratio = np.maximum(_sample(image, after), _DARK) / np.maximum(_sample(keyframe_image, before), _DARK)
    return ViewChange(
        flow=_rms(after - before),
        translation_flow=_rms(unturned[:, :2] / unturned[:, 2:] - before),
        brightness=float(abs(np.log(np.median(ratio)))),
    )


def sample_points(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Up to 600 points spread over a depth map's known pixels, float64 N×3 in its camera frame."""
    known = np.flatnonzero(np.isfinite(depth))
    known = known[:: max(1, known.size // _MAX_POINTS)]
    rays = np.concatenate([camera.normalized().reshape(-1, 2)[known], np.ones((known.size, 1))], axis=1)
    return rays * depth.ravel()[known, None].astype(np.float64)


def _project(points: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Pixels of N×3 points, NaN behind the camera."""
    z = np.where(points[:, 2:] > 0, points[:, 2:], np.nan)
    return (points @ camera.matrix.T)[:, :2] / z


def track_corners(before_image: np.ndarray, after_image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners of one image and where the pyramidal Lucas-Kanade tracker finds them in the other, N×2 each."""
    first, second = (np.uint8(np.clip(255 * np.sqrt(image), 0, 255)) for image in (before_image, after_image))
    corners = cv2.goodFeaturesToTrack(first, _MAX_POINTS, 0.01, 8)
    if corners is None:
        return np.empty((0, 2)), np.empty((0, 2))
    found, status, _ = cv2.calcOpticalFlowPyrLK(first, second, corners, None, winSize=(15, 15), maxLevel=4)
    tracked = status.ravel() == 1
    return corners[tracked, 0].astype(np.float64), found[tracked, 0].astype(np.float64)


def _turn_grid(T_image_keyframe: np.ndarray, camera: PinholeCamera) -> tuple[np.ndarray, np.ndarray]:
    """A grid of pixels, and where the rotation takes them; NaN behind the camera."""
    u, v = np.meshgrid(np.linspace(0, camera.width - 1, 9), np.linspace(0, camera.height - 1, 9))
    grid = np.stack([u.ravel(), v.ravel()], axis=1)
    rays = _homogeneous(grid) @ np.linalg.inv(camera.matrix).T
    return grid, _project(rays @ T_image_keyframe[:3, :3].T, camera)


def _inside(pixels: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    u, v = pixels[:, 0], pixels[:, 1]
    return (u >= 0) & (v >= 0) & (u <= camera.width - 1) & (v <= camera.height - 1)


def _sample(image: np.ndarray, pixels: np.ndarray) -> np.ndarray:
    u, v = np.rint(pixels).astype(int).T
    return image[v, u]


def _homogeneous(pixels: np.ndarray) -> np.ndarray:
    return np.concatenate([pixels, np.ones((len(pixels), 1))], axis=1)


def _rms(flow: np.ndarray) -> float:
    """Root mean square length of N×2 vectors, the longest tenth left out as mismatched or occluded."""
    lengths = np.sort(np.linalg.norm(flow, axis=1))
    return float(np.sqrt(np.mean(lengths[: max(1, int(0.9 * len(lengths)))] ** 2)))
