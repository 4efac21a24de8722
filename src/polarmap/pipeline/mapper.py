"""The pipeline: frames in, keyframes with dense depth out, and a map at the end.

    frame ──> polarization ──> pose ──> keyframe? ──> stereo ──> inliers ──> prior
                        \\                                              \\      /
                         `──────────────────────────────────────────> densify ──> fusion ──> map

Poses are given, or odometry finds them and adjusts those of the last keyframes later; the surface follows.
A keyframe is mapped when the later keyframes that its stereo wants (`stereo.future`) have come.
"""

from __future__ import annotations

import logging
from collections import Counter, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING

import numpy as np

from polarmap.data.codes import Status
from polarmap.data.cues import Cues
from polarmap.data.dense_depth import DenseDepth
from polarmap.data.keyframe import CueBeliefs, Keyframe, Stages
from polarmap.data.map import Map, SegmentMap
from polarmap.data.plane_field import PlaneField
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import SensorNoise
from polarmap.densify.method import Expected
from polarmap.densify.paper.guidance import guide, plane_gradient
from polarmap.densify.paper.loop import densify
from polarmap.densify.sigma import OtherView
from polarmap.densify.surfaces.find import find_surfaces
from polarmap.densify.surfaces.planes import seen_from
from polarmap.errors import InputError
from polarmap.fusion.movable_surface import MovableSurface
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.origin import LARGEST_STEP, local_origin, shifted, steps_of
from polarmap.geometry.pose import inverse, is_rigid, without_noise
from polarmap.geometry.surface import normals_from_depth
from polarmap.geometry.warp import warp_depth
from polarmap.materials.estimate import estimate_materials
from polarmap.pipeline.config import Config
from polarmap.pipeline.keyframe_rule import sample_points, view_change
from polarmap.pipeline.poses.follower import ODD, PoseFollower
from polarmap.pipeline.poses.source import Candidate, GivenPoses, PoseSource, PoseUpdate, given_pose
from polarmap.polarization.cues import disambiguate
from polarmap.prior.names import DEFAULT_PRIOR
from polarmap.prior.priors import Prior, PriorDepth, make_prior
from polarmap.sensing.frame_check import FrameCheck
from polarmap.sensing.front_end import PolarizationFrontEnd
from polarmap.sensing.noise import stabilized
from polarmap.stereo.consistency import inliers, photometric_filter
from polarmap.stereo.depth_range import search_range, useful_views
from polarmap.stereo.patchmatch.search import StereoView, patchmatch
from polarmap.timing import StepClock

if TYPE_CHECKING:
    from polarmap.data.camera_file import CameraFile
    from polarmap.data.frame import Frame

log = logging.getLogger(__name__)

_BIT_DEPTH = 8  # of images whose sensor is not known
_HALF_BELIEVED = np.float32(0.01)  # relative standard deviation of depth at which confidence is a half


@dataclass
class _View:
    """A keyframe on its way through the pipeline.

    T_local_camera: its pose from the segment's centre. given: whether that is final, and given from outside.
    """

    index: int
    timestamp: float
    image: PolarizationImage
    stable: np.ndarray  # sqrt(intensity)
    T_world_camera: np.ndarray
    T_local_camera: np.ndarray
    given: bool
    stereo: np.ndarray | None = None  # depth that stereo defends
    depth: np.ndarray | None = None  # after densification
    planes: np.ndarray | None = None  # that hold a good part of the view, see `Surfaces.lasting`

    def motion_to(self, other: _View) -> np.ndarray:
        """T_other_this."""
        motion = inverse(other.T_local_camera) @ self.T_local_camera
        return without_noise(motion) if self.given and other.given else motion


@dataclass
class _Segment:
    """Keyframes in one world and scale: those that wait for later ones, the last ones mapped, and the surface.

    In that world, centre is what all that is done is counted from: the first pose if poses are given, so that nothing
    depends on where their world has its origin; None before there is a pose. origin: what mesh and cloud are from.
    """

    number: int
    surface: MovableSurface
    mapped: deque[_View]
    pending: deque[_View] = field(default_factory=deque)
    keyframes: int = 0
    centre: np.ndarray | None = None
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))

    def begin_at(self, position: np.ndarray, given: bool) -> None:
        """Choose centre and origin by the first position (3,)."""
        self.origin = local_origin(position)
        self.centre = position.copy() if given else self.origin

    def local(self, T_world_camera: np.ndarray) -> np.ndarray:
        """A pose as it is from the centre."""
        return T_world_camera if self.centre is None else shifted(T_world_camera, -self.centre)

    def in_world(self, T_local_camera: np.ndarray) -> np.ndarray:
        """The pose that `local` has made local."""
        return T_local_camera if self.centre is None else shifted(T_local_camera, self.centre)

    def extract(self) -> SegmentMap:
        volume, mesh, cloud = self.surface.surface.volume, self.surface.mesh(), self.surface.points()
        shift = np.zeros(3) if self.centre is None else self.centre - self.origin
        return SegmentMap(
            segment=self.number,
            keyframes=self.keyframes,
            mesh=mesh and mesh.shifted(shift),
            cloud=cloud and cloud.shifted(shift),
            voxel_size=volume and volume.voxel_size,
            blocks=volume.block_count if volume else 0,
            origin=self.origin,
            left_out=volume.left_out if volume else 0,
        )


class Mapper:
    """Maps a stream of frames whose poses are given, or found by odometry.

        sequence = open_sequence("livingroom")
        mapper = Mapper(sequence.camera_file, read_trajectory("groundtruth.txt").at)
        for frame in sequence:
            mapper.process(frame)
        result = mapper.finish()

    camera: a camera file's content, or a PinholeCamera for use with `process_image` alone.
    poses: a source of poses such as `odometry_poses(camera_file)`, or what gives T_world_camera (4×4) at a
        timestamp in seconds, None where it is not known.
    prior: by default `polarmap.prior.DEFAULT_PRIOR`, with the options of `config`.
    on_keyframe: called with each keyframe as it is done, those that `finish` completes included.
    on_pose: called with a keyframe's index and its final T_world_camera once odometry will not change it any more;
        only for keyframes whose pose could still change when they were done.
    tracked: what is known of the last frame's pose. left_out: how many frames were not used, by reason: unfit pictures,
        and given poses that their neighbours or the pictures contradict.

    Given poses may have their origin anywhere (UTM, say): all is done from the first one, and comes out the same but
    for rounding. Poses that go in and come out are in their own world; mesh and cloud are counted from `Map.origin`.

    After odometry was lost it begins a new segment with another world and scale: what waits is completed, and a new
    surface begins. Memory does not grow with the number of frames, only with the surface that was seen.
    """

    def __init__(
        self,
        camera: CameraFile | PinholeCamera,
        poses: PoseSource | Callable[[float], np.ndarray | None] | None = None,
        prior: Prior | None = None,
        config: Config | None = None,
        on_keyframe: Callable[[Keyframe], None] | None = None,
        on_pose: Callable[[int, np.ndarray], None] | None = None,
    ) -> None:
        self.config = config or Config()
        self._front_end = None if isinstance(camera, PinholeCamera) else PolarizationFrontEnd(camera)
        self.camera = camera if self._front_end is None else self._front_end.camera
        self._source = GivenPoses(poses) if callable(poses) else poses
        self._prior = prior or make_prior(DEFAULT_PRIOR, self.config.prior)
        self._on_keyframe = on_keyframe
        self._on_pose = on_pose
        self._clock = StepClock()
        self._segment = self._new_segment(0)
        self._done: dict[int, SegmentMap] = {}
        self._frames = self._posed = 0
        self._mapped: set[int] = set()  # indices of keyframes
        self.tracked = PoseUpdate(status=Status.STARTING)
        self.left_out: Counter[str] = Counter()
        self._frame_check = self._new_frame_check(camera)
        self._follower = PoseFollower(self.camera, getattr(self._source, "trajectory", None))
        self._poses_given = False  # that of the last frame
        self._unfit: dict[int, str] = {}  # frames that odometry may use and stereo may not

    def process(self, frame: Frame) -> Keyframe | None:
        """Take the next frame; returns the keyframe that was completed with it, usually an earlier frame's.

        Where more than one was, as at the end of a segment, it is the last of them.
        Raises InputError where the frame does not fit the camera or its pose is no rigid motion.
        """
        if self._front_end is None or self._source is None:
            raise InputError("mapper: process() needs a camera file and poses; without them use process_image()")
        if not self._source.needs(frame.timestamp):
            return self._leave_out(self._source.unseen(frame.timestamp))
        with self._clock("polarization"):
            image = self._front_end(frame)
        return self._follow(image, None, frame.timestamp, frame.index, frame.exposure, frame)

    def process_image(
        self,
        image: PolarizationImage,
        T_world_camera: np.ndarray | None,
        timestamp: float,
        index: int,
        exposure: float | None = None,
    ) -> Keyframe | None:
        """As `process`, for a polarization image (H×W of the camera) whose pose is given.

        Where it is None, the mapper's source of poses is asked for it. exposure: its exposure time in seconds, None or
        NaN if not known.
        """
        if image.intensity.shape != self.camera.shape:
            raise InputError(
                f"frame {index}: image {image.intensity.shape} does not fit the camera {self.camera.shape}"
            )
        return self._follow(image, T_world_camera, timestamp, index, exposure)

    def finish(self) -> Map:
        """Complete the keyframes that still wait for later ones, and extract the map."""
        trajectory = self._source.finish() if self._source else None
        if trajectory is not None:
            self._posed = len(trajectory)
            self._adjust({pose.index: pose.T_world_camera for pose in trajectory if pose.is_keyframe})
        self._close_segment()
        if trajectory is None:
            trajectory = self._follower.segmented(self._mapped)
        main, *others = sorted(self._done.values(), key=lambda done: (-done.keyframes, done.segment))
        return Map(
            mesh=main.mesh,
            cloud=main.cloud,
            frames=self._frames,
            posed=self._posed,
            keyframes=self.keyframe_count,
            voxel_size=main.voxel_size,
            blocks=main.blocks,
            origin=main.origin,
            left_out=main.left_out,
            unfit=dict(self.left_out),
            milliseconds=dict(self._clock.milliseconds),
            segment=main.segment,
            others=tuple(done for done in others if done.keyframes),
            trajectory=trajectory,
        )

    @property
    def keyframe_count(self) -> int:
        """Keyframes mapped until now."""
        return len(self._mapped)

    def _follow(
        self,
        image: PolarizationImage,
        T_world_camera: np.ndarray | None,
        timestamp: float,
        index: int,
        exposure: float | None,
        frame: Frame | None = None,
    ) -> Keyframe | None:
        """Judge the picture, then find or judge its pose."""
        given = T_world_camera is not None or self._source is None or isinstance(self._source, GivenPoses)
        with self._clock("frame check"):
            verdict = self._frame_check.judge(image.intensity, index, timestamp, exposure)
        if verdict.earlier:
            index_of_first, fault = verdict.earlier
            self._withdraw(index_of_first, fault.text)
        if verdict.fault and (given or verdict.fault.severe):
            return self._leave_out(PoseUpdate(status=Status.LOST, reason=verdict.fault.text))
        if verdict.fault:
            self._unfit[index] = verdict.fault.text
        with self._clock(self._source.step if self._source else GivenPoses.step):
            if T_world_camera is not None or self._source is None:
                update = given_pose(image, T_world_camera, timestamp, index)
            else:
                update = self._source.track(image, timestamp, index, exposure, frame)
            if given:
                update = self._follower.follow(update)
                if self._follower.odd is not None:
                    self._withdraw(self._follower.odd, ODD)
            elif update.T_world_camera is not None and not verdict.fault:
                self._follower.note(Candidate(index, timestamp, image, update.T_world_camera), update.segment)
        self._poses_given = given
        return self._take(update) if update.T_world_camera is not None or not given else self._leave_out(update)

    def _leave_out(self, update: PoseUpdate) -> None:
        """Count a frame that is not used, for the reason that the update gives; nothing else changes."""
        self.tracked = replace(update, segment=self._segment.number)
        self._frames += 1
        self.left_out[update.reason] += 1

    def _withdraw(self, index: int, reason: str) -> None:
        """Leave out an earlier frame, unless it is mapped already."""
        fit = deque(view for view in self._segment.pending if view.index != index)
        self.left_out[reason] += len(fit) < len(self._segment.pending)
        self._segment.pending = fit
        self._unfit[index] = reason
        log.warning("frame %d: %s; it is left out", index, reason)

    def _take(self, update: PoseUpdate) -> Keyframe | None:
        """What a frame brings: better poses for earlier keyframes, and perhaps new ones."""
        self.tracked = update
        self._frames += 1
        self._posed += update.T_world_camera is not None
        keyframe = None
        if update.segment != self._segment.number:
            keyframe = self._close_segment()
            self._segment = self._new_segment(update.segment)
        self._adjust(update.poses)
        for candidate in update.candidates:
            keyframe = self._consider(candidate) or keyframe
        return keyframe

    def _consider(self, candidate: Candidate) -> Keyframe | None:
        """Make a frame a keyframe if it shows enough that is new; returns the keyframe that it completes."""
        view = self._view(candidate)
        with self._clock("keyframes"):
            if self._is_keyframe(view) and self._is_fit(view.index):
                self._segment.pending.append(view)
        return self._complete() if self._is_ready() else None

    def _adjust(self, poses: Mapping[int, np.ndarray]) -> None:
        """Move the keyframes that odometry has moved, on their way through the pipeline and in the surface."""
        segment = self._segment
        local = {index: segment.local(T_world_camera) for index, T_world_camera in poses.items()}
        for view in (*segment.pending, *segment.mapped):
            view.T_world_camera = poses.get(view.index, view.T_world_camera)
            view.T_local_camera = local.get(view.index, view.T_local_camera)
        with self._clock("fusion"):
            self._report(segment.surface.move(local))

    def _report(self, final_poses: Mapping[int, np.ndarray]) -> None:
        """Tell final poses, which are from the segment's origin."""
        for index, T_local_camera in final_poses.items() if self._on_pose else ():
            self._on_pose(index, self._segment.in_world(T_local_camera))

    def _new_segment(self, number: int) -> _Segment:
        return _Segment(number, MovableSurface(self.config.fusion), deque(maxlen=max(self.config.stereo.past, 1)))

    def _close_segment(self) -> Keyframe | None:
        """Complete what waits for later keyframes, since none will come; keep the surface and nothing else."""
        segment, keyframe = self._segment, None
        while segment.pending:
            keyframe = self._complete()
        with self._clock("fusion"):
            self._report(segment.surface.settle())
        with self._clock("mesh"):
            self._done[segment.number] = segment.extract()
        return keyframe

    def _view(self, candidate: Candidate) -> _View:
        T, image, segment = _checked_pose(candidate), candidate.image, self._segment
        if segment.centre is None:
            segment.begin_at(T[:3, 3], candidate.given)
        stable = stabilized(image.intensity)
        return _View(candidate.index, candidate.timestamp, image, stable, T, segment.local(T), candidate.given)

    def _new_frame_check(self, camera: CameraFile | PinholeCamera) -> FrameCheck:
        if self._front_end is None:
            return FrameCheck(SensorNoise(), _BIT_DEPTH)
        return FrameCheck(camera.noise, camera.bit_depth, self._front_end.valid)

    def _is_fit(self, index: int) -> bool:
        """Whether a frame may be a keyframe by what its picture, and the one before it, show."""
        unfit = self._unfit.get(index)
        reason = unfit or self._follower.contradiction(index)
        if reason and not unfit and self._poses_given:
            self.tracked = PoseUpdate(status=Status.LOST, reason=reason, segment=self._segment.number)
            self._posed -= 1
        self.left_out.update([reason] if reason else ())
        return not reason

    def _is_keyframe(self, view: _View) -> bool:
        segment = self._segment
        last = segment.pending[-1] if segment.pending else (segment.mapped[-1] if segment.mapped else None)
        if last is None:
            return True
        change = view_change(
            last.image.intensity, view.image.intensity, last.motion_to(view), self.camera, self._points_seen_by(last)
        )
        return change is None or change.score(self.camera, self.config.keyframes) > 1.0

    def _points_seen_by(self, view: _View) -> np.ndarray | None:
        """The newest mapped depth as points in the view's camera frame; None before there is any."""
        if not self._segment.mapped:
            return None
        newest = self._segment.mapped[-1]
        T = newest.motion_to(view)
        return sample_points(newest.depth, self.camera) @ T[:3, :3].T + T[:3, 3]

    def _is_ready(self) -> bool:
        """Whether the oldest waiting keyframe has the neighbours it waits for; the very first one waits for two."""
        return len(self._segment.pending) > self._awaited()

    def _awaited(self) -> int:
        stereo = self.config.stereo
        return max(stereo.future, min(2, stereo.past + stereo.future) - len(self._segment.mapped))

    def _complete(self) -> Keyframe:
        """Map the oldest waiting keyframe."""
        segment, awaited, past = self._segment, self._awaited(), self.config.stereo.past
        view = segment.pending.popleft()
        neighbours = [*list(segment.mapped)[-past:] * (past > 0), *list(segment.pending)[:awaited]]
        keyframe = self._map(view, neighbours)
        with self._clock("fusion"):
            segment.surface.integrate(
                keyframe.depth, view.image.intensity, keyframe.confidence, self.camera, view.T_local_camera, view.index
            )
        segment.mapped.append(view)
        segment.keyframes += 1
        self._mapped.add(view.index)
        if self._on_keyframe:
            self._on_keyframe(keyframe)
        return keyframe

    def _map(self, view: _View, neighbours: list[_View]) -> Keyframe:
        """Stereo, inliers, prior, densification, cues: the paper's overview, left to right."""
        clock = StepClock()
        with clock("stereo"):
            planes = self._stereo(view, neighbours)
            view.stereo = photometric_filter(planes, self.config.consistency)
        with clock("inliers"):
            others = [(v.stereo, view.motion_to(v)) for v in neighbours if v.stereo is not None]
            points = inliers(view.stereo, planes.score, others, self.camera, self.config.inliers)
        with clock("prior"):
            prior = self._prior(view.image, points, self.camera)
        views = [OtherView(v.stable, view.motion_to(v), v.stereo) for v in neighbours]
        by = self._by_surfaces if self.config.densify.method == "surfaces" else self._by_the_paper
        dense, cues, beliefs = by(clock, view, planes, points, prior, views)
        view.depth = dense.depth
        self._clock.add(clock.milliseconds)
        return Keyframe(
            index=view.index,
            timestamp=view.timestamp,
            T_world_camera=view.T_world_camera,
            camera=self.camera,
            image=view.image,
            depth=dense.depth,
            normal=dense.normal,
            azimuth=cues.azimuth,
            zenith=cues.zenith,
            label=cues.label,
            origin=dense.origin,
            sigma=dense.sigma,
            confidence=_confidence(dense),
            stages=Stages(view.stereo, points, dense.first),
            prior_verdict=prior.verdict,
            beliefs=beliefs,
            milliseconds=clock.milliseconds,
            segment=self._segment.number,
        )

    def _by_surfaces(self, clock, view, planes, points, prior, views) -> tuple[DenseDepth, Cues, CueBeliefs]:
        """Planes and free surfaces; the ambiguities of polarization are resolved by the depth that comes out."""
        with clock("densify"):
            free = [prior.depth] if prior.by_points is None else [prior.depth, prior.by_points]
            options, expected = self.config.surfaces, _expected(prior)
            known = self._known_planes(view)
            surfaces = find_surfaces(
                points, free, view.image, view.stable, self.camera, views, options, expected, known
            )
            view.planes = surfaces.lasting
        with clock("cues"):
            cues = self._disambiguate(view, surfaces.dense.normal, points, prior)
        return surfaces.dense, cues, CueBeliefs(surfaces=surfaces.polarization_weight)

    def _by_the_paper(self, clock, view, planes, points, prior, views) -> tuple[DenseDepth, Cues, CueBeliefs]:
        """The paper's loop, guided by the cues, whose ambiguities the prior resolves."""
        with clock("cues"):
            cues = self._disambiguate(view, normals_from_depth(prior.depth, self.camera), points, prior)
        with clock("densify"):
            guidance = guide(
                prior.depth, cues, self._slopes(planes, points), self.camera, self.config.cues.orthographic
            )
            dense = densify(points, guidance.gradient, view.stable, views, self.camera, self.config.densify)
        return dense, cues, CueBeliefs(guidance.diffuse, guidance.specular)

    def _disambiguate(self, view: _View, normals: np.ndarray, points: np.ndarray, prior: PriorDepth) -> Cues:
        """The cues, with what surfaces are made of where stereo has points on them."""
        options = self.config.cues
        materials = estimate_materials(view.image, normals, self.camera, None, options, np.isfinite(points))
        specular = prior.prediction and prior.prediction.specular
        return disambiguate(view.image, normals, self.camera, options, materials.eta, materials.metal, specular)

    def _stereo(self, view: _View, neighbours: list[_View]) -> PlaneField:
        motions = [view.motion_to(v) for v in neighbours]
        baselines = [float(np.linalg.norm(motion[:3, 3])) for motion in motions]
        useful = useful_views(baselines)
        if not useful:
            log.warning("frame %d: no other keyframe has moved from it, so it gets no depth", view.index)
            return PlaneField.empty(self.camera.shape)
        poses = [inverse(motions[i]) if view.given else neighbours[i].T_local_camera for i in useful]
        return patchmatch(
            StereoView(view.image.intensity, np.eye(4) if view.given else view.T_local_camera, view.image),
            [StereoView(neighbours[i].image.intensity, T) for i, T in zip(useful, poses, strict=True)],
            self.camera,
            search_range(baselines, self.camera, self.config.stereo),
            self.config.patchmatch,
            self._expected_inverse_depth(view),
        )

    def _expected_inverse_depth(self, view: _View) -> np.ndarray | None:
        """The last mapped keyframe's depth as this view would see it: where stereo may start."""
        if not self._segment.mapped:
            return None
        last = self._segment.mapped[-1]
        return 1.0 / warp_depth(last.depth, self.camera, last.motion_to(view))

    def _known_planes(self, view: _View) -> np.ndarray | None:
        """What the last mapped keyframe is made of, in this one's frame."""
        if not self._segment.mapped or self._segment.mapped[-1].planes is None:
            return None
        last = self._segment.mapped[-1]
        return seen_from(last.planes, last.motion_to(view))

    def _slopes(self, planes: PlaneField, points: np.ndarray) -> np.ndarray:
        """Gradient of log range of the stereo planes, NaN where the point is no inlier."""
        slopes = plane_gradient(planes.inverse_depth, planes.gradient_u, planes.gradient_v, self.camera)
        slopes[np.isnan(points)] = np.nan
        return slopes


def _checked_pose(candidate: Candidate) -> np.ndarray:
    T = np.asarray(candidate.T_world_camera, np.float64)
    if not is_rigid(T):
        raise InputError(f"frame {candidate.index}: its pose is not a finite 4x4 rigid motion")
    if (step := steps_of(T[:3, 3])) > LARGEST_STEP:
        raise InputError(
            f"frame {candidate.index}: its position is {np.abs(T[:3, 3]).max():g} from the origin, where numbers are "
            f"{step:g} apart even in double precision; give poses in metres, from an origin that is nearer"
        )
    return T


def _expected(prior: PriorDepth) -> Expected | None:
    """What planes should be like, by a network that tells how sure it is."""
    found = prior.prediction
    if found is None or any(a is None for a in (found.sigma_depth, found.normal, found.sigma_normal)):
        return None
    return Expected(prior.aligned_depth, found.sigma_depth, found.normal, found.sigma_normal, prior.mirrored)


def _confidence(dense: DenseDepth) -> np.ndarray:
    """From 1 for exact depth, through a half at 1 % of standard deviation, to 0."""
    confidence = _HALF_BELIEVED / (_HALF_BELIEVED + dense.sigma)  # so that no sigma overflows
    return np.where(np.isfinite(dense.depth), confidence, 0.0).astype(np.float32)
