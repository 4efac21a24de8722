"""What a stereo method is: from views of known pose to a plane for every pixel."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Protocol

import numpy as np

from polarmap.data.plane_field import PlaneField
from polarmap.data.view import View
from polarmap.geometry.camera import PinholeCamera


class StereoMethod(Protocol):
    """Depth of a view from its neighbours. Which of it is kept is decided after it, see `consistency`."""

    def __call__(
        self,
        reference: View,
        others: Sequence[View],
        camera: PinholeCamera,
        depth_range: tuple[float, float],
        start: np.ndarray | None = None,
    ) -> PlaneField:
        """The plane of every pixel of `reference` that fits `others` best.

        others: at least one view, all of which have moved. depth_range: (nearest, farthest) z to try, in the unit of
        the poses. start: expected inverse depth, float32 H×W, NaN where unknown; None where nothing is. Scores must be
        0 for no match to 1, and sigma the standard deviation of inverse depth by noise.
        Raises InputError where a size differs from the camera's.
        """
        ...
