"""A table top with bottles, ceramics and fruit. World z is up; the table stands over the origin."""

from __future__ import annotations

from polarmap.synth.path import Loop
from polarmap.synth.scene import Cylinder, Material, PointLight, Primitive, Rectangle, Revolved, Scene, Sphere
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.objects import bottle, ellipsoid, rounded_box
from polarmap.synth.scenes.placement import Y_AXIS, Point, noise, pose

_TOP = 0.74  # metres, the table's height


def built_in_table() -> BuiltInScene:
    """The table, seen from one long side, as if by someone who leans over it."""
    lamps = (PointLight((-0.5, -0.3, 2.1), 4.0), PointLight((1.6, -1.6, 2.3), 3.0))
    return BuiltInScene(
        Scene((*_surroundings(), *_table(), *_bottles(), *_ceramics(), *_fruit()), lamps, surround=1.2),
        eye=(0.1, -1.25, 1.38),
        target=(0.02, 0.1, 0.78),
        loop=Loop(sideways=0.45, forward=0.1, first_angle=0.1, sway=0.012, gaze_drift=0.03, follow=0.25),
        step=0.02,
    )


def _surroundings() -> tuple[Primitive, ...]:
    wall = Material("wall", albedo=0.62, gloss=0.25)
    floor = Material("floor", albedo=0.25, gloss=0.3)
    picture = Material("picture", albedo=0.4, texture=noise(0.15, seed=21), gloss=0.6)
    return (
        Rectangle(floor, pose((0.0, 0.0, 0.0)), width=8.0, height=8.0),
        Rectangle(wall, pose((0.0, 1.5, 1.5), (0.0, -1.0, 0.0)), width=8.0, height=3.0),
        Rectangle(wall, pose((-3.0, 0.0, 1.5), (1.0, 0.0, 0.0)), width=8.0, height=3.0),
        Rectangle(wall, pose((3.0, 0.0, 1.5), (-1.0, 0.0, 0.0)), width=8.0, height=3.0),
        Rectangle(picture, pose((0.75, 1.49, 1.25), (0.0, -1.0, 0.0)), width=0.8, height=0.6),
        Rectangle(picture, pose((-0.95, 1.49, 1.2), (0.0, -1.0, 0.0)), width=0.5, height=0.7),
    )


def _table() -> tuple[Primitive, ...]:
    """A lacquered top on four legs, with a place mat."""
    lacquer = Material("lacquer", albedo=0.24, eta=1.52, shininess=300.0)
    cloth = Material("place mat", albedo=0.4, texture=noise(0.06, seed=22), gloss=0.1)
    legs = tuple(
        Cylinder(lacquer, pose((x, y, _TOP / 2 - 0.02)), radius=0.03, height=_TOP - 0.04)
        for x in (-0.72, 0.72)
        for y in (-0.37, 0.37)
    )
    top = rounded_box(lacquer, (0.0, 0.0, _TOP - 0.02), (1.6, 0.9, 0.04), 0.012)
    return (top, *legs, rounded_box(cloth, _on_table(-0.3, -0.24, 0.002), (0.42, 0.3, 0.004), 0.001, turn=0.15))


def _bottles() -> tuple[Primitive, ...]:
    green = Material("green glass", albedo=0.05, eta=1.52, shininess=500.0)
    brown = Material("brown glass", albedo=0.09, eta=1.55, shininess=500.0)
    white = Material("white plastic", albedo=0.6, eta=1.46, gloss=0.8, shininess=60.0)
    label = Material("label", albedo=0.5, texture=noise(0.03, seed=23), gloss=0.3)
    return (
        *bottle(green, _on_table(-0.12, 0.2), height=0.31, radius=0.039, label=label),
        *bottle(green, _on_table(0.42, 0.3), height=0.33, radius=0.042),
        *bottle(brown, _on_table(0.02, 0.08), height=0.22, radius=0.031),
        *bottle(white, _on_table(-0.55, 0.22), height=0.24, radius=0.045),
    )


def _ceramics() -> tuple[Primitive, ...]:
    """A waisted vase, a mug, a bowl, a plate, a box of tea and a book."""
    glaze = Material("blue glaze", albedo=0.15, eta=1.6, shininess=250.0)
    pale = Material("pale glaze", albedo=0.5, eta=1.55, shininess=150.0)
    cover = Material("book cover", albedo=0.07, eta=1.45, gloss=0.9)
    print_ = Material("printed card", albedo=0.42, texture=noise(0.05, seed=24), gloss=0.5)
    x, y, z = _on_table(0.24, 0.22)
    return (
        Revolved(glaze, pose((x, y, z + 0.13)), bottom=0.06, middle=0.035, top=0.055, height=0.26),
        Cylinder(pale, pose(_on_table(0.3, -0.16, 0.05)), radius=0.042, height=0.1),
        Revolved(pale, pose(_on_table(-0.02, -0.18, 0.03)), bottom=0.05, middle=0.085, top=0.11, height=0.06),
        rounded_box(cover, _on_table(0.56, -0.1, 0.016), (0.2, 0.27, 0.032), 0.004, turn=-0.3),
        rounded_box(print_, _on_table(-0.36, 0.16, 0.09), (0.14, 0.07, 0.18), 0.002, turn=0.35),
    )


def _fruit() -> tuple[Primitive, ...]:
    orange = Material("orange", albedo=0.4, texture=noise(0.02, seed=25, contrast=0.35), gloss=0.6, shininess=25.0)
    apple = Material("apple", albedo=0.22, texture=noise(0.05, seed=26, contrast=0.6), shininess=80.0)
    plum = Material("plum", albedo=0.06, eta=1.45, shininess=60.0)
    return (
        Sphere(orange, pose(_on_table(-0.05, -0.16, 0.085)), radius=0.04),
        Sphere(orange, pose(_on_table(0.03, -0.21, 0.085)), radius=0.038),
        ellipsoid(apple, _on_table(0.01, -0.14, 0.085), radius=0.038, height=0.068),
        ellipsoid(plum, _on_table(0.17, -0.27, 0.02), radius=0.025, height=0.04),
        Revolved(plum, pose(_on_table(0.11, -0.33, 0.023), Y_AXIS), 0.0, 0.023, 0.0, 0.056),
    )


def _on_table(x: float, y: float, height: float = 0.0) -> Point:
    return x, y, _TOP + height
