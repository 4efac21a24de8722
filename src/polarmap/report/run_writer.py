"""Writes a run to its folder while it goes on (see docs/output.md)."""

from __future__ import annotations

import logging
import os
import platform
import sys
from collections import deque
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import asdict
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from time import monotonic
from typing import TYPE_CHECKING, Literal

import cv2
import numpy as np

from polarmap.densify.densify import Origin
from polarmap.errors import PolarmapError
from polarmap.io.depth_png import depth_png_scale, write_depth_png
from polarmap.io.files import write_bytes
from polarmap.io.images import write_image
from polarmap.io.keyframe_file import write_keyframe
from polarmap.io.ply import write_ply
from polarmap.io.results import (
    CLOUD_NAME,
    CONFIG_NAME,
    KEYFRAMES_NAME,
    MESH_NAME,
    TRAJECTORY_NAME,
    TUM_HEADER,
    Intrinsics,
    KeyframeSummary,
    MapSummary,
    PictureRanges,
    RunResults,
    StepTime,
    Weights,
    append_line,
    prepare_output,
    tum_line,
    write_results,
)
from polarmap.polarization.cues import Reflection
from polarmap.report.html import write_report
from polarmap.report.keyframe_pictures import PICTURES, keyframe_pictures, picture_ranges
from polarmap.report.preview import render_map

if TYPE_CHECKING:
    from polarmap.config import Config
    from polarmap.geometry.camera import PinholeCamera
    from polarmap.results import Keyframe, Map

log = logging.getLogger(__name__)

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

    A frame's pose is given by `add_frame`, a keyframe by `add_keyframe` (which fits `Mapper(on_keyframe=...)`), the
    map by `add_map`. Leaving the block writes results.json and report.html; the run is complete if the map was
    given and no exception ended it, otherwise interrupted.

    out: made if it does not exist; must be empty unless `force` says to replace an earlier run in it.
    command, sequence, pose_source: for the record. poses: "odometry" if the run finds them itself, up to scale.
    stages: whether keyframe files hold the depth after each step too.

    Raises InputError as `prepare_output` does. Every method raises PolarmapError, here or at a later call, where a
    file cannot be written, on a full disk for instance; what was written before stays as it is.
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
        self._fixed = {
            "command": command,
            "sequence": sequence,
            "poses": poses,
            "pose_source": pose_source,
            "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
            "camera": Intrinsics(**asdict(camera)),
            "versions": _versions(),
            "machine": f"{platform.system()} {platform.machine()}",
            "cpu_count": os.cpu_count(),
        }
        self._stages = stages
        self._start = monotonic()
        self._frames = self._posed = 0
        self._keyframes: list[KeyframeSummary] = []
        self._poses: list[np.ndarray] = []
        self._ranges: PictureRanges | None = None
        self._depth_scale: float | None = None
        self._map: MapSummary | None = None
        self._map_milliseconds: dict[str, float] = {}
        self._thread = ThreadPoolExecutor(1, thread_name_prefix="polarmap-writer")
        self._waiting: deque[Future] = deque()
        prepare_output(self.out, force)
        self._write_heads(config)

    def __enter__(self) -> RunWriter:
        return self

    def __exit__(self, kind, error, traceback) -> None:
        problem = self._drain()
        failure = error or problem
        complete = failure is None and self._map is not None
        try:
            write_results(self.out, self._results("complete" if complete else "interrupted", _reason(failure)))
            write_report(self.out)
        except PolarmapError as unwritten:
            if failure is None:
                raise
            log.warning("%s", unwritten)
        if error is None and problem is not None:
            raise problem

    def add_frame(self, timestamp: float, T_world_camera: np.ndarray | None) -> None:
        """Count a frame that was mapped; a line in trajectory.txt unless its pose is None."""
        self._frames += 1
        if T_world_camera is not None:
            self._posed += 1
            append_line(self.out / TRAJECTORY_NAME, tum_line(timestamp, T_world_camera))

    def add_keyframe(self, keyframe: Keyframe) -> None:
        """Have a keyframe written; waits only if two are not written yet. Its arrays must not change any more."""
        self._submit(self._write_keyframe, keyframe)

    def add_map(self, result: Map) -> None:
        """Have the final map written."""
        self._submit(self._write_map, result)

    def _submit(self, write: Callable, result: Keyframe | Map) -> None:
        while self._waiting and (self._waiting[0].done() or len(self._waiting) >= _MAX_WAITING):
            self._waiting.popleft().result()
        self._waiting.append(self._thread.submit(write, result))

    def _drain(self) -> BaseException | None:
        """Wait until the background is done; returns the first exception that ended something there."""
        problems = [future.exception() for future in self._waiting]
        self._thread.shutdown()
        return next((problem for problem in problems if problem is not None), None)

    def _write_heads(self, config: Config) -> None:
        write_results(self.out, self._results("running"))
        write_bytes(self.out / CONFIG_NAME, config.to_yaml().encode())
        for name in (TRAJECTORY_NAME, KEYFRAMES_NAME):
            write_bytes(self.out / name, TUM_HEADER.encode())

    def _write_keyframe(self, keyframe: Keyframe) -> None:
        name = f"{keyframe.index:06d}"
        if self._depth_scale is None:  # as long as no keyframe had depth
            self._ranges = picture_ranges(keyframe)
        write_keyframe(self.out / "keyframes" / f"{name}.npz", keyframe, self._stages)
        beyond = self._write_depth(self.out / "depth" / f"{name}.png", keyframe.depth)
        for kind, picture in keyframe_pictures(keyframe, self._ranges).items():
            self._write_picture(f"{name}_{kind}.{PICTURES[kind][1]}", picture)
        append_line(self.out / KEYFRAMES_NAME, tum_line(keyframe.timestamp, keyframe.T_world_camera))
        self._poses.append(keyframe.T_world_camera)
        self._keyframes.append(_summary(keyframe, beyond))
        write_results(self.out, self._results("running"))

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
        mesh, cloud = result.mesh, result.cloud
        if mesh is not None:
            write_ply(self.out / MESH_NAME, mesh.vertices, faces=mesh.faces, normals=mesh.normals, grey=mesh.grey)
        if cloud is not None:
            write_ply(self.out / CLOUD_NAME, cloud.points, normals=cloud.normals, grey=cloud.grey)
        if mesh is not None and len(mesh.faces) and self._poses:
            for view, picture in render_map(mesh, np.array(self._poses)).items():
                self._write_picture(f"map_{view}.jpg", picture)
        self._map_milliseconds = result.milliseconds
        self._map = MapSummary(
            voxel_size=result.voxel_size,
            blocks=result.blocks,
            vertices=0 if mesh is None else len(mesh.vertices),
            faces=0 if mesh is None else len(mesh.faces),
            points=0 if cloud is None else len(cloud.points),
        )

    def _write_picture(self, name: str, picture: np.ndarray) -> None:
        write_image(self.out / "pictures" / name, cv2.cvtColor(picture, cv2.COLOR_RGB2BGR))

    def _results(self, status: str, reason: str | None = None) -> RunResults:
        return RunResults(
            **self._fixed,
            status=status,
            reason=reason,
            seconds=round(monotonic() - self._start, 3),
            depth_scale=self._depth_scale,
            picture_ranges=self._ranges,
            frames=self._frames,
            posed=self._posed,
            milliseconds=_step_times(self._keyframes, self._map_milliseconds),
            map=self._map,
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
        beyond_png=beyond_png,
        prior_verdict=keyframe.prior_verdict,
        diffuse_weights=Weights(**asdict(keyframe.diffuse_weights)),
        specular_weights=Weights(**asdict(keyframe.specular_weights)),
        milliseconds=keyframe.milliseconds,
    )


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


def _reason(error: BaseException | None) -> str | None:
    return None if error is None else str(error) or type(error).__name__
