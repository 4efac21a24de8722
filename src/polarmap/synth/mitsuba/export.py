"""Analytic scenes as Mitsuba scene files.

What the two renderers share: shapes, Fresnel's equations, diffuse light polarized by transmission (Mitsuba's
pplastic, Baek et al. 2018), metals by their complex index. What differs: Mitsuba's surround (a constant emitter) is
hidden by what stands before it, light is reflected many times, lobes have a width, and light enters the body through
the surface too, for which albedos are divided by the mean transmittance so that bodies under the surround are equally
bright. Textures count by their mean.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import write_bytes
from polarmap.io.formats.ply import write_ply
from polarmap.synth.dielectric import fresnel_reflectances
from polarmap.synth.meshes import shape_mesh
from polarmap.synth.mitsuba.view import TO_MITSUBA
from polarmap.synth.scene import Box, Cylinder, Material, Primitive, Prism, Rectangle, Revolved, Scene, Sphere

_ROUGHNESS = 0.001
_LARGEST = 1e3  # metres; half the side of an infinite plane


def write_mitsuba_scene(path: Path, scene: Scene, camera: PinholeCamera, T_world_camera: np.ndarray) -> None:
    """Write a scene, seen by `camera` from a pose, as a Mitsuba 3 scene file, with meshes in PATH's folder.

    Curved shapes that Mitsuba lacks become PLY files beside it, named after it. Files of the same names are replaced.
    Raises PolarmapError where a file cannot be written.
    """
    path = Path(path)
    root = ElementTree.Element("scene", version="3.0.0")
    _add_sensor(root, camera, np.asarray(T_world_camera, float))
    for i, material in enumerate(scene.materials):
        _add_material(root, f"material{i}", material)
    for i, primitive in enumerate(scene.primitives):
        _add_shape(root, path, i, primitive, f"material{scene.materials.index(primitive.material)}")
    for light in scene.lights:
        emitter = ElementTree.SubElement(root, "emitter", type="point")
        x, y, z = light.position
        ElementTree.SubElement(emitter, "point", name="position", x=repr(float(x)), y=repr(float(y)), z=repr(float(z)))
        _add(emitter, "spectrum", "intensity", float(light.intensity))
    _add(ElementTree.SubElement(root, "emitter", type="constant"), "spectrum", "radiance", float(scene.surround))
    ElementTree.indent(root)
    write_bytes(path, ElementTree.tostring(root, "utf-8"))


def mean_transmittance(eta: float) -> float:
    """Share of uniform unpolarized light that enters a dielectric: ∫ (1 - R(θ)) 2 sinθ cosθ dθ."""
    squared_sine = (np.arange(2000) + 0.5) / 2000
    r_s, r_p = fresnel_reflectances(np.sqrt(1.0 - squared_sine), eta)
    return float(1.0 - 0.5 * np.mean(r_s + r_p))


def _add_sensor(root: ElementTree.Element, camera: PinholeCamera, T_world_camera: np.ndarray) -> None:
    sensor = ElementTree.SubElement(root, "sensor", type="perspective")
    _add(sensor, "float", "fov", float(2.0 * np.degrees(np.arctan(0.5 * camera.width / camera.fx))))
    _add(sensor, "string", "fov_axis", "x")
    _add_transform(sensor, T_world_camera @ TO_MITSUBA)
    film = ElementTree.SubElement(sensor, "film", type="hdrfilm")
    _add(film, "integer", "width", camera.width)
    _add(film, "integer", "height", camera.height)


def _add_material(root: ElementTree.Element, name: str, material: Material) -> None:
    outer = ElementTree.SubElement(root, "bsdf", type="twosided", id=name)
    if material.is_metal:
        _add_metal(outer, material)
        return
    bsdf = ElementTree.SubElement(outer, "bsdf", type="pplastic")
    _add(bsdf, "spectrum", "diffuse_reflectance", min(1.0, material.albedo / mean_transmittance(material.eta)))
    _add(bsdf, "spectrum", "specular_reflectance", float(material.gloss))
    _add(bsdf, "float", "int_ior", float(material.eta))
    _add(bsdf, "float", "ext_ior", 1.0)
    _add(bsdf, "float", "alpha", _ROUGHNESS)


def _add_metal(parent: ElementTree.Element, material: Material) -> None:
    bsdf = ElementTree.SubElement(parent, "bsdf", type="roughconductor")
    _add(bsdf, "spectrum", "eta", float(material.eta))
    _add(bsdf, "spectrum", "k", float(material.absorption))
    _add(bsdf, "spectrum", "specular_reflectance", float(material.gloss))
    _add(bsdf, "float", "alpha", _ROUGHNESS)


def _add_shape(root: ElementTree.Element, path: Path, index: int, primitive: Primitive, material: str) -> None:
    if isinstance(primitive, Revolved | Prism):
        file = path.with_name(f"{path.stem}_{index:03d}.ply")
        mesh = shape_mesh(primitive)
        write_ply(file, mesh.vertices, faces=mesh.faces, normals=mesh.normals)
        shape = _shape(root, "ply", primitive.T_world_object, material)
        _add(shape, "string", "filename", file.name)
        return
    half = np.minimum(primitive.half_size, _LARGEST)
    scale = np.diag([*half, 1.0])
    if isinstance(primitive, Sphere):
        _add(_shape(root, "sphere", primitive.T_world_object, material), "float", "radius", float(primitive.radius))
    elif isinstance(primitive, Box):
        _shape(root, "cube", primitive.T_world_object @ scale, material)
    elif isinstance(primitive, Rectangle):
        _shape(root, "rectangle", primitive.T_world_object @ scale, material)
    elif isinstance(primitive, Cylinder):
        _add_cylinder(root, primitive, scale, material)


def _add_cylinder(root: ElementTree.Element, cylinder: Cylinder, scale: np.ndarray, material: str) -> None:
    """Its side, and its ends, which Mitsuba's has not."""
    lower, upper = np.eye(4), np.eye(4)
    lower[2, 3], upper[2, 3] = -1.0, 1.0
    side = np.diag([1.0, 1.0, 2.0, 1.0])  # Mitsuba's goes from z = 0 to 1
    side[2, 3] = -1.0
    for kind, place in (("cylinder", side), ("disk", lower), ("disk", upper)):
        _shape(root, kind, cylinder.T_world_object @ scale @ place, material)


def _shape(root: ElementTree.Element, kind: str, to_world: np.ndarray, material: str) -> ElementTree.Element:
    shape = ElementTree.SubElement(root, "shape", type=kind)
    _add_transform(shape, to_world)
    ElementTree.SubElement(shape, "ref", id=material, name="bsdf")
    return shape


def _add_transform(parent: ElementTree.Element, matrix: np.ndarray) -> None:
    transform = ElementTree.SubElement(parent, "transform", name="to_world")
    ElementTree.SubElement(transform, "matrix", value=" ".join(repr(float(v)) for v in matrix.ravel()))


def _add(parent: ElementTree.Element, kind: str, name: str, value: object) -> None:
    ElementTree.SubElement(parent, kind, name=name, value=str(value))
