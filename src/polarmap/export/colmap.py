"""A COLMAP workspace: undistorted pictures, a sparse model with tracks, dense depth and normal maps."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polarmap.export.output import make_folder, prepare_folder, remarks, require_room, write_record
from polarmap.export.samples import Samples, choose_samples
from polarmap.export.source import MapSource
from polarmap.geometry.pose import inverse
from polarmap.io.files import write_bytes
from polarmap.io.formats.colmap_writer import SparseModel, write_binary_model, write_colmap_map, write_text_model
from polarmap.io.formats.images import write_image
from polarmap.io.run_folder.keyframe_file import KeyframeResult

_LEAST_AGREEMENT = 0.01  # share of the depth within which another keyframe sees the same point
_SIGMAS = 2.0
_SOURCES = 20  # views that COLMAP's own stereo would take for an image, if it were run


def export_colmap(
    source: MapSource, out: Path, *, points: int = 30_000, min_confidence: float = 0.1, force: bool = False
) -> int:
    """Write the workspace into the folder `out`; returns the number of points.

    points: at most so many, chosen as in `choose_samples`. Depth maps are left whole but for pixels below
    `min_confidence`. Raises InputError as `prepare_folder` does, and where there are no keyframes with pictures.
    """
    require_room(out, force)
    source = source.with_pictures()
    samples = choose_samples(source, points, min_confidence)
    prepare_folder(out, force)
    names = [_name(index) for index in source.files]
    write_record(out, source, "colmap", points=len(samples), images=len(names))
    images = make_folder(out / "images")
    stereo = [make_folder(out / "stereo" / name) for name in ("depth_maps", "normal_maps")]
    text = make_folder(out / "sparse" / "0")
    poses, observations, pixels = [], [], []
    for place, keyframe in enumerate(source.keyframes("writing keyframes")):
        name = names[place]
        write_image(images / name, source.picture(keyframe.index))
        unsure = ~(keyframe.confidence >= min_confidence) | np.isnan(keyframe.normal).any(axis=-1)
        write_colmap_map(stereo[0] / f"{name}.geometric.bin", np.where(unsure, np.nan, keyframe.depth))
        write_colmap_map(stereo[1] / f"{name}.geometric.bin", np.where(unsure[..., None], np.nan, keyframe.normal))
        seen, where = observed(samples, keyframe)
        poses.append(keyframe.T_world_camera)
        observations.append(np.column_stack([np.full(len(seen), place), seen]))
        pixels.append(where)
    model = SparseModel(
        source.camera,
        names,
        np.array(poses),
        samples.position,
        samples.grey,
        np.concatenate(observations),
        np.concatenate(pixels),
        remarks(source),
    )
    write_binary_model(out / "sparse", model)
    write_text_model(text, model)
    _write_stereo_settings(out / "stereo", names)
    return len(samples)


def observed(samples: Samples, keyframe: KeyframeResult) -> tuple[np.ndarray, np.ndarray]:
    """Which samples a keyframe sees, int64 M, and at which pixels, float64 M×2.

    Those that came from it, and those that lie in its image at the depth it has there, within two standard deviations
    of both or 1 %.
    """
    T_camera_world, camera = inverse(keyframe.T_world_camera), keyframe.camera
    local = samples.position @ T_camera_world[:3, :3].T + T_camera_world[:3, 3]
    front = np.flatnonzero(local[:, 2] > 0)
    local = local[front]
    pixel = local[:, :2] / local[:, 2:] * (camera.fx, camera.fy) + (camera.cx, camera.cy)
    inside = ((pixel > -0.5) & (pixel < (camera.width - 0.5, camera.height - 0.5))).all(axis=1)
    front, local, pixel = front[inside], local[inside], pixel[inside]
    u, v = np.rint(pixel).astype(np.int64).T
    depth = keyframe.depth[v, u]
    sigma = np.hypot(samples.sigma[front], keyframe.sigma[v, u] * depth)
    with np.errstate(invalid="ignore"):  # where there is no depth
        same = np.abs(local[:, 2] - depth) <= np.maximum(_SIGMAS * sigma, _LEAST_AGREEMENT * depth)
    own = samples.keyframe[front] == keyframe.index
    pixel[own] = samples.pixel[front[own]]
    return front[own | same], pixel[own | same]


def _name(index: int) -> str:
    return f"{index:06d}.png"


def _write_stereo_settings(folder: Path, names: list[str]) -> None:
    """The lists of images without which COLMAP's fusion and stereo do not begin."""
    write_bytes(folder / "fusion.cfg", ("\n".join(names) + "\n").encode())
    patch_match = "".join(f"{name}\n__auto__, {_SOURCES}\n" for name in names)
    write_bytes(folder / "patch-match.cfg", patch_match.encode())
