"""How noisy an image is."""

from __future__ import annotations

import cv2
import numpy as np


def estimate_noise(image: np.ndarray) -> float:
    """Standard deviation of pixel noise, from the lower quartile of a mask that cancels planes.

    Immerkær, CVIU 1996, has the mask [1 -2 1]ᵀ[1 -2 1] and the mean; the quartile also bears images that are mostly
    texture. At least 1e-3, what 8-bit steps amount to in a picture without noise.
    """
    line = np.float32([[1.0, -2.0, 1.0]])
    residual = np.abs(cv2.sepFilter2D(image, cv2.CV_32F, line, line.T))[1:-1, 1:-1]
    quartile_of_normal = 0.3186
    return max(float(np.quantile(residual[::2, ::2], 0.25)) / (6.0 * quartile_of_normal), 1e-3)
