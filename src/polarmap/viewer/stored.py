"""A run's folder, as the page shows it."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from polarmap.errors import InputError
from polarmap.export.source import MapSource
from polarmap.io.formats.images import read_colours
from polarmap.report.keyframe_pictures import PICTURES
from polarmap.viewer.patch import SHOWN, Patch, make_patch, vertex_step

MOST_KEYFRAMES = 200  # of a long run; of more, as many at even distances


def stored_patches(source: MapSource) -> Iterator[Patch]:
    """The keyframes of a run's segment, at most `MOST_KEYFRAMES`, in order of time, counted from the source's origin.

    Raises InputError where a file cannot be read, or a picture is not of its keyframe's size.
    """
    indices = list(source.files)
    chosen = np.linspace(0, len(indices) - 1, min(MOST_KEYFRAMES, len(indices))).round().astype(int)
    fewer = replace(source, files={indices[i]: source.files[indices[i]] for i in chosen})
    step = vertex_step(source.camera)
    for keyframe in fewer.keyframes("reading"):
        pictures = dict(_pictures(source, keyframe.index))
        grey = pictures.get("image", np.full((*keyframe.depth.shape, 3), 128, np.uint8))
        if grey.shape[:2] != keyframe.depth.shape:
            raise InputError(f"{source.picture_path(keyframe.index)}: is not of its keyframe's size")
        small = {name: picture[:: max(1, step // 2), :: max(1, step // 2)] for name, picture in pictures.items()}
        yield make_patch(keyframe, source.segment, step, grey[::step, ::step], small)


def _pictures(source: MapSource, index: int) -> Iterator[tuple[str, np.ndarray]]:
    for name in SHOWN:
        path = source.folder / "pictures" / f"{index:06d}_{name}.{PICTURES[name][1]}"
        if path.exists():
            yield name, read_colours(path, source.camera.width * source.camera.height)[..., ::-1]
