"""A street side under an overcast sky. World z is up, x leads along the street, the near house stands at y = 0."""

from __future__ import annotations

from polarmap.synth.path import Loop
from polarmap.synth.scene import Box, Cylinder, Material, PointLight, Primitive, Rectangle, Scene, Sphere
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.objects import car, rounded_box
from polarmap.synth.scenes.placement import noise, pose

_OUTWARD = (0.0, -1.0, 0.0)  # of the house fronts
_KERB = 0.12  # metres
_DOORS = (-1.4, 1.6)  # x of the garage doors' middles


def built_in_street() -> BuiltInScene:
    """The street side, seen from the other pavement by someone who walks past and comes back."""
    sun = PointLight((-25.0, -40.0, 45.0), 1.6 * 66.0**2)
    return BuiltInScene(
        Scene((*_ground(), *_near_house(), *_garage_doors(), *_far_houses(), *_kerbside()), sun, surround=1.4),
        eye=(-2.2, -6.2, 1.6),
        target=(2.2, -0.5, 1.25),
        loop=Loop(sideways=2.0, forward=0.5, first_angle=0.1, sway=0.025, gaze_drift=0.03, follow=0.6),
        step=0.035,
        depth_scale=1000.0,
    )


def _ground() -> tuple[Primitive, ...]:
    asphalt = Material("asphalt", albedo=0.16, texture=noise(0.12, seed=41, contrast=0.45), eta=1.25, gloss=0.15)
    slabs = Material("pavement", albedo=0.3, eta=1.25, gloss=0.15)
    kerb = Material("kerb", albedo=0.38, gloss=0.2)
    return (
        Rectangle(asphalt, pose((10.0, -6.0, 0.0)), width=60.0, height=12.0),
        Box(slabs, pose((10.0, -0.7, _KERB / 2)), size=(60.0, 1.6, _KERB)),
        Box(kerb, pose((10.0, -1.55, _KERB / 2)), size=(60.0, 0.12, _KERB + 0.02)),
    )


def _near_house() -> tuple[Primitive, ...]:
    """Bare render, with brick piers beside the garage doors, a ledge and upper windows."""
    render = Material("render", albedo=0.5, gloss=0.15)
    brick = Material("brick", albedo=0.3, texture=noise(0.12, seed=42), gloss=0.1)
    ledge = Material("ledge", albedo=0.4, gloss=0.3)
    pane = Material("window", albedo=0.02, eta=1.52)
    frame = Material("window frame", albedo=0.65, gloss=0.8)
    windows = []
    for x in (-1.4, 1.6, 5.6):
        windows += [
            rounded_box(frame, (x, 0.0, 4.0), (1.3, 0.1, 1.3), 0.02),
            Rectangle(pane, pose((x, -0.055, 4.0), _OUTWARD), width=1.1, height=1.1),
        ]
    piers = tuple(Box(brick, pose((x, 0.0, 1.3)), size=(0.4, 0.16, 2.6)) for x in (-2.9, 0.1, 3.1))
    sign = Material("notice", albedo=0.45, texture=noise(0.12, seed=43), gloss=0.6)
    return (
        Box(render, pose((0.5, 4.0, 2.9)), size=(15.0, 8.0, 5.8)),
        *piers,
        Box(ledge, pose((0.5, -0.06, 2.7)), size=(15.0, 0.12, 0.16)),
        *windows,
        Rectangle(sign, pose((4.6, -0.01, 1.6), _OUTWARD), width=0.8, height=0.6),
        rounded_box(frame, (6.6, 0.0, 1.1), (1.0, 0.1, 2.1), 0.02),
    )


def _garage_doors() -> tuple[Primitive, ...]:
    """Doors of four painted boards each; nothing on them but the grooves between."""
    paint = Material("door paint", albedo=0.36, eta=1.5, gloss=0.9, shininess=30.0)
    return tuple(
        rounded_box(paint, (x, -0.01, 0.12 + 0.3 + 0.56 * i), (2.4, 0.08, 0.55), 0.02) for x in _DOORS for i in range(4)
    )


def _far_houses() -> tuple[Primitive, ...]:
    """Two more houses down the street, and one across its end."""
    pale = Material("pale render", albedo=0.58, gloss=0.15)
    brown = Material("brown render", albedo=0.3, gloss=0.2)
    grey = Material("grey render", albedo=0.42, gloss=0.2)
    pane = Material("window", albedo=0.02, eta=1.52)
    brick = Material("brick", albedo=0.3, texture=noise(0.12, seed=42), gloss=0.1)
    windows = tuple(
        Rectangle(pane, pose((x, -0.61, z), _OUTWARD), width=1.1, height=1.5) for x in (13.0, 16.5) for z in (1.7, 4.6)
    )
    return (
        Box(pale, pose((15.0, 3.0, 3.4)), size=(8.0, 7.2, 6.8)),
        Box(brick, pose((15.0, -0.6, 0.4)), size=(8.1, 0.12, 0.8)),
        *windows,
        Box(brown, pose((25.0, 3.5, 4.0)), size=(9.0, 8.0, 8.0)),
        Box(grey, pose((42.0, -6.0, 4.0)), size=(6.0, 30.0, 8.0)),
    )


def _kerbside() -> tuple[Primitive, ...]:
    """A parked car, a bush in a tub, a bollard, a lamp post and a bin."""
    paint = Material("car paint", albedo=0.1, eta=1.5, shininess=500.0)
    plate = Material("number plate", albedo=0.6, texture=noise(0.04, seed=44), gloss=0.6)
    leaves = Material("bush", albedo=0.2, texture=noise(0.12, seed=45), gloss=0.5)
    tub = Material("tub", albedo=0.35, texture=noise(0.1, seed=46), gloss=0.2)
    iron = Material("cast iron", albedo=0.06, gloss=0.7)
    plastic = Material("bin", albedo=0.12, eta=1.48, gloss=0.9)
    return (
        *car(paint, (2.3, -2.75, 0.0), plate),
        Sphere(leaves, pose((-2.8, -0.7, 1.05)), radius=0.5),
        Box(tub, pose((-2.8, -0.7, 0.42)), size=(0.6, 0.6, 0.6)),
        Cylinder(iron, pose((-0.2, -1.3, 0.55)), radius=0.06, height=0.9),
        Cylinder(iron, pose((6.4, -1.3, 2.6)), radius=0.07, height=5.0),
        rounded_box(plastic, (5.6, -0.5, 0.65), (0.6, 0.6, 1.05), 0.05),
    )
