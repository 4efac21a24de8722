"""Scenes with known answers, and what a polarization camera sees of them, for several test files."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import lru_cache

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import SensorNoise
from polarmap.data.view import View
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import incidence_direction
from polarmap.sensing.stokes import polarization_image
from polarmap.synth import Material, Pattern, Rendering, Scene, Texture, render, scenes

WIDE = PinholeCamera(width=120, height=90, fx=90.0, fy=92.0, cx=59.5, cy=44.5)  # a 67° lens
EXACT = SensorNoise(full_well=1e9, read_noise=0.0)
TYPICAL = SensorNoise(full_well=10_000.0, read_noise=2.5)
TEXTURED = Material("textured", albedo=0.45, texture=Texture(Pattern.NOISE, 0.2, 0.9, octaves=3, seed=1), gloss=0.0)
MATERIALS = {"matte": scenes.MATTE, "glass": scenes.BLACK_GLASS, "plastic": scenes.PLASTIC, "textured": TEXTURED}
ROLLED = np.array([[0.0, -1.0, 0.0, 0.0], [1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
_ANGLES = np.radians([0.0, 45.0, 90.0, 135.0])[:, None, None]


@lru_cache
def view_of(shape: str, material: str = "matte", rolled: bool = False) -> Rendering:
    """A built-in single surface from the origin, by a camera that may be rolled by 90 degrees."""
    scene = getattr(scenes, shape)(MATERIALS[material])
    return render(scene, WIDE, ROLLED if rolled else np.eye(4))


def polarization_of(rendering: Rendering, noise: SensorNoise = EXACT, seed: int | None = None) -> PolarizationImage:
    """What four ideal polarizers see, exposed to 0.9 of the scale; with sensor noise where a seed is given."""
    s0, s1, s2 = rendering.stokes * (0.9 / rendering.stokes[0].max())
    channels = 0.5 * (s0 + s1 * np.cos(2 * _ANGLES) + s2 * np.sin(2 * _ANGLES))
    if seed is not None:
        sigma = np.sqrt(noise.variance(channels))
        channels = channels + sigma * np.random.default_rng(seed).standard_normal(channels.shape)
    return polarization_image(channels.astype(np.float32), noise)


def moved(x: float, y: float = 0.0, z: float = 0.0) -> np.ndarray:
    """T_world_camera of a camera that is only shifted."""
    T = np.eye(4)
    T[:3, 3] = x, y, z
    return T


def turned(rotation_vector: tuple[float, float, float], translation=(0.0, 0.0, 0.0)) -> np.ndarray:
    """A rigid motion from an axis times an angle in radians, by Rodrigues' formula."""
    angle = np.linalg.norm(rotation_vector)
    x, y, z = np.asarray(rotation_vector) / angle
    across = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    T = moved(*translation)
    T[:3, :3] = np.eye(3) + np.sin(angle) * across + (1 - np.cos(angle)) * across @ across
    return T


def stereo_views(
    scene: Scene, camera: PinholeCamera, poses, noise: SensorNoise | None = TYPICAL
) -> tuple[Rendering, list[View]]:
    """The rendering from the first pose, and grey images with sensor noise from all."""
    renderings = [render(scene, camera, T, supersample=2) for T in poses]
    exposure = 0.45 / max(r.stokes[0].max() for r in renderings)
    return renderings[0], [
        View(PolarizationImage.unpolarized(_grey(r.stokes[0] * exposure, noise, seed)), T)
        for seed, (r, T) in enumerate(zip(renderings, poses, strict=True))
    ]


def _grey(intensity: np.ndarray, noise: SensorNoise | None, seed: int) -> np.ndarray:
    if noise is None:
        return intensity
    sigma = 0.5 * np.sqrt(noise.variance(intensity))  # the mean of four pixels
    return intensity + (sigma * np.random.default_rng(seed).standard_normal(intensity.shape)).astype(np.float32)


def pixel_rays(camera: PinholeCamera) -> np.ndarray:
    """(x, y, 1) of every pixel, float64 H×W×3."""
    u, v = np.meshgrid(np.arange(camera.width), np.arange(camera.height))
    return np.stack([(u - camera.cx) / camera.fx, (v - camera.cy) / camera.fy, np.ones(camera.shape)], axis=-1)


def plane_depth(camera: PinholeCamera, normal, distance: float) -> np.ndarray:
    """z of the plane through (0, 0, distance), float64 H×W; `normal` need not be a unit vector."""
    return distance * normal[2] / (pixel_rays(camera) @ np.asarray(normal, float))


def sphere_depth(camera: PinholeCamera, centre=(0.2, -0.1, 2.0), radius: float = 0.6) -> np.ndarray:
    """z of a sphere's near side, float64 H×W, NaN beside it."""
    rays = pixel_rays(camera)
    squared, along = (rays**2).sum(-1), rays @ np.asarray(centre)
    discriminant = along**2 - squared * (np.dot(centre, centre) - radius**2)
    return (along - np.sqrt(np.where(discriminant > 0, discriminant, np.nan))) / squared


def log_range(depth: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """ln of the distance to the camera's centre, float64 H×W."""
    return np.log(depth * np.linalg.norm(pixel_rays(camera), axis=-1))


def gradient_of(depth: Callable[[PinholeCamera], np.ndarray], camera: PinholeCamera) -> np.ndarray:
    """∇ log range per pixel of a surface given by its z, float64 H×W×2: differences over a hundredth of a pixel."""
    step = 0.005
    shifts = ({"cx": camera.cx - step}, {"cx": camera.cx + step}, {"cy": camera.cy - step}, {"cy": camera.cy + step})
    right, left, down, up = (log_range(depth(c), c) for c in (replace(camera, **shift) for shift in shifts))
    return np.stack([right - left, down - up], axis=-1) / (2 * step)


def azimuth_of(normals: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Angle of the plane of incidence in the image, (-π, π]."""
    d = incidence_direction(normals, camera)
    return np.arctan2(d[..., 1], d[..., 0])


def turn_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between directions, radians in [0, π]."""
    return np.abs((a - b + np.pi) % (2 * np.pi) - np.pi)


def angle_between(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Between unit vectors, H×W degrees, accurate for small angles too."""
    return np.degrees(2 * np.arcsin(np.clip(0.5 * np.linalg.norm(a.astype(float) - b, axis=-1), 0.0, 1.0)))
