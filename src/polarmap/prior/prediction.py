"""What a depth network says of an image."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Prediction:
    """All that a network says of an image, H×W float32 unless said; None for what it does not tell.

    relative_inverse_depth: up to scale and offset, near is large, NaN where there is none.
    normal: unit, camera frame, toward the camera, H×W×3.
    specular: probability that mirrored light rules the polarization, else light from the body.
    sigma_depth, sigma_normal: the network's own guess of the standard deviation of depth relative to itself, once
        aligned, and of the normal's angle in radians.
    """

    relative_inverse_depth: np.ndarray
    normal: np.ndarray | None = None
    specular: np.ndarray | None = None
    sigma_depth: np.ndarray | None = None
    sigma_normal: np.ndarray | None = None
