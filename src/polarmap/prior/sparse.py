"""The `sparse` prior: inverse depth interpolated over the whole image from the sparse points."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.prior.encoding import encode_display
from polarmap.prior.options import PriorOptions
from polarmap.prior.plane_grid import interpolate_planes

MIN_POINTS = 3  # a plane
_FLATNESS = 1e-3  # slopes carry planes over bare walls, and are let go where nothing supports them
_MARGIN = np.float32(1.25)  # how far beyond the points' inverse depths the interpolation may go
_SUPPORT = 0.02  # of the image diagonal, the side of the square that counts as a point's company
_MAX_SAMPLES = 20_000


def interpolate_inverse_depth(
    intensity: np.ndarray,
    sparse_depth: np.ndarray,
    confidence: np.ndarray | None = None,
    options: PriorOptions | None = None,
) -> np.ndarray:
    """Inverse depth of all pixels, planar within surfaces and free to jump where the image has an edge.

    intensity: linear grey, float32 H×W. sparse_depth: metres, float32 H×W, NaN where there is no point.
    confidence: weight of each point, float32 H×W >= 0, or None for equal weights.
    Returns float32 H×W in 1/m, within a quarter of the range of the points (their 0.5 to 99.5 %); NaN everywhere
    where there are fewer than three points.
    """
    inverse_depth, weights = inverse_points(sparse_depth, confidence)
    if np.count_nonzero(weights) < MIN_POINTS:
        return np.full(sparse_depth.shape, np.nan, np.float32)
    field = interpolate_field(intensity, inverse_depth, weights, options or PriorOptions(), _FLATNESS)
    return clip_to_points(field, inverse_depth, weights)


def interpolate_field(
    intensity: np.ndarray, values: np.ndarray, weights: np.ndarray, options: PriorOptions, flatness: float
) -> np.ndarray:
    """Positive values at pixels of positive weight, carried over the image along its surfaces, float32 H×W."""
    guide = encode_display(intensity, 0.5)
    return interpolate_planes(values, _supported(weights), guide, options.contrast, options.point_noise, flatness)


def _supported(weights: np.ndarray) -> np.ndarray:
    """Less weight to points in thinner company than most: stereo is wrong there more often, float32 H×W."""
    side = 2 * round(0.5 * _SUPPORT * np.hypot(*weights.shape)) + 1
    density = cv2.blur(weights, (side, side))
    at_points = density[weights > 0]
    usual = np.median(at_points[:: at_points.size // _MAX_SAMPLES + 1])
    return weights * np.minimum(density / usual, 1.0)


def inverse_points(sparse_depth: np.ndarray, confidence: np.ndarray | None) -> tuple[np.ndarray, np.ndarray]:
    """Inverse depth and weight of the points, float32 H×W each, weight 0 (inverse depth 0) where there is none."""
    if confidence is not None and confidence.shape != sparse_depth.shape:
        raise InputError(f"prior: confidence {confidence.shape} and sparse depth {sparse_depth.shape} differ in shape")
    known = np.isfinite(sparse_depth) & (sparse_depth > 0)
    if confidence is not None:
        known &= np.isfinite(confidence) & (confidence > 0)
    weights = known.astype(np.float32) if confidence is None else np.where(known, confidence, 0).astype(np.float32)
    inverse_depth = np.zeros(sparse_depth.shape, np.float32)
    np.divide(1.0, sparse_depth, out=inverse_depth, where=known, casting="same_kind")
    return inverse_depth, weights


def clip_to_points(field: np.ndarray, inverse_depth: np.ndarray, weights: np.ndarray) -> np.ndarray:
    """`field` bounded by the range of the points' inverse depths, with a margin."""
    low, high = robust_range(inverse_depth[weights > 0])
    return np.clip(field, low / _MARGIN, high * _MARGIN)


def robust_range(values: np.ndarray) -> tuple[np.float32, np.float32]:
    """The 0.5 and 99.5 % quantiles."""
    samples = values[:: values.size // _MAX_SAMPLES + 1]
    low, high = np.quantile(samples, [0.005, 0.995])
    return np.float32(low), np.float32(high)
