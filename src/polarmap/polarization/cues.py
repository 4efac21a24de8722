"""Azimuth, zenith and kind of reflection of every pixel: the ambiguities of polarization, resolved by a prior.

The angle of polarization φ allows four azimuths, two if diffuse reflection dominates and two if specular does.
Following the paper (Section III-B) the one nearest to the direction of a relative depth prior is taken; its kind
labels the pixel, chooses between equations (5) and (6), and the prior's zenith chooses between the two specular
solutions.

Under perspective diffuse light oscillates in the plane of incidence, so φ is along d = n_xy - n_z x. Specular light
oscillates along v × n, which the image shows along the contour of equal range: φ is perpendicular to ∇w, and
d = M ∇w (see `geometry.surface`). Only on the optical axis, or for the orthographic camera, is that the paper's
φ ± π/2; at the corner of a 67° lens the two differ by up to 15°.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import IntEnum

import cv2
import numpy as np
from numba import njit, prange

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import incidence_direction, normals_from_cues, zenith_of
from polarmap.options import Options, parameter
from polarmap.polarization.fresnel import diffuse_dolp, diffuse_zenith, specular_zeniths
from polarmap.polarization.types import PolarizationImage

_TABLE_SIZE = 4096


class Reflection(IntEnum):
    """Kind of reflection that dominates a pixel's polarization."""

    NONE = 0
    DIFFUSE = 1
    SPECULAR = 2


class CueOptions(Options):
    """How cues are read."""

    refractive_index: float = parameter(1.5, "η of all surfaces", source="III-B", gt=1, lt=10)
    orthographic: bool = parameter(False, "the paper's tan φ = ∇y z/∇x z in place of perspective", source="III-B")
    max_sigma_aolp: float = parameter(0.3, "a noisier angle of polarization is no cue", "rad", gt=0, lt=0.9)
    vote_radius: int = parameter(3, "the kind of reflection is voted on in a square of this radius", "pixels", ge=0)


@dataclass(frozen=True)
class Cues:
    """Disambiguated polarization, H×W each, NaN (label 0, confidence 0) where it says nothing.

    azimuth: float32 radians in (-π, π]. zenith: float32 radians in [0, π/2].
    label: uint8, a `Reflection`. confidence: float32 in [0, 1], how clear the angle and the vote are.
    """

    azimuth: np.ndarray
    zenith: np.ndarray
    label: np.ndarray
    confidence: np.ndarray

    def normals(self, camera: PinholeCamera, orthographic: bool = False) -> np.ndarray:
        """The normals that the cues state, float32 H×W×3."""
        return normals_from_cues(self.azimuth, self.zenith, camera, orthographic)


def disambiguate(
    image: PolarizationImage,
    prior_normals: np.ndarray,
    camera: PinholeCamera,
    options: CueOptions | None = None,
) -> Cues:
    """Resolve the π, π/2 and specular zenith ambiguities of `image` by a prior's normals.

    prior_normals: float32 H×W×3 in the camera frame, NaN where the prior says nothing.
    Raises InputError where the shapes differ or the refractive index is not a dielectric's.
    """
    options = options or CueOptions()
    if image.aolp.shape != camera.shape or prior_normals.shape != (*camera.shape, 3):
        raise InputError(
            f"cues: image {image.aolp.shape} and prior {prior_normals.shape} do not fit the camera {camera.shape}"
        )
    direction = incidence_direction(prior_normals, camera, options.orthographic)
    prior_zenith = zenith_of(prior_normals, camera, options.orthographic)
    strength = _cue_strength(image, options)
    xy = _metric_coordinates(camera, options)
    vote, weight = _vote(image.aolp, direction, strength, xy, options.vote_radius)
    max_diffuse = np.float32(diffuse_dolp(np.pi / 2, options.refractive_index))
    results = [np.empty(camera.shape, t) for t in (np.float32, np.float32, np.uint8, np.float32)]
    _resolve(
        image.aolp, image.dolp, image.sigma_dolp, strength, direction, prior_zenith, vote, weight, xy,
        zenith_tables(options.refractive_index), max_diffuse, *results,
    )  # fmt: skip
    return Cues(*results)


def zenith_tables(eta: float) -> np.ndarray:
    """Zenith for diffuse, specular below and above the Brewster angle, float32 3×4096, evenly spaced in √ρ.

    Near the normal θ grows as √ρ, so that this spacing is exact where ρ is small.
    """
    rho = np.linspace(0.0, 1.0, _TABLE_SIZE) ** 2
    return np.stack([diffuse_zenith(rho, eta), *specular_zeniths(rho, eta)]).astype(np.float32)


def _cue_strength(image: PolarizationImage, options: CueOptions) -> np.ndarray:
    """1 for a noiseless angle, 0 for one that is noisier than allowed or unusable."""
    strength = 1.0 - (image.sigma_aolp / options.max_sigma_aolp) ** 2
    return np.where(image.usable, np.maximum(strength, 0.0), 0.0).astype(np.float32)


def _metric_coordinates(camera: PinholeCamera, options: CueOptions) -> np.ndarray:
    """The x of M = I + x xᵀ, zero for the orthographic camera, float32 H×W×2."""
    return np.zeros_like(camera.normalized()) if options.orthographic else camera.normalized()


def _vote(aolp, direction, strength, xy, radius) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean over a square of the votes (1: diffuse, -1: specular) and of their weight."""
    kind = np.empty_like(aolp)
    weight = np.empty_like(aolp)
    _kind_votes(aolp, direction, strength, xy, kind, weight)
    size = (2 * radius + 1,) * 2
    return cv2.boxFilter(kind, -1, size), cv2.boxFilter(weight, -1, size)


@njit(cache=True)
def _double_cosine(ax, ay, bx, by):
    """cos 2δ for the angle δ between two vectors; 0 where one of them is zero."""
    norms = (ax * ax + ay * ay) * (bx * bx + by * by)
    dot = ax * bx + ay * by
    return np.float32(2.0) * dot * dot / norms - np.float32(1.0) if norms > 0 else np.float32(0.0)


@njit(parallel=True, cache=True)
def _kind_votes(aolp, direction, strength, xy, kind, weight):
    height, width = aolp.shape
    for v in prange(height):
        for u in range(width):
            kind[v, u] = 0.0
            weight[v, u] = 0.0
            dx = direction[v, u, 0]
            dy = direction[v, u, 1]
            d2 = dx * dx + dy * dy
            if not (strength[v, u] > 0 and d2 > 0):
                continue
            x = xy[v, u, 0]
            y = xy[v, u, 1]
            along = (dx * x + dy * y) / (np.float32(1.0) + x * x + y * y)
            cosine = np.cos(aolp[v, u])
            sine = np.sin(aolp[v, u])
            diffuse = _double_cosine(cosine, sine, dx, dy)
            specular = _double_cosine(-sine, cosine, dx - x * along, dy - y * along)  # M⁻¹ d is along ∇w
            # a prior that faces the camera votes little
            w = strength[v, u] * np.sqrt(min(d2, np.float32(1.0)))
            kind[v, u] = np.float32(0.5) * w * (diffuse - specular)
            weight[v, u] = w


@njit(cache=True)
def _look_up(tables, row, rho):
    x = np.sqrt(min(max(rho, np.float32(0.0)), np.float32(1.0))) * np.float32(_TABLE_SIZE - 1)
    i = min(int(x), _TABLE_SIZE - 2)
    share = x - np.float32(i)
    return tables[row, i] + share * (tables[row, i + 1] - tables[row, i])


@njit(parallel=True, cache=True)
def _resolve(
    aolp, dolp, sigma_dolp, strength, direction, prior_zenith, vote, weight, xy, tables, max_diffuse,
    azimuth, zenith, label, confidence,
):  # fmt: skip
    """The four candidates reduced to one; polarization clearly above what diffuse light can have is specular."""
    height, width = aolp.shape
    for v in prange(height):
        for u in range(width):
            azimuth[v, u] = np.nan
            zenith[v, u] = np.nan
            label[v, u] = 0
            confidence[v, u] = 0.0
            prior_size = direction[v, u, 0] ** 2 + direction[v, u, 1] ** 2
            if not (strength[v, u] > 0 and weight[v, u] > 0 and prior_size > 0):
                continue
            diffuse = vote[v, u] >= 0 and dolp[v, u] - 2 * sigma_dolp[v, u] < max_diffuse
            dx = np.cos(aolp[v, u])
            dy = np.sin(aolp[v, u])
            if not diffuse:
                dx, dy = -dy, dx
                along = dx * xy[v, u, 0] + dy * xy[v, u, 1]
                dx += xy[v, u, 0] * along
                dy += xy[v, u, 1] * along
            side = np.float32(1.0) if direction[v, u, 0] * dx + direction[v, u, 1] * dy >= 0 else np.float32(-1.0)
            azimuth[v, u] = np.arctan2(side * dy, side * dx)
            if diffuse:
                zenith[v, u] = _look_up(tables, 0, dolp[v, u])
            else:
                low = _look_up(tables, 1, dolp[v, u])
                high = _look_up(tables, 2, dolp[v, u])
                nearer_low = not abs(high - prior_zenith[v, u]) < abs(low - prior_zenith[v, u])
                zenith[v, u] = low if nearer_low else high
            label[v, u] = 1 if diffuse else 2
            confidence[v, u] = strength[v, u] * abs(vote[v, u]) / weight[v, u]
