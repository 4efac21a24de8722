"""Stokes vectors of a synthetic scene: diffuse and specular reflection, both polarized, and added.

The plane of incidence is spanned by the viewing ray and the normal n. Light that left the body of the material is
polarized along it (Fresnel's transmittances), light mirrored by the surface across it (Fresnel's reflectances; those of
a metal have a complex index, and nothing leaves its body). All is added in a frame about the ray; the angle of the sum
then goes to the image plane: a polarizer pixel sees a field direction e along e_xy - e_z·(x, y) in normalized
coordinates. Directions perpendicular in space are so in the image only on the optical axis. The incoming light is
unpolarized, also after a bounce.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numba import prange

from polarmap.data.codes import Reflection
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import FAST_MATH, njit
from polarmap.synth.conductor import conductor_reflectances
from polarmap.synth.dielectric import fresnel_reflectances, fresnel_transmittances
from polarmap.synth.raycast import advance, closest_hit, dot, facing, is_blocked, normal_at, pack, to_object, unit
from polarmap.synth.scene import Pattern, Scene
from polarmap.synth.textures import image_modulation, modulation

_FASTMATH = FAST_MATH - {"afn"}
_ORIGIN = (0.0, 0.0, 0.0)
_NOWHERE = (math.nan, math.nan, math.nan)
_INTERLEAVE = 16
_GRAZING = 1e-6  # least cosine, so that no ray lies within the surface


@dataclass(frozen=True)
class Rendering:
    """One noise-free view of a scene with its truth; geometry is that of the pixels' centres.

    stokes: S0, S1, S2 as radiance, float32 3×H×W, AoLP from image +x toward +y.
    depth: z in metres, float32 H×W, NaN where nothing is hit.
    normal: unit, camera frame, towards the camera, float32 H×W×3, NaN where nothing is hit.
    material: index into `Scene.materials`, int16 H×W, -1 where nothing is hit.
    reflection: `Reflection`, uint8 H×W: which part of the light decides the direction of polarization, SPECULAR for a
        metal too; NONE where nothing is hit.
    """

    stokes: np.ndarray
    depth: np.ndarray
    normal: np.ndarray
    material: np.ndarray
    reflection: np.ndarray


def render(scene: Scene, camera: PinholeCamera, T_world_camera: np.ndarray, supersample: int = 1) -> Rendering:
    """The scene from a pose, its Stokes vectors averaged over supersample×supersample rays a pixel.

    Raises InputError where `supersample` is under 1.
    """
    if supersample < 1:
        raise InputError(f"render: supersample must be 1 or more, not {supersample}")
    height, width = camera.shape
    rendering = Rendering(
        stokes=np.empty((3, height, width), np.float32),
        depth=np.empty((height, width), np.float32),
        normal=np.empty((height, width, 3), np.float32),
        material=np.empty((height, width), np.int16),
        reflection=np.empty((height, width), np.uint8),
    )
    intrinsics = (camera.fx, camera.fy, camera.cx, camera.cy)
    packed = pack(scene, np.asarray(T_world_camera, np.float64))
    rows = np.argsort(np.arange(height) % _INTERLEAVE, kind="stable")  # so that all threads get cheap and dear ones
    _render(packed, intrinsics, rows, rendering.depth, rendering.normal, rendering.material, rendering.reflection,
            rendering.stokes, supersample)  # fmt: skip
    return rendering


@njit(parallel=True)
def _render(scene, intrinsics, rows, depth, normal, material, reflection, stokes, supersample):
    for i in prange(depth.shape[0]):
        _render_row(scene, intrinsics, rows[i], depth, normal, material, reflection, stokes, supersample)


@njit(error_model="numpy", fastmath=_FASTMATH)
def _render_row(scene, intrinsics, v, depth, normal, material, reflection, stokes, supersample):
    fx, fy, cx, cy = intrinsics
    for u in range(depth.shape[1]):
        ray = ((u - cx) / fx, (v - cy) / fy, 1.0)
        index, t, n = _first_surface(scene, ray)
        if supersample > 1:
            s = _average_stokes(scene, u, v, intrinsics, supersample)
        else:
            s = _stokes_towards_camera(scene, index, t, n, ray)
        depth[v, u] = t if index >= 0 else np.nan
        material[v, u] = scene.primitives[index].material if index >= 0 else -1
        normal[v, u, 0], normal[v, u, 1], normal[v, u, 2] = n
        reflection[v, u] = _dominant_reflection(n, ray, s) if index >= 0 else Reflection.NONE
        stokes[0, v, u], stokes[1, v, u], stokes[2, v, u] = s


@njit
def _dominant_reflection(n, ray, s):
    cos2, sin2 = double_angle(n, ray)
    return Reflection.DIFFUSE if s[1] * cos2 + s[2] * sin2 >= 0.0 else Reflection.SPECULAR


@njit(error_model="numpy", fastmath=_FASTMATH)
def _average_stokes(scene, u, v, intrinsics, supersample):
    fx, fy, cx, cy = intrinsics
    s0, s1, s2 = 0.0, 0.0, 0.0
    for j in range(supersample):
        y = (v + (j + 0.5) / supersample - 0.5 - cy) / fy
        for i in range(supersample):
            ray = ((u + (i + 0.5) / supersample - 0.5 - cx) / fx, y, 1.0)
            index, t, n = _first_surface(scene, ray)
            s = _stokes_towards_camera(scene, index, t, n, ray)
            s0, s1, s2 = s0 + s[0], s1 + s[1], s2 + s[2]
    share = 1.0 / supersample**2
    return s0 * share, s1 * share, s2 * share


@njit
def _first_surface(scene, ray):
    """(primitive's index or -1, t, normal) on a ray from the camera's centre whose z is 1, so that t is depth."""
    index, t = closest_hit(scene, _ORIGIN, ray, math.inf)
    if index < 0:
        return index, t, _NOWHERE
    return index, t, facing(normal_at(scene.primitives[index], advance(_ORIGIN, t, ray)), ray)


@njit(error_model="numpy", fastmath=_FASTMATH)
def _stokes_towards_camera(scene, index, t, n, ray):
    """(S0, S1, S2) of the light that arrives against `ray` from what `_first_surface` gave."""
    if index < 0:
        return scene.surround, 0.0, 0.0
    primitive = scene.primitives[index]
    point = advance(_ORIGIN, t, ray)
    material = scene.materials[primitive.material]
    d = unit(ray)
    cos_theta = max(-dot(n, d), _GRAZING)
    r_s, r_p = _reflectances(cos_theta, material)
    t_s, t_p = (0.0, 0.0) if material.absorption > 0.0 else fresnel_transmittances(cos_theta, material.eta)

    irradiance, h0, h1, h2 = 0.0, 0.0, 0.0, 0.0
    for i in range(scene.lights.size):
        received, to_light = _irradiance(scene, i, point, n)
        glint = highlight(material, received, to_light, n, ray)
        irradiance, h0, h1, h2 = irradiance + received, h0 + glint[0], h1 + glint[1], h2 + glint[2]
    body = _albedo(scene, primitive, material, point) * (scene.surround + irradiance / math.pi)
    mirrored = _mirrored_radiance(scene, material, point, n, d)
    along = 0.5 * (body * (t_p - t_s) - mirrored * (r_s - r_p))  # the plane of incidence; negative: across it
    cos2, sin2 = angle_about_ray(n, ray)
    s1, s2 = seen_in_image(along * cos2 + h1, along * sin2 + h2, ray)
    return 0.5 * (body * (t_s + t_p) + mirrored * (r_s + r_p)) + h0, s1, s2


@njit(error_model="numpy")
def _reflectances(cos_theta, material):
    if material.absorption > 0.0:
        return conductor_reflectances(cos_theta, material.eta, material.absorption)
    return fresnel_reflectances(cos_theta, material.eta)


@njit(error_model="numpy")
def angle_about_ray(e, ray):
    """(cos 2ψ, sin 2ψ) of a field direction about the ray (x, y, 1), ψ from the level direction (1, 0, -x) downward.

    Whatever e has along the ray drops out, so the normal stands for the field in the plane of incidence; (1, 0) where
    nothing is left.
    """
    x, y, _ = ray
    a = (e[0] - x * e[2]) * math.sqrt(1.0 + x * x + y * y)
    b = (1.0 + x * x) * e[1] - y * (x * e[0] + e[2])
    squared = a * a + b * b
    if squared < 1e-20:
        return 1.0, 0.0
    return (a * a - b * b) / squared, 2.0 * a * b / squared


@njit(error_model="numpy")
def seen_in_image(s1, s2, ray):
    """(S1, S2) of the image plane from those about the ray: the angle is projected, the degree kept."""
    x, y, _ = ray
    polarized = math.hypot(s1, s2)
    if polarized == 0.0:
        return 0.0, 0.0
    cosine2, sine2, both = 0.5 * (1.0 + s1 / polarized), 0.5 * (1.0 - s1 / polarized), 0.5 * s2 / polarized
    level, lower, length = 1.0 + x * x, x * y, math.sqrt(1.0 + x * x + y * y)
    # The field direction cos ψ (level, lower) + sin ψ (0, length), as products of two components.
    xx = level * level * cosine2
    xy = level * (lower * cosine2 + length * both)
    yy = lower * lower * cosine2 + 2.0 * lower * length * both + length * length * sine2
    scale = polarized / (xx + yy)
    return scale * (xx - yy), scale * 2.0 * xy


@njit(error_model="numpy")
def double_angle(e, ray):
    """(cos 2φ, sin 2φ) of a field direction in the image, e_xy - e_z·(x, y); (1, 0) where that vanishes.

    Whatever e has along the ray (x, y, 1) drops out, so the normal stands for the field in the plane of incidence.
    """
    dx, dy = e[0] - e[2] * ray[0], e[1] - e[2] * ray[1]
    squared = dx * dx + dy * dy
    if squared < 1e-20:
        return 1.0, 0.0
    return (dx * dx - dy * dy) / squared, 2.0 * dx * dy / squared


@njit(error_model="numpy")
def _albedo(scene, primitive, material, point):
    if material.pattern == 0:
        return material.albedo
    local = to_object(primitive, point)
    if material.pattern == Pattern.IMAGE:
        m = image_modulation(scene.images[material.image], material.size, local)
    else:
        m = modulation(material.pattern, material.size, material.octaves, material.seed, local)
    return min(1.0, material.albedo * (1.0 + material.contrast * m))


@njit(error_model="numpy", fastmath=_FASTMATH)
def _irradiance(scene, which, point, n):
    """Irradiance by one of the point lights, 0 in its shadow, and the unit direction towards it."""
    light = scene.lights[which]
    to_light = advance(light.position, -1.0, point)
    squared = dot(to_light, to_light)
    direction = unit(to_light)
    cosine = dot(n, direction)
    if light.intensity == 0.0 or cosine <= 0.0:
        return 0.0, direction
    if light.shadows and is_blocked(scene, point, direction, math.sqrt(squared)):
        return 0.0, direction
    return light.intensity * cosine / squared, direction


@njit(error_model="numpy", fastmath=_FASTMATH)
def _mirrored_radiance(scene, material, point, n, d):
    """What the surface mirrors towards the viewer, before Fresnel's reflectances.

    One bounce; where it ends textures count by their mean, as in the blurred reflection of a surface that is not quite
    smooth, and a metal by what it would reflect if it faced the viewer.
    """
    if material.gloss == 0.0:
        return 0.0
    mirror = advance(d, -2.0 * dot(n, d), n)
    index, t = closest_hit(scene, point, mirror, math.inf)
    if index < 0:
        return material.gloss * scene.surround
    primitive = scene.primitives[index]
    end = advance(point, t, mirror)
    met = scene.materials[primitive.material]
    if met.absorption > 0.0:
        return material.gloss * met.gloss * conductor_reflectances(1.0, met.eta, met.absorption)[0] * scene.surround
    normal = facing(normal_at(primitive, end), mirror)
    irradiance = 0.0
    for i in range(scene.lights.size):
        received, _ = _irradiance(scene, i, end, normal)
        irradiance += received
    return material.gloss * met.albedo * (scene.surround + irradiance / math.pi)


@njit(error_model="numpy", fastmath=_FASTMATH)
def highlight(material, irradiance, to_light, n, ray):
    """(S0, S1, S2), about the ray, of the point light's highlight.

    It is Blinn-Phong's lobe (m+8)/(8π)·(n·h)^m, each facet a mirror.
    The facets that send light to the viewer have the half vector h as normal, which is thus what polarizes.
    """
    if material.shininess == 0.0 or irradiance == 0.0:
        return 0.0, 0.0, 0.0
    d = unit(ray)
    h = unit(advance(to_light, -1.0, d))
    lobe = (material.shininess + 8.0) / (8.0 * math.pi) * dot(n, h) ** material.shininess
    r_s, r_p = _reflectances(max(-dot(h, d), _GRAZING), material)
    radiance = material.gloss * lobe * irradiance
    cos2, sin2 = angle_about_ray(h, ray)
    across = 0.5 * radiance * (r_s - r_p)
    return 0.5 * radiance * (r_s + r_p), -across * cos2, -across * sin2
