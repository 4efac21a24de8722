"""The window of keyframes that are adjusted together: their states, their images, and the prior that others left."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.lie import se3_exp
from polarmap.geometry.pose import inverse, orthonormalized
from polarmap.jit import njit
from polarmap.odometry.pattern import PATTERN_SIZE
from polarmap.odometry.points import ActivePoints, ImmaturePoints
from polarmap.odometry.projection import fill_projection
from polarmap.odometry.window.residuals import CALIBRATION, FRAME, Pairs

_FIRST_POSE_INFORMATION = 1e9  # holds the first keyframe where it is
_FIRST_THRESHOLD = PATTERN_SIZE * 8.0**2  # squared grey values; for a first adjustment, which sets it by what it finds


@dataclass(eq=False)
class KeyframeState:
    """A keyframe of the window.

    T_first: T_camera_world at the first estimate, about which everything is linearized. step: the present state's
    distance from it, xi. affine: a, b; affine_first: at the first estimate. exposure: relative to other frames.
    threshold: energy over which a residual is an outlier. chosen: points that were chosen in it.
    """

    index: int
    slot: int
    T_first: np.ndarray
    affine: np.ndarray
    exposure: float = 1.0
    threshold: float = _FIRST_THRESHOLD
    chosen: int = 0
    step: np.ndarray = field(default_factory=lambda: np.zeros(6))
    affine_first: np.ndarray = field(default_factory=lambda: np.zeros(2))

    def __post_init__(self) -> None:
        self.affine_first = self.affine.copy()

    @property
    def T_camera_world(self) -> np.ndarray:
        """The present pose."""
        return se3_exp(self.step) @ self.T_first

    @property
    def T_world_camera(self) -> np.ndarray:
        """The present pose, inverted."""
        return inverse(self.T_camera_world)

    @property
    def deviation(self) -> np.ndarray:
        """The present state's distance from the first estimate, 8 variables."""
        return np.concatenate([self.step, self.affine - self.affine_first])

    def relinearize(self) -> None:
        """Make the present state the first estimate; only while nothing is marginalized about the old one."""
        self.T_first, self.step = orthonormalized(self.T_camera_world), np.zeros(6)
        self.affine_first = self.affine.copy()


@dataclass(frozen=True, eq=False)
class Projection:
    """From S keyframe slots into one image: KRKi float32 S×3×3, Kt float32 S×3, gain, offset float32 S; see Pairs."""

    KRKi: np.ndarray
    Kt: np.ndarray
    gain: np.ndarray
    offset: np.ndarray


class Window:
    """Keyframes in slots, the points that they host, and what marginalization left about them.

    images: float32 S×H×W×3 by slot. keyframes: from old to new. prior_H, prior_b: quadratic prior over calibration
    and slots; its gradient at a deviation x from the first estimate is prior_b + prior_H x.
    """

    def __init__(self, camera: PinholeCamera, capacity: int) -> None:
        self.camera = camera
        self.capacity = capacity
        self.images = np.zeros((capacity, camera.height, camera.width, 3), np.float32)
        self.keyframes: list[KeyframeState] = []
        self.points = ActivePoints.empty(capacity)
        self.immature = ImmaturePoints.empty()
        self.calibration = np.array([camera.fx, camera.fy, camera.cx, camera.cy])
        self.calibration_first = self.calibration.copy()
        size = CALIBRATION + FRAME * capacity
        self.prior_H, self.prior_b = np.zeros((size, size)), np.zeros(size)

    @property
    def newest(self) -> KeyframeState:
        """The last keyframe added."""
        return self.keyframes[-1]

    def add(self, index: int, level: np.ndarray, T_camera_world: np.ndarray, affine: np.ndarray, exposure: float = 1.0):
        """A new keyframe from level 0 of its pyramid; every point gets a residual in it."""
        slot = min(set(range(self.capacity)) - {k.slot for k in self.keyframes})
        keyframe = KeyframeState(index, slot, T_camera_world, np.asarray(affine, float).copy(), exposure)
        if not self.keyframes:
            where = slice(CALIBRATION + FRAME * slot, CALIBRATION + FRAME * slot + 6)
            self.prior_H[where, where] += _FIRST_POSE_INFORMATION * np.eye(6)
        self.images[slot] = level
        self.keyframes.append(keyframe)
        self.points.state[:, slot] = 1
        return keyframe

    def thresholds(self) -> np.ndarray:
        """Outlier energies by slot, float32 S."""
        thresholds = np.zeros(self.capacity, np.float32)
        for keyframe in self.keyframes:
            thresholds[keyframe.slot] = keyframe.threshold
        return thresholds

    def deviation(self) -> np.ndarray:
        """The present state's distance from the first estimate, float64 D."""
        x = np.zeros(CALIBRATION + FRAME * self.capacity)
        x[:CALIBRATION] = self.calibration - self.calibration_first
        for keyframe in self.keyframes:
            start = CALIBRATION + FRAME * keyframe.slot
            x[start : start + FRAME] = keyframe.deviation
        return x

    def pairs(self) -> Pairs:
        """Projection between all keyframes, at the present state and at the first estimate."""
        S = self.capacity
        now, first = np.tile(np.eye(4), (S, 1, 1)), np.tile(np.eye(4), (S, 1, 1))
        affine, affine_first, exposure = np.zeros((S, 2)), np.zeros((S, 2)), np.ones(S)
        for keyframe in self.keyframes:
            s = keyframe.slot
            now[s], first[s] = keyframe.T_camera_world, keyframe.T_first
            affine[s], affine_first[s], exposure[s] = keyframe.affine, keyframe.affine_first, keyframe.exposure
        return Pairs(
            *_pairs(self.matrix, now, first, affine, affine_first, exposure), self.calibration.astype(np.float32)
        )

    def projection_to(self, T_camera_world: np.ndarray, affine: np.ndarray, exposure: float) -> Projection:
        """Projection of every keyframe into a frame that is none of them."""
        S = self.capacity
        poses = np.tile(np.eye(4), (S, 1, 1))
        gain, offset = np.ones(S, np.float32), np.zeros(S, np.float32)
        for keyframe in self.keyframes:
            s = keyframe.slot
            poses[s] = T_camera_world @ keyframe.T_world_camera
            gain[s], offset[s] = relative_brightness(keyframe.affine, keyframe.exposure, affine, exposure)
        KRKi, Kt = self._projection(poses)
        return Projection(KRKi.astype(np.float32), Kt.astype(np.float32), gain, offset)

    def _projection(self, T: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """KRKi and Kt of motions ...×4×4."""
        K = self.matrix
        return K @ T[..., :3, :3] @ np.linalg.inv(K), T[..., :3, 3] @ K.T

    @property
    def matrix(self) -> np.ndarray:
        """K of the present calibration, float64 3×3."""
        fx, fy, cx, cy = self.calibration
        return np.array([[fx, 0.0, cx], [0.0, fy, cy], [0.0, 0.0, 1.0]])


def project(pixel, inverse_depth, host, projection, shape):
    """Pixels u, v (N each) of hosted points in a frame, and whether they are inside by four pixels."""
    rays = np.concatenate([pixel, np.ones((len(pixel), 1), np.float32)], axis=1)
    p = np.einsum("nij,nj->ni", projection.KRKi[host], rays) + inverse_depth[:, None] * projection.Kt[host]
    with np.errstate(divide="ignore", invalid="ignore"):
        u, v = p[:, 0] / p[:, 2], p[:, 1] / p[:, 2]
    inside = (p[:, 2] > 0) & (u > 3) & (v > 3) & (u < shape[1] - 4) & (v < shape[0] - 4)
    return u, v, inside


def relative_brightness(affine_host, exposure_host, affine_target, exposure_target):
    """(gain, offset): a host intensity I is expected as gain I + offset in the target (DSO, equation 4).

    affine: (a, b) in the last axis.
    """
    gain = exposure_target / exposure_host * np.exp(affine_target[..., 0] - affine_host[..., 0])
    return gain, affine_target[..., 1] - gain * affine_host[..., 1]


@njit
def _pairs(K, now, first, affine, affine_first, exposure):
    """What `Pairs` holds of every two slots, the calibration left out; poses float64 S×4×4."""
    S = len(now)
    KRKi, Kt = np.empty((S, S, 3, 3), np.float32), np.empty((S, S, 3), np.float32)
    R0, t0 = np.empty((S, S, 3, 3), np.float32), np.empty((S, S, 3), np.float32)
    gain, offset, gain0 = np.empty((S, S), np.float32), np.empty((S, S), np.float32), np.empty((S, S), np.float32)
    host_map = np.zeros((S, S, FRAME, FRAME))
    T, T_first = np.empty((3, 4)), np.empty((3, 4))
    for h in range(S):
        for t in range(S):
            _relative(now[t], now[h], T)
            _relative(first[t], first[h], T_first)
            fill_projection(K, T, KRKi[h, t], Kt[h, t])
            for i in range(3):
                t0[h, t, i] = T_first[i, 3]
                R0[h, t, i, 0], R0[h, t, i, 1], R0[h, t, i, 2] = T_first[i, 0], T_first[i, 1], T_first[i, 2]
            ratio = exposure[t] / exposure[h]
            factor = ratio * np.exp(affine[t, 0] - affine[h, 0])
            factor_first = ratio * np.exp(affine_first[t, 0] - affine_first[h, 0])
            gain[h, t], offset[h, t], gain0[h, t] = factor, affine[t, 1] - factor * affine[h, 1], factor_first
            _fill_host_map(T_first, factor_first, host_map[h, t])
    return KRKi, Kt, gain, offset, R0, t0, gain0, affine_first[:, 1].astype(np.float32), host_map


@njit
def _relative(T_target, T_host, T):
    """T_target T_host⁻¹ of motions 4×4, into the 3×4 of its rotation and translation."""
    for i in range(3):
        T[i, 3] = T_target[i, 3]
        for k in range(3):
            T[i, k] = 0.0
            for j in range(3):
                T[i, k] += T_target[i, j] * T_host[k, j]
            T[i, 3] -= T[i, k] * T_host[k, 3]


@njit
def _fill_host_map(T, gain, D):
    """-adjoint of T (3×4), and how the relative brightness changes with the host's; the rest of D is zero."""
    for k in range(3):
        x, y, z = T[0, k], T[1, k], T[2, k]
        D[0, k] = D[3, 3 + k] = -x
        D[1, k] = D[4, 3 + k] = -y
        D[2, k] = D[5, 3 + k] = -z
        D[0, 3 + k] = T[2, 3] * y - T[1, 3] * z
        D[1, 3 + k] = T[0, 3] * z - T[2, 3] * x
        D[2, 3 + k] = T[1, 3] * x - T[0, 3] * y
    D[6, 6], D[7, 7] = -1.0, -gain
