"""The gradient of log range that depth is spread along: the prior's, corrected by the polarization cues.

How far cues can be believed differs between scenes and between kinds of reflection: a mixed pixel's degree of
polarization follows neither equation. The stereo points tell. With g' the prior's gradient, a the one turned into
the cue's azimuth, c the cue's own and g that of the stereo planes, the weights of

    g ≈ g' + κ (β₁ (a - g') + β₂ (c - a)),   κ the cue's confidence,

are fitted at the stereo points, for diffuse, specular and metal pixels apart. If the cues are exact κβ is 1 whatever
the prior is worth; if they are noise β is 0, and the map is that of the prior alone.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.data.codes import Reflection
from polarmap.data.cues import Cues
from polarmap.data.keyframe import CueWeights
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import log_range_gradient, range_factor
from polarmap.jit import njit

_MIN_SAMPLES = 200
_MAX_SAMPLES = 20_000


@dataclass(frozen=True)
class Guidance:
    """gradient: ∇w per pixel, float32 H×W×2 (along u, along v). diffuse, specular, metal: the weights found."""

    gradient: np.ndarray
    diffuse: CueWeights
    specular: CueWeights
    metal: CueWeights = CueWeights()  # noqa: RUF009


def guide(
    prior_depth: np.ndarray,
    cues: Cues,
    stereo_gradient: np.ndarray,
    camera: PinholeCamera,
    orthographic: bool = False,
) -> Guidance:
    """Combine prior and cues, weighing them by how well they explain the stereo points.

    prior_depth: float32 H×W z. stereo_gradient: ∇w of the stereo planes, float32 H×W×2, NaN where there is no
    stereo point. Where the prior is NaN the gradient is NaN.
    """
    prior = prior_gradient(prior_depth, camera)
    cue = log_range_gradient(cues.azimuth, cues.zenith, camera, orthographic)
    turned = _with_direction(prior, cue)
    gradient = prior.copy()
    weights = {}
    for kind in (Reflection.DIFFUSE, Reflection.SPECULAR, Reflection.METAL):
        pixels = cues.label == kind
        known = pixels & np.isfinite(stereo_gradient + prior + cue).all(axis=-1)
        weights[kind] = _fit(prior, turned, cue, stereo_gradient, cues.confidence, known)
        _apply(gradient, turned, cue, cues.confidence, pixels, weights[kind])
    return Guidance(gradient, *weights.values())


def prior_gradient(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Central differences of log range per pixel, float32 H×W×2."""
    log_range = np.log(depth * range_factor(camera))
    return np.stack([np.gradient(log_range, axis=1), np.gradient(log_range, axis=0)], axis=-1).astype(np.float32)


def plane_gradient(
    inverse_depth: np.ndarray, gradient_u: np.ndarray, gradient_v: np.ndarray, camera: PinholeCamera
) -> np.ndarray:
    """∇w per pixel of planes given by q = 1/z and its gradient: ∇w = -∇q/q + ∇ ln sqrt(1+|x|²), float32 H×W×2."""
    xy = camera.normalized()
    stretch = xy / (1.0 + np.einsum("hwc,hwc->hw", xy, xy))[..., None] / np.float32([camera.fx, camera.fy])
    return stretch - np.stack([gradient_u, gradient_v], axis=-1) / inverse_depth[..., None]


def _with_direction(prior: np.ndarray, cue: np.ndarray) -> np.ndarray:
    """The prior's steepness in the cue's direction."""
    steepness = np.linalg.norm(prior, axis=-1) / np.maximum(np.linalg.norm(cue, axis=-1), 1e-12)
    return cue * steepness[..., None]


def _fit(prior, turned, cue, stereo, confidence, known) -> CueWeights:
    """Least squares for β₁, β₂ with Cauchy weights, clipped to [0, 1]; zero where samples are few."""
    samples = np.flatnonzero(known)
    if samples.size < _MIN_SAMPLES:
        return CueWeights()
    samples = samples[:: max(1, samples.size // _MAX_SAMPLES)]
    prior, turned, cue, stereo = (a.reshape(-1, 2)[samples].astype(np.float64) for a in (prior, turned, cue, stereo))
    kappa = confidence.ravel()[samples, None]
    A = np.stack([(kappa * (turned - prior)).ravel(), (kappa * (cue - turned)).ravel()], axis=1)
    y = (stereo - prior).ravel()
    weight = np.ones_like(y)
    for _ in range(6):
        normal = (A * weight[:, None]).T @ A + 1e-12 * np.eye(2)
        beta = np.linalg.solve(normal, (A * weight[:, None]).T @ y)
        residual = np.abs(y - A @ beta)
        weight = 1.0 / (1.0 + (residual / (3.0 * np.median(residual) + 1e-12)) ** 2) ** 2
    limit = 1.0 / max(float(np.median(kappa)), 0.1)  # κβ is held to 1 at every pixel
    azimuth, zenith = np.clip(beta, 0.0, limit)
    return CueWeights(float(azimuth), float(min(azimuth, zenith)))


def _apply(gradient, turned, cue, confidence, pixels, weights: CueWeights) -> None:
    _blend(gradient, turned, cue, confidence, pixels, np.float32(weights.azimuth), np.float32(weights.zenith))


@njit(parallel=True)
def _blend(gradient, turned, cue, confidence, pixels, azimuth_weight, zenith_weight):
    height, width = pixels.shape
    for v in prange(height):
        for u in range(width):
            if not pixels[v, u]:
                continue
            azimuth = min(azimuth_weight * confidence[v, u], np.float32(1.0))
            zenith = min(zenith_weight * confidence[v, u], np.float32(1.0))
            for i in range(2):
                turn = azimuth * (turned[v, u, i] - gradient[v, u, i])
                tilt = zenith * (cue[v, u, i] - turned[v, u, i])
                gradient[v, u, i] += turn + tilt
