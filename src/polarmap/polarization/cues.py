"""Azimuth, zenith and kind of reflection of every pixel: the ambiguities of polarization, resolved by a prior.

The angle of polarization φ allows four azimuths, two if diffuse reflection dominates and two if specular does.
Following the paper (Section III-B) the one nearest to the direction of a relative depth prior is taken; its kind
labels the pixel, chooses between equations (5) and (6), and the prior's zenith chooses between the two specular
solutions.

Under perspective diffuse light oscillates in the plane of incidence, so φ is along d = n_xy - n_z x. Specular light
oscillates along v × n, which the image shows along the contour of equal range: φ is perpendicular to ∇w, and
d = M ∇w (see `geometry.surface`). Only on the optical axis, or for the orthographic camera, is that the paper's
φ ± π/2; at the corner of a 67° lens the two differ by up to 15°.

A metal polarizes like a specular dielectric, but much less. Which pixels are metals, and the refractive index of the
others, may be given (see `materials`).
"""

from __future__ import annotations

from functools import lru_cache

import cv2
import numpy as np
from numba import prange

from polarmap.data.cues import Cues
from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit
from polarmap.polarization.fresnel import diffuse_dolp, diffuse_zenith, metal_zeniths, specular_zeniths
from polarmap.polarization.metals import METALS
from polarmap.polarization.options import CueOptions

_TABLE_SIZE = 4096
_MAP_INDICES = np.linspace(1.3, 2.0, 71)  # refractive indices that a map of them is read to


def disambiguate(
    image: PolarizationImage,
    prior_normals: np.ndarray,
    camera: PinholeCamera,
    options: CueOptions | None = None,
    eta: np.ndarray | None = None,
    metal: np.ndarray | None = None,
    specular: np.ndarray | None = None,
) -> Cues:
    """Resolve the π, π/2 and specular zenith ambiguities of `image` by a prior's normals.

    prior_normals: float32 H×W×3 in the camera frame, NaN where the prior says nothing.
    eta: refractive index of every pixel, float32 H×W, the options' one by default. Values other than that one are
        read to 0.01 and within [1.3, 2].
    metal: which metal a pixel is, uint8 H×W, 1 + index in `metals.METALS`, 0 for none; by default none is.
    specular: probability, float32 H×W in [0, 1], that mirrored light rules, as a network guesses it; it joins the vote.
    Raises InputError where the shapes differ or the refractive index is not a dielectric's.
    """
    options = options or CueOptions()
    tables, max_diffuse, row = _dielectric_tables(eta, camera, options)
    metal = _metal_map(metal, camera)
    if image.aolp.shape != camera.shape or prior_normals.shape != (*camera.shape, 3):
        raise InputError(
            f"cues: image {image.aolp.shape} and prior {prior_normals.shape} do not fit the camera {camera.shape}"
        )
    if specular is not None and specular.shape != camera.shape:
        raise InputError(f"cues: specular {specular.shape} does not fit the camera {camera.shape}")
    cosine, sine = np.cos(image.aolp), np.sin(image.aolp)
    xy = _metric_coordinates(camera, options)
    normals = np.ascontiguousarray(prior_normals, np.float32)
    guess = image.aolp[:0] if specular is None else np.float32(options.expected_kind) * (1 - 2 * specular)
    strength, vote, weight = (np.empty(camera.shape, np.float32) for _ in range(3))
    sharpness = np.float32(1.0 / options.max_sigma_aolp)
    _kind_votes(cosine, sine, image.sigma_aolp, image.usable, normals, xy, sharpness, guess, strength, vote, weight)
    size = (2 * options.vote_radius + 1,) * 2
    vote, weight = cv2.boxFilter(vote, -1, size), cv2.boxFilter(weight, -1, size)
    results = [np.empty(camera.shape, t) for t in (np.float32, np.float32, np.uint8, np.float32)]
    _resolve(
        image.aolp, cosine, sine, image.dolp, image.sigma_dolp, strength, normals, vote, weight, xy,
        tables, max_diffuse, row, _metal_tables(), metal, *results,
    )  # fmt: skip
    return Cues(*results)


def zenith_tables(eta: float) -> np.ndarray:
    """Zenith for diffuse, specular below and above the Brewster angle, float32 3×4096, evenly spaced in √ρ.

    Near the normal θ grows as √ρ, so that this spacing is exact where ρ is small.
    """
    rho = np.linspace(0.0, 1.0, _TABLE_SIZE) ** 2
    return np.stack([diffuse_zenith(rho, eta), *specular_zeniths(rho, eta)]).astype(np.float32)


def _dielectric_tables(eta, camera, options) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Zenith tables K×3×4096 and largest diffuse ρ of K indices, and which of them a pixel has, uint8 H×W."""
    if eta is None:
        most = np.float32([diffuse_dolp(np.pi / 2, options.refractive_index)])
        return zenith_tables(options.refractive_index)[None], most, np.zeros(camera.shape, np.uint8)
    row = np.empty(camera.shape, np.uint8)
    if eta.shape != camera.shape or not _nearest_rows(eta, np.float32(options.refractive_index), row):
        raise InputError(f"cues: eta {eta.shape} must fit the camera {camera.shape} and be over 1 everywhere")
    return *_map_tables(options.refractive_index), row


@njit
def _nearest_rows(eta, typical, row):
    """Which of `_map_tables` each pixel's index is read to; False where one is no dielectric's."""
    last, steps = _MAP_INDICES.size - 1, 1.0 / (_MAP_INDICES[1] - _MAP_INDICES[0])
    fit = True
    for v in range(eta.shape[0]):
        for u in range(eta.shape[1]):
            fit &= eta[v, u] > 1.0
            nearest = np.rint((eta[v, u] - _MAP_INDICES[0]) * steps)
            row[v, u] = last + 1 if eta[v, u] == typical else np.uint8(min(max(nearest, 0.0), last))
    return fit


@lru_cache(maxsize=1)
def _map_tables(typical: float) -> tuple[np.ndarray, np.ndarray]:
    """Those of the indices that a map is read to, and last those of `typical`."""
    indices = np.append(_MAP_INDICES, typical)
    most = diffuse_dolp(np.pi / 2, indices)
    return np.stack([zenith_tables(float(eta)) for eta in indices]), most.astype(np.float32)


def _metal_map(metal, camera) -> np.ndarray:
    if metal is None:
        return np.zeros(camera.shape, np.uint8)
    if metal.shape != camera.shape or metal.max(initial=0) > len(METALS):
        raise InputError(f"cues: metal {metal.shape} must fit the camera {camera.shape} and hold 0 to {len(METALS)}")
    return metal.astype(np.uint8)


@lru_cache(maxsize=1)
def _metal_tables() -> np.ndarray:
    """Zenith below and above the pseudo-Brewster angle of every metal, float32 M×2×4096, spaced as `zenith_tables`."""
    rho = np.linspace(0.0, 1.0, _TABLE_SIZE) ** 2
    return np.stack([metal_zeniths(rho, metal.n, metal.k) for metal in METALS])


def _metric_coordinates(camera: PinholeCamera, options: CueOptions) -> np.ndarray:
    """The x of M = I + x xᵀ, zero for the orthographic camera, float32 H×W×2."""
    return np.zeros_like(camera.normalized()) if options.orthographic else camera.normalized()


@njit(inline="always", error_model="numpy")
def _double_cosine(ax, ay, bx, by):
    """cos 2δ for the angle δ between a unit vector and another; 0 where that is zero."""
    norm, dot = bx * bx + by * by, ax * bx + ay * by
    return np.float32(2.0) * dot * dot / norm - np.float32(1.0) if norm > 0 else np.float32(0.0)


@njit(parallel=True, error_model="numpy")
def _kind_votes(cosine, sine, sigma, usable, normals, xy, sharpness, guess, strength, kind, weight):
    """How clear each angle is: 1 if it is noiseless, 0 if it is noisier than allowed or unusable. Votes (1: diffuse,
    -1: specular) times their weight, and that.

    guess: weighted votes of a network, where the angle is clear, or empty.
    """
    height, width = sigma.shape
    zero, half, one, guessed = np.float32(0.0), np.float32(0.5), np.float32(1.0), guess.size > 0
    for v in prange(height):
        for u in range(width):
            noise = sigma[v, u] * sharpness
            clear = max(one - noise * noise, zero) if usable[v, u] else zero
            strength[v, u], kind[v, u], weight[v, u] = clear, zero, zero
            if not clear > 0:
                continue
            x, y, nz = xy[v, u, 0], xy[v, u, 1], normals[v, u, 2]
            dx, dy = normals[v, u, 0] - nz * x, normals[v, u, 1] - nz * y
            d2 = dx * dx + dy * dy
            if d2 > 0:
                along = (dx * x + dy * y) / (one + x * x + y * y)
                c, s = cosine[v, u], sine[v, u]
                diffuse = _double_cosine(c, s, dx, dy)
                specular = _double_cosine(-s, c, dx - x * along, dy - y * along)  # M⁻¹ d is along ∇w
                w = clear * np.sqrt(min(d2, one))  # a prior that faces the camera votes little
                kind[v, u], weight[v, u] = half * w * (diffuse - specular), w
            if guessed:
                kind[v, u] += clear * guess[v, u]
                weight[v, u] += clear * abs(guess[v, u])


@njit
def _look_up(tables, row, rho):
    x = np.sqrt(min(max(rho, np.float32(0.0)), np.float32(1.0))) * np.float32(_TABLE_SIZE - 1)
    i = min(int(x), _TABLE_SIZE - 2)
    share = x - np.float32(i)
    return tables[row, i] + share * (tables[row, i + 1] - tables[row, i])


@njit
def _nearer(tables, row, rho, prior_zenith):
    """Of the zeniths in two neighbouring rows the one nearer to the prior's."""
    low = _look_up(tables, row, rho)
    high = _look_up(tables, row + 1, rho)
    return high if abs(high - prior_zenith) < abs(low - prior_zenith) else low


@njit(parallel=True, error_model="numpy")
def _resolve(
    aolp, cosine, sine, dolp, sigma_dolp, strength, normals, vote, weight, xy, tables, max_diffuse, row,
    metal_tables, metal, azimuth, zenith, label, confidence,
):  # fmt: skip
    """The four candidates reduced to one; polarization clearly above what diffuse light can have is specular."""
    height, width = aolp.shape
    pi, one = np.float32(np.pi), np.float32(1.0)
    for v in prange(height):
        for u in range(width):
            x, y = xy[v, u, 0], xy[v, u, 1]
            nx, ny, nz = normals[v, u, 0], normals[v, u, 1], normals[v, u, 2]
            px, py = nx - nz * x, ny - nz * y
            if not (strength[v, u] > 0 and weight[v, u] > 0 and px * px + py * py > 0):
                azimuth[v, u], zenith[v, u], label[v, u], confidence[v, u] = np.nan, np.nan, 0, 0.0
                continue
            confidence[v, u] = strength[v, u] * abs(vote[v, u]) / weight[v, u]
            dx, dy, table = cosine[v, u], sine[v, u], tables[row[v, u]]
            if vote[v, u] >= 0 and dolp[v, u] - 2 * sigma_dolp[v, u] < max_diffuse[row[v, u]]:
                azimuth[v, u] = aolp[v, u] if px * dx + py * dy >= 0 else aolp[v, u] - pi
                zenith[v, u] = _look_up(table, 0, dolp[v, u])
                label[v, u] = 1
                continue
            dx, dy = -dy, dx
            along = dx * x + dy * y
            dx, dy = dx + x * along, dy + y * along
            side = one if px * dx + py * dy >= 0 else -one
            azimuth[v, u] = np.arctan2(side * dy, side * dx)
            towards = -(nx * x + ny * y + nz) / np.sqrt(one + x * x + y * y)
            expected = np.arccos(min(max(towards, np.float32(0.0)), one))
            if metal[v, u] > 0 and vote[v, u] < 0:
                zenith[v, u] = _nearer(metal_tables[metal[v, u] - 1], 0, dolp[v, u], expected)
                label[v, u] = 3
            else:
                zenith[v, u] = _nearer(table, 1, dolp[v, u], expected)
                label[v, u] = 2
