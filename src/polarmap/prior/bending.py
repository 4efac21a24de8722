"""An aligned network's depth, bent to the points that it was aligned to."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.prior.options import PriorOptions
from polarmap.prior.sparse import clip_to_points, interpolate_field, inverse_points, robust_range

_FLATNESS = 0.1  # what corrects a network is extrapolated as a constant, the network's own slopes are kept
_REACH = 0.03  # of the image diagonal; farther from the points a network's shape is the better guess


def bend_to_points(
    inverse_depth: np.ndarray,
    interpolated: np.ndarray,
    intensity: np.ndarray,
    sparse_depth: np.ndarray,
    confidence: np.ndarray | None = None,
    options: PriorOptions | None = None,
) -> np.ndarray:
    """An aligned network's inverse depth, corrected by the points: near them theirs, far from them its shape.

    A network's scale differs from surface to surface. The ratio of the points to it, interpolated along surfaces,
    corrects that; and toward the points the result passes into the `sparse` prior, which is better there.
    inverse_depth: positive, float32 H×W in 1/m. interpolated: that of the `sparse` prior. At least three points.
    Returns float32 H×W, bounded as the `sparse` prior is.
    """
    options = options or PriorOptions()
    points, weights = inverse_points(sparse_depth, confidence)
    ratio = points / inverse_depth
    correction = interpolate_field(intensity, ratio, weights, options, _FLATNESS)
    bent = clip_to_points(inverse_depth * np.clip(correction, *robust_range(ratio[weights > 0])), points, weights)
    near = nearness(weights > 0)
    return near * interpolated + (1 - near) * bent


def nearness(points: np.ndarray) -> np.ndarray:
    """How much the `sparse` prior counts beside a network: 1 at the points (bool H×W), 1/2 at 3 % of the diagonal."""
    distance = cv2.distanceTransform((~points).astype(np.uint8), cv2.DIST_L2, 5)
    return 1.0 / (1.0 + np.square(distance / np.float32(_REACH * np.hypot(*points.shape))))
