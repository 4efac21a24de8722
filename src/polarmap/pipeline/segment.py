"""A segment: keyframes in one world and scale, those that wait, those that were mapped, and the surface they make."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Collection, Mapping
from concurrent.futures import Future
from dataclasses import dataclass, replace
from time import perf_counter

import numpy as np

from polarmap.data.depth_map import DepthMap
from polarmap.data.map import SegmentMap
from polarmap.data.view import View
from polarmap.errors import InputError
from polarmap.fusion.depth_store import DepthStore
from polarmap.fusion.options import FusionOptions
from polarmap.fusion.surface import Surface
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.origin import LARGEST_STEP, local_origin, shifted, steps_of
from polarmap.geometry.pose import is_rigid
from polarmap.geometry.sim3 import Sim3
from polarmap.pipeline.executor import Executor, InLine
from polarmap.pipeline.keyframe_depth import DepthJob, KeyframeDepth
from polarmap.pipeline.poses.source import Candidate
from polarmap.pipeline.witnesses import Witnesses
from polarmap.stereo.options import StereoOptions

_MOST_FUSING = 6  # changes of the surface that wait, each at most a depth map; with more of them no job begins


@dataclass(frozen=True, eq=False)
class Fused:
    """What became of a change of the surface.

    settled: final poses of keyframes that could move until then, by index. finished: when, in seconds of
    `time.perf_counter`. keyframe, timestamp: index and time of the one that was integrated; None and NaN if the change
    was another.
    """

    settled: Mapping[int, Sim3]
    milliseconds: float
    finished: float
    keyframe: int | None = None
    timestamp: float = float("nan")


class Segment:
    """Keyframes in one world and scale, the only place where they change.

    In that world, `centre` is what all that is done is counted from: the first pose if poses are given, so that nothing
    depends on where their world has its origin. origin: what mesh and cloud are counted from.
    pending: keyframes that wait for later ones. mapped: the last ones that have depth. skipped: the last ones that will
    have none; others are matched with them all the same. witnesses: what earlier ones saw. keyframes: how many have
    depth.
    patient: whether keyframes wait for the later ones that stereo wants, or are matched with those that there are.
    fusing: what changes the surface, here and now by default; one change after the other, in order.
    """

    def __init__(
        self,
        number: int,
        camera: PinholeCamera,
        stereo: StereoOptions,
        fusion: FusionOptions,
        store: DepthStore | None = None,
        fusing: Executor | None = None,
        patient: bool = True,
    ) -> None:
        self.number = number
        self._patient = patient
        self._fusing = fusing or InLine()
        self._changes: deque[Future[Fused]] = deque()
        self._moved_to: dict[int, Sim3] = {}  # poses that the surface was told last
        self.surface = Surface(fusion, store)
        self.pending: deque[View] = deque()
        self.mapped: deque[View] = deque(maxlen=max(stereo.past, 1))
        self.skipped: deque[View] = deque(maxlen=max(stereo.past, 1))
        self.witnesses = Witnesses(camera)
        self.keyframes = 0
        self.origin = np.zeros(3)
        self._camera = camera
        self._stereo = stereo
        self._centre: np.ndarray | None = None
        self._under_way: View | None = None
        self._poses: dict[int, Sim3] = {}  # in the world, of keyframes that wait, are under way or may move
        self._moving: frozenset[int] = frozenset()
        self._novelty: dict[int, float] = {}  # of keyframes that wait
        self._mapped_at: dict[int, float] = {}  # scale of keyframes that may move, when their depth was found

    @property
    def newest(self) -> View | None:
        """The last keyframe."""
        if self.pending:
            return self.pending[-1]
        return self._under_way or (self.mapped[-1] if self.mapped else None)

    @property
    def is_ready(self) -> bool:
        """Whether the oldest waiting keyframe has the neighbours it waits for; the first of all waits for two.

        Not while the surface is far behind.
        """
        return self.backlog > 0 and len(self._changes) < _MOST_FUSING

    @property
    def backlog(self) -> int:
        """How many waiting keyframes could be mapped."""
        return max(0, len(self.pending) - self._awaited)

    @property
    def _awaited(self) -> int:
        past, future = self._stereo.past, self._stereo.future
        return max(future if self._patient else 0, min(2, past + future) - len(self.mapped))

    def local_pose(self, candidate: Candidate) -> np.ndarray:
        """A candidate's pose from the centre, float64 4×4; the first one chooses that.

        Raises InputError where the pose is no rigid motion, or so far away that its numbers hold no surface.
        """
        T = _checked_pose(candidate)
        if self._centre is None:
            self.origin = local_origin(T[:3, 3])
            self._centre = T[:3, 3].copy() if candidate.given else self.origin
        return shifted(T, -self._centre)

    def add(self, candidate: Candidate, novelty: float = 1.0) -> None:
        """Make a candidate a keyframe, which waits to be mapped. novelty: how much it shows that the last does not."""
        image, T = candidate.frame.polarization, self.local_pose(candidate)
        view = View(image, T, candidate.index, candidate.timestamp, candidate.given, known=candidate.known)
        self.pending.append(view)
        self._novelty[candidate.index] = novelty
        self._poses[candidate.index] = Sim3.from_matrix(np.asarray(candidate.T_world_camera, np.float64))

    def withdraw(self, index: int) -> bool:
        """Take back a keyframe; False where none of that number waits."""
        fit = deque(view for view in self.pending if view.index != index)
        withdrawn = len(fit) < len(self.pending)
        self.pending = fit
        self._novelty.pop(index, None)
        return withdrawn

    def skip_one(self) -> int:
        """Give up, of the keyframes that wait, the one without which the next would show least that is new.

        Returns its index. There must be two at least; the newest stays, since later frames are compared with it.
        """
        steps = [self._novelty[view.index] for view in self.pending]
        least = min(range(len(steps) - 1), key=lambda i: steps[i] + steps[i + 1])
        view, following = self.pending[least], self.pending[least + 1]
        self._novelty[following.index] += steps[least]
        self.withdraw(view.index)
        self.skipped.append(view)
        return view.index

    def move(self, poses: Mapping[int, Sim3], final: Collection[int] = ()) -> None:
        """Move keyframes to present T_world_camera, by index, with their depth and in the surface.

        final: those that do not move any more.
        """
        self._moving = (self._moving | poses.keys()) - frozenset(final)
        self._poses |= poses
        local = {index: self._local(pose) for index, pose in poses.items()}

        def moved(view: View) -> View:
            return view.moved(local[view.index]) if view.index in local else view

        self.pending = deque(map(moved, self.pending))
        self.mapped = deque(map(moved, self.mapped), self.mapped.maxlen)
        self.skipped = deque(map(moved, self.skipped), self.skipped.maxlen)
        self.witnesses.move(local)
        self._under_way = self._under_way and moved(self._under_way)
        unmoved = all(_same(pose, self._moved_to.get(index)) for index, pose in local.items())
        self._moved_to = local
        if final or not unmoved:
            self._change(lambda: self.surface.move(local), final)

    def news(self, wait: bool = False) -> list[Fused]:
        """What has been done to the surface since the last call. wait: for all that is to be done."""
        done = []
        while self._changes and (wait or self._changes[0].done()):
            fused = self._changes.popleft().result()
            done.append(replace(fused, settled=self._settled(fused.settled)))
        return done

    def next_job(self) -> DepthJob:
        """Hand out the oldest waiting keyframe with those around it; `complete` takes what comes of it."""
        past, future = self._stereo.past, max(self._awaited, self._stereo.future)
        self._under_way = view = self.pending.popleft()
        self._novelty.pop(view.index, None)
        last = self.mapped[-1] if self.mapped else None
        others = sorted((*self.mapped, *self.skipped, *self.pending), key=lambda other: other.index)
        before = [other for other in others if other.index < view.index]
        after = [other for other in others if other.index > view.index]
        neighbours = (*before[max(0, len(before) - past) :], *after[:future])
        return DepthJob(self._camera, view, neighbours, last, self.witnesses.called(view, last))

    def complete(self, job: DepthJob, result: KeyframeDepth) -> np.ndarray:
        """Take the depth of the keyframe that is under way, and fuse it; returns its present T_world_camera.

        Where it was moved meanwhile, its depth moves after.
        """
        now, self._under_way = self._under_way or job.view, None
        pose = Sim3(now.scale, now.T_world_camera[:3, :3], now.T_world_camera[:3, 3])
        done = replace(job.view, stereo=result.stereo, depth=result.dense.depth, planes=result.planes)
        if len(self.mapped) == self.mapped.maxlen and (witness := self.mapped[0].witness):
            self.witnesses.add(witness)
        self.mapped.append(done if now is job.view else done.moved(pose))
        self.keyframes += 1
        depth_map = DepthMap(result.dense.depth, now.image.intensity, result.confidence, self._camera)
        movable = now.index in self._moving
        if movable:
            self._mapped_at[now.index] = job.view.scale

        def integrate() -> None:
            self.surface.integrate(now.index, depth_map.scaled(1.0 / job.view.scale), pose, movable)

        self._change(integrate, keyframe=now)
        T_world_camera = self._poses[now.index].rigid
        waiting = {view.index for view in self.pending} | self._moving
        self._poses = {index: pose for index, pose in self._poses.items() if index in waiting}
        return T_world_camera

    def settle(self) -> list[Fused]:
        """Nothing moves any more: what is still to be done to the surface, with the final poses of the last that could.

        Their scale is that by which the depth has grown since it was found.
        """
        self._change(lambda: None, final=None)
        return self.news(wait=True)

    def extract(self) -> SegmentMap:
        """The surface as mesh and points."""
        mesh, cloud = self.surface.mesh(), self.surface.points()
        shift = np.zeros(3) if self._centre is None else self._centre - self.origin
        return SegmentMap(
            segment=self.number,
            keyframes=self.keyframes,
            mesh=mesh and mesh.shifted(shift),
            cloud=cloud and cloud.shifted(shift),
            voxel_size=self.surface.voxel_size,
            blocks=self.surface.blocks,
            origin=self.origin,
            left_out=self.surface.left_out,
        )

    def _change(
        self, change: Callable[[], None], final: Collection[int] | None = (), keyframe: View | None = None
    ) -> None:
        """Have the surface changed, and its keyframes settled that are final; all if that is None."""

        def work(surface: Surface) -> Fused:
            begin = perf_counter()
            change()
            settled = surface.settle(final) if final or final is None else {}
            end = perf_counter()
            done = Fused(settled, 1000 * (end - begin), end)
            return done if keyframe is None else replace(done, keyframe=keyframe.index, timestamp=keyframe.timestamp)

        self._changes.append(self._fusing.submit(work, self.surface))

    def _local(self, pose: Sim3) -> Sim3:
        """A pose as it is from the centre."""
        return pose if self._centre is None else replace(pose, translation=pose.translation - self._centre)

    def _settled(self, poses: Mapping[int, Sim3]) -> dict[int, Sim3]:
        """Final poses, in the world again."""
        centre = np.zeros(3) if self._centre is None else self._centre
        return {
            i: Sim3(pose.scale / self._mapped_at.pop(i), pose.rotation, pose.translation + centre)
            for i, pose in poses.items()
        }


def _same(pose: Sim3, other: Sim3 | None) -> bool:
    return other is not None and np.array_equal(pose.matrix, other.matrix)


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
