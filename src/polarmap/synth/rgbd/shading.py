"""Stokes vectors of an RGB-D frame: every pixel a piece of surface, its picture value the albedo.

A pixel whose depth lies on no plane is shaded as one that faces the camera, one without depth as one that faces the
light at the typical distance; neither is polarized.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.data.codes import Reflection
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import range_factor
from polarmap.jit import FAST_MATH, njit
from polarmap.synth.dielectric import fresnel_reflectances, fresnel_transmittances
from polarmap.synth.raycast import MATERIAL, advance, cross, dot, unit
from polarmap.synth.rgbd.models import BlinnPhong, Model
from polarmap.synth.rgbd.normals import plane_normals
from polarmap.synth.shading import Rendering, angle_about_ray, double_angle, highlight, seen_in_image

_FASTMATH = FAST_MATH - {"afn"}
_GRAZING = 1e-6  # least cosine, so that no ray lies within the surface


@dataclass(frozen=True)
class Shader:
    """Makes the Stokes vectors of frames of one camera.

    typical_distance: from the light to surfaces, metres, where the Fresnel model's light has its unit strength.
    gain: factor on all radiance. depth_step: that of stored depth, metres (see `plane_normals`).
    """

    camera: PinholeCamera
    model: Model
    typical_distance: float = 2.0
    gain: float = 1.0
    depth_step: float = 0.0

    def render(
        self, picture: np.ndarray, depth: np.ndarray, light: np.ndarray, normals: np.ndarray | None = None
    ) -> Rendering:
        """One noise-free frame.

        picture: float32 H×W in [0, 1]. depth: z, float32 H×W metres, NaN where none. light: position in the frame's
        camera frame, metres. normals: float32 H×W×3 (see `Rendering`), from depth where None.
        The rendering's material is 0 where there is depth. Raises InputError where a shape is not the camera's.
        """
        shape = self.camera.shape
        if picture.shape != shape or depth.shape != shape:
            raise InputError(f"RGB-D frame: picture {picture.shape} and depth {depth.shape} do not fit camera {shape}")
        if normals is None:
            normals = plane_normals(depth, self.camera, self.depth_step)
        rendering = Rendering(
            stokes=np.empty((3, *shape), np.float32),
            depth=depth,
            normal=normals,
            material=np.where(np.isfinite(depth), 0, -1).astype(np.int16),
            reflection=np.empty(shape, np.uint8),
        )
        self._shade(picture, rendering, np.asarray(light, np.float64))
        return rendering

    def light_distance(self, depth: np.ndarray, light: np.ndarray) -> float:
        """Median distance in metres from a light, in the frame's camera frame, to the surfaces; NaN without depth."""
        points = self.camera.rays() * (depth * range_factor(self.camera))[..., None]
        return float(np.nanmedian(np.linalg.norm(points - np.asarray(light), axis=-1)))

    def _shade(self, picture: np.ndarray, rendering: Rendering, light: np.ndarray) -> None:
        camera, model = self.camera, self.model
        intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
        frame = (picture, rendering.depth, rendering.normal, intrinsics, light)
        outputs = (self.gain, rendering.stokes, rendering.reflection)
        if isinstance(model, BlinnPhong):
            _blinn_phong(*frame, (model.ambient, model.specular, model.shininess, model.eta), *outputs)
        else:
            material = np.zeros(1, MATERIAL)
            material["eta"], material["gloss"], material["shininess"] = model.eta, model.gloss, model.shininess
            _fresnel(*frame, material, model.surround, self.typical_distance, *outputs)


@njit(parallel=True)
def _blinn_phong(picture, depth, normals, intrinsics, light, model, gain, stokes, reflection):
    height, width = picture.shape
    for v in prange(height):
        for u in range(width):
            ray, albedo, z = _ray(u, v, intrinsics), picture[v, u], depth[v, u]
            n, known = _normal(normals, u, v, ray)
            s, kind = (albedo, 0.0, 0.0), Reflection.NONE
            if z == z:
                s, kind = _blinn_phong_stokes(albedo, z, n, ray, light, model)
            stokes[0, v, u], stokes[1, v, u], stokes[2, v, u] = gain * s[0], gain * s[1], gain * s[2]
            reflection[v, u] = kind if known else Reflection.NONE


@njit(parallel=True)
def _fresnel(
    picture, depth, normals, intrinsics, light, material, surround, distance, gain, stokes, reflection
):  # fmt: skip
    height, width = picture.shape
    for v in prange(height):
        for u in range(width):
            ray, albedo, z = _ray(u, v, intrinsics), picture[v, u], depth[v, u]
            n, known = _normal(normals, u, v, ray)
            s, kind = (albedo * (surround + 1.0), 0.0, 0.0), Reflection.NONE
            if z == z:
                s, kind = _fresnel_stokes(albedo, z, n, ray, light, material[0], surround, distance)
            stokes[0, v, u], stokes[1, v, u], stokes[2, v, u] = gain * s[0], gain * s[1], gain * s[2]
            reflection[v, u] = kind if known else Reflection.NONE


@njit
def _normal(normals, u, v, ray):
    """The pixel's normal and that it is known, or one that faces the camera, which polarizes nothing."""
    n = (normals[v, u, 0], normals[v, u, 1], normals[v, u, 2])
    if n[2] == n[2]:
        return (float(n[0]), float(n[1]), float(n[2])), True
    d = unit(ray)
    return (-d[0], -d[1], -d[2]), False


@njit
def _ray(u, v, intrinsics):
    fx, fy, cx, cy = intrinsics
    return (u - cx) / fx, (v - cy) / fy, 1.0


@njit(error_model="numpy", fastmath=_FASTMATH)
def _blinn_phong_stokes(albedo, z, n, ray, light, model):
    """(S0, S1, S2) and the dominant reflection of one pixel, by the paper's equations (5) and (6)."""
    ambient, strength, shininess, eta = model
    d = unit(ray)
    to_light = unit((light[0] - z * ray[0], light[1] - z * ray[1], light[2] - z * ray[2]))
    facing = max(dot(n, to_light), 0.0)
    diffuse = albedo * (ambient + (1.0 - ambient) * facing)
    specular = 0.0
    if facing > 0.0:
        specular = strength * max(dot(n, unit(advance(to_light, -1.0, d))), 0.0) ** shininess
    cos_theta = max(-dot(n, d), _GRAZING)
    if diffuse >= specular:
        t_s, t_p = fresnel_transmittances(cos_theta, eta)
        dolp, e, kind = (t_p - t_s) / (t_p + t_s), n, Reflection.DIFFUSE
    else:
        r_s, r_p = fresnel_reflectances(cos_theta, eta)
        dolp, e, kind = (r_s - r_p) / (r_s + r_p), cross(ray, n), Reflection.SPECULAR
    cos2, sin2 = double_angle(e, ray)
    s0 = diffuse + specular
    return (s0, s0 * dolp * cos2, s0 * dolp * sin2), kind


@njit(error_model="numpy", fastmath=_FASTMATH)
def _fresnel_stokes(albedo, z, n, ray, light, material, surround, distance):
    """(S0, S1, S2) and the reflection that decides the direction of polarization, of one pixel."""
    d = unit(ray)
    to_light = (light[0] - z * ray[0], light[1] - z * ray[1], light[2] - z * ray[2])
    falloff = 2.0 * distance**2 / (dot(to_light, to_light) + distance**2)
    to_light = unit(to_light)
    irradiance = math.pi * falloff * max(dot(n, to_light), 0.0)
    cos_theta = max(-dot(n, d), _GRAZING)
    t_s, t_p = fresnel_transmittances(cos_theta, material.eta)
    r_s, r_p = fresnel_reflectances(cos_theta, material.eta)
    body, mirrored = albedo * (surround + irradiance / math.pi), material.gloss * surround
    along = 0.5 * (body * (t_p - t_s) - mirrored * (r_s - r_p))  # the plane of incidence; negative: across it
    cos2, sin2 = angle_about_ray(n, ray)
    h0, h1, h2 = highlight(material, irradiance, to_light, n, ray)
    s1, s2 = seen_in_image(along * cos2 + h1, along * sin2 + h2, ray)
    within_cos2, within_sin2 = double_angle(n, ray)
    kind = Reflection.DIFFUSE if s1 * within_cos2 + s2 * within_sin2 >= 0.0 else Reflection.SPECULAR
    return (0.5 * (body * (t_s + t_p) + mirrored * (r_s + r_p)) + h0, s1, s2), kind
