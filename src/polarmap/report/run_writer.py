"""Writes a run to its folder while it goes on (see docs/output.md)."""

from __future__ import annotations

import logging
import os
import platform
import sys
from collections import Counter, deque
from collections.abc import Callable, Iterable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Any, Literal, TypeVar

import cv2
import numpy as np

from polarmap.data.codes import Origin, Reflection
from polarmap.errors import NothingMapped, PolarmapError
from polarmap.geometry.origin import shifted
from polarmap.geometry.sim3 import Sim3
from polarmap.io.files import printable, write_bytes
from polarmap.io.folder_lock import FolderLock
from polarmap.io.formats.depth_png import depth_png_scale, write_depth_png
from polarmap.io.formats.images import write_image
from polarmap.io.formats.ply import offset_text, write_ply
from polarmap.io.run_folder.folder import (
    CLOUD_NAME,
    CONFIG_NAME,
    KEYFRAMES_NAME,
    MESH_NAME,
    ODOMETRY_TUM_HEADER,
    OFFSET_NAME,
    TRAJECTORY_NAME,
    TUM_HEADER,
    append_line,
    prepare_output,
    segment_file,
    tum_line,
    write_results,
)
from polarmap.io.run_folder.keyframe_file import read_keyframe, replace_pose, write_keyframe
from polarmap.io.run_folder.results import (
    Intrinsics,
    KeyframeSummary,
    LiveSummary,
    MapSummary,
    PictureRanges,
    RunResults,
    SearchSummary,
    SegmentSummary,
    StepTime,
    SummaryLine,
    Weights,
)
from polarmap.niceness import give_way
from polarmap.report.html import write_report
from polarmap.report.keyframe_pictures import PICTURES, keyframe_pictures, picture_ranges
from polarmap.report.preview import render_map
from polarmap.report.summary import Evidence, nothing_mapped, summarize

if TYPE_CHECKING:
    from polarmap.data.keyframe import Keyframe
    from polarmap.data.live import LiveFigures
    from polarmap.data.map import Map, SegmentMap
    from polarmap.data.trajectory import PosedFrame
    from polarmap.geometry.camera import PinholeCamera
    from polarmap.pipeline.config import Config

log = logging.getLogger(__name__)

Item = TypeVar("Item")
Status = Literal["running", "complete", "interrupted", "failed"]

_PACKAGES = ("polarmap", "numpy", "numba", "scipy", "opencv-python-headless", "onnxruntime")
_MAX_WAITING = 2  # keyframes held in memory until they are written
_HEADROOM = 4.0  # of the depth pictures' range over the first keyframe's depth
_MAX_PNG_DEPTH = 65535


class RunWriter:
    """Writes a run's folder in the background; however the run ends, the folder holds what was done.

        with RunWriter(out, config, mapper.camera, sequence="livingroom") as writer:
            for frame in sequence:
                keyframe = mapper.process(frame)
                ...

    A frame's pose is given by `add_frame`, a keyframe by `add_keyframe` (which fits `Mapper(on_keyframe=...)`), a
    keyframe's final pose by `add_pose` (`Mapper(on_pose=...)`), the map by `add_map`, what else is known for the
    summary by `add_evidence`, and how a live run kept up by `add_live`. Leaving the block writes results.json and
    report.html; the run is complete if the map was given and no exception ended it, failed if it came to its end
    without a surface, otherwise interrupted. `summary` are then the lines that sum it up.

    out: made if it does not exist; must be empty unless `force` says to replace an earlier run in it.
    command, sequence, pose_source: for the record. poses: "odometry" if the run finds them itself, up to scale.
    stages: whether keyframe files hold the depth after each step too.

    Raises InputError as `prepare_output` does, and where another run is writing there. Every method raises
    PolarmapError, here or at a later call, where a file cannot be written, on a full disk for instance; what was
    written before stays as it is.
    """

    def __init__(
        self,
        out: Path | str,
        config: Config,
        camera: PinholeCamera,
        *,
        command: str = "",
        sequence: str = "",
        poses: Literal["given", "odometry"] = "given",
        pose_source: str = "",
        force: bool = False,
        stages: bool = False,
    ) -> None:
        self.out = Path(out)
        self._fixed: dict[str, Any] = {
            "command": printable(command),
            "sequence": printable(sequence),
            "poses": poses,
            "pose_source": printable(pose_source),
            "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "camera": Intrinsics(**asdict(camera)),
            "versions": _versions(),
            "machine": f"{platform.system()} {platform.machine()}",
            "cpu_count": os.cpu_count(),
        }
        self._stages = stages
        self._orthographic = config.cues.orthographic
        self._start = monotonic()
        self._frames = self._posed = 0
        self._without_pose: dict[float, str] = {}  # by time, since a later adjustment may give it one
        self._unfit: Counter[str] = Counter()
        self._first_time = self._last_time = float("nan")
        self._path_length = 0.0
        self._last_pose: tuple[int, np.ndarray] | None = None
        self._evidence = Evidence()
        self._live: LiveSummary | None = None
        self.summary: list[SummaryLine] = []
        self._keyframes: list[KeyframeSummary] = []
        self._poses: dict[int, np.ndarray] = {}
        self._ranges: PictureRanges | None = None
        self._depth_scale: float | None = None
        self._map: MapSummary | None = None
        self._map_milliseconds: dict[str, float] = {}
        self._segment = 0
        self._segments: list[SegmentSummary] = []
        self._header = TUM_HEADER if poses == "given" else ODOMETRY_TUM_HEADER
        self._headed: set[Path] = set()
        self._thread = ThreadPoolExecutor(1, "polarmap-writer", give_way)
        self._waiting: deque[Future] = deque()
        self._lock = FolderLock(self.out)
        prepare_output(self.out, force, self._lock)
        try:
            self._write_heads(config)
        except PolarmapError:
            self._lock.release()
            raise

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind, error, traceback) -> None:
        try:
            self._close(error)
        finally:
            self._lock.release()

    def _close(self, error: BaseException | None) -> None:
        problem = self._drain()
        failure = error or problem
        try:
            write_results(self.out, self._final_results(failure))
            write_report(self.out)
        except PolarmapError as unwritten:
            if failure is None:
                raise
            log.warning("%s", unwritten)
        if error is None and problem is not None:
            raise problem

    def _final_results(self, failure: BaseException | None) -> RunResults:
        """With the summary, and the status that follows from how the run ended."""
        results = self._results("interrupted", _reason(failure))
        if isinstance(failure, NothingMapped):
            results = results.model_copy(update={"status": "failed"})
        elif failure is None and self._map is not None:
            results = results.model_copy(update={"status": "failed" if nothing_mapped(results) else "complete"})
        self.summary = summarize(results, self.out, self._evidence)
        if results.status == "failed" and results.reason is None:
            results = results.model_copy(update={"reason": self.summary[0].text})
        return results.model_copy(update={"summary": self.summary})

    def add_frame(
        self, timestamp: float, T_world_camera: np.ndarray | None, segment: int = 0, reason: str = ""
    ) -> None:
        """Count a frame that was mapped; a line in its segment's trajectory file unless its pose is None.

        reason: why it is None.
        """
        self._first_time = timestamp if self._frames == 0 else self._first_time
        self._last_time = timestamp
        self._frames += 1
        if T_world_camera is None:
            self._without_pose[timestamp] = reason or "not known"
            return
        self._posed += 1
        self._add_way(segment, T_world_camera[:3, 3])
        self._append_pose(TRAJECTORY_NAME, segment, timestamp, T_world_camera)

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Have a keyframe written; waits only if two are not written yet. Its arrays must not change any more."""
        self._submit(self._write_keyframe, keyframe)

    def add_pose(self, index: int, pose: Sim3) -> None:
        """Have the final pose of a keyframe written that was added before, and its depth times the pose's scale."""
        self._submit(self._move_keyframe, index, pose)

    def add_map(self, result: Map) -> None:
        """Have the final map written, and the final trajectories if it has one."""
        self._submit(self._write_map, result)

    def add_evidence(self, evidence: Evidence) -> None:
        """Give the summary what is known beside the counts."""
        self._evidence = evidence

    def add_live(self, figures: LiveFigures) -> None:
        """Tell how the run kept up with its frames."""
        self._live = LiveSummary(**asdict(figures))

    def _add_way(self, segment: int, position: np.ndarray) -> None:
        if self._last_pose is not None and self._last_pose[0] == segment:
            self._path_length += float(np.linalg.norm(position - self._last_pose[1]))
        self._last_pose = segment, position.copy()

    def _submit(self, write: Callable, *what: object) -> None:
        while self._waiting and (self._waiting[0].done() or len(self._waiting) >= _MAX_WAITING):
            self._waiting.popleft().result()
        self._waiting.append(self._thread.submit(write, *what))

    def _drain(self) -> BaseException | None:
        """Wait until the background is done; returns the first exception that ended something there."""
        problems = [future.exception() for future in self._waiting]
        self._thread.shutdown()
        return next((problem for problem in problems if problem is not None), None)

    def _write_heads(self, config: Config) -> None:
        write_results(self.out, self._results("running"))
        write_bytes(self.out / CONFIG_NAME, config.to_yaml().encode())
        for name in (TRAJECTORY_NAME, KEYFRAMES_NAME):
            self._write_poses(name, 0, [])

    def _write_keyframe(self, keyframe: Keyframe) -> None:
        name = f"{keyframe.index:06d}"
        if self._ranges is None or self._depth_scale is None:  # as long as no keyframe had depth
            self._ranges = picture_ranges(keyframe)
        write_keyframe(self.out / "keyframes" / f"{name}.npz", keyframe, self._stages)
        beyond = self._write_depth(self.out / "depth" / f"{name}.png", keyframe.depth)
        for kind, picture in keyframe_pictures(keyframe, self._ranges, self._orthographic).items():
            self._write_picture(f"{name}_{kind}.{PICTURES[kind][1]}", picture)
        self._append_pose(KEYFRAMES_NAME, keyframe.segment, keyframe.timestamp, keyframe.T_world_camera)
        self._poses[keyframe.index] = keyframe.T_world_camera
        self._keyframes.append(_summary(keyframe, beyond))
        write_results(self.out, self._results("running"))

    def _move_keyframe(self, index: int, pose: Sim3) -> None:
        T_world_camera, name = pose.rigid, f"{index:06d}"
        if index not in self._poses or (pose.scale == 1.0 and np.array_equal(self._poses[index], T_world_camera)):
            return
        path = self.out / "keyframes" / f"{name}.npz"
        replace_pose(path, T_world_camera, pose.scale)
        self._poses[index] = T_world_camera
        if pose.scale != 1.0:
            self._write_depth(self.out / "depth" / f"{name}.png", read_keyframe(path).depth)

    def _append_pose(self, name: str, segment: int, timestamp: float, T_world_camera: np.ndarray) -> None:
        path = self.out / segment_file(name, segment)
        if path not in self._headed:
            self._write_poses(name, segment, [])
        append_line(path, tum_line(timestamp, T_world_camera))

    def _write_poses(self, name: str, segment: int, poses: list[tuple[float, np.ndarray]]) -> None:
        path = self.out / segment_file(name, segment, self._segment)
        write_bytes(path, (self._header + "".join(tum_line(t, T) for t, T in poses)).encode())
        self._headed.add(path)

    def _write_depth(self, path: Path, depth: np.ndarray) -> int:
        """Write a depth picture; returns how many pixels are too far for it."""
        known = depth[np.isfinite(depth)]
        if self._depth_scale is None and known.size:
            self._depth_scale = depth_png_scale(_HEADROOM * float(np.percentile(known, 99.9)))
        scale = self._depth_scale or 1.0
        beyond = depth > _MAX_PNG_DEPTH / scale
        write_depth_png(path, np.where(beyond, np.float32(np.nan), depth), scale)
        return int(np.count_nonzero(beyond))

    def _write_map(self, result: Map) -> None:
        surfaces: tuple[Map | SegmentMap, ...] = (result, *result.others)
        if result.trajectory is not None:
            self._write_trajectories(result.segment, result.trajectory, surfaces)
        for surface in surfaces:
            self._write_surface(surface)
        keyframes = [k.index for k in self._keyframes if k.segment == result.segment]
        if result.mesh is not None and len(result.mesh.faces) and keyframes:
            poses = shifted(np.array([self._poses[index] for index in keyframes]), -result.origin)
            for view, picture in render_map(result.mesh, poses).items():
                self._write_picture(f"map_{view}.jpg", picture)
        self._unfit = Counter(result.unfit)
        self._map_milliseconds = result.milliseconds
        self._map = _map_summary(result)

    def _write_surface(self, surface: Map | SegmentMap) -> None:
        mesh, cloud = surface.mesh, surface.cloud
        mesh_path, cloud_path, offset_path = (
            self.out / segment_file(name, surface.segment, self._segment)
            for name in (MESH_NAME, CLOUD_NAME, OFFSET_NAME)
        )
        origin = surface.origin
        if mesh is not None:
            write_ply(mesh_path, mesh.vertices, faces=mesh.faces, normals=mesh.normals, grey=mesh.grey, offset=origin)
        if cloud is not None:
            write_ply(cloud_path, cloud.points, normals=cloud.normals, grey=cloud.grey, offset=origin)
        if np.any(origin):
            write_bytes(offset_path, f"{offset_text(origin)}\n".encode())

    def _write_trajectories(
        self, main: int, trajectory: tuple[PosedFrame, ...], surfaces: tuple[Map | SegmentMap, ...]
    ) -> None:
        """The final poses of every segment, in place of those written while the run went on. main: the first one."""
        self._segment, self._posed = main, len(trajectory)
        for frame in trajectory:
            self._without_pose.pop(frame.timestamp, None)
        frames = _by_segment((f.segment, (f.timestamp, f.T_world_camera)) for f in trajectory)
        keyframes = _by_segment((k.segment, (_time(k), self._poses[k.index])) for k in self._keyframes)
        stale, self._headed = self._headed, set()
        for segment in {main, *frames, *keyframes}:
            self._write_poses(TRAJECTORY_NAME, segment, frames.get(segment, []))
            self._write_poses(KEYFRAMES_NAME, segment, keyframes.get(segment, []))
        for path in stale - self._headed:
            path.unlink(missing_ok=True)
        self._segments = [
            SegmentSummary(
                segment=surface.segment,
                posed=len(frames.get(surface.segment, [])),
                keyframes=len(keyframes.get(surface.segment, [])),
                map=_map_summary(surface),
            )
            for surface in surfaces
        ]

    def _write_picture(self, name: str, picture: np.ndarray) -> None:
        write_image(self.out / "pictures" / name, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

    def _results(self, status: Status, reason: str | None = None) -> RunResults:
        return RunResults(
            **self._fixed,
            status=status,
            reason=reason,
            seconds=round(monotonic() - self._start, 3),
            depth_scale=self._depth_scale,
            picture_ranges=self._ranges,
            frames=self._frames,
            posed=self._posed,
            without_pose=Counter(self._without_pose.values()),
            unfit=self._unfit - Counter(self._without_pose.values()),
            recorded_seconds=_span(self._first_time, self._last_time),
            path_length=self._path_length,
            live=self._live,
            milliseconds=_step_times(self._keyframes, self._map_milliseconds),
            map=self._map,
            segment=self._segment,
            segments=self._segments,
            keyframes=self._keyframes,
        )


def _summary(keyframe: Keyframe, beyond_png: int) -> KeyframeSummary:
    origins = np.bincount(keyframe.origin.ravel(), minlength=len(Origin))
    labels = np.bincount(keyframe.label.ravel(), minlength=len(Reflection))
    return KeyframeSummary(
        index=keyframe.index,
        timestamp=keyframe.timestamp,
        points=int(np.isfinite(keyframe.depth).sum()),
        density=keyframe.density,
        stereo=int(origins[Origin.STEREO]),
        propagated=int(origins[Origin.PROPAGATED]),
        estimated=int(origins[Origin.ESTIMATED]),
        diffuse=int(labels[Reflection.DIFFUSE]),
        specular=int(labels[Reflection.SPECULAR]),
        metal=int(labels[Reflection.METAL]),
        beyond_png=beyond_png,
        prior_verdict=keyframe.prior_verdict,
        diffuse_weights=Weights(**asdict(keyframe.beliefs.diffuse)),
        specular_weights=Weights(**asdict(keyframe.beliefs.specular)),
        surfaces_weight=keyframe.beliefs.surfaces,
        median_depth=_median(keyframe.depth),
        search=None if keyframe.search is None else SearchSummary(**asdict(keyframe.search)),
        milliseconds=keyframe.milliseconds,
        segment=keyframe.segment,
    )


def _map_summary(surface: Map | SegmentMap) -> MapSummary:
    mesh, cloud = surface.mesh, surface.cloud
    return MapSummary(
        voxel_size=surface.voxel_size,
        blocks=surface.blocks,
        vertices=0 if mesh is None else len(mesh.vertices),
        faces=0 if mesh is None else len(mesh.faces),
        points=0 if cloud is None else len(cloud.points),
        origin=tuple(surface.origin.tolist()),
        left_out=surface.left_out,
    )


def _by_segment(items: Iterable[tuple[int, Item]]) -> dict[int, list[Item]]:
    groups: dict[int, list[Item]] = {}
    for segment, item in items:
        groups.setdefault(segment, []).append(item)
    return groups


def _step_times(keyframes: list[KeyframeSummary], whole_run: dict[str, float]) -> dict[str, StepTime]:
    """Time of each step; what the map says of the whole run includes the keyframes' steps."""
    times: dict[str, list[float]] = {}
    for keyframe in keyframes:
        for step, milliseconds in keyframe.milliseconds.items():
            times.setdefault(step, []).append(milliseconds)
    steps = {step: StepTime(median=float(np.median(t)), total=sum(t)) for step, t in times.items()}
    rest = {step: StepTime(median=None, total=t) for step, t in whole_run.items() if step not in steps}
    return steps | rest


def _versions() -> dict[str, str]:
    versions = {"python": sys.version.split()[0]}
    for package in _PACKAGES:
        try:
            versions[package] = version(package)
        except PackageNotFoundError:  # run from its source, or another build of OpenCV
            log.debug("version of %s is not known", package)
    return versions


def _span(first: float, last: float) -> float | None:
    return round(last - first, 9) if last - first >= 0 else None


def _time(keyframe: KeyframeSummary) -> float:
    return float("nan") if keyframe.timestamp is None else keyframe.timestamp


def _median(depth: np.ndarray) -> float | None:
    known = depth[np.isfinite(depth)]
    return float(np.median(known)) if known.size else None


def _reason(error: BaseException | None) -> str | None:
    return None if error is None else printable(str(error) or type(error).__name__)
