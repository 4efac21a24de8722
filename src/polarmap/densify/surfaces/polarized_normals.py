"""Normals of free surfaces, turned about the line of sight to where the angle of polarization says.

Stereo's depth of a curved glossy thing is lumpy, and so are its normals; its angle of polarization is smooth, and
right to a few degrees where the degree is not small. It leaves four directions, two for diffuse and two for specular
light. The one nearest to the direction of a guide is taken: the smoothed normals, and as far as these are lumpy those
that a network expects. The zenith is the guide's, since the degree of polarization of mixed light says little of it.
How much the turned normal counts is decided by the normals themselves: where they agree with each other within a few
degrees polarization can add nothing, and where they do not it is better.
"""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera

_LEAST_DOLP = 0.05  # below it walls are polarized by whatever lights them
_STOKES_SIGMA = 2.0  # pixels, of the Gaussian that polarization is averaged over
_NORMAL_SIGMA = 3.0  # likewise, of the normals
_SPREAD_SIGMA = 4.0  # likewise, of how they differ from their mean
_ANGLE_SIGMA = 0.05  # radians: spread of normals at which polarization is believed half
_EXPECTED_WEIGHT = np.float32(0.4)  # of the guide, that expected normals have where the found ones say little


def turned_normals(
    normal: np.ndarray,
    free: np.ndarray,
    image: PolarizationImage | None,
    camera: PinholeCamera,
    expected: np.ndarray | None = None,
) -> np.ndarray:
    """Normals where `free` (bool H×W) turned as far as guide and polarization are better; the others as they are.

    normal: unit vectors toward the camera, float32 H×W×3, NaN where none. image: None if polarization is not to count.
    expected: like `normal`, as a network expects them, everywhere. Returns the like of `normal`.
    """
    found = np.isfinite(normal).all(axis=-1)
    used = free & found
    clear, angle = _clear_angle(image) if image is not None else (np.zeros_like(free), None)
    if expected is None:
        used &= clear
    if not used.any():
        return normal
    known = np.nan_to_num(normal)
    smooth = _unit(cv2.GaussianBlur(known, (0, 0), _NORMAL_SIGMA))
    difference = np.sum((known - smooth) ** 2, axis=-1)  # of unit vectors: the square of the angle, if that is small
    difference[~found] = 0.0
    weight = cv2.GaussianBlur(found.astype(np.float32), (0, 0), _SPREAD_SIGMA)
    spread = cv2.GaussianBlur(difference, (0, 0), _SPREAD_SIGMA)[used] / weight[used]
    share = (spread / (spread + np.float32(_ANGLE_SIGMA**2)))[:, None]
    guide = smooth[used]
    if expected is not None:
        trust = _EXPECTED_WEIGHT * share
        guide = _unit((1.0 - trust) * guide + trust * expected[used])
    if angle is not None:
        turning = clear[used]
        guide[turning] = _turned(guide[turning], angle[used][turning], camera.normalized()[used][turning])
    result = normal.copy()
    result[used] = _unit(share * guide + (1.0 - share) * known[used])
    return result


def _clear_angle(image: PolarizationImage) -> tuple[np.ndarray, np.ndarray]:
    """Where the smoothed angle of polarization says something, bool H×W, and that angle."""
    s0, s1, s2 = (cv2.GaussianBlur(part, (0, 0), _STOKES_SIGMA) for part in _polarized(image))
    degree = np.hypot(s1, s2) / np.maximum(s0, np.float32(1e-6))
    return image.usable & (degree > _LEAST_DOLP), 0.5 * np.arctan2(s2, s1)


def _polarized(image: PolarizationImage) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """S0, S1 and S2, all over two, float32 H×W."""
    polarized = image.intensity * image.dolp
    return image.intensity, polarized * np.cos(2.0 * image.aolp), polarized * np.sin(2.0 * image.aolp)


def _turned(normal: np.ndarray, angle: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """Normals N×3 with their direction d = n_xy - n_z x taken to the nearest that polarization allows.

    angle: φ, N. xy: normalized coordinates of the pixels, N×2. Diffuse light has φ along d, specular light along the
    contour of equal range, so that d = M p with M = I + x xᵀ and p perpendicular to φ (see `polarization.cues`).
    """
    direction = normal[:, :2] - normal[:, 2:] * xy
    length = np.linalg.norm(direction, axis=1, keepdims=True)
    diffuse = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    specular = np.stack([-diffuse[:, 1], diffuse[:, 0]], axis=1)
    specular = _unit(specular + xy * np.sum(specular * xy, axis=1, keepdims=True))
    along = [np.sum(axis * direction, axis=1, keepdims=True) for axis in (diffuse, specular)]
    nearest = np.where(np.abs(along[0]) >= np.abs(along[1]), np.sign(along[0]) * diffuse, np.sign(along[1]) * specular)
    return _unit(np.concatenate([length * nearest + normal[:, 2:] * xy, normal[:, 2:]], axis=1))


def _unit(vectors: np.ndarray) -> np.ndarray:
    return (vectors / np.maximum(np.linalg.norm(vectors, axis=-1, keepdims=True), 1e-9)).astype(np.float32)
