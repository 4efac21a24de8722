"""From Mitsuba's Stokes frames, one per viewing ray, to the image plane.

For a viewing ray v (away from the camera) and a vector `vertical`, Mitsuba's frame is x = v × vertical and
y = -v × x, angles from x toward y, counter-clockwise as displayed. An angle ψ there is the field direction
e = cos ψ x + sin ψ y, which a polarizer pixel sees along e_xy - (e_z/v_z)·v_xy. The degree of polarization stays.
"""

from __future__ import annotations

import numpy as np


def to_image_plane(stokes: np.ndarray, rays: np.ndarray, vertical: np.ndarray) -> np.ndarray:
    """Stokes vectors S0, S1, S2, 3×H×W, with AoLP from image +x toward +y, of Mitsuba's, 3×H×W.

    rays: viewing rays in the camera frame (OpenCV axes), H×W×3. vertical: the vector that Mitsuba's frames are made
    with, in the camera frame; (0, -1, 0) where it is the camera's own upward axis.
    """
    rays = np.asarray(rays, float)
    rays = rays / np.linalg.norm(rays, axis=-1, keepdims=True)
    x = np.cross(rays, vertical)
    x /= np.linalg.norm(x, axis=-1, keepdims=True)
    y = -np.cross(rays, x)
    psi = 0.5 * np.arctan2(stokes[2], stokes[1])[..., None]
    e = np.cos(psi) * x + np.sin(psi) * y
    seen = e[..., :2] - e[..., 2:] / rays[..., 2:] * rays[..., :2]
    double_angle = 2.0 * np.arctan2(seen[..., 1], seen[..., 0])
    polarized = np.hypot(stokes[1], stokes[2])
    return np.stack([stokes[0], polarized * np.cos(double_angle), polarized * np.sin(double_angle)])
