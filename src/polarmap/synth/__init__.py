"""An analytic polarization simulator: scenes of simple shapes, Fresnel's equations, a polarization sensor.

The forward model of what the rest of the package inverts, sharing none of its computations. `recording` writes
sequences as files and is imported by itself.
"""

from polarmap.synth.path import Arc, arc_path, handheld_path
from polarmap.synth.rendering import DEFAULT_CAMERA, SynthFrame, render_sequence
from polarmap.synth.scene import (
    Box,
    Cylinder,
    Material,
    Pattern,
    PointLight,
    Primitive,
    Prism,
    Rectangle,
    Revolved,
    Scene,
    Sphere,
    Texture,
)
from polarmap.synth.scenes import BuiltInScene, built_in_scene
from polarmap.synth.sensor import Sensor
from polarmap.synth.shading import Rendering, render

__all__ = [
    "DEFAULT_CAMERA",
    "Arc",
    "Box",
    "BuiltInScene",
    "Cylinder",
    "Material",
    "Pattern",
    "PointLight",
    "Primitive",
    "Prism",
    "Rectangle",
    "Rendering",
    "Revolved",
    "Scene",
    "Sensor",
    "Sphere",
    "SynthFrame",
    "Texture",
    "arc_path",
    "built_in_scene",
    "handheld_path",
    "render",
    "render_sequence",
]
