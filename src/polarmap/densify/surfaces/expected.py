"""What a network expects of a view, which planes should be like."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.prior.priors import PriorDepth


@dataclass(frozen=True)
class Expected:
    """What is guessed of a view from its picture, such as a network's depth and normals, with standard deviations.

    depth: float32 H×W z, positive. sigma_depth: float32 H×W, relative to it. normal: float32 H×W×3, unit vectors toward
    the camera. sigma_normal: float32 H×W, of its angle in radians. mirrored: bool H×W, where points are behind what is
    expected as what is seen in a mirror is; None where that is not known.
    """

    depth: np.ndarray
    sigma_depth: np.ndarray
    normal: np.ndarray
    sigma_normal: np.ndarray
    mirrored: np.ndarray | None = None

    @classmethod
    def of(cls, prior: PriorDepth) -> Expected | None:
        """What the prior's network expects; None where it does not tell how sure it is."""
        found = prior.prediction
        if found is None or prior.aligned_depth is None:
            return None
        if found.sigma_depth is None or found.normal is None or found.sigma_normal is None:
            return None
        return cls(prior.aligned_depth, found.sigma_depth, found.normal, found.sigma_normal, prior.mirrored)
