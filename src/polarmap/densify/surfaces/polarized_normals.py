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
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.densify.surfaces.evidence import halved_stokes
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit

_LEAST_DOLP = 0.05  # below it walls are polarized by whatever lights them
_STOKES_SIGMA = 2.0  # pixels, of the Gaussian that polarization is averaged over
_NORMAL_SIGMA = 3.0  # likewise, of the normals
_SPREAD_SIGMA = 4.0  # likewise, of how they differ from their mean
_ANGLE_SIGMA = 0.05  # radians: spread of normals at which polarization is believed half
_EXPECTED_WEIGHT = 0.4  # of the guide, that expected normals have where the found ones say little


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
    used = free & np.isfinite(normal[..., 0])
    if not used.any() or (image is None and expected is None):
        return normal
    known = np.nan_to_num(normal[::2, ::2])  # what is smoothed does not need more
    smooth = cv2.GaussianBlur(known, (0, 0), 0.5 * _NORMAL_SIGMA)
    spread = np.zeros((2, *known.shape[:2]), np.float32)
    _differences(known, smooth, spread)
    spread = [cv2.GaussianBlur(part, (0, 0), 0.5 * _SPREAD_SIGMA) for part in spread]
    light = np.zeros((0, 0, 3), np.float32) if image is None else _smoothed_light(image)
    clear = used[:0] if image is None else image.usable
    guess = known[:0] if expected is None else np.ascontiguousarray(expected, np.float32)
    result = np.array(normal, np.float32, order="C")
    _turn(used, smooth, *spread, light, clear, guess, camera.normalized(), result)
    return result


def _smoothed_light(image: PolarizationImage) -> np.ndarray:
    """S0, S1 and S2, all over two, averaged, float32 H/2×W/2×3, rounded down."""
    return cv2.GaussianBlur(halved_stokes(image), (0, 0), 0.5 * _STOKES_SIGMA)


@njit(parallel=True)
def _differences(known, smooth, spread):
    """The squared distance of unit vectors from their mean, which is that of the angle if it is small, and 1 for each;
    0 where there is no normal, which is known as 0.
    """
    for v in prange(known.shape[0]):
        for u in range(known.shape[1]):
            if known[v, u, 0] != 0 or known[v, u, 1] != 0 or known[v, u, 2] != 0:
                x, y, z = _unit(smooth[v, u, 0], smooth[v, u, 1], smooth[v, u, 2])
                x, y, z = x - known[v, u, 0], y - known[v, u, 1], z - known[v, u, 2]
                spread[0, v, u] = x * x + y * y + z * z
                spread[1, v, u] = 1.0


@njit(parallel=True, error_model="numpy")
def _turn(used, smooth, spread, weights, light, clear, expected, xy, result):
    """See `turned_normals`, in place. smooth, spread, weights, light: of every second pixel in a row and a column.
    light, clear, expected: empty where they are not to count.
    """
    angular, guided = light.size > 0, expected.size > 0
    one, least = np.float32(1.0), np.float32(_LEAST_DOLP)
    variance, weight = np.float32(_ANGLE_SIGMA**2), np.float32(_EXPECTED_WEIGHT)
    for v in prange(used.shape[0]):
        for u in range(used.shape[1]):
            if not used[v, u]:
                continue
            turning, s1, s2 = False, np.float32(0.0), np.float32(0.0)
            if angular and clear[v, u]:
                i, j = min(v // 2, light.shape[0] - 1), min(u // 2, light.shape[1] - 1)
                s1, s2 = light[i, j, 1], light[i, j, 2]
                turning = np.sqrt(s1 * s1 + s2 * s2) > least * max(light[i, j, 0], np.float32(1e-6))
            if not (turning or guided):
                continue
            i, j = v // 2, u // 2
            if not weights[i, j] > 0:
                continue
            share = spread[i, j] / (spread[i, j] + variance * weights[i, j])
            x, y, z = _unit(smooth[i, j, 0], smooth[i, j, 1], smooth[i, j, 2])
            if guided:
                trust = weight * share
                rest = one - trust
                x, y, z = _unit(
                    rest * x + trust * expected[v, u, 0],
                    rest * y + trust * expected[v, u, 1],
                    rest * z + trust * expected[v, u, 2],
                )
            if turning:
                x, y, z = _turned(x, y, z, s1, s2, xy[v, u, 0], xy[v, u, 1])
            rest = one - share
            x, y, z = _unit(
                share * x + rest * result[v, u, 0],
                share * y + rest * result[v, u, 1],
                share * z + rest * result[v, u, 2],
            )
            result[v, u, 0], result[v, u, 1], result[v, u, 2] = x, y, z


@njit(error_model="numpy")
def _turned(nx, ny, nz, s1, s2, x, y):
    """A normal with its direction d = n_xy - n_z x taken to the nearest that polarization allows.

    s1, s2: Stokes components of any scale. x, y: normalized coordinates of the pixel. Diffuse light has its angle φ
    along d, specular light along the contour of equal range, so that d = M p with M = I + x xᵀ and p perpendicular to φ
    (see `polarization.cues`).
    """
    dx, dy = nx - nz * x, ny - nz * y
    length = np.sqrt(dx * dx + dy * dy)
    ax, ay = _half_turned(s1, s2)
    bx, by = -ay, ax
    along = bx * x + by * y
    bx, by = bx + x * along, by + y * along
    scale = np.float32(1.0) / np.sqrt(bx * bx + by * by)
    bx, by = bx * scale, by * scale
    diffuse, specular = ax * dx + ay * dy, bx * dx + by * dy
    if abs(diffuse) < abs(specular):
        ax, ay, diffuse = bx, by, specular
    length *= np.sign(diffuse)
    return _unit(length * ax + nz * x, length * ay + nz * y, nz)


@njit(error_model="numpy")
def _half_turned(s1, s2):
    """The unit vector along φ = ½ atan2(s2, s1), or against it."""
    half, length = np.float32(0.5), np.sqrt(s1 * s1 + s2 * s2)
    longer = np.sqrt(half * (np.float32(1.0) + abs(s1) / length))
    shorter = half * s2 / (length * longer)
    return (longer, shorter) if s1 >= 0 else (shorter, longer)


@njit(error_model="numpy")
def _unit(x, y, z):
    scale = np.float32(1.0) / max(np.sqrt(x * x + y * y + z * z), np.float32(1e-9))
    return x * scale, y * scale, z * scale
