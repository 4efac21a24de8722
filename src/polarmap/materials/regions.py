"""Regions of a view that may be one material, and what a quantity that is measured at their pixels is on the whole.

The polarization of light from the surface alone, or from the body alone, depends on the zenith and on nothing else.
That of mixed light depends on the brightness too: where more of one kind of light arrives, the degree is nearer to
that of this kind alone. So a quantity that is computed from zenith and degree as if light were pure is fitted together
with its slope along the logarithm of intensity: a slope that is not zero, or not known, tells that it must not be
believed. A drift along the zenith tells the same of a wrong relation.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange

from polarmap.jit import njit

_LARGEST_TURN = np.float32(np.cos(np.radians(15.0)))
_MOST_SAMPLES = 1000  # of one region; more change nothing
_ROUNDS = 5
_DRIFT_PRIOR = 0.5  # standard deviation of the slope along the zenith before anything is measured
_INDEPENDENT = 16.0  # samples that share one error: normals come from windows of several pixels


@dataclass(frozen=True)
class RegionFits:
    """Of R regions, by their number from 0, float64 arrays of length R; NaN where a region has too few samples.

    value: at the region's mean brightness and zenith, and its standard deviation sigma by the samples' scatter.
    slope: per e-fold of intensity, and slope_sigma. drift: from one end of the region's zeniths to the other.
    scatter: robust standard deviation of one sample. zeniths: logarithm of the largest by the smallest of the region,
    if they are evenly spread. samples: how many.
    """

    value: np.ndarray
    sigma: np.ndarray
    slope: np.ndarray
    slope_sigma: np.ndarray
    drift: np.ndarray
    scatter: np.ndarray
    zeniths: np.ndarray
    samples: np.ndarray


def smooth_regions(normals: np.ndarray, labels: np.ndarray | None = None) -> np.ndarray:
    """Connected regions whose normals turn by less than 15° from pixel to pixel, int32 H×W from 1, 0 for none.

    normals: float32 H×W×3, NaN where unknown. labels: integers H×W such as those of surfaces, which no region crosses.
    """
    inside = np.empty(normals.shape[:2], np.uint8)
    labels = np.zeros(normals.shape[:2], np.int64) if labels is None else labels.astype(np.int64)
    _interiors(normals, labels, inside)
    inside = cv2.morphologyEx(inside, cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))  # no bridges of a pixel or two
    _, regions = cv2.connectedComponents(inside, connectivity=4)
    return regions


@njit(parallel=True)
def _interiors(normals, labels, inside):
    """1 where the pixel continues the surface of its right and lower neighbours."""
    height, width = labels.shape
    for v in prange(height):
        for u in range(width):
            right, down = min(u + 1, width - 1), min(v + 1, height - 1)
            same = labels[v, u] == labels[v, right] and labels[v, u] == labels[down, u]
            inside[v, u] = (
                same
                and _cosine(normals[v, u], normals[v, right]) > _LARGEST_TURN
                and _cosine(normals[v, u], normals[down, u]) > _LARGEST_TURN
            )


@njit
def _cosine(a, b):
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2]


def fit_regions(
    region: np.ndarray,
    value: np.ndarray,
    weight: np.ndarray,
    log_intensity: np.ndarray,
    log_zenith: np.ndarray,
    count: int,
    least: int,
    slope_prior: float = 1.0,
) -> RegionFits:
    """Robust weighted least squares of `value` by region, linear in both logarithms (Cauchy's weights).

    region: numbers from 0 to count - 1 of N samples; the other arrays are N long. Regions of fewer than `least` samples
    get NaN. slope_prior: standard deviation of the slope before anything is measured.
    """
    order = np.argsort(region, kind="stable")
    starts = np.searchsorted(region[order], np.arange(count + 1))
    columns = [np.ascontiguousarray(a[order], np.float64) for a in (value, weight, log_intensity, log_zenith)]
    results = np.full((8, count), np.nan)
    _fit_all(starts, *columns, max(least, 8), slope_prior, results)
    return RegionFits(*results)


@njit(parallel=True)
def _fit_all(starts, value, weight, log_intensity, log_zenith, least, slope_prior, results):
    for r in prange(starts.size - 1):
        a, b = starts[r], starts[r + 1]
        results[7, r] = b - a
        if b - a < least:
            continue
        step = 1 + (b - a - 1) // _MOST_SAMPLES
        y, w, x1, x2 = value[a:b:step], weight[a:b:step], log_intensity[a:b:step], log_zenith[a:b:step]
        results[:7, r] = _fit(y, w, x1 - np.mean(x1), x2 - np.mean(x2), (b - a) / _INDEPENDENT, slope_prior)


@njit
def _fit(y, w, x1, x2, independent, slope_prior):
    """The first seven of `RegionFits` of one region, whose samples count as so many independent ones."""
    beta, covariance, scatter = np.zeros(3), np.eye(3), 0.0
    residual = y - np.median(y)
    for _ in range(_ROUNDS):
        scatter = max(1.4826 * np.median(np.abs(residual)), 1e-4)
        v = w / (1.0 + (residual / (2.5 * scatter)) ** 2) ** 2
        v *= independent / (np.sum(v) * scatter * scatter)
        A = np.diag(np.array([0.0, slope_prior**-2, _DRIFT_PRIOR**-2]))
        b = np.zeros(3)
        for i in range(y.size):
            row = (1.0, x1[i], x2[i])
            for j in range(3):
                b[j] += v[i] * row[j] * y[i]
                for k in range(3):
                    A[j, k] += v[i] * row[j] * row[k]
        covariance = np.linalg.inv(A)
        beta = covariance @ b
        residual = y - beta[0] - beta[1] * x1 - beta[2] * x2
    ends = 3.5 * np.std(x2)  # sqrt(12): from end to end of an even distribution
    return np.array([beta[0], covariance[0, 0] ** 0.5, beta[1], covariance[1, 1] ** 0.5, beta[2] * ends, scatter, ends])
