"""The residual pattern: the eight pixels around a point that are compared (DSO, figure 4)."""

from __future__ import annotations

import numpy as np

PATTERN = np.array([[0, -2], [-1, -1], [1, -1], [-2, 0], [0, 0], [2, 0], [-1, 1], [0, 2]], dtype=np.float32)  # (du, dv)
PATTERN_SIZE = len(PATTERN)
PATTERN_RADIUS = 2  # pixels
CENTRE = 4  # index of the pattern's centre
OUTLIER_ENERGY = np.float32(PATTERN_SIZE * 12.0**2)
"""Squared grey values over the pattern, above which it does not match: 12 at each pixel, a third more than where the
robust norm turns linear (`OdometryOptions.huber`)."""
