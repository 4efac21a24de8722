"""Guesses of a frame's motion, which direct alignment starts from."""

from __future__ import annotations

from collections.abc import Iterator

import cv2
import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import se3_exp
from polarmap.geometry.pose import inverse

_TURNS = (0.02, 0.05)  # radians
_MAX_POINTS = 1500
_MIN_MATCHES = 25
_REPROJECTION = 2.0  # pixels
_KEYPOINTS = 1500


def usual_motions(T_last_reference: np.ndarray, T_before_reference: np.ndarray) -> Iterator[np.ndarray]:
    """T_frame_reference to try, the likeliest first: the motion goes on, twice as fast, stops, or turns a little.

    T_last_reference, T_before_reference: of the last two frames, float64 4×4 (DSO, section 3.1).
    """
    motion = T_last_reference @ inverse(T_before_reference)
    onward = motion @ T_last_reference
    yield onward
    yield motion @ onward
    yield T_last_reference
    yield np.eye(4)
    for size in _TURNS:
        for axis in range(3):
            for turn in (-size, size):
                xi = np.zeros(6)
                xi[3 + axis] = turn
                yield se3_exp(xi) @ onward


class FeatureMatcher:
    """Finds a frame's pose against a keyframe by matched corners, for jumps that direct alignment cannot follow."""

    def __init__(self, camera: PinholeCamera) -> None:
        self._camera = camera
        self._image: np.ndarray | None = None
        self._described: tuple | None = None

    def set_reference(self, level: np.ndarray, pixels: np.ndarray, inverse_depth: np.ndarray) -> None:
        """Take a keyframe: its level 0, float32 H×W×3 in [0, 255], and points in it, N×2 and N."""
        self._image = _eight_bit(level)
        self._described = None
        some = slice(None, None, max(1, len(pixels) // _MAX_POINTS))
        self._pixels = np.ascontiguousarray(pixels[some], np.float32)
        self._points = self._camera.unproject(self._pixels) / inverse_depth[some, None].astype(np.float64)

    def motions(self, level: np.ndarray) -> Iterator[np.ndarray]:
        """T_frame_reference, float64 4×4, from optical flow, then from descriptors, where either finds one."""
        if self._image is None or len(self._pixels) < _MIN_MATCHES:
            return
        image = _eight_bit(level)
        for match in (self._by_flow, self._by_descriptors):
            T = self._pose(*match(image))
            if T is not None:
                yield T

    def _by_flow(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        found, status, _ = cv2.calcOpticalFlowPyrLK(
            self._image, image, self._pixels[:, None], None, winSize=(21, 21), maxLevel=5
        )
        kept = status[:, 0] > 0
        return self._points[kept], found[kept, 0]

    def _by_descriptors(self, image: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Key points near the reference's points take over their depth."""
        nothing = np.zeros((0, 3)), np.zeros((0, 2), np.float32)
        if min(image.shape) <= 80:  # ORB's border
            return nothing
        orb = cv2.ORB_create(_KEYPOINTS)
        if self._described is None:
            self._described = orb.detectAndCompute(self._image, None)
        (keys, descriptors), (new_keys, new_descriptors) = self._described, orb.detectAndCompute(image, None)
        if descriptors is None or new_descriptors is None:
            return nothing
        matches = cv2.BFMatcher(cv2.NORM_HAMMING, crossCheck=True).match(descriptors, new_descriptors)
        if not matches:
            return nothing
        before = np.array([keys[m.queryIdx].pt for m in matches], np.float32)
        after = np.array([new_keys[m.trainIdx].pt for m in matches], np.float32)
        distance = np.linalg.norm(before[:, None] - self._pixels[None], axis=2)
        nearest = distance.argmin(axis=1)
        kept = distance[np.arange(len(before)), nearest] < 8.0
        depth = self._points[nearest[kept], 2:]
        return self._camera.unproject(before[kept]) * depth, after[kept]

    def _pose(self, points: np.ndarray, pixels: np.ndarray) -> np.ndarray | None:
        if len(points) < _MIN_MATCHES:
            return None
        cv2.setRNGSeed(0)
        ok, rotation, translation, inliers = cv2.solvePnPRansac(
            points, pixels.astype(np.float64), self._camera.matrix, None, reprojectionError=_REPROJECTION,
            iterationsCount=200, flags=cv2.SOLVEPNP_EPNP,
        )  # fmt: skip
        if not ok or inliers is None or len(inliers) < _MIN_MATCHES or not np.isfinite(translation).all():
            return None
        T = np.eye(4)
        T[:3, :3], T[:3, 3] = cv2.Rodrigues(rotation)[0], translation[:, 0]
        return T


def _eight_bit(level: np.ndarray) -> np.ndarray:
    return cv2.convertScaleAbs(np.ascontiguousarray(level[..., 0]))
