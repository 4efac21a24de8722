"""An office corridor, bare but for its two ends. World z is up, y leads along it from the near end at y = 0."""

from __future__ import annotations

from polarmap.synth.path import Loop
from polarmap.synth.scene import Box, Cylinder, Material, PointLight, Primitive, Rectangle, Revolved, Scene, Sphere
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.objects import rounded_box
from polarmap.synth.scenes.placement import noise, pose

_LENGTH, _WIDTH, _HEIGHT = 13.0, 2.2, 2.6
_LAMPS = (1.6, 4.8, 8.0, 11.2)  # y of the ceiling lamps
_DOORS = ((-1.0, 3.6), (1.0, 5.6), (-1.0, 7.6), (1.0, 9.4))  # side, y


def built_in_corridor() -> BuiltInScene:
    """The corridor, walked from its near end to the middle and back, looking at the far end."""
    lamps = tuple(PointLight((0.0, y, _HEIGHT - 0.25), 2.6, shadows=False) for y in _LAMPS)
    return BuiltInScene(
        Scene((*_shell(), *_doors(), *_lamps(), *_near_end(), *_far_end()), lamps, surround=0.95),
        eye=(-0.15, 1.0, 1.5),
        target=(0.05, 9.0, 1.25),
        loop=Loop(sideways=0.3, forward=2.6, first_angle=0.04, sway=0.02, gaze_drift=0.025),
    )


def _shell() -> tuple[Primitive, ...]:
    wall = Material("wall", albedo=0.6, eta=1.2, gloss=0.15)
    base = Material("oil paint", albedo=0.34, eta=1.4, gloss=0.5)
    floor = Material("linoleum", albedo=0.24, eta=1.5, gloss=0.5)
    ceiling = Material("ceiling", albedo=0.7, eta=1.22, gloss=0.2)
    middle, half = _LENGTH / 2, _WIDTH / 2
    sides = []
    for side in (-1.0, 1.0):
        inward = (-side, 0.0, 0.0)
        sides += [
            Rectangle(wall, pose((side * half, middle, 1.9), inward), width=_LENGTH, height=1.4),
            Rectangle(base, pose((side * half, middle, 0.6), inward), width=_LENGTH, height=1.2),
        ]
    return (
        Rectangle(floor, pose((0.0, middle, 0.0)), width=_WIDTH, height=_LENGTH),
        Rectangle(ceiling, pose((0.0, middle, _HEIGHT), (0.0, 0.0, -1.0)), width=_WIDTH, height=_LENGTH),
        Rectangle(wall, pose((0.0, 0.0, 1.3), (0.0, 1.0, 0.0)), width=_WIDTH, height=_HEIGHT),
        Rectangle(wall, pose((0.0, _LENGTH, 1.3), (0.0, -1.0, 0.0)), width=_WIDTH, height=_HEIGHT),
        *sides,
    )


def _doors() -> tuple[Primitive, ...]:
    """Bare doors, each in a frame, with a handle."""
    frame = Material("door frame", albedo=0.12, gloss=0.8)
    leaf = Material("door", albedo=0.42, eta=1.55, gloss=1.0)
    handle = Material("handle", albedo=0.3, shininess=200.0)
    parts = []
    for side, y in _DOORS:
        x = side * _WIDTH / 2
        parts += [
            rounded_box(frame, (x, y, 1.05), (0.05, 1.06, 2.16), 0.01),
            rounded_box(leaf, (x, y, 1.02), (0.08, 0.92, 2.02), 0.008),
            Cylinder(handle, pose((x - side * 0.07, y - 0.36, 1.05), (0.0, 1.0, 0.0)), radius=0.012, height=0.13),
        ]
    return tuple(parts)


def _lamps() -> tuple[Primitive, ...]:
    shade = Material("lamp shade", albedo=0.85, gloss=0.5)
    return tuple(
        Revolved(shade, pose((0.0, y, _HEIGHT - 0.06)), bottom=0.06, middle=0.15, top=0.2, height=0.12) for y in _LAMPS
    )


def _near_end() -> tuple[Primitive, ...]:
    """Notice boards on both walls of the first metres and a mat."""
    board = Material("notice board", albedo=0.42, texture=noise(0.14, seed=31), gloss=0.2)
    mat = Material("mat", albedo=0.3, texture=noise(0.08, seed=32), gloss=0.05)
    left = pose((-_WIDTH / 2 + 0.01, 2.2, 1.5), (1.0, 0.0, 0.0))
    right = pose((_WIDTH / 2 - 0.01, 2.5, 1.45), (-1.0, 0.0, 0.0))
    return (
        Rectangle(board, left, width=1.5, height=0.9),
        Rectangle(board, right, width=1.3, height=1.0),
        Rectangle(mat, pose((0.1, 2.3, 0.004)), width=1.1, height=1.5),
    )


def _far_end() -> tuple[Primitive, ...]:
    """A poster, a cabinet, a plant in a pot and a bin before the end wall, a mat on the floor."""
    poster = Material("poster", albedo=0.45, texture=noise(0.25, seed=33), gloss=0.6)
    wood = Material("cabinet", albedo=0.3, texture=noise(0.15, seed=34, contrast=0.7), gloss=0.6)
    leaves = Material("leaves", albedo=0.22, texture=noise(0.1, seed=35), gloss=0.7)
    pot = Material("pot", albedo=0.4, eta=1.55, shininess=80.0)
    mat = Material("far mat", albedo=0.3, texture=noise(0.12, seed=36), gloss=0.05)
    y = _LENGTH
    return (
        Rectangle(poster, pose((-0.1, y - 0.01, 1.75), (0.0, -1.0, 0.0)), width=1.6, height=1.1),
        Box(wood, pose((-0.6, y - 0.25, 0.5)), size=(0.8, 0.45, 1.0)),
        Revolved(pot, pose((0.55, y - 0.5, 0.2)), bottom=0.13, middle=0.17, top=0.19, height=0.4),
        Sphere(leaves, pose((0.55, y - 0.5, 0.75)), radius=0.38),
        Rectangle(poster, pose((_WIDTH / 2 - 0.01, y - 1.1, 1.5), (-1.0, 0.0, 0.0)), width=1.2, height=0.9),
        Rectangle(poster, pose((-_WIDTH / 2 + 0.01, y - 1.3, 1.5), (1.0, 0.0, 0.0)), width=1.4, height=1.0),
        Rectangle(mat, pose((0.0, y - 1.6, 0.004)), width=1.6, height=1.6),
    )
