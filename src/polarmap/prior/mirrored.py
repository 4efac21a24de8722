"""Which points stereo found in a mirror, by the depth that a network expects of the mirror itself.

The picture in a glossy surface has texture, and stereo finds it where it seems to be: always behind the surface. The
polarization of texture gives most of such points away (`densify.surfaces.evidence`), but not those of
weak texture, or those near Brewster's angle, where a mirror's picture is as strong as what it hides. A network has seen
what stands where mirrors are.
"""

from __future__ import annotations

import numpy as np
from numba import prange

from polarmap.jit import njit
from polarmap.prior.prediction import Prediction

_BEHIND = 2.0  # standard deviations
_LEAST_SIGMA = 0.1  # of log depth; a network's errors are the same all over a surface
_LEAST_SPECULAR = 0.1  # probability below which a surface shows no mirrored picture


def mirrored_points(points: np.ndarray, aligned: np.ndarray, prediction: Prediction) -> np.ndarray:
    """Points far behind a surface that may be a mirror, bool H×W.

    points: z in metres, float32 H×W, NaN where none. aligned: the network's inverse depth in 1/m, float32 H×W.
    None where the network does not say how sure it is and what reflects.
    """
    if prediction.sigma_depth is None or prediction.specular is None:
        return np.zeros(points.shape, bool)
    mirrored = np.empty(points.shape, bool)
    _judge(points, aligned, prediction.sigma_depth, prediction.specular, mirrored)
    return mirrored


@njit(parallel=True)
def _judge(points, aligned, sigma_depth, specular, mirrored):
    least, behind = np.float32(_LEAST_SIGMA), np.float32(_BEHIND)
    for v in prange(points.shape[0]):
        for u in range(points.shape[1]):
            mirrored[v, u] = False
            if points[v, u] > 0 and specular[v, u] > _LEAST_SPECULAR:
                sigma = np.sqrt(sigma_depth[v, u] * sigma_depth[v, u] + least * least)
                mirrored[v, u] = np.log(points[v, u] * aligned[v, u]) > behind * sigma
