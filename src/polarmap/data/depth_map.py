"""A depth map as it is fused."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polarmap.geometry.camera import PinholeCamera


@dataclass(frozen=True, eq=False)
class DepthMap:
    """Depth of a picture; its arrays must not change any more.

    depth: float32 H×W z, NaN where none. grey: float32 H×W, share of full scale. confidence: float32 H×W in [0, 1].
    camera: of these images.
    """

    depth: np.ndarray
    grey: np.ndarray
    confidence: np.ndarray
    camera: PinholeCamera

    def scaled(self, scale: float) -> DepthMap:
        """With depth times `scale`; itself at 1."""
        return self if scale == 1.0 else replace(self, depth=np.float32(scale) * self.depth)
