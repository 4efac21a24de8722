"""Which points stereo found in a mirror, by the depth that a network expects of the mirror itself.

The picture in a glossy surface has texture, and stereo finds it where it seems to be: always behind the surface. The
polarization of texture gives most of such points away (`densify.surfaces.evidence`), but not those of
weak texture, or those near Brewster's angle, where a mirror's picture is as strong as what it hides. A network has seen
what stands where mirrors are.
"""

from __future__ import annotations

import numpy as np

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
    known = points > 0
    behind = np.zeros(points.shape, bool)
    sigma = np.hypot(prediction.sigma_depth[known], _LEAST_SIGMA)
    behind[known] = np.log(points[known] * aligned[known]) > _BEHIND * sigma
    return behind & (prediction.specular > _LEAST_SPECULAR)
