"""Metal spheres and cylinders among plastic ones on a table. World z is up; the table stands over the origin."""

from __future__ import annotations

from polarmap.polarization.metals import ALUMINIUM, CHROMIUM, COPPER, GOLD, IRON, STEEL
from polarmap.synth.path import Loop
from polarmap.synth.scene import Cylinder, Material, PointLight, Primitive, Rectangle, Scene, Sphere
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.objects import rounded_box
from polarmap.synth.scenes.placement import Point, noise, pose

_TOP = 0.74  # metres, the table's height
_PANELS = 8  # around the table; what is mirrored varies from one to the next


def built_in_metals() -> BuiltInScene:
    """The table, seen by someone who leans over it, in a room of light and dark panels."""
    lamps = (PointLight((-0.6, -0.5, 2.2), 4.0), PointLight((1.4, -1.5, 2.3), 3.0))
    return BuiltInScene(
        Scene((*_surroundings(), *_table(), *_metals(), *_plastics()), lamps, surround=1.2),
        eye=(0.05, -1.05, 1.3),
        target=(0.0, 0.05, 0.8),
        loop=Loop(sideways=0.45, forward=0.1, first_angle=0.1, sway=0.012, gaze_drift=0.03, follow=0.25),
        step=0.02,
    )


def _surroundings() -> tuple[Primitive, ...]:
    ceiling = Material("ceiling", albedo=0.75, gloss=0.2)
    floor = Material("floor", albedo=0.25, texture=noise(0.3, seed=51), gloss=0.2)
    return (
        Rectangle(floor, pose((0.0, 0.0, 0.0)), width=6.0, height=6.0),
        Rectangle(ceiling, pose((0.0, 0.0, 2.6), (0.0, 0.0, -1.0)), width=6.0, height=6.0),
        *(panel for wall in range(4) for panel in _wall(wall)),
    )


def _wall(side: int) -> tuple[Primitive, ...]:
    """Upright panels, light and dark by turns, on one of the four walls."""
    dark = Material("dark panel", albedo=0.12, texture=noise(0.2, seed=52), gloss=0.2)
    light = Material("light panel", albedo=0.7, texture=noise(0.3, seed=53, contrast=0.4), gloss=0.2)
    panels = []
    width = 6.0 / _PANELS
    for i in range(_PANELS):
        along = (i + 0.5) * width - 3.0
        x, y = ((along, 3.0), (along, -3.0), (3.0, along), (-3.0, along))[side]
        normal = ((0.0, -1.0, 0.0), (0.0, 1.0, 0.0), (-1.0, 0.0, 0.0), (1.0, 0.0, 0.0))[side]
        panels.append(Rectangle((dark, light)[i % 2], pose((x, y, 1.3), normal), width=width, height=2.6))
    return tuple(panels)


def _table() -> tuple[Primitive, ...]:
    cloth = Material("table cloth", albedo=0.4, texture=noise(0.08, seed=54), gloss=0.1)
    return (rounded_box(cloth, (0.0, 0.0, _TOP - 0.02), (1.6, 1.0, 0.04), 0.012),)


def _metals() -> tuple[Primitive, ...]:
    """Each metal once."""
    return (
        _ball(Material.metal(STEEL), -0.32, -0.2, 0.1),
        _ball(Material.metal(COPPER), -0.05, -0.28, 0.085),
        _ball(Material.metal(ALUMINIUM), 0.2, -0.22, 0.09),
        _can(Material.metal(CHROMIUM), -0.2, 0.1, 0.075, 0.24),
        _can(Material.metal(IRON), 0.06, 0.06, 0.07, 0.2),
        _ball(Material.metal(GOLD), 0.42, -0.1, 0.08),
    )


def _plastics() -> tuple[Primitive, ...]:
    """Of the same shapes: glossy black and grey, and matte with a texture."""
    black = Material("black plastic", albedo=0.02)
    grey = Material("grey plastic", albedo=0.2)
    paper = Material("paper", albedo=0.5, texture=noise(0.05, seed=55, contrast=0.6), gloss=0.0)
    return (
        _ball(black, 0.27, 0.12, 0.09),
        _can(grey, 0.47, 0.16, 0.07, 0.2),
        _can(paper, -0.46, 0.12, 0.08, 0.22),
    )


def _ball(material: Material, x: float, y: float, radius: float) -> Sphere:
    return Sphere(material, pose(_on_table(x, y, radius)), radius=radius)


def _can(material: Material, x: float, y: float, radius: float, height: float) -> Cylinder:
    return Cylinder(material, pose(_on_table(x, y, height / 2)), radius=radius, height=height)


def _on_table(x: float, y: float, height: float) -> Point:
    return x, y, _TOP + height
