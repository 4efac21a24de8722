"""Azimuth, zenith and kind of reflection of every pixel: the ambiguities of polarization, resolved by a prior.

The angle of polarization allows four azimuths, {φ, φ+π} if diffuse reflection dominates and φ ± π/2 if specular
does. Following the paper (Section III-B) the one nearest to the direction of a relative depth prior is taken; its
kind labels the pixel, chooses between equations (5) and (6), and the prior's zenith chooses between the two
specular solutions.
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

_TABLE_SIZE = 2048


class Reflection(IntEnum):
    """Kind of reflection that dominates a pixel's polarization."""

    NONE = 0
    DIFFUSE = 1
    SPECULAR = 2


class CueOptions(Options):
    """How cues are read."""

    refractive_index: float = parameter(1.5, "η of all surfaces", source="III-B", gt=1, lt=10)
    orthographic: bool = parameter(
        False, "the paper's tan φ = ∇y z/∇x z in place of perspective", source="III-B"
    )
    max_sigma_aolp: float = parameter(0.3, "a noisier angle of polarization is no cue", "rad", gt=0, lt=0.9)
    vote_radius: int = parameter(
        3, "the kind of reflection is voted on in a square of this radius", "pixels", ge=0
    )


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
    vote, weight = _vote(image.aolp, direction, strength, options.vote_radius)
    results = [np.empty(camera.shape, t) for t in (np.float32, np.float32, np.uint8, np.float32)]
    _resolve(
        image.aolp, image.dolp, strength, direction, prior_zenith, vote, weight,
        zenith_tables(options.refractive_index), np.float32(diffuse_dolp(np.pi / 2, options.refractive_index)), *results,
    )  # fmt: skip
    return Cues(*results)


def zenith_tables(eta: float) -> np.ndarray:
    """Zenith against ρ in [0, 1] for diffuse, specular below and above the Brewster angle, float32 3×2048."""
    rho = np.linspace(0.0, 1.0, _TABLE_SIZE)
    return np.stack([diffuse_zenith(rho, eta), *specular_zeniths(rho, eta)]).astype(np.float32)


def _cue_strength(image: PolarizationImage, options: CueOptions) -> np.ndarray:
    """1 for a noiseless angle, 0 for one that is noisier than allowed or unusable."""
    strength = 1.0 - (image.sigma_aolp / options.max_sigma_aolp) ** 2
    return np.where(image.usable, np.maximum(strength, 0.0), 0.0).astype(np.float32)


def _vote(aolp, direction, strength, radius) -> tuple[np.ndarray, np.ndarray]:
    """Weighted mean, over a square, of cos 2(φ - φ') (1: diffuse, -1: specular) and of its weight."""
    kind = np.empty_like(aolp)
    weight = np.empty_like(aolp)
    _kind_votes(aolp, direction, strength, kind, weight)
    size = (2 * radius + 1,) * 2
    return cv2.boxFilter(kind, -1, size), cv2.boxFilter(weight, -1, size)


@njit(parallel=True, cache=True)
def _kind_votes(aolp, direction, strength, kind, weight):
    height, width = aolp.shape
    for v in prange(height):
        for u in range(width):
            dx = direction[v, u, 0]
            dy = direction[v, u, 1]
            d2 = dx * dx + dy * dy
            kind[v, u] = 0.0
            weight[v, u] = 0.0
            if strength[v, u] > 0 and d2 > 0:
                double = np.float32(2.0) * aolp[v, u]
                w = strength[v, u] * np.sqrt(min(d2, np.float32(1.0)))
                # |d|² cos 2(φ - φ') without an arctangent; a prior that faces the camera votes little
                kind[v, u] = w * ((dx * dx - dy * dy) * np.cos(double) + 2 * dx * dy * np.sin(double)) / d2
                weight[v, u] = w


@njit(cache=True)
def _look_up(tables, row, rho):
    x = min(max(rho, np.float32(0.0)), np.float32(1.0)) * np.float32(_TABLE_SIZE - 1)
    i = min(int(x), _TABLE_SIZE - 2)
    share = x - np.float32(i)
    return tables[row, i] + share * (tables[row, i + 1] - tables[row, i])


@njit(parallel=True, cache=True)
def _resolve(
    aolp,
    dolp,
    strength,
    direction,
    prior_zenith,
    vote,
    weight,
    tables,
    max_diffuse,
    azimuth,
    zenith,
    label,
    confidence,
):
    """The four candidates reduced to one; stronger polarization than diffuse light can have is specular."""
    height, width = aolp.shape
    for v in prange(height):
        for u in range(width):
            azimuth[v, u] = np.nan
            zenith[v, u] = np.nan
            label[v, u] = 0
            confidence[v, u] = 0.0
            if not (strength[v, u] > 0 and weight[v, u] > 0):
                continue
            diffuse = vote[v, u] >= 0 and dolp[v, u] < max_diffuse
            angle = aolp[v, u] if diffuse else aolp[v, u] + np.float32(np.pi / 2)
            towards = direction[v, u, 0] * np.cos(angle) + direction[v, u, 1] * np.sin(angle)
            if towards < 0:
                angle -= np.float32(np.pi)
            azimuth[v, u] = angle if angle <= np.float32(np.pi) else angle - np.float32(2 * np.pi)
            if diffuse:
                zenith[v, u] = _look_up(tables, 0, dolp[v, u])
            else:
                low = _look_up(tables, 1, dolp[v, u])
                high = _look_up(tables, 2, dolp[v, u])
                nearer_low = not abs(high - prior_zenith[v, u]) < abs(low - prior_zenith[v, u])
                zenith[v, u] = low if nearer_low else high
            label[v, u] = 1 if diffuse else 2
            confidence[v, u] = strength[v, u] * abs(vote[v, u]) / weight[v, u]
