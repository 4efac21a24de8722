"""What a run gives: keyframes one by one, and the map at the end."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from polarmap.densify.guidance import CueWeights
from polarmap.fusion.mesh import Mesh, PointCloud
from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.results import PosedFrame
from polarmap.polarization.types import PolarizationImage


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

    diffuse: CueWeights = CueWeights()  # noqa: RUF009
    specular: CueWeights = CueWeights()  # noqa: RUF009
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
    milliseconds: by step.
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

    @property
    def density(self) -> float:
        """Share of the pixels that have depth."""
        return float(np.isfinite(self.depth).mean())


@dataclass(frozen=True)
class SegmentMap:
    """The surface of one segment in its own world and unit; mesh and cloud are None where no keyframe had depth.

    origin: float64 (3,), of mesh and cloud in the world of the poses: add it to their coordinates.
    left_out: points of depth maps that are too far from there for the voxels' numbers.
    """

    segment: int
    keyframes: int
    mesh: Mesh | None
    cloud: PointCloud | None
    voxel_size: float | None
    blocks: int
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    left_out: int = 0


@dataclass(frozen=True)
class Map:
    """The fused map; mesh and cloud are None where no keyframe had depth.

    frames: how many were given, posed: how many of them had a pose, keyframes: how many became one. unfit: how many
    were not used, by reason: pictures that are black, say, and given poses that their neighbours contradict.
    voxel_size: metres (or units of the poses). milliseconds: summed over the run, by step.
    origin: float64 (3,), of mesh and cloud in the world of the poses: add it to their coordinates. Zero unless the
    poses are far from zero, see `polarmap.geometry.origin`. left_out: points of depth maps that are too far from there
    for the voxels' numbers.
    segment: the one that mesh, cloud, voxel_size and blocks are of, which is that with most keyframes.
    others: the surfaces of the other segments. trajectory: final poses of all frames that odometry tracked, or whose
    given poses were taken if those jumped and a new segment began; None where poses were given and did not.
    """

    mesh: Mesh | None
    cloud: PointCloud | None
    frames: int
    posed: int
    keyframes: int
    voxel_size: float | None
    blocks: int
    milliseconds: dict[str, float]
    segment: int = 0
    others: tuple[SegmentMap, ...] = ()
    trajectory: tuple[PosedFrame, ...] | None = None
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))
    left_out: int = 0
    unfit: dict[str, int] = field(default_factory=dict)
