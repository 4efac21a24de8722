"""A run's folder, as the page shows it."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np

from polarmap.data.mesh import Mesh
from polarmap.errors import InputError
from polarmap.io.formats.images import MAX_PIXELS, read_colours
from polarmap.io.formats.ply_reader import read_ply
from polarmap.io.run_folder.folder import MESH_NAME, read_results
from polarmap.io.run_folder.keyframe_file import read_keyframe
from polarmap.report.keyframe_pictures import PICTURES
from polarmap.viewer.patch import SHOWN, Patch, make_patch, vertex_step

MOST_KEYFRAMES = 200  # of a long run; of more, as many at even distances


def stored_patches(out: Path) -> Iterator[Patch]:
    """The keyframes of a run's main segment, at most `MOST_KEYFRAMES`, in order of time.

    Raises InputError where the folder is not a run's, or a file in it cannot be read.
    """
    results = read_results(out)
    keyframes = [keyframe for keyframe in results.keyframes if keyframe.segment == results.segment]
    if len(keyframes) > MOST_KEYFRAMES:
        chosen = np.linspace(0, len(keyframes) - 1, MOST_KEYFRAMES).round().astype(int)
        keyframes = [keyframes[i] for i in chosen]
    for summary in keyframes:
        keyframe = read_keyframe(out / "keyframes" / f"{summary.index:06d}.npz")
        step = vertex_step(keyframe.camera)
        shown = dict(_pictures(out, summary.index))
        grey = shown.get("image", np.full((*keyframe.depth.shape, 3), 128, np.uint8))
        if grey.shape[:2] != keyframe.depth.shape:
            raise InputError(f"{out}: the picture of frame {summary.index} is not of its keyframe's size")
        small = {name: picture[:: max(1, step // 2), :: max(1, step // 2)] for name, picture in shown.items()}
        yield make_patch(keyframe, summary.segment, step, grey[::step, ::step], small)


def stored_mesh(out: Path) -> tuple[Mesh, np.ndarray] | None:
    """The fused surface of a run's main segment, and the origin of its vertices; None if there is none.

    Raises InputError where it cannot be read.
    """
    path = out / MESH_NAME
    if not path.exists():
        return None
    found = read_ply(path, ("red",))
    if not len(found.faces):
        return None
    points = (found.points - found.offset).astype(np.float32)
    normals = np.zeros_like(points) if found.normals is None else found.normals.astype(np.float32)
    grey = found.properties.get("red", np.full(len(points), 128.0)) / 255.0
    return Mesh(points, found.faces.astype(np.int32), normals, grey.astype(np.float32)), found.offset


def _pictures(out: Path, index: int) -> Iterator[tuple[str, np.ndarray]]:
    for name in SHOWN:
        path = out / "pictures" / f"{index:06d}_{name}.{PICTURES[name][1]}"
        if path.exists():
            yield name, read_colours(path, MAX_PIXELS)[..., ::-1]
