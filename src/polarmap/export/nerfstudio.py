"""A data set of nerfstudio: transforms.json, pictures, depth as 16-bit PNG, points that Gaussians begin from."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

from polarmap.export.output import make_folder, prepare_folder, remarks, require_room, write_record
from polarmap.export.samples import choose_samples
from polarmap.export.source import MapSource
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import write_bytes
from polarmap.io.formats.depth_png import depth_png_scale, write_depth_png
from polarmap.io.formats.images import write_image
from polarmap.io.formats.ply import write_ply

OPENCV_TO_OPENGL = np.diag([1.0, -1.0, -1.0, 1.0])
"""Camera axes: y down and z forward to y up and z back, and the other way round."""

_MILLIMETRES = 1000.0  # values per unit, nerfstudio's default
_MAX_VALUE = 65535.0
_LEAST_VALUES = 500.0  # at the usual depth, so that a step is at most 0.2 %
_MOST_MEDIANS = 8.0  # that a depth picture has room for


def export_nerfstudio(
    source: MapSource, out: Path, *, points: int = 30_000, min_confidence: float = 0.1, force: bool = False
) -> float:
    """Write the data set into the folder `out`; returns the depth pictures' unit, `--depth-unit-scale-factor`.

    points: at most so many, chosen as in `choose_samples`. Depth below `min_confidence`, or too far for the pictures,
    is left out. Raises InputError as `prepare_folder` does, and where there are no keyframes with pictures.
    """
    require_room(out, force)
    source = source.with_pictures()
    samples = choose_samples(source, points, min_confidence)
    prepare_folder(out, force)
    scale = _depth_scale(source)
    write_record(
        out, source, "nerfstudio", points=len(samples), images=len(source.files), depth_unit_scale_factor=1.0 / scale
    )
    for name in ("images", "depth"):
        make_folder(out / name)
    frames = []
    for keyframe in source.keyframes("writing keyframes"):
        image, depth = f"images/{keyframe.index:06d}.png", f"depth/{keyframe.index:06d}.png"
        write_image(out / image, source.picture(keyframe.index))
        sure = (keyframe.confidence >= min_confidence) & (keyframe.depth * scale <= _MAX_VALUE)
        write_depth_png(out / depth, np.where(sure, keyframe.depth, np.nan), scale)
        pose = keyframe.T_world_camera @ OPENCV_TO_OPENGL
        frames.append({"file_path": image, "depth_file_path": depth, "transform_matrix": pose.tolist()})
    write_ply(
        out / "points.ply",
        samples.position,
        normals=samples.normal,
        grey=samples.grey / 255.0,
        offset=source.origin,
        comments=remarks(source),
    )
    transforms = {
        **_intrinsics(source.camera),
        "depth_unit_scale_factor": 1.0 / scale,
        "ply_file_path": "points.ply",
        "comment": "; ".join(remarks(source)),
        "frames": frames,
    }
    write_bytes(out / "transforms.json", (json.dumps(transforms, indent=1) + "\n").encode())
    return 1.0 / scale


def _intrinsics(camera: PinholeCamera) -> dict[str, object]:
    """Of all frames; nerfstudio's first pixel has its centre at (0.5, 0.5)."""
    return {
        "camera_model": "OPENCV",
        "w": camera.width,
        "h": camera.height,
        "fl_x": camera.fx,
        "fl_y": camera.fy,
        "cx": camera.cx + 0.5,
        "cy": camera.cy + 0.5,
        **dict.fromkeys(("k1", "k2", "p1", "p2"), 0.0),
    }


def _depth_scale(source: MapSource) -> float:
    """Values per unit of depth: millimetres, or what suits the map where these are too fine or too coarse."""
    medians = [k.median_depth for k in source.results.keyframes if k.index in source.files and k.median_depth]
    if not medians:
        return _MILLIMETRES
    usual, far = float(np.median(medians)), max(medians)
    if usual * _MILLIMETRES >= _LEAST_VALUES and _MOST_MEDIANS * far * _MILLIMETRES <= _MAX_VALUE:
        return _MILLIMETRES
    return depth_png_scale(_MOST_MEDIANS * far)
