"""The start of a map: a first frame, the frames that wait, and the two ways to find the motion between two of them.

Corners that are followed from the first frame give motion and depth whatever the motion was (`two_view`), and direct
alignment refines them. Where an image has too few corners, direct alignment alone must do, which takes slow motion.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.options import OdometryOptions
from polarmap.odometry.pyramid import Pyramid, level_cameras
from polarmap.odometry.start.direct import DirectStarter, Start
from polarmap.odometry.start.two_view import TwoViewStarter

_PARALLAX = 0.01  # of the focal length, which the direct start needs; 5 pixels of 500
_LEAST_PARALLAX = 1.0  # pixels
_FEW_CORNERS = 120  # below which direct alignment is tried too
_MAX_WAITING = 60  # frames after which a new first frame is taken


@dataclass(frozen=True, eq=False)
class WaitingFrame:
    """A frame that has no pose yet; its image is float32 H×W in [0, 1].

    problem: why it cannot be tracked in the map that there was; empty if there was none.
    """

    index: int
    timestamp: float
    image: np.ndarray
    exposure: float
    problem: str = ""


class Starter:
    """Takes frames until two of them make a start.

    waiting: the first frame and those after it, without the last one added. reason: why there is no start yet.
    """

    def __init__(
        self, camera: PinholeCamera, options: OdometryOptions, seed: int, valid: np.ndarray | None = None
    ) -> None:
        self._corners = TwoViewStarter(camera, seed=seed)
        self._direct = DirectStarter(level_cameras(camera), options, seed, valid)
        self._min_parallax = max(_PARALLAX * 0.5 * (camera.fx + camera.fy), _LEAST_PARALLAX)
        self.waiting: list[WaitingFrame] = []
        self.reason = ""

    def add(self, frame: WaitingFrame, pyramid: Pyramid) -> Start | None:
        """Take the next frame; a start between the first waiting frame and this one, if there is one."""
        if not self.waiting:
            self._begin(frame, pyramid)
            return None
        start = self._try(frame, pyramid)
        if start is not None:
            return start
        if self._is_hopeless():
            self._begin(frame, pyramid)
        else:
            self.waiting.append(frame)
        return None

    def _begin(self, frame: WaitingFrame, pyramid: Pyramid) -> None:
        reason = self.reason
        self.waiting = []
        if not self._direct.begin(pyramid):
            self.reason = self._direct.reason
            return
        self._corners.begin(frame.image)
        self.waiting = [frame]
        self.reason = reason or "the first frame waits for a second one"

    def _try(self, frame: WaitingFrame, pyramid: Pyramid) -> Start | None:
        if not self._corners.exhausted:
            geometry = self._corners.add(frame.image)
            self.reason = self._corners.reason
            if geometry is not None:
                start = self._direct.refine(
                    pyramid, geometry.T_second_first, geometry.pixels, geometry.inverse_depth
                )  # fmt: skip
                self.reason = "" if start else self._direct.reason
                return start
            if self._corners.count >= _FEW_CORNERS:
                return None
        start = self._direct.add(pyramid, self._min_parallax)
        self.reason = self._direct.reason
        return start

    def _is_hopeless(self) -> bool:
        return len(self.waiting) >= _MAX_WAITING or (self._corners.exhausted and self._direct.unfit)
