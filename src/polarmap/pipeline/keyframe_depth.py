"""From a keyframe and its neighbours to its dense depth: the paper's overview, left to right.

    stereo ──> inliers ──> prior ──> densify

A `DepthJob` holds all that the depth depends on, and nothing of it changes any more; so it can be done anywhere, at any
time after. (A prior may remember earlier frames, see `polarmap.prior.priors`: jobs are done in order.)
"""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from polarmap.data.cues import Cues
from polarmap.data.dense_depth import DenseDepth
from polarmap.data.depth_search import DepthSearch
from polarmap.data.keyframe import CueBeliefs, Keyframe, Stages
from polarmap.data.plane_field import PlaneField
from polarmap.data.view import View, Witness
from polarmap.densify.method import Densifier, SparseView
from polarmap.densify.surfaces.planes import seen_from
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.geometry.warp import warp_depth
from polarmap.prior.priors import Prior
from polarmap.stereo.consistency import inliers, photometric_filter
from polarmap.stereo.depth_range import at_ends, beyond_near_end, search_range, useful_views
from polarmap.stereo.method import StereoMethod
from polarmap.stereo.options import ConsistencyOptions, InlierOptions, StereoOptions
from polarmap.timing import StepClock

log = logging.getLogger(__name__)

_HALF_BELIEVED = np.float32(0.01)  # relative standard deviation of depth at which confidence is a half


@dataclass(frozen=True, eq=False)
class DepthJob:
    """A keyframe to be mapped. neighbours: other keyframes, those that were mapped with their depth. last: the one that
    was mapped before it, None if it is the first. witnesses: yet earlier ones that see the same from elsewhere.
    hurry: whether mapping is behind.
    """

    camera: PinholeCamera
    view: View
    neighbours: tuple[View, ...]
    last: View | None = None
    witnesses: tuple[Witness, ...] = ()
    hurry: bool = False


@dataclass(frozen=True, eq=False)
class KeyframeDepth:
    """What a job gives; images H×W of its camera.

    stereo: what stereo defends by itself, inliers: what other keyframes do not contradict, float32 z with NaN.
    confidence: float32 in [0, 1]. planes: as `View.planes`. prior_verdict: which prior was used, and why. milliseconds:
    by step. search: over which depths stereo searched; None where no neighbour has moved.
    """

    stereo: np.ndarray
    inliers: np.ndarray
    dense: DenseDepth
    confidence: np.ndarray
    cues: Cues
    beliefs: CueBeliefs
    planes: np.ndarray | None
    prior_verdict: str
    milliseconds: dict[str, float]
    search: DepthSearch | None = None


class DepthSteps:
    """The steps of a job, each of which may be another method."""

    def __init__(
        self,
        stereo: StereoMethod,
        prior: Prior,
        densify: Densifier,
        views: StereoOptions | None = None,
        consistency: ConsistencyOptions | None = None,
        confirmation: InlierOptions | None = None,
    ) -> None:
        self.stereo = stereo
        self.prior = prior
        self.densify = densify
        self._views = views or StereoOptions()
        self._consistency = consistency or ConsistencyOptions()
        self._confirmation = confirmation or InlierOptions()

    def __call__(self, job: DepthJob) -> KeyframeDepth:
        """Do a job."""
        view, camera, clock = job.view, job.camera, StepClock()
        with clock("stereo"):
            planes, stereo, search = self._match(job)
        with clock("inliers"):
            others = [(v.stereo, view.motion_to(v)) for v in job.neighbours if v.stereo is not None]
            points = inliers(stereo, planes.score, others, camera, self._confirmation)
        with clock("prior"):
            prior = self.prior(view.image, points, camera, hurry=job.hurry)
        neighbours = tuple(view.neighbour(other) for other in job.neighbours)
        seen = [witness for other in job.neighbours if (witness := other.witness)]
        sightings = tuple(witness.sighting(view) for witness in (*seen, *job.witnesses))
        sparse = SparseView(view, camera, points, planes, prior, neighbours, sightings, _known_planes(job))
        found = self.densify(sparse, clock)
        return KeyframeDepth(
            stereo=stereo,
            inliers=points,
            dense=found.dense,
            confidence=_confidence(found.dense),
            cues=found.cues,
            beliefs=found.beliefs,
            planes=found.planes,
            prior_verdict=prior.verdict,
            milliseconds=clock.milliseconds,
            search=search,
        )

    def _match(self, job: DepthJob) -> tuple[PlaneField, np.ndarray, DepthSearch | None]:
        """Planes, the depths of them that stereo defends, and where they were searched."""
        view, camera = job.view, job.camera
        motions = [view.motion_to(other) for other in job.neighbours]
        useful = useful_views([float(np.linalg.norm(T[:3, 3])) for T in motions])
        if not useful:
            log.warning("frame %d: no other keyframe has moved from it, so it gets no depth", view.index)
            none = PlaneField.empty(camera.shape)
            return none, photometric_filter(none, self._consistency), None
        reference, others = view, [job.neighbours[i] for i in useful]
        if view.given:  # from this view's camera, so that nothing depends on where the world has its origin
            others = [replace(other, T_world_camera=inverse(view.motion_to(other))) for other in others]
            reference = replace(view, T_world_camera=np.eye(4))
        depth_range = search_range(motions, camera, self._views, _known_depths(job))
        start = _expected_inverse_depth(job)

        def search(ends: tuple[float, float]) -> tuple[PlaneField, np.ndarray, DepthSearch]:
            planes = self.stereo(reference, others, camera, ends, start)
            return planes, photometric_filter(planes, self._consistency), at_ends(planes, ends, self._consistency)

        found = search(depth_range)
        wider = beyond_near_end(found[2], self._views)
        return found if wider is None else max(search(wider), found, key=lambda tried: np.isfinite(tried[1]).sum())


def as_keyframe(job: DepthJob, result: KeyframeDepth, T_world_camera: np.ndarray, segment: int) -> Keyframe:
    """All that is known of a keyframe once its job is done."""
    dense, cues = result.dense, result.cues
    return Keyframe(
        index=job.view.index,
        timestamp=job.view.timestamp,
        T_world_camera=T_world_camera,
        camera=job.camera,
        image=job.view.image,
        depth=dense.depth,
        normal=dense.normal,
        azimuth=cues.azimuth,
        zenith=cues.zenith,
        label=cues.label,
        origin=dense.origin,
        sigma=dense.sigma,
        confidence=result.confidence,
        stages=Stages(result.stereo, result.inliers, dense.first),
        prior_verdict=result.prior_verdict,
        beliefs=result.beliefs,
        milliseconds=result.milliseconds,
        segment=segment,
        search=result.search,
    )


def _expected_inverse_depth(job: DepthJob) -> np.ndarray | None:
    """The last mapped keyframe's depth as this view would see it: where stereo may start."""
    if job.last is None or job.last.depth is None:
        return None
    return 1.0 / warp_depth(job.last.depth, job.camera, job.last.motion_to(job.view))


def _known_depths(job: DepthJob) -> list[np.ndarray]:
    """What is known of this view's depths before stereo: of points that its pose is from, and by its neighbours'."""
    known = [] if job.view.known is None else [job.view.known]
    for other in job.neighbours:
        if other.stereo is not None:
            known.append(warp_depth(other.stereo, job.camera, other.motion_to(job.view)))
    return known


def _known_planes(job: DepthJob) -> np.ndarray | None:
    """What the last mapped keyframe is made of, in this one's frame."""
    if job.last is None or job.last.planes is None:
        return None
    return seen_from(job.last.planes, job.last.motion_to(job.view))


def _confidence(dense: DenseDepth) -> np.ndarray:
    """From 1 for exact depth, through a half at 1 % of standard deviation, to 0."""
    confidence = _HALF_BELIEVED / (_HALF_BELIEVED + dense.sigma)  # so that no sigma overflows
    return np.where(np.isfinite(dense.depth), confidence, 0.0).astype(np.float32)
