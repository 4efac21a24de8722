"""Which regions of a view are metals, where normals are known.

A metal mirrors and does nothing else. Its degree of polarization is far below that of a dielectric's mirrored light at
the same zenith and has the same angle, which mixed light of a dielectric has, too. What tells them apart is that a
metal's degree is the same at every brightness of what it mirrors, and that of mixed light is not (see `regions`). So
a region is taken for a metal only if its brightness varies and its degree does not follow; where all is evenly bright
nobody can tell. Only zeniths below the Brewster angles of dielectrics count: beyond, a dielectric mirrors much more
than its body gives, and its degree falls through those of metals.
"""

from __future__ import annotations

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera
from polarmap.materials.regions import RegionFits, fit_regions
from polarmap.materials.samples import SPECULAR, MaterialSamples, material_samples
from polarmap.polarization.fresnel import metal_dolp
from polarmap.polarization.metals import METALS

_PURE = 0.8  # share of a region's samples that must be specular
_LEAST_SAMPLES = 60
_LARGEST_MISFIT = 0.25  # of ln ρ against the nearest metal; a dielectric's mirrored light is off by more than 0.7
_LARGEST_SLOPE = 0.45  # of ln ρ along ln intensity: the ratio of body to mirrored light, if light is mixed
_LARGEST_DRIFT = 0.5
_LARGEST_SCATTER = 0.3
_LEAST_ZENITHS = np.log(1.4)  # a relation to the zenith is not seen on one zenith
_DRIFT_SHARE = 0.3  # how much a drift, which normals that are too smooth make, too, counts in choosing the metal
_HIGHEST = np.radians(55.0)
_ZENITH_ERROR = 0.07  # radians, of one sample's normal


def find_metals(
    image: PolarizationImage,
    normals: np.ndarray,
    camera: PinholeCamera,
    regions: np.ndarray | None = None,
    known: np.ndarray | None = None,
) -> np.ndarray:
    """Which metal a pixel is most like, uint8 H×W: 0 none, otherwise 1 + its index in `metals.METALS`.

    Arguments as of `estimate_refractive_index`.
    """
    return metals_of(material_samples(image, normals, camera, regions, known), camera.shape)


def metals_of(samples: MaterialSamples, shape: tuple[int, int]) -> np.ndarray:
    """As `find_metals`, from samples."""
    chosen = samples.of(SPECULAR, _PURE, (samples.zenith < _HIGHEST) & (samples.dolp > 0))
    best, metal = np.full(samples.count, np.inf), np.zeros(samples.count, np.uint8)
    for index, candidate in enumerate(METALS):
        fits = _fits_to(samples, chosen, metal_dolp(samples.zenith[chosen], candidate.n, candidate.k))
        misfit = np.where(_is_metal(fits), np.hypot(fits.value, _DRIFT_SHARE * fits.drift), np.inf)
        better = misfit < best
        best[better], metal[better] = misfit[better], index + 1
    return samples.spread(metal, 0, shape)


def _fits_to(samples: MaterialSamples, chosen: np.ndarray, expected: np.ndarray) -> RegionFits:
    """ln ρ against a relation."""
    dolp, zenith = samples.dolp[chosen], samples.zenith[chosen]
    weight = 1.0 / ((samples.sigma_dolp[chosen] / dolp) ** 2 + (2.0 * _ZENITH_ERROR / np.sin(2.0 * zenith)) ** 2)
    columns = (np.log(dolp / expected), weight, samples.log_intensity[chosen], np.log(zenith))
    return fit_regions(samples.region[chosen], *columns, samples.count, _LEAST_SAMPLES)


def _is_metal(fits: RegionFits) -> np.ndarray:
    return (
        (np.abs(fits.value) < _LARGEST_MISFIT)
        & (np.abs(fits.slope) + 2.0 * fits.slope_sigma < _LARGEST_SLOPE)
        & (np.abs(fits.drift) < _LARGEST_DRIFT)
        & (fits.scatter < _LARGEST_SCATTER)
        & (fits.zeniths > _LEAST_ZENITHS)
    )
