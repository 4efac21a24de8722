"""The motion between two images from matched pixels, where the pixel in the first image is exact.

A point x1 = (x, y, 1) of the first camera with inverse depth q is at the direction p = R x1 + q t of the second one,
so that it lies on the epipolar line l = t × R x1 there. The distance of its match from that line is the reprojection
error of the best q, which is how the depths leave the problem (Hartley and Zisserman, Multiple View Geometry, 2nd
ed., chapters 9 and 12): a two-view bundle adjustment has 5 unknowns, whatever the number of points. Errors enter by
Geman and McClure's function ρ(e) = e² / (1 + e²/c²), whose c shrinks from step to step (Black and Rangarajan,
IJCV 1996), so that the solution is found from afar and outliers weigh nothing in the end.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit


@dataclass(frozen=True, eq=False)
class Matches:
    """Matched pixels: first, second float64 N×2 (u, v); x1, x2 float64 N×3, the same as (x, y, 1)."""

    first: np.ndarray
    second: np.ndarray
    x1: np.ndarray
    x2: np.ndarray
    camera: PinholeCamera

    @classmethod
    def of(cls, camera: PinholeCamera, first: np.ndarray, second: np.ndarray) -> Matches:
        """The matches of two images of `camera`, each array N×2 in pixels."""
        first, second = np.ascontiguousarray(first, float), np.ascontiguousarray(second, float)
        return cls(first, second, camera.unproject(first), camera.unproject(second), camera)

    def __len__(self) -> int:
        return len(self.first)

    def subset(self, chosen: np.ndarray) -> Matches:
        """Those of an index or mask."""
        parts = (np.ascontiguousarray(a[chosen]) for a in (self.first, self.second, self.x1, self.x2))
        return Matches(*parts, self.camera)

    @property
    def focal(self) -> np.ndarray:
        """(fx, fy), pixels."""
        return np.array([self.camera.fx, self.camera.fy])


@dataclass(frozen=True, eq=False)
class Triangulation:
    """Per match: signed distance from the epipolar line (pixels), inverse depth (1 where the baseline is 1), and
    its derivative along the line (pixels per unit of inverse depth), at the point of the line next to the match."""

    error: np.ndarray
    inverse_depth: np.ndarray
    slope: np.ndarray

    @property
    def disparity(self) -> np.ndarray:
        """Signed pixels along the epipolar line from the point at infinity; negative behind the cameras."""
        return self.inverse_depth * self.slope


def fit_rotation(matches: Matches, scales: np.ndarray) -> np.ndarray:
    """R, float64 3×3, for which x2 ∥ R x1 explains most matches; scales: c of each step, pixels."""
    return _fit_rotation(matches.x1, matches.x2, matches.focal, np.asarray(scales, float))


def rotation_flow(matches: Matches, R: np.ndarray) -> np.ndarray:
    """Pixels that remain when the rotation is removed, x2 - R x1, float64 N×2."""
    turned = matches.x1 @ R.T
    return matches.focal * (matches.x2[:, :2] - turned[:, :2] / turned[:, 2:])


def refine_motion(
    matches: Matches, R: np.ndarray, t: np.ndarray, scales: np.ndarray
) -> tuple[np.ndarray, np.ndarray, float]:
    """(R, t, cost): the nearest minimum of Σ ρ(e), |t| = 1, its sign unknown; cost in pixels² at the last scale."""
    R, t = np.ascontiguousarray(R, float), np.ascontiguousarray(t / np.linalg.norm(t))
    return _refine(matches.x1, matches.x2, R, t, matches.focal, np.ascontiguousarray(scales, float))


def direction_std(matches: Matches, R: np.ndarray, t: np.ndarray, scale: float, noise: float) -> float:
    """Standard deviation of the direction of t along its least certain axis, radians; noise in pixels."""
    R, t = np.ascontiguousarray(R, float), np.ascontiguousarray(t / np.linalg.norm(t))
    H, _, _ = _system(matches.x1, matches.x2, R, t, _tangents(t), matches.focal, float(scale))
    return _largest_std(H, slice(3, 5), noise)


def triangulate(matches: Matches, R: np.ndarray, t: np.ndarray) -> Triangulation:
    """What the motion says about every match; |t| is the baseline in units of the inverse depth."""
    y, focal = matches.x1 @ R.T, matches.focal
    line = np.cross(t, y)
    normal = line[:, :2] / focal
    norm = np.maximum(np.linalg.norm(normal, axis=1), 1e-12)
    error = (line * matches.x2).sum(axis=1) / norm
    foot = matches.x2.copy()
    foot[:, :2] -= (error / norm)[:, None] * normal / focal
    across = np.cross(foot, t)
    square = np.maximum((across**2).sum(axis=1), 1e-18)
    q = -(np.cross(foot, y) * across).sum(axis=1) / square
    p = y + q[:, None] * t
    z = np.where(np.abs(p[:, 2]) > 1e-9, p[:, 2], 1e-9)
    slope = np.linalg.norm(focal * (t[:2] * p[:, 2:] - p[:, :2] * t[2]), axis=1) / z**2
    return Triangulation(error, np.where(p[:, 2] > 0, q, -np.abs(q)), slope)


def plane_residual(matches: Matches, R: np.ndarray, t: np.ndarray, plane: np.ndarray) -> np.ndarray:
    """x2 less the pixel at which the plane q = plane · x1 sees x1, pixels, float64 N×2."""
    p = matches.x1 @ R.T + (matches.x1 @ plane)[:, None] * t
    z = np.where(np.abs(p[:, 2:]) > 1e-9, p[:, 2:], 1e-9)
    return matches.focal * (matches.x2[:, :2] - p[:, :2] / z)


def refine_plane(
    matches: Matches, R: np.ndarray, t: np.ndarray, plane: np.ndarray, scales: np.ndarray, noise: float
) -> tuple[np.ndarray, np.ndarray, np.ndarray, float]:
    """(R, t, plane, std of t's direction in radians): minimum of Σ ρ(|x2 - π(R x1 + (plane · x1) t)|), |t| = 1."""
    length = np.linalg.norm(t)
    t, plane = t / length, plane * length
    H = np.eye(8)
    for scale in scales:
        H, g = _plane_system(matches, R, t, plane, scale)
        step = -np.linalg.solve(H + 1e-6 * np.diag(np.diag(H)) + 1e-12 * np.eye(8), g)
        R = _exp(step[:3]) @ R
        t = t + step[3:5] @ _tangents(t)
        t, plane = t / np.linalg.norm(t), plane + step[5:]
    return R, t, plane, _largest_std(H, slice(3, 5), noise)


def _plane_system(matches, R, t, plane, scale) -> tuple[np.ndarray, np.ndarray]:
    """Normal equations of the rotation (3), the direction of t (2) and the plane (3)."""
    y, q = matches.x1 @ R.T, matches.x1 @ plane
    p = y + q[:, None] * t
    moves = [np.cross(axis, y) for axis in np.eye(3)]
    moves += [q[:, None] * tangent for tangent in _tangents(t)]
    moves += [matches.x1[:, k, None] * t for k in range(3)]
    dp = np.stack(moves, axis=2)
    z = np.where(np.abs(p[:, 2]) > 1e-9, p[:, 2], 1e-9)[:, None, None]
    J = -matches.focal[:, None] * (dp[:, :2] - p[:, :2, None] * dp[:, 2:] / z) / z
    e = matches.focal * (matches.x2[:, :2] - p[:, :2] / z[:, 0])
    weight = 1 / (1 + (e**2).sum(axis=1) / scale**2) ** 2
    weighted = J * weight[:, None, None]
    return np.einsum("nik,nil->kl", weighted, J), np.einsum("nik,ni->k", weighted, e)


def _largest_std(H: np.ndarray, block: slice, noise: float) -> float:
    covariance = np.linalg.pinv(H, hermitian=True)[block, block] * noise**2
    return float(np.sqrt(max(np.linalg.eigvalsh(covariance)[-1], 0.0)))


@njit(error_model="numpy")
def _exp(w):
    """Rodrigues' formula: the rotation by |w| radians about w."""
    angle = np.sqrt(w[0] ** 2 + w[1] ** 2 + w[2] ** 2)
    a = np.sin(angle) / angle if angle > 1e-8 else 1.0
    b = (1.0 - np.cos(angle)) / angle**2 if angle > 1e-4 else 0.5
    W = np.array([[0.0, -w[2], w[1]], [w[2], 0.0, -w[0]], [-w[1], w[0], 0.0]])
    return np.eye(3) + a * W + b * (W @ W)


@njit(error_model="numpy")
def _tangents(t):
    """Two unit vectors at right angles to the unit vector t and to each other, as rows."""
    k = np.argmin(np.abs(t))
    axis = np.zeros(3)
    axis[k] = 1.0
    a = np.cross(t, axis)
    a /= np.sqrt((a**2).sum())
    B = np.empty((2, 3))
    B[0], B[1] = a, np.cross(t, a)
    return B


@njit(error_model="numpy")
def _fit_rotation(x1, x2, focal, scales):
    R = np.eye(3)
    for c in scales:
        H, g = 1e-9 * np.eye(3), np.zeros(3)
        for i in range(len(x1)):
            y = R @ x1[i]
            a, b = y[0] / y[2], y[1] / y[2]
            e0, e1 = focal[0] * (a - x2[i, 0]), focal[1] * (b - x2[i, 1])
            J0 = focal[0] * np.array([-a * b, 1 + a * a, -b])
            J1 = focal[1] * np.array([-1 - b * b, a * b, a])
            weight = 1.0 / (1.0 + (e0 * e0 + e1 * e1) / c**2) ** 2
            for k in range(3):
                g[k] += weight * (J0[k] * e0 + J1[k] * e1)
                for m in range(3):
                    H[k, m] += weight * (J0[k] * J0[m] + J1[k] * J1[m])
        R = _exp(-np.linalg.solve(H, g)) @ R
    return R


@njit(error_model="numpy")
def _system(x1, x2, R, t, B, focal, c):
    """H (5×5), g and the cost of the motion's 3 rotations and 2 directions (the rows of B)."""
    H, g, cost, J = np.zeros((5, 5)), np.zeros(5), 0.0, np.empty(5)
    fx2, fy2 = 1.0 / focal[0] ** 2, 1.0 / focal[1] ** 2
    for i in range(len(x1)):
        a, b = x2[i, 0], x2[i, 1]
        y0 = R[0, 0] * x1[i, 0] + R[0, 1] * x1[i, 1] + R[0, 2]
        y1 = R[1, 0] * x1[i, 0] + R[1, 1] * x1[i, 1] + R[1, 2]
        y2 = R[2, 0] * x1[i, 0] + R[2, 1] * x1[i, 1] + R[2, 2]
        l0, l1, l2 = t[1] * y2 - t[2] * y1, t[2] * y0 - t[0] * y2, t[0] * y1 - t[1] * y0
        d = np.sqrt(l0 * l0 * fx2 + l1 * l1 * fy2) + 1e-12
        e = (a * l0 + b * l1 + l2) / d
        for k in range(5):
            if k < 3:  # the derivative of l by a rotation about axis k: t × (axis × y) = axis (t·y) - y t_k
                ty = t[0] * y0 + t[1] * y1 + t[2] * y2
                d0, d1, d2 = -y0 * t[k], -y1 * t[k], -y2 * t[k]
                d0, d1, d2 = d0 + (ty if k == 0 else 0.0), d1 + (ty if k == 1 else 0.0), d2 + (ty if k == 2 else 0.0)
            else:
                s = B[k - 3]
                d0, d1, d2 = s[1] * y2 - s[2] * y1, s[2] * y0 - s[0] * y2, s[0] * y1 - s[1] * y0
            J[k] = (a * d0 + b * d1 + d2) / d - e * (l0 * d0 * fx2 + l1 * d1 * fy2) / (d * d)
        ratio = 1.0 / (1.0 + e * e / (c * c))
        cost += e * e * ratio
        for k in range(5):
            g[k] += ratio * ratio * J[k] * e
            for m in range(k + 1):
                H[k, m] += ratio * ratio * J[k] * J[m]
    for k in range(5):
        for m in range(k):
            H[m, k] = H[k, m]
    return H, g, cost


@njit(error_model="numpy")
def _refine(x1, x2, R, t, focal, scales):
    """Levenberg and Marquardt; the scale changes from step to step."""
    damping, B = 1e-3, _tangents(t)
    H, g, cost = _system(x1, x2, R, t, B, focal, scales[0])
    for i in range(len(scales)):
        A = H.copy()
        for k in range(5):
            A[k, k] += damping * H[k, k] + 1e-9
        step = -np.linalg.solve(A, g)
        new_R = _exp(step[:3]) @ R
        new_t = t + step[3] * B[0] + step[4] * B[1]
        new_t /= np.sqrt((new_t**2).sum())
        new_B = _tangents(new_t)
        new_H, new_g, new_cost = _system(x1, x2, new_R, new_t, new_B, focal, scales[i])
        following = scales[min(i + 1, len(scales) - 1)]
        if new_cost < cost:
            R, t, B, H, g, cost = new_R, new_t, new_B, new_H, new_g, new_cost
            damping = max(damping * 0.1, 1e-9)
        else:
            damping = min(damping * 10.0, 1e6)
        if following != scales[i]:
            H, g, cost = _system(x1, x2, R, t, B, focal, following)
    return R, t, cost
