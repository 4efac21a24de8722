"""A keyframe as a piece of surface: triangles between its pixels, with colours, and its pictures."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polarmap.data.keyframe import Keyframe
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.sim3 import Sim3
from polarmap.io.run_folder.results import PictureRanges
from polarmap.report import pictures
from polarmap.report.keyframe_pictures import keyframe_pictures

COLOURS = ("grey", "normal", "sigma", "reflection", "age")
SHOWN = ("image", "depth", "normal", "dolp", "aolp")

_MOST_COLUMNS, _MOST_ROWS = 160, 120  # vertices of a patch
_LARGEST_STEP = 0.05  # of depth from one vertex to the next, as its share, beyond which the surface is cut
_LARGEST_SIGMA = 0.05


@dataclass(frozen=True, eq=False)
class Patch:
    """What a keyframe saw.

    vertices: float32 N×3 in the camera's frame. faces: int32 M×3, counterclockwise as the camera sees them.
    colours: uint8 N×3 for each of `COLOURS` but age. pictures: RGB uint8 by name, as many of `SHOWN` as there are.
    pose: T_world_camera; its scale is by how much the vertices have grown since.
    """

    index: int
    segment: int
    camera: PinholeCamera
    pose: Sim3
    vertices: np.ndarray
    faces: np.ndarray
    colours: dict[str, np.ndarray]
    pictures: dict[str, np.ndarray]

    def moved(self, pose: Sim3) -> Patch:
        """The same elsewhere."""
        return replace(self, pose=pose)


def patch_of(keyframe: Keyframe, ranges: PictureRanges) -> Patch:
    """A keyframe's patch. ranges: of colours, which all keyframes of a run share."""
    step = vertex_step(keyframe.camera)
    coarse = coarser(keyframe, max(1, step // 2))
    shown = {name: picture for name, picture in keyframe_pictures(coarse, ranges).items() if name in SHOWN}
    grey = pictures.grey(keyframe.image.intensity[::step, ::step], ranges.white)
    return make_patch(keyframe, keyframe.segment, step, grey, shown)


def make_patch(keyframe, segment: int, step: int, grey: np.ndarray, shown: dict[str, np.ndarray]) -> Patch:
    """A patch of a `Keyframe` or a `KeyframeResult`. grey: RGB uint8, of every `step`-th pixel."""
    T, z = keyframe.T_world_camera, keyframe.depth[::step, ::step]
    vertices, faces, kept = surface(z, keyframe.camera, step)
    in_world = keyframe.normal[::step, ::step] @ T[:3, :3].T.astype(np.float32)
    colours = {
        "grey": grey,
        "normal": pictures.normals(in_world),
        "sigma": pictures.error(keyframe.sigma[::step, ::step], _LARGEST_SIGMA),
        "reflection": pictures.labels(keyframe.label[::step, ::step]),
    }
    return Patch(
        index=keyframe.index,
        segment=segment,
        camera=keyframe.camera,
        pose=Sim3.from_matrix(T),
        vertices=vertices,
        faces=faces,
        colours={name: picture[kept] for name, picture in colours.items()},
        pictures=shown,
    )


def vertex_step(camera: PinholeCamera) -> int:
    """Pixels from one vertex of a patch to the next."""
    return max(1, -(-camera.width // _MOST_COLUMNS), -(-camera.height // _MOST_ROWS))


def surface(z: np.ndarray, camera: PinholeCamera, step: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Triangles between pixels whose depth, float32 rows×columns, is of every `step`-th pixel of the camera.

    Returns vertices float32 N×3 in the camera's frame, faces int32 M×3, and which pixels the vertices are, bool
    rows×columns. A triangle has known depths at its corners, with no step between any two.
    """
    rows, columns = z.shape
    numbers = np.arange(rows * columns, dtype=np.int32).reshape(rows, columns)
    a, b, c, d = numbers[:-1, :-1], numbers[:-1, 1:], numbers[1:, :-1], numbers[1:, 1:]
    triangles = np.concatenate([np.stack(t, axis=-1).reshape(-1, 3) for t in ((a, c, b), (b, c, d))])
    corners = z.ravel()[triangles]
    near, far = corners.min(axis=1), corners.max(axis=1)  # NaN is neither
    triangles = triangles[far - near < _LARGEST_STEP * near]
    kept = np.zeros(z.size, bool)
    kept[triangles] = True
    renumbered = np.cumsum(kept, dtype=np.int32) - 1
    v, u = np.divmod(np.flatnonzero(kept), columns)
    vertices = camera.unproject(step * np.stack([u, v], axis=1)) * z.ravel()[kept, None]
    return vertices.astype(np.float32), renumbered[triangles], kept.reshape(z.shape)


def coarser(keyframe: Keyframe, step: int) -> Keyframe:
    """Every `step`-th pixel of a keyframe, as pictures that are looked at need no more."""

    def part(values: np.ndarray) -> np.ndarray:
        return np.ascontiguousarray(values[::step, ::step])

    camera, image = keyframe.camera, keyframe.image
    depth = part(keyframe.depth)
    names = ("intensity", "dolp", "aolp", "sigma_dolp", "sigma_aolp", "saturated", "underexposed")
    (height, width), f = depth.shape, 1.0 / step
    fewer = PinholeCamera(width, height, camera.fx * f, camera.fy * f, camera.cx * f, camera.cy * f)
    return replace(
        keyframe,
        camera=fewer,
        image=replace(image, **{name: part(getattr(image, name)) for name in names}),
        depth=depth,
        **{name: part(getattr(keyframe, name)) for name in ("normal", "azimuth", "zenith", "label", "origin")},
        **{name: part(getattr(keyframe, name)) for name in ("sigma", "confidence")},
    )
