"""Glossy, curved things close together on a table, a bare wall behind. World z is up; the table is over the origin."""

from __future__ import annotations

import math

from polarmap.polarization.metals import COPPER, STEEL
from polarmap.synth.path import Arc, Loop
from polarmap.synth.scene import Cylinder, Material, PointLight, Primitive, Prism, Rectangle, Revolved, Scene, Sphere
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.objects import bottle, rounded_box, turned
from polarmap.synth.scenes.placement import Point, noise, pose

_TOP = 0.74  # metres, the table's height


def built_in_things() -> BuiltInScene:
    """The things from near, by hand, and from an arc of 100° with a longer lens."""
    lamps = (PointLight((-0.7, -0.8, 1.9), 6.0), PointLight((0.9, -0.4, 1.7), 3.0))
    things = (*_pottery(), *_bottle(), *_tins(), *_fruit(), *_balls(), *_toy_car((0.23, -0.1, _TOP), turn=0.5))
    return BuiltInScene(
        Scene((*_surroundings(), *_table(), *things), lamps, surround=0.9),
        eye=(-0.06, -0.57, 1.0),
        target=(0.0, 0.08, 0.815),
        loop=Loop(sideways=0.18, forward=0.04, first_angle=0.1, sway=0.008, gaze_drift=0.03, follow=0.1),
        step=0.02,
        arc=Arc(eye=(0.0, -0.92, 1.16), target=(0.0, 0.03, 0.83), angle=100.0, step=0.08, fov=39.0),
    )


def _surroundings() -> tuple[Primitive, ...]:
    wall = Material("wall", albedo=0.55, gloss=0.2)
    floor = Material("floor", albedo=0.3, gloss=0.3)
    prints = Material("print", albedo=0.45, texture=noise(0.06, seed=61), gloss=0.4)
    return (
        Rectangle(floor, pose((0.0, 0.0, 0.0)), width=6.0, height=6.0),
        Rectangle(wall, pose((0.0, 0.75, 1.3), (0.0, -1.0, 0.0)), width=5.0, height=2.6),
        Rectangle(wall, pose((-2.0, 0.0, 1.3), (1.0, 0.0, 0.0)), width=5.0, height=2.6),
        Rectangle(wall, pose((2.0, 0.0, 1.3), (-1.0, 0.0, 0.0)), width=5.0, height=2.6),
        Rectangle(prints, pose((-0.42, 0.745, 1.13), (0.0, -1.0, 0.0)), width=0.28, height=0.2),
        Rectangle(prints, pose((0.36, 0.745, 1.16), (0.0, -1.0, 0.0)), width=0.2, height=0.26),
    )


def _table() -> tuple[Primitive, ...]:
    """A table cloth with a faint pattern, and a newspaper under some of the things."""
    cloth = Material("table cloth", albedo=0.3, texture=noise(0.12, seed=62, contrast=0.35), gloss=0.15)
    newspaper = Material("newspaper", albedo=0.5, texture=noise(0.03, seed=63), gloss=0.1)
    return (
        rounded_box(cloth, (0.0, 0.05, _TOP - 0.02), (1.3, 0.9, 0.04), 0.015),
        rounded_box(newspaper, _on_table(0.04, -0.06, 0.001), (0.36, 0.26, 0.002), 0.0005, turn=0.3),
    )


def _pottery() -> tuple[Primitive, ...]:
    """A vase with a waist, and a pot with a lid and a spout."""
    glaze = Material("blue glaze", albedo=0.22, eta=1.55, shininess=250.0)
    pale = Material("pale glaze", albedo=0.5, eta=1.5, shininess=150.0)
    vase = (
        (0.0, 0.034), (0.01, 0.042), (0.05, 0.065), (0.085, 0.074), (0.12, 0.068), (0.16, 0.042), (0.185, 0.03),
        (0.205, 0.031), (0.225, 0.046), (0.23, 0.046),
    )  # fmt: skip
    pot = (
        (0.0, 0.03), (0.004, 0.036), (0.022, 0.049), (0.042, 0.054), (0.064, 0.048), (0.084, 0.031), (0.09, 0.027),
        (0.102, 0.01), (0.106, 0.008),
    )  # fmt: skip
    x, y, z = _on_table(0.07, 0.02)
    spout = pose((x - 0.052, y - 0.042, z + 0.062), (-0.6, -0.48, 0.64))
    return (
        *turned(glaze, _on_table(0.19, 0.16), vase),
        *turned(pale, (x, y, z), pot),
        Sphere(pale, pose((x, y, z + 0.112)), radius=0.0105),
        Revolved(pale, spout, bottom=0.015, middle=0.011, top=0.008, height=0.06),
    )


def _bottle() -> tuple[Primitive, ...]:
    glass = Material("green glass", albedo=0.06, eta=1.52, shininess=500.0)
    label = Material("label", albedo=0.5, texture=noise(0.03, seed=64), gloss=0.4)
    return bottle(glass, _on_table(-0.07, 0.15), height=0.29, radius=0.04, label=label)


def _tins() -> tuple[Primitive, ...]:
    """A printed tin, a copper beaker, and a lacquered box."""
    printed = Material(
        "printed tin", albedo=0.42, texture=noise(0.04, seed=65, contrast=0.4), gloss=0.7, shininess=40.0
    )
    lacquer = Material("red lacquer", albedo=0.14, eta=1.52, shininess=300.0)
    return (
        Cylinder(printed, pose(_on_table(-0.09, 0.0, 0.055)), radius=0.037, height=0.11),
        Revolved(Material.metal(COPPER), pose(_on_table(-0.26, 0.14, 0.05)), 0.032, 0.038, 0.043, height=0.1),
        rounded_box(lacquer, _on_table(0.33, 0.06, 0.03), (0.1, 0.08, 0.06), 0.022, turn=0.4),
    )


def _fruit() -> tuple[Primitive, ...]:
    """A pear and a plum, both bare, and an orange with its peel."""
    pear = Material("pear", albedo=0.4, eta=1.45, shininess=60.0)
    plum = Material("plum", albedo=0.07, eta=1.45, shininess=80.0)
    orange = Material("orange", albedo=0.4, texture=noise(0.01, seed=66, contrast=0.3), gloss=0.6, shininess=25.0)
    outline = ((0.0, 0.0), (0.006, 0.02), (0.033, 0.0365), (0.07, 0.02), (0.088, 0.013), (0.094, 0.0))
    return (
        *turned(pear, _on_table(-0.21, -0.01), outline),
        Sphere(orange, pose(_on_table(-0.17, -0.11, 0.036)), radius=0.036),
        Sphere(plum, pose(_on_table(-0.09, -0.13, 0.022)), radius=0.022),
    )


def _balls() -> tuple[Primitive, ...]:
    ivory = Material("ivory ball", albedo=0.6, eta=1.54, shininess=200.0)
    return (
        Sphere(ivory, pose(_on_table(0.02, -0.09, 0.036)), radius=0.036),
        Sphere(Material.metal(STEEL), pose(_on_table(0.13, -0.11, 0.025)), radius=0.025),
    )


def _toy_car(foot: Point, turn: float) -> tuple[Primitive, ...]:
    """A lacquered toy, 14 cm long, its front turned by `turn` radians from +x toward +y; `foot` is below its middle."""
    paint = Material("car paint", albedo=0.18, eta=1.5, shininess=400.0)
    rubber = Material("rubber", albedo=0.05, gloss=0.4)
    body = ((-0.058, 0.026), (0.058, 0.024), (0.058, 0.03), (0.03, 0.036), (-0.056, 0.038))
    cabin = ((-0.046, 0.046), (0.018, 0.044), (-0.004, 0.06), (-0.034, 0.061))
    x, y, z = foot
    along, across = (math.cos(turn), math.sin(turn)), (math.sin(turn), -math.cos(turn))
    axis = (*across, 0.0)

    def wheel(ahead: float, aside: float) -> Cylinder:
        centre = (x + ahead * along[0] + aside * across[0], y + ahead * along[1] + aside * across[1], z + 0.014)
        return Cylinder(rubber, pose(centre, axis), radius=0.014, height=0.009)

    return (
        Prism(paint, pose(foot, axis), body, 0.04, 0.012),
        Prism(paint, pose(foot, axis), cabin, 0.028, 0.01),
        *(wheel(ahead, aside) for ahead in (-0.038, 0.038) for aside in (-0.03, 0.03)),
    )


def _on_table(x: float, y: float, height: float = 0.0) -> Point:
    return x, y, _TOP + height
