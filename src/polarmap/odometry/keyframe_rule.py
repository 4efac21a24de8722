"""DSO's rule for when a frame becomes a keyframe, w_f f + w_ft f_t + w_a a > 1 (Engel et al. 2016, section 3.1).

Odometry applies it to the frames that it tracks, and the mapper to those whose poses it is given.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from polarmap.geometry.camera import PinholeCamera


class KeyframeWeights(Protocol):
    """The weights of the rule: w_f and w_ft per pixel of a 640×480 image, w_a of the brightness."""

    @property
    def flow_weight(self) -> float:
        """w_f."""

    @property
    def translation_weight(self) -> float:
        """w_ft."""

    @property
    def brightness_weight(self) -> float:
        """w_a."""


@dataclass(frozen=True)
class ViewChange:
    """What has changed since the last keyframe.

    flow: f, root mean square motion of the points in pixels. translation_flow: f_t, the same without rotation.
    brightness: a = |ln ratio|.
    """

    flow: float
    translation_flow: float
    brightness: float

    def score(self, camera: PinholeCamera, weights: KeyframeWeights) -> float:
        """The left side of the rule; its weights are for 640×480 and scale with the image."""
        flow = weights.flow_weight * self.flow + weights.translation_weight * self.translation_flow
        return vga_scale(camera) * flow + weights.brightness_weight * self.brightness


def vga_scale(camera: PinholeCamera) -> float:
    """Pixels of a 640×480 image per pixel of the camera's, by width and height together as DSO has it."""
    return (640 + 480) / (camera.width + camera.height)
