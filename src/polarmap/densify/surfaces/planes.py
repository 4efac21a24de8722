"""Planes in two forms: in space, where views share them, and in a view's image, where they give inverse depth.

In space a plane is p = (α, β, γ) with p·X = 1, along its normal. In the image it is (q₀, q_u, q_v) with the inverse
depth q(u, v) = q₀ + q_u (u - c_u) + q_v (v - c_v), (c_u, c_v) the image's centre. Since q = α x + β y + γ in normalized
coordinates, each form is linear in the other.
"""

from __future__ import annotations

import numpy as np

from polarmap.geometry.camera import PinholeCamera

_LEAST_DISTANCE = 0.05  # of a plane from the new camera, as a share of that from the old one


def in_image(planes: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """(q₀, q_u, q_v) of planes (α, β, γ) in the camera's frame, float64 N×3."""
    q_u, q_v = planes[:, 0] / camera.fx, planes[:, 1] / camera.fy
    d_u, d_v = _centre(camera)
    return np.stack([planes[:, 2] + q_u * d_u + q_v * d_v, q_u, q_v], axis=1)


def in_space(planes: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """(α, β, γ) in the camera's frame of planes (q₀, q_u, q_v), float64 N×3."""
    q, q_u, q_v = planes.T
    d_u, d_v = _centre(camera)
    return np.stack([q_u * camera.fx, q_v * camera.fy, q - q_u * d_u - q_v * d_v], axis=1)


def seen_from(planes: np.ndarray, T_other_this: np.ndarray) -> np.ndarray:
    """Planes (α, β, γ) of this frame in the other one, float64 N×3; less those that the other camera is on or behind.

    With X' = R X + t the plane p·X = 1 is R p·X' = 1 + R p·t.
    """
    turned = planes @ T_other_this[:3, :3].T
    scale = 1.0 + turned @ T_other_this[:3, 3]
    kept = scale > _LEAST_DISTANCE
    return turned[kept] / scale[kept, None]


def _centre(camera: PinholeCamera) -> tuple[float, float]:
    """Of the image, from the principal point."""
    return 0.5 * (camera.width - 1) - camera.cx, 0.5 * (camera.height - 1) - camera.cy
