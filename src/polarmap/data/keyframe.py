"""What a run gives: keyframes one by one, and the map at the end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polarmap.data.depth_search import DepthSearch
from polarmap.data.polarization_image import PolarizationImage
from polarmap.geometry.camera import PinholeCamera


@dataclass(frozen=True)
class CueWeights:
    """How far one kind of reflection is believed: β₁ for the azimuth, β₂ for the zenith, from 0.

    They multiply the cue's confidence, and the product is held to 1.
    """

    azimuth: float = 0.0
    zenith: float = 0.0


@dataclass(frozen=True)
class Stages:
    """Depth of a keyframe before it was done, float32 H×W z with NaN: what each step of the pipeline adds.

    stereo: points that stereo defends by itself. inliers: those that other keyframes do not contradict.
    first: after the first step of densification: iteration 1 of the paper's loop, or the free surface without planes.
    """

    stereo: np.ndarray
    inliers: np.ndarray
    first: np.ndarray


@dataclass(frozen=True)
class CueBeliefs:
    """How far polarization was believed in a keyframe, by its agreement with the stereo points.

    diffuse, specular: by the paper's loop, for pixels of either kind. surfaces: in telling planes apart, from 0 to 0.5.
    """

    diffuse: CueWeights = CueWeights()
    specular: CueWeights = CueWeights()
    surfaces: float = 0.0


@dataclass(frozen=True)
class Keyframe:
    """A keyframe with its dense depth; arrays H×W unless said, angles in radians, NaN where unknown.

    index: the frame's. timestamp: seconds. T_world_camera: float64 4×4, as it was when the keyframe was mapped.
    segment: which world and scale the pose is in; odometry begins a new one after a loss.
    depth: float32 z in metres (or units of the poses). normal: float32 H×W×3 in the camera frame.
    azimuth, zenith: float32, what polarization says. label: uint8, a `Reflection`. origin: uint8, an `Origin`.
    confidence: float32 in [0, 1], 0 where there is no depth.
    sigma: float32, standard deviation of depth as a share of it.
    prior_verdict: which prior was used, and why. beliefs: how far the cues were believed.
    milliseconds: by step. search: over which depths stereo searched, None where it did not.
    """

    index: int
    timestamp: float
    T_world_camera: np.ndarray
    camera: PinholeCamera
    image: PolarizationImage
    depth: np.ndarray
    normal: np.ndarray
    azimuth: np.ndarray
    zenith: np.ndarray
    label: np.ndarray
    origin: np.ndarray
    sigma: np.ndarray
    confidence: np.ndarray
    stages: Stages
    prior_verdict: str
    beliefs: CueBeliefs
    milliseconds: dict[str, float] = field(default_factory=dict)
    segment: int = 0
    search: DepthSearch | None = None

    @property
    def density(self) -> float:
        """Share of the pixels that have depth."""
        return float(np.isfinite(self.depth).mean())
