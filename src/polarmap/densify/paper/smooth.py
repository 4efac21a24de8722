"""Edge-weighted total variation smoothing of a depth map with holes."""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import njit


def edge_weights(intensity: np.ndarray, zeta: float = 3.0) -> np.ndarray:
    """τ = exp(-ζ|∇I|) of the paper's equation (10), float32 H×W; intensity in [0, 1] of full scale."""
    gu = np.zeros_like(intensity)
    gv = np.zeros_like(intensity)
    gu[:, :-1] = np.diff(intensity, axis=1)
    gv[:-1] = np.diff(intensity, axis=0)
    return np.exp(-zeta * np.hypot(gu, gv)).astype(np.float32)


def smooth_total_variation(
    values: np.ndarray, weights: np.ndarray, strength: float = 0.3, iterations: int = 3, max_step: float = np.inf
) -> np.ndarray:
    """Minimize ½|z - z₀|² + λ Σ τ|∇z| over the known pixels (equation (10)), by projected dual ascent.

    values: float32 H×W, NaN where unknown (stays so; no gradient is taken across). weights: τ, float32 H×W.
    strength: λ. iterations: the paper takes 3; more come closer to the minimum. max_step: neighbours that differ by
    more lie on different surfaces, and no gradient is taken between them.
    Source: Chambolle, An algorithm for total variation minimization, 2004, with step 1/4.
    """
    smooth = values.copy()
    dual = np.zeros((2, *values.shape), np.float32)
    for _ in range(iterations):
        _ascend(smooth, weights, np.float32(strength), np.float32(max_step), dual)
        _primal(values, dual, smooth)
    return smooth


@njit(parallel=True)
def _ascend(z, tau, strength, max_step, dual):
    height, width = z.shape
    for v in prange(height):
        for u in range(width):
            gu = z[v, u + 1] - z[v, u] if u + 1 < width else np.float32(0.0)
            gv = z[v + 1, u] - z[v, u] if v + 1 < height else np.float32(0.0)
            pu = dual[0, v, u] + (np.float32(0.25) * gu if abs(gu) <= max_step else np.float32(0.0))
            pv = dual[1, v, u] + (np.float32(0.25) * gv if abs(gv) <= max_step else np.float32(0.0))
            bound = strength * tau[v, u]
            excess = max(np.float32(1.0), np.sqrt(pu * pu + pv * pv) / max(bound, np.float32(1e-12)))
            dual[0, v, u] = pu / excess
            dual[1, v, u] = pv / excess


@njit(parallel=True)
def _primal(values, dual, smooth):
    height, width = values.shape
    for v in prange(height):
        for u in range(width):
            divergence = dual[0, v, u] + dual[1, v, u]
            if u > 0:
                divergence -= dual[0, v, u - 1]
            if v > 0:
                divergence -= dual[1, v - 1, u]
            smooth[v, u] = values[v, u] + divergence
