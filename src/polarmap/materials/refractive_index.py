"""The refractive index of dielectric surfaces, by region, where the normal is known and light comes from the body.

At a known zenith the degree of polarization of light from the body has η as its only unknown: every such pixel votes.
Albedo does not matter, so that views of several zeniths, as of a curved surface, need no light model; that one η fits
all of them is part of the proof. Mixed light imitates a wrong η: in the same way at all zeniths, nearly, but not at
all brightnesses (see `regions`). What does not clearly depart from 1.5 stays there. Mirrored light is not asked: its
degree hardly depends on η, so that a normal that is off by 2° shifts η by 0.2.
"""

from __future__ import annotations

from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import njit
from polarmap.materials.regions import RegionFits, fit_regions
from polarmap.materials.samples import DIFFUSE, MaterialSamples, material_samples
from polarmap.polarization.fresnel import diffuse_dolp

if TYPE_CHECKING:
    from polarmap.polarization.options import CueOptions

LEAST_INDEX, LARGEST_INDEX = 1.3, 2.0

_PURE = 0.8  # share of a region's samples that must be of one kind
_LEAST_SAMPLES = 100
_CLEAR = 4.0  # least degree to be expected, in standard deviations
_LARGEST_SCATTER = 0.35
_SLOPE_PRIOR = 0.3  # of η per e-fold of intensity, if light is mixed
_DRIFT_SHARE = 0.5
_SYSTEMATIC = 0.04  # by the region's normal being off by 2° as a whole
_CLEAR_DEPARTURE = 1.5  # from the typical η, in standard deviations
_ZENITH_ERROR = 0.07  # radians, of one sample's normal
_BEYOND = 5.0  # how much worse an η outside the bounds is than its distance from them
_TABLE_INDICES = np.linspace(1.1, 2.6, 76)
_TABLE_STEPS = 4  # per degree of zenith


def estimate_refractive_index(
    image: PolarizationImage,
    normals: np.ndarray,
    camera: PinholeCamera,
    regions: np.ndarray | None = None,
    options: CueOptions | None = None,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """η per pixel, float32 H×W in [1.3, 2], the options' refractive index (1.5) where nothing better is known.

    normals: float32 H×W×3 toward the camera, NaN where unknown, such as those of stereo. regions: integers H×W which no
    material crosses, such as the labels of surfaces; by default regions end where normals turn. known: bool H×W, pixels
    whose normal is measured, such as those of stereo points; by default all that have one.
    Raises InputError where shapes differ from the camera's.
    """
    samples = material_samples(image, normals, camera, regions, known)
    return refractive_index_of(samples, camera.shape, 1.5 if options is None else options.refractive_index)


def refractive_index_of(samples: MaterialSamples, shape: tuple[int, int], typical: float = 1.5) -> np.ndarray:
    """As `estimate_refractive_index`, from samples."""
    fits = _fits_of(samples)
    by_region = np.where(np.isfinite(fits.value), shrunk(fits, typical), typical)
    return samples.spread(by_region.astype(np.float32), typical, shape)


def shrunk(fits: RegionFits, typical: float) -> np.ndarray:
    """Estimates drawn toward `typical` by their uncertainty, that of light being pure included, within the bounds.

    Of a departure δ the share max(0, 1 - (1.5σ/δ)²) is kept, as by a positive-part James-Stein estimator.
    """
    beyond = np.maximum(np.maximum(LEAST_INDEX - fits.value, fits.value - LARGEST_INDEX), 0.0)
    impure = np.maximum(fits.slope**2, fits.slope_sigma**2) + (_DRIFT_SHARE * fits.drift) ** 2
    variance = fits.sigma**2 + _SYSTEMATIC**2 + impure + (_BEYOND * beyond) ** 2
    departure = fits.value - typical
    kept = 1.0 - _CLEAR_DEPARTURE**2 * variance / np.maximum(departure**2, 1e-12)
    share = np.where(fits.scatter < _LARGEST_SCATTER, np.maximum(kept, 0.0), 0.0)
    return np.where(share > 0.0, np.clip(typical + share * departure, LEAST_INDEX, LARGEST_INDEX), typical)


def _fits_of(samples: MaterialSamples) -> RegionFits:
    """Pixels are chosen and weighed by the degree to be expected, since choosing by their own would raise the mean."""
    clear = diffuse_dolp(samples.zenith, LEAST_INDEX) > _CLEAR * samples.sigma_dolp
    chosen = samples.of(DIFFUSE, _PURE, clear)
    zenith, dolp = samples.zenith[chosen], samples.dolp[chosen]
    votes = np.empty(chosen.size)
    _vote(_table(), zenith, dolp, votes)
    relative = samples.sigma_dolp[chosen] / diffuse_dolp(zenith, 1.5)
    weight = 1.0 / (relative**2 + (2.0 * _ZENITH_ERROR / np.tan(zenith)) ** 2)
    columns = (votes, weight, samples.log_intensity[chosen], np.log(zenith))
    return fit_regions(samples.region[chosen], *columns, samples.count, _LEAST_SAMPLES, _SLOPE_PRIOR)


@lru_cache(maxsize=1)
def _table() -> np.ndarray:
    """ρ of light from the body by zenith and η."""
    zeniths = np.radians(np.arange(90 * _TABLE_STEPS + 1) / _TABLE_STEPS)[:, None]
    return diffuse_dolp(zeniths, _TABLE_INDICES)


@njit
def _vote(table, zenith, dolp, votes):
    """The η at which the table, which rises along η, has a degree; the nearest end beyond it."""
    first, step = _TABLE_INDICES[0], _TABLE_INDICES[1] - _TABLE_INDICES[0]
    last = table.shape[1] - 1
    for i in range(votes.size):
        x = np.degrees(zenith[i]) * _TABLE_STEPS
        row = min(int(x), table.shape[0] - 2)
        share = x - row
        low, high = 0, last
        while high - low > 1:
            middle = (low + high) // 2
            below = _between(table, row, share, middle) <= dolp[i]
            low, high = (middle, high) if below else (low, middle)
        a, b = _between(table, row, share, low), _between(table, row, share, high)
        votes[i] = first + step * (low + min(max((dolp[i] - a) / (b - a), 0.0), 1.0))


@njit
def _between(table, row, share, column):
    return table[row, column] + share * (table[row + 1, column] - table[row, column])
