"""The pipeline: frames in, keyframes with dense depth out, and a map at the end.

    frame ──> polarization ──> pose ──> keyframe? ──> stereo ──> inliers ──> prior
                        \\                                              \\      /
                         `──────────────────────────────────────────> densify ──> fusion ──> map

What comes in is judged and given a pose (`intake`); a frame that shows enough that is new becomes a keyframe
(`keyframe_rule`) and waits for the later ones that its stereo wants (`segment`); its depth is a job of its own
(`keyframe_depth`), done here or by an executor; the surface takes it, and follows the poses as they are adjusted.
"""

from __future__ import annotations

import logging
from collections import Counter
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future
from dataclasses import replace

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.codes import Status
from polarmap.data.frame import Frame
from polarmap.data.keyframe import Keyframe
from polarmap.data.map import Map, SegmentMap
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.trajectory import Trajectory
from polarmap.data.view import View, relative_motion
from polarmap.densify.method import Densifier
from polarmap.errors import InputError
from polarmap.fusion.depth_store import DepthStore
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.sim3 import Sim3
from polarmap.pipeline.config import Config
from polarmap.pipeline.executor import Executor, InLine
from polarmap.pipeline.intake import Arrival, Intake
from polarmap.pipeline.keyframe_depth import DepthJob, DepthSteps, KeyframeDepth, as_keyframe
from polarmap.pipeline.keyframe_rule import sample_points, view_change
from polarmap.pipeline.methods import make_densifier, make_stereo
from polarmap.pipeline.poses.given import GivenPoses
from polarmap.pipeline.poses.source import Candidate, PoseSource, PoseUpdate
from polarmap.pipeline.segment import Fused, Segment
from polarmap.prior.names import DEFAULT_PRIOR
from polarmap.prior.priors import Prior, make_prior
from polarmap.sensing.front_end import FrontEnd, GivenImage, require_polarization
from polarmap.stereo.method import StereoMethod
from polarmap.timing import StepClock

log = logging.getLogger(__name__)

_ALL_NEW = 4.0  # novelty of a frame that shares next to nothing with the last keyframe


class Mapper:
    """Maps a stream of frames whose poses are given, or found by odometry.

        sequence = open_sequence("livingroom")
        mapper = Mapper(sequence.camera_file, read_trajectory("groundtruth.txt"))
        for frame in sequence:
            mapper.process(frame)
        result = mapper.finish()

    camera: a camera file's content, or a PinholeCamera for use with `process_image` alone.
    poses: a trajectory, a source of poses such as `odometry_poses(camera_file)`, or what gives T_world_camera (4×4) at
        a timestamp in seconds, None where it is not known.
    prior: by default `polarmap.prior.names.DEFAULT_PRIOR`, with the options of `config`.
    on_keyframe: called with each keyframe as it is done, those that `finish` completes included.
    on_pose: called with a keyframe's index and its final T_world_camera, whose scale is that by which its depth has
        grown since, once it will not change any more; only for keyframes that could still move when they were done.
    stereo, densifier: methods in place of those that the options name.
    executor: what maps keyframes, here and now by default. fusing: what changes the surface, likewise.
    depth_store: where depth maps of keyframes are kept that may still move, in memory by default.
    most_waiting: how many keyframes may wait that could be mapped; none of them waits for later ones, then, to be
        matched with. Of more of them, those are skipped that show least
        that is new, and the next is mapped in a hurry, by one look of the prior where that takes more. By default every
        keyframe is mapped, however late.
    on_fused: called with what was done to the surface, keyframe by keyframe.
    steps: what maps a keyframe. skipped, hurried: how many keyframes were not mapped, or in a hurry. tracked: what is
        known of the last frame's pose. left_out: how many frames were not used, by reason: unfit pictures, and given
        poses that their neighbours or the pictures contradict.

    Given poses may have their origin anywhere (UTM, say): all is done from the first one, and comes out the same but
    for rounding. Poses that go in and come out are in their own world; mesh and cloud are counted from `Map.origin`.

    After odometry was lost it begins a new segment with another world and scale: what waits is completed, and a new
    surface begins. Memory does not grow with the number of frames, only with the surface that was seen.
    """

    def __init__(
        self,
        camera: CameraFile | PinholeCamera,
        poses: PoseSource | Trajectory | Callable[[float], np.ndarray | None] | None = None,
        prior: Prior | None = None,
        config: Config | None = None,
        on_keyframe: Callable[[Keyframe], None] | None = None,
        on_pose: Callable[[int, Sim3], None] | None = None,
        *,
        stereo: StereoMethod | None = None,
        densifier: Densifier | None = None,
        executor: Executor | None = None,
        fusing: Executor | None = None,
        depth_store: DepthStore | None = None,
        most_waiting: int | None = None,
        on_fused: Callable[[Fused], None] | None = None,
    ) -> None:
        self.config = config = config or Config()
        self._source = _as_source(poses)
        self._front_end = None if isinstance(camera, PinholeCamera) else _front_end(camera, self._source)
        self.camera = camera if isinstance(camera, PinholeCamera) else camera.camera
        self.steps = DepthSteps(
            stereo or make_stereo(config),
            prior or make_prior(DEFAULT_PRIOR, config.prior),
            densifier or make_densifier(config),
            config.stereo,
            config.consistency,
            config.inliers,
        )
        self._executor = executor or InLine()
        self._under_way: tuple[DepthJob, Future[KeyframeDepth]] | None = None
        self._fusing = fusing
        self._store = depth_store
        self._most_waiting = most_waiting
        self._on_fused = on_fused
        self._on_keyframe = on_keyframe
        self._on_pose = on_pose
        self._clock = StepClock()
        camera_file = None if isinstance(camera, PinholeCamera) else camera
        valid = None if self._front_end is None else self._front_end.valid
        self._intake = Intake(self.camera, self._source, self._clock, camera_file, valid)
        self._segment = self._new_segment(0)
        self._done: dict[int, SegmentMap] = {}
        self._mapped: set[int] = set()  # indices of keyframes
        self.skipped = self.hurried = 0
        self._late = False  # whether keyframes were skipped since the last job began
        self.tracked = PoseUpdate(status=Status.STARTING)

    def process(self, frame: Frame) -> Keyframe | None:
        """Take the next frame; returns the keyframe that was completed with it, usually an earlier frame's.

        Where more than one was, as at the end of a segment, it is the last of them.
        Raises InputError where the frame does not fit the camera or its pose is no rigid motion.
        """
        if self._front_end is None or self._source is None:
            raise InputError("mapper: process() needs a camera file and poses; without them use process_image()")
        passed = self._intake.pass_by(frame.timestamp)
        return self._take(passed or self._intake.take(self._front_end(frame)))

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
        return self._take(self._intake.take(GivenImage(image, timestamp, index, exposure), T_world_camera))

    def finish(self) -> Map:
        """Complete the keyframes that still wait for later ones, and extract the map."""
        rest = self._intake.rest()
        if rest is not None:
            self._follow(rest)
        trajectory = self._intake.finish()
        if trajectory is not None:
            self._move({pose.index: Sim3.from_matrix(pose.T_world_camera) for pose in trajectory if pose.is_keyframe})
        self._close_segment()
        if trajectory is None:
            trajectory = self._intake.segmented(frozenset(self._mapped))
        main, *others = sorted(self._done.values(), key=lambda done: (-done.keyframes, done.segment))
        return Map(
            mesh=main.mesh,
            cloud=main.cloud,
            frames=self._intake.frames,
            posed=self._intake.posed,
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

    @property
    def backlog(self) -> int:
        """Keyframes that could be mapped and wait for it, or are under way."""
        return self._segment.backlog + (self._under_way is not None)

    @property
    def left_out(self) -> Counter[str]:
        """How many frames were not used, by reason."""
        return self._intake.left_out

    def _take(self, arrival: Arrival) -> Keyframe | None:
        """What a frame brings: better poses for earlier keyframes, and perhaps new ones."""
        update, keyframe = arrival.update, self._collect_late()
        for index, reason in arrival.withdrawn:
            self.left_out[reason] += self._segment.withdraw(index)
        if arrival.left_out:
            self.tracked = replace(update, segment=self._segment.number)
            return keyframe
        self.tracked = update
        return self._follow(update) or keyframe

    def _follow(self, update: PoseUpdate) -> Keyframe | None:
        """Move what has moved, and map what may be mapped."""
        keyframe = None
        if update.segment != self._segment.number:
            keyframe = self._close_segment()
            self._segment = self._new_segment(update.segment)
        self._move(update.moved, update.final)
        for candidate in update.candidates:
            self._consider(candidate)
            keyframe = self._advance() or keyframe
        return keyframe

    def _consider(self, candidate: Candidate) -> None:
        """Make a frame a keyframe if it shows enough that is new."""
        segment, index = self._segment, candidate.index
        with self._clock("keyframes"):
            novelty = self._novelty(candidate)
            if novelty <= 1.0:
                return
            reason = self._intake.refusal(index)
        if not reason:
            with self._clock("polarization"):
                segment.add(candidate, novelty)
            self._skip_some()
        elif self._intake.is_pose_at_fault(index):
            self.tracked = PoseUpdate(status=Status.LOST, reason=reason, segment=segment.number)

    def _novelty(self, candidate: Candidate) -> float:
        """How much a frame shows that the last keyframe does not, in units of what makes it one."""
        T, last = self._segment.local_pose(candidate), self._segment.newest
        if last is None:
            return _ALL_NEW
        motion = relative_motion(last.T_world_camera, T, last.given and candidate.given)
        points = self._points_seen_by(last)
        change = view_change(last.image.intensity, candidate.frame.intensity, motion, self.camera, points)
        return _ALL_NEW if change is None else change.score(self.camera, self.config.keyframes)

    def _skip_some(self) -> None:
        """Leave out keyframes as long as too many wait."""
        while self._most_waiting is not None and self._segment.backlog > self._most_waiting:
            index = self._segment.skip_one()
            self.skipped += 1
            self._late = True
            log.debug("frame %d: mapping is behind; it is tracked, but not mapped", index)

    def _points_seen_by(self, view: View) -> np.ndarray | None:
        """The newest mapped depth as points in the view's camera frame; None before there is any."""
        newest = self._segment.mapped[-1] if self._segment.mapped else None
        if newest is None or newest.depth is None:
            return None
        T = newest.motion_to(view)
        return sample_points(newest.depth, self.camera) @ T[:3, :3].T + T[:3, 3]

    def _move(self, poses: Mapping[int, Sim3], final: Collection[int] = ()) -> None:
        self._segment.move(poses, final)
        self._report(self._segment.news())

    def _advance(self) -> Keyframe | None:
        """Begin the next job if its keyframe is ready and none is under way; returns the keyframe that came of it."""
        if self._under_way is None and self._segment.is_ready:
            self._begin_job()
        return self._collect()

    def _collect_late(self) -> Keyframe | None:
        """As `_collect` for the job of an earlier frame, after which the next may begin at once."""
        keyframe = self._collect()
        if keyframe is not None and self._segment.is_ready:
            self._begin_job()
        return keyframe

    def _begin_job(self) -> None:
        late, self._late = self._late, False
        hurry = late and self.config.prior.looks > 1  # what there is to be saved
        self.hurried += hurry
        job = replace(self._segment.next_job(), hurry=hurry)
        self._under_way = job, self._executor.submit(self.steps, job)

    def _collect(self, wait: bool = False) -> Keyframe | None:
        """Take what has come of the job that is under way, if it is done; returns its keyframe."""
        if self._under_way is None or not (wait or self._under_way[1].done()):
            return None
        (job, future), self._under_way = self._under_way, None
        result = future.result()
        self._clock.add(result.milliseconds)
        T_world_camera = self._segment.complete(job, result)
        keyframe = as_keyframe(job, result, T_world_camera, self._segment.number)
        self._mapped.add(keyframe.index)
        if self._on_keyframe:
            self._on_keyframe(keyframe)
        self._report(self._segment.news())
        return keyframe

    def _close_segment(self) -> Keyframe | None:
        """Complete what waits for later keyframes, since none will come; keep the surface and nothing else."""
        segment, keyframe = self._segment, self._collect(wait=True)
        while segment.pending:
            self._begin_job()
            keyframe = self._collect(wait=True)
        self._report(segment.settle())
        with self._clock("mesh"):
            self._done[segment.number] = segment.extract()
        return keyframe

    def _report(self, changes: list[Fused]) -> None:
        for fused in changes:
            self._clock.add({"fusion": fused.milliseconds})
            if self._on_pose:
                for index, pose in fused.settled.items():
                    self._on_pose(index, pose)
            if self._on_fused and fused.keyframe is not None:
                self._on_fused(fused)

    def _new_segment(self, number: int) -> Segment:
        stereo, fusion, patient = self.config.stereo, self.config.fusion, self._most_waiting is None
        return Segment(number, self.camera, stereo, fusion, self._store, self._fusing, patient)


def _as_source(poses: PoseSource | Trajectory | Callable | None) -> PoseSource | None:
    if isinstance(poses, Trajectory):
        return GivenPoses.of(poses)
    return GivenPoses(poses) if callable(poses) else poses


def _front_end(camera_file: CameraFile, source: PoseSource | None) -> FrontEnd:
    require_polarization(camera_file)
    own = None if source is None else source.front_end
    return FrontEnd(camera_file) if own is None else own
