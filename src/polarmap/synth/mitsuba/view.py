"""Views of a Mitsuba scene: Stokes vectors by its `stokes` integrator, geometry by rays through the pixels' centres."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from types import ModuleType
from typing import Any

import numpy as np

from polarmap.data.codes import Reflection
from polarmap.errors import InputError, PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import look_at
from polarmap.io.files import MAX_TEXT_BYTES, open_input
from polarmap.synth.mitsuba.stokes_basis import to_image_plane
from polarmap.synth.mitsuba.variant import import_mitsuba
from polarmap.synth.shading import Rendering

TO_MITSUBA = np.diag([-1.0, -1.0, 1.0, 1.0])
"""T_camera_sensor: Mitsuba's sensor has x to the left and y upward."""

_LUMINANCE = np.array([0.2126, 0.7152, 0.0722])  # of linear sRGB
_SAMPLES_AT_ONCE = 2**21  # of a vectorizing variant, which keeps them all in memory
_NEAR, _FAR = 1e-3, 1e4  # clipping planes, metres


@dataclass(frozen=True, eq=False)
class MitsubaScene:
    """A loaded scene with what its own sensor says.

    fov: horizontal field of view in degrees, None where the sensor has none. width, height: of its film, pixels.
    T_world_camera: where it stands, OpenCV axes. vertical: what the `stokes` integrator takes for upward, world frame.
    """

    mi: ModuleType
    scene: Any
    fov: float | None
    width: int
    height: int
    T_world_camera: np.ndarray
    vertical: np.ndarray


def load_scene(path: Path, variant: str | None = None) -> MitsubaScene:
    """Read a Mitsuba scene file (XML); `variant` as in `import_mitsuba`.

    Raises InputError where the file is none or holds no sensor, PolarmapError where Mitsuba is not installed.
    """
    path = Path(path)
    mi = import_mitsuba(variant)
    with open_input(path, MAX_TEXT_BYTES):
        pass  # Mitsuba opens it by its name
    try:
        scene = mi.load_file(str(path))
    except Exception as error:
        raise InputError(f"{path}: Mitsuba does not load it: {_last_line(error)}") from None
    if not scene.sensors():
        raise InputError(f"{path}: the scene has no sensor; add one to say where to look from")
    sensor = scene.sensors()[0]
    parameters = mi.traverse(sensor)
    to_world = _matrix(parameters["to_world"] if "to_world" in parameters else sensor.world_transform())
    width, height = (int(side) for side in np.ravel(sensor.film().size()))
    fov = float(np.ravel(parameters["x_fov"])[0]) if "x_fov" in parameters else None
    eye, forward, vertical = to_world[:3, 3], to_world[:3, 2], to_world[:3, 1]
    return MitsubaScene(mi, scene, fov, width, height, look_at(eye, eye + forward, vertical), vertical)


def render_stokes(
    loaded: MitsubaScene, camera: PinholeCamera, T_world_camera: np.ndarray, spp: int, max_depth: int, seed: int
) -> np.ndarray:
    """S0, S1, S2 as radiance, float32 3×H×W, AoLP from image +x toward +y, from `spp` paths a pixel.

    camera: with square pixels and the principal point in the middle. max_depth: of a path, in segments.
    Raises PolarmapError where Mitsuba fails.
    """
    mi = loaded.mi
    integrator = mi.load_dict({"type": "stokes", "nested": {"type": "path", "max_depth": max_depth}})
    sensor = _sensor(mi, camera, T_world_camera)
    passes = _passes(mi, camera, spp)
    total = np.zeros((camera.height, camera.width, 4, 3))
    for i, samples in enumerate(passes):
        try:
            image = mi.render(loaded.scene, sensor=sensor, integrator=integrator, spp=samples, seed=seed + i)
            total += samples / spp * np.array(image)[..., -12:].reshape(total.shape)
        except Exception as error:
            raise PolarmapError(f"Mitsuba cannot render the scene: {_last_line(error)}") from None
    stokes = np.moveaxis(total @ _LUMINANCE, -1, 0)[:3]
    vertical = np.asarray(T_world_camera)[:3, :3].T @ loaded.vertical
    return to_image_plane(stokes, camera.rays(), vertical).astype(np.float32)


def geometry(loaded: MitsubaScene, camera: PinholeCamera, T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Depth z, metres, float32 H×W, and unit normals, camera frame, towards it, float32 H×W×3; NaN where none."""
    T_world_camera = np.asarray(T_world_camera, float)
    rays = camera.rays().reshape(-1, 3).astype(float)
    distance, normal = _first_hits(loaded, T_world_camera[:3, 3], rays @ T_world_camera[:3, :3].T)
    normal = normal @ T_world_camera[:3, :3]
    normal *= np.where((normal * rays).sum(axis=1) > 0.0, -1.0, 1.0)[:, None]
    missed = ~np.isfinite(distance)
    depth = np.where(missed, np.nan, distance * rays[:, 2])
    normal[missed] = np.nan
    shape = camera.shape
    return depth.reshape(shape).astype(np.float32), normal.reshape(*shape, 3).astype(np.float32)


def rendering(stokes: np.ndarray, depth: np.ndarray, normal: np.ndarray, camera: PinholeCamera) -> Rendering:
    """These as a `Rendering`, with the reflection that decides the angle; materials are all 0."""
    xy = camera.normalized()
    dx, dy = normal[..., 0] - normal[..., 2] * xy[..., 0], normal[..., 1] - normal[..., 2] * xy[..., 1]
    along = stokes[1] * (dx * dx - dy * dy) + stokes[2] * 2.0 * dx * dy
    hit = np.isfinite(depth)
    reflection = np.where(along >= 0.0, Reflection.DIFFUSE, Reflection.SPECULAR)
    return Rendering(
        stokes=stokes,
        depth=depth,
        normal=normal,
        material=np.where(hit, 0, -1).astype(np.int16),
        reflection=np.where(hit, reflection, Reflection.NONE).astype(np.uint8),
    )


def centre_distance(loaded: MitsubaScene) -> float | None:
    """Metres from the scene's own sensor to what it looks at, None where it looks at nothing."""
    T = loaded.T_world_camera
    distance, _ = _first_hits(loaded, T[:3, 3], T[None, :3, 2])
    return float(distance[0]) if np.isfinite(distance[0]) else None


def _first_hits(loaded: MitsubaScene, origin: np.ndarray, directions: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Distance (N, infinite for none) and shading normal (N×3) along unit world directions, N×3."""
    mi = loaded.mi
    if mi.variant().startswith("scalar"):
        hits = (_scalar_hit(loaded, origin, direction) for direction in directions)
        rows = np.array([(hit.t, *(hit.sh_frame.n if hit.is_valid() else (0.0, 0.0, 0.0))) for hit in hits], float)
        return rows[:, 0], rows[:, 1:]
    ray = mi.Ray3f(mi.Point3f(*map(float, origin)), mi.Vector3f(*np.ascontiguousarray(directions.T, np.float32)))
    hit = loaded.scene.ray_intersect(ray)
    return np.array(hit.t, float), np.array(hit.sh_frame.n, float).T


def _scalar_hit(loaded: MitsubaScene, origin: np.ndarray, direction: np.ndarray):
    return loaded.scene.ray_intersect(loaded.mi.Ray3f(list(map(float, origin)), list(map(float, direction))))


def _sensor(mi: ModuleType, camera: PinholeCamera, T_world_camera: np.ndarray):
    fov = 2.0 * np.degrees(np.arctan(0.5 * camera.width / camera.fx))
    film = {
        "type": "hdrfilm",
        "width": camera.width,
        "height": camera.height,
        "pixel_format": "luminance",
        "component_format": "float32",
        "rfilter": {"type": "box"},
    }
    return mi.load_dict(
        {
            "type": "perspective",
            "fov": float(fov),
            "fov_axis": "x",
            "near_clip": _NEAR,
            "far_clip": _FAR,
            "to_world": mi.ScalarTransform4f((np.asarray(T_world_camera) @ TO_MITSUBA).tolist()),
            "film": film,
            "sampler": {"type": "independent"},
        }
    )


def _passes(mi: ModuleType, camera: PinholeCamera, spp: int) -> list[int]:
    """`spp` split so that each part fits in memory."""
    if mi.variant().startswith("scalar"):
        return [spp]
    most = max(1, _SAMPLES_AT_ONCE // (camera.width * camera.height))
    return [most] * (spp // most) + ([spp % most] if spp % most else [])


def _matrix(transform) -> np.ndarray:
    return np.array(transform.matrix, float).reshape(4, 4)


def _last_line(error: Exception) -> str:
    return str(error).strip().splitlines()[-1] if str(error).strip() else type(error).__name__
