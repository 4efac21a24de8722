"""The residual pattern: the eight pixels around a point that are compared (DSO, figure 4)."""

from __future__ import annotations

import numpy as np

PATTERN = np.array([[0, -2], [-1, -1], [1, -1], [-2, 0], [0, 0], [2, 0], [-1, 1], [0, 2]], dtype=np.float32)  # (du, dv)
PATTERN_SIZE = len(PATTERN)
PATTERN_RADIUS = 2  # pixels
CENTRE = 4  # index of the pattern's centre
