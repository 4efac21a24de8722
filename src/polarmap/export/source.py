"""What is exported: the keyframes, pictures and mesh of one segment of a run, counted from one origin."""

from __future__ import annotations

import logging
import os
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np

from polarmap.data.mesh import Mesh
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.origin import local_origin, shifted
from polarmap.io.formats.images import read_picture
from polarmap.io.formats.ply_reader import read_ply
from polarmap.io.run_folder.folder import MESH_NAME, RESULTS_NAME, keyframe_files, read_results, segment_file
from polarmap.io.run_folder.keyframe_file import KeyframeResult, read_keyframe
from polarmap.io.run_folder.results import MapSummary, RunResults

log = logging.getLogger(__name__)

_FULL = 255.0


def _no_progress(step: str, done: int, total: int) -> None:
    """Nobody watches."""


@dataclass(frozen=True, eq=False)
class MapSource:
    """One segment of a run's folder.

    folder: the run's. results: its results.json. segment: which one. files: those of its keyframes, by index.
    on_progress: told the step, and how many of how many keyframes it has done.
    """

    folder: Path
    results: RunResults
    segment: int
    files: dict[int, Path]
    on_progress: Callable[[str, int, int], None] = _no_progress

    @property
    def camera(self) -> PinholeCamera:
        """Of all keyframes and pictures."""
        return PinholeCamera(**self.results.camera.model_dump())

    @property
    def unit(self) -> str:
        """What lengths are in, for people."""
        return "metres" if self.results.poses == "given" else "units of odometry"

    @property
    def map(self) -> MapSummary | None:
        """The fused map's record; None where the run did not come to it."""
        others = {segment.segment: segment.map for segment in self.results.segments}
        return others.get(self.segment, self.results.map if self.segment == self.results.segment else None)

    @cached_property
    def origin(self) -> np.ndarray:
        """The position in the world of the poses that all that is exported is counted from, float64 (3,)."""
        if self.map is not None:
            if not np.isfinite(self.map.origin).all():
                raise InputError(f"{self.folder / RESULTS_NAME}: its map.origin is infinite; run the mapping again")
            return np.array(self.map.origin)
        first = next(iter(self.files.values()), None)
        return np.zeros(3) if first is None else local_origin(read_keyframe(first).T_world_camera[:3, 3])

    def require_keyframes(self) -> None:
        """InputError where there is none."""
        if not self.files:
            raise InputError(f"{self.folder}: no keyframes of segment {self.segment} in it (keyframes/NNNNNN.npz)")

    def keyframes(self, step: str) -> Iterator[KeyframeResult]:
        """One by one, in order, with poses counted from `origin`. step: what is done with them, for who watches.

        Raises InputError where a file is malformed or of another camera.
        """
        for done, path in enumerate(self.files.values()):
            self.on_progress(step, done, len(self.files))
            keyframe = read_keyframe(path, self.results.camera.size)
            if not np.allclose(keyframe.camera.matrix, self.camera.matrix, rtol=1e-6, atol=1e-3):
                raise InputError(f"{path}: another camera than results.json has; run the mapping again")
            yield replace(keyframe, T_world_camera=shifted(keyframe.T_world_camera, -self.origin))
        self.on_progress(step, len(self.files), len(self.files))

    def picture_path(self, index: int) -> Path:
        """The undistorted grey picture of a keyframe, which may be missing."""
        return self.folder / "pictures" / f"{index:06d}_image.jpg"

    def picture(self, index: int) -> np.ndarray:
        """A keyframe's picture as a display shows it, uint8 H×W; InputError where it is missing or broken."""
        return read_picture(self.picture_path(index), self.results.camera.size, 8)

    def with_pictures(self) -> MapSource:
        """Without the keyframes that have no picture, which is warned of; InputError where none has one."""
        self.require_keyframes()
        kept = {index: path for index, path in self.files.items() if os.path.isfile(self.picture_path(index))}
        if not kept:
            raise InputError(f"{self.folder / 'pictures'}: no NNNNNN_image.jpg of any keyframe, which this needs")
        if missing := len(self.files) - len(kept):
            log.warning("%s: %d keyframes have no picture and are left out", self.folder / "pictures", missing)
        return replace(self, files=kept)

    @property
    def mesh_path(self) -> Path:
        """The fused surface's file, which may be missing."""
        return self.folder / segment_file(MESH_NAME, self.segment, self.results.segment)

    def mesh(self) -> Mesh:
        """The fused surface, counted from `origin`; InputError where there is none, or a file is no mesh."""
        path = self.mesh_path
        if not os.path.isfile(path):
            raise InputError(
                f"{path}: no such file, since the run did not come to its mesh; run it to its end, or export 'ply'"
            )
        ply = read_ply(path, ("red",))
        if not len(ply.faces) or ply.normals is None:
            raise InputError(f"{path}: no triangles with normals in it; run the mapping again")
        vertices = (ply.points - self.origin).astype(np.float32)
        if not np.isfinite(vertices).all():
            raise InputError(f"{path}: has points that are not finite; run the mapping again")
        grey = ply.properties.get("red", np.full(len(vertices), _FULL)) / _FULL
        return Mesh(
            vertices, ply.faces.astype(np.int32), ply.normals.astype(np.float32), np.clip(grey, 0, 1).astype(np.float32)
        )


def open_map(
    folder: Path, segment: int | None = None, on_progress: Callable[[str, int, int], None] = _no_progress
) -> MapSource:
    """A segment of the run in `folder`, by default its main one. Warns where the run did not come to its end.

    Raises InputError where the folder is not a run's, or has no such segment.
    """
    folder = Path(folder)
    results = read_results(folder)
    if results.status in ("running", "interrupted"):
        log.warning("%s: the run is not complete (%s); what is there is exported", folder, results.status)
    wanted = results.segment if segment is None else segment
    segments = {keyframe.segment for keyframe in results.keyframes} | {results.segment}
    if wanted not in segments:
        raise InputError(f"{folder}: no segment {wanted}; it has {', '.join(map(str, sorted(segments)))}")
    own = {keyframe.index for keyframe in results.keyframes if keyframe.segment == wanted}
    files = {index: path for index, path in keyframe_files(folder).items() if index in own}
    return MapSource(folder, results, wanted, files, on_progress)
