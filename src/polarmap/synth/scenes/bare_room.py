"""A living room with bare walls and few textured things. World z is up, the floor's centre the origin."""

from __future__ import annotations

from polarmap.synth.path import Loop
from polarmap.synth.scene import Box, Cylinder, Material, PointLight, Primitive, Rectangle, Revolved, Scene
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.objects import bottle, ellipsoid, rounded_box
from polarmap.synth.scenes.placement import Point, noise, pose

_X, _Y, _HEIGHT = 2.3, 2.7, 2.5  # half the floor's sides, and the ceiling


def built_in_bare_room() -> BuiltInScene:
    """The room, seen from its middle towards a corner."""
    lamps = (PointLight((1.35, 1.85, 1.5), 4.5, shadows=False), PointLight((-0.4, -0.6, 2.3), 9.0))
    return BuiltInScene(
        Scene((*_shell(), *_woodwork(), *_sofa(), *_table(), *_small_things()), lamps, surround=1.1),
        eye=(-0.7, -1.5, 1.5),
        target=(0.55, 1.9, 0.85),
        loop=Loop(sideways=1.0, forward=0.45),
    )


def _shell() -> tuple[Primitive, ...]:
    wall = Material("wall", albedo=0.62, gloss=0.25)
    tinted = Material("tinted wall", albedo=0.42, gloss=0.3)
    floor = Material("parquet", albedo=0.22, eta=1.5, gloss=0.5)
    ceiling = Material("ceiling", albedo=0.72, gloss=0.2)
    return (
        Rectangle(floor, pose((0.0, 0.0, 0.0)), width=2 * _X, height=2 * _Y),
        Rectangle(ceiling, pose((0.0, 0.0, _HEIGHT), (0.0, 0.0, -1.0)), width=2 * _X, height=2 * _Y),
        Rectangle(wall, pose((0.0, _Y, 1.25), (0.0, -1.0, 0.0)), width=2 * _X, height=_HEIGHT),
        Rectangle(wall, pose((0.0, -_Y, 1.25), (0.0, 1.0, 0.0)), width=2 * _X, height=_HEIGHT),
        Rectangle(tinted, pose((_X, 0.0, 1.25), (-1.0, 0.0, 0.0)), width=2 * _Y, height=_HEIGHT),
        Rectangle(wall, pose((-_X, 0.0, 1.25), (1.0, 0.0, 0.0)), width=2 * _Y, height=_HEIGHT),
    )


def _woodwork() -> tuple[Primitive, ...]:
    """Skirting boards, a door, a radiator, a picture and a bookcase."""
    white = Material("white paint", albedo=0.68, eta=1.52, gloss=0.9)
    door = Material("door", albedo=0.5, eta=1.55, gloss=1.0)
    picture = Material("picture", albedo=0.4, texture=noise(0.18, seed=11), gloss=0.9)
    frame = Material("frame", albedo=0.06, gloss=0.9)
    books = Material("books", albedo=0.35, texture=noise(0.12, seed=12), gloss=0.4)
    case = Material("bookcase", albedo=0.3, gloss=0.6)
    radiator = tuple(rounded_box(white, (_X - 0.08, 0.35 + 0.12 * i, 0.45), (0.09, 0.1, 0.6), 0.04) for i in range(6))
    return (
        Box(white, pose((0.0, _Y - 0.01, 0.05)), size=(2 * _X, 0.02, 0.1)),
        Box(white, pose((_X - 0.01, 0.0, 0.05)), size=(0.02, 2 * _Y, 0.1)),
        Box(white, pose((-_X + 0.01, 0.0, 0.05)), size=(0.02, 2 * _Y, 0.1)),
        rounded_box(white, (-1.5, _Y, 1.03), (1.0, 0.06, 2.1), 0.012),
        rounded_box(door, (-1.5, _Y - 0.02, 1.0), (0.86, 0.06, 2.0), 0.008),
        *radiator,
        Box(frame, pose((0.35, _Y - 0.015, 1.55)), size=(0.92, 0.03, 0.72)),
        Rectangle(picture, pose((0.35, _Y - 0.032, 1.55), (0.0, -1.0, 0.0)), width=0.84, height=0.64),
        Box(case, pose((-_X + 0.16, 0.9, 0.6)), size=(0.32, 1.0, 1.2)),
        Box(books, pose((-_X + 0.2, 0.9, 0.62)), size=(0.28, 0.9, 1.05)),
    )


def _sofa() -> tuple[Primitive, ...]:
    """Bare leather, with one cushion of patterned cloth."""
    leather = Material("leather", albedo=0.13, eta=1.45, gloss=0.6, shininess=12.0)
    cloth = Material("cushion", albedo=0.4, texture=noise(0.06, seed=13), gloss=0.1)
    return (
        rounded_box(leather, (0.4, 2.15, 0.28), (1.7, 0.8, 0.32), 0.08),
        rounded_box(leather, (0.4, 2.48, 0.6), (1.7, 0.22, 0.55), 0.1),
        rounded_box(leather, (-0.42, 2.12, 0.42), (0.2, 0.84, 0.5), 0.09),
        rounded_box(leather, (1.22, 2.12, 0.42), (0.2, 0.84, 0.5), 0.09),
        rounded_box(cloth, (-0.1, 2.26, 0.62), (0.4, 0.16, 0.36), 0.07, turn=0.3),
    )


def _table() -> tuple[Primitive, ...]:
    """A low lacquered table on a patterned rug, with a vase and a bowl."""
    rug = Material("rug", albedo=0.33, texture=noise(0.16, seed=14), gloss=0.05)
    lacquer = Material("black lacquer", albedo=0.06, eta=1.52, shininess=300.0)
    glaze = Material("glaze", albedo=0.45, eta=1.58, shininess=120.0)
    glass = Material("green glass", albedo=0.05, eta=1.52, shininess=400.0)
    top = 0.42
    legs = tuple(
        Cylinder(lacquer, pose((0.5 + x, 0.75 + y, top / 2)), radius=0.025, height=top)
        for x in (-0.42, 0.42)
        for y in (-0.24, 0.24)
    )
    return (
        Rectangle(rug, pose((0.4, 0.8, 0.004)), width=1.9, height=1.3),
        rounded_box(lacquer, (0.5, 0.75, top), (1.0, 0.6, 0.04), 0.015),
        *legs,
        Revolved(glaze, pose((0.25, 0.85, top + 0.17)), bottom=0.05, middle=0.1, top=0.04, height=0.3),
        Revolved(glaze, pose((0.72, 0.66, top + 0.05)), bottom=0.06, middle=0.1, top=0.13, height=0.06),
        *bottle(glass, (0.5, 0.9, top + 0.02), height=0.3, radius=0.04),
    )


def _small_things() -> tuple[Primitive, ...]:
    """A floor lamp, a ball, a pouffe, a basket."""
    metal = Material("lamp stand", albedo=0.1, gloss=0.9, shininess=100.0)
    shade = Material("lamp shade", albedo=0.75, gloss=0.1)
    rubber = Material("ball", albedo=0.3, eta=1.5, shininess=40.0)
    basket = Material("basket", albedo=0.35, texture=noise(0.05, seed=15), gloss=0.1)
    felt = Material("pouffe", albedo=0.3, gloss=0.05)
    x, y = 1.85, 2.25
    foot: Point = (x, y, 0.02)
    return (
        Cylinder(metal, pose(foot), radius=0.15, height=0.03),
        Cylinder(metal, pose((x, y, 0.75)), radius=0.014, height=1.5),
        Revolved(shade, pose((x, y, 1.55)), bottom=0.2, middle=0.16, top=0.12, height=0.26),
        ellipsoid(rubber, (-0.75, 1.75, 0.16), radius=0.16, height=0.32),
        rounded_box(felt, (1.75, 1.2, 0.2), (0.5, 0.5, 0.4), 0.1, turn=0.4),
        Revolved(basket, pose((-0.75, 2.4, 0.2)), bottom=0.16, middle=0.2, top=0.21, height=0.4),
    )
