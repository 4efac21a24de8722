"""The demo's room. World z is up, the floor's centre the origin."""

from __future__ import annotations

from polarmap.synth.scene import (
    Box,
    Cylinder,
    Material,
    Pattern,
    PointLight,
    Primitive,
    Rectangle,
    Scene,
    Sphere,
    Texture,
)
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.placement import noise, pose


def built_in_room() -> BuiltInScene:
    """The room and a path through it."""
    return BuiltInScene(room(), eye=(-0.9, -1.3, 1.45), target=(1.15, 1.95, 0.95), step=0.04)


def room() -> Scene:
    """A room of 5 m by 5 m by 2.5 m, mostly bare, with some textured things in it, lit by a lamp."""
    return Scene(
        (*_shell(), *_pictures(), *_furniture()),
        PointLight(position=(0.5, -1.4, 1.6), intensity=30.0),
        surround=1.3,
    )


def _shell() -> tuple[Primitive, ...]:
    wall = Material("wall", albedo=0.6, gloss=0.3)
    wainscot = Material("side wall", albedo=0.3)
    floor = Material("floor", albedo=0.16)
    ceiling = Material("ceiling", albedo=0.7, gloss=0.3)
    return (
        Rectangle(floor, pose((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), width=5.0, height=5.0),
        Rectangle(ceiling, pose((0.0, 0.0, 2.5), (0.0, 0.0, -1.0)), width=5.0, height=5.0),
        Rectangle(wall, pose((0.0, 2.5, 1.25), (0.0, -1.0, 0.0)), width=5.0, height=2.5),
        Rectangle(wall, pose((0.0, -2.5, 1.25), (0.0, 1.0, 0.0)), width=5.0, height=2.5),
        Rectangle(wainscot, pose((-2.5, 0.0, 1.25), (1.0, 0.0, 0.0)), width=5.0, height=2.5),
        Rectangle(wainscot, pose((2.5, 0.0, 1.25), (-1.0, 0.0, 0.0)), width=5.0, height=2.5),
    )


def _pictures() -> tuple[Primitive, ...]:
    """Two framed pictures on the far wall, a poster on either side, a rug."""
    frame = Material("frame", albedo=0.08)
    picture = Material("picture", albedo=0.45, texture=noise(0.16, seed=1), gloss=0.9)
    poster = Material("poster", albedo=0.5, texture=noise(0.2, seed=2), gloss=0.5)
    rug = Material("rug", albedo=0.35, texture=noise(0.12, seed=3), gloss=0.1)
    return (
        Box(frame, pose((-0.6, 2.485, 1.6)), size=(1.3, 0.03, 1.0)),
        Rectangle(picture, pose((-0.6, 2.465, 1.6), (0.0, -1.0, 0.0)), width=1.2, height=0.9),
        Box(frame, pose((1.35, 2.485, 1.55)), size=(1.4, 0.03, 1.0)),
        Rectangle(picture, pose((1.35, 2.465, 1.55), (0.0, -1.0, 0.0)), width=1.3, height=0.9),
        Rectangle(poster, pose((-2.495, 1.3, 1.3), (1.0, 0.0, 0.0)), width=1.2, height=1.4),
        Rectangle(poster, pose((2.495, 1.1, 1.4), (-1.0, 0.0, 0.0)), width=1.5, height=1.2),
        Rectangle(rug, pose((0.45, 0.75, 0.005)), width=2.6, height=1.8),
    )


def _furniture() -> tuple[Primitive, ...]:
    """A cabinet, a crate and a column, with spheres and a vase on them; half of them bare."""
    lacquer = Material("lacquer", albedo=0.1)
    plaster = Material("plaster", albedo=0.6, gloss=0.6)
    ceramic = Material("ceramic", albedo=0.3, shininess=120.0)
    wood = Material("wood", albedo=0.35, texture=noise(0.1, seed=4), gloss=0.4)
    marble = Material("marble", albedo=0.45, texture=noise(0.08, seed=5))
    stripes = Material("stripes", albedo=0.45, texture=Texture(Pattern.STRIPES, size=0.03, contrast=0.7))
    return (
        Box(lacquer, pose((0.2, 2.2, 0.45)), size=(1.0, 0.5, 0.9)),
        Cylinder(stripes, pose((0.0, 2.15, 1.08)), radius=0.11, height=0.36),
        Sphere(marble, pose((0.45, 2.15, 1.04)), radius=0.14),
        Box(wood, pose((1.6, 1.6, 0.3), turn=0.45), size=(0.7, 0.6, 0.6)),
        Sphere(ceramic, pose((1.6, 1.6, 0.86)), radius=0.26),
        Cylinder(plaster, pose((-0.65, 1.55, 0.5)), radius=0.24, height=1.0),
        Sphere(marble, pose((-0.65, 1.55, 1.2)), radius=0.2),
        Sphere(plaster, pose((1.1, 0.75, 0.165)), radius=0.16),
    )
