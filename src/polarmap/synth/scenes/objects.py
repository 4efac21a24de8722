"""Things that scenes are furnished with, put together from the shapes: bottles, vases, a car."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

import numpy as np
from scipy.interpolate import PchipInterpolator

from polarmap.synth.scene import Cylinder, Material, Primitive, Prism, Revolved
from polarmap.synth.scenes.placement import Point, pose


def bottle(
    glass: Material, foot: Point, height: float = 0.3, radius: float = 0.038, label: Material | None = None
) -> tuple[Primitive, ...]:
    """An upright bottle: a body, an ellipsoidal shoulder, a neck with a lip, and a label or none."""
    x, y, z = foot
    body, shoulder, neck = 0.58 * height, 0.17 * height, 0.37 * radius
    middle = np.sqrt(radius**2 - (radius**2 - neck**2) / 4)
    parts = (
        Revolved(glass, pose((x, y, z + body / 2)), radius, radius, radius, body),
        Revolved(glass, pose((x, y, z + body + shoulder / 2)), radius, middle, neck, shoulder),
        Revolved(
            glass, pose((x, y, z + (body + shoulder + height) / 2)), neck, neck, 0.95 * neck, height - body - shoulder
        ),
        Cylinder(glass, pose((x, y, z + 0.97 * height)), radius=1.15 * neck, height=0.03 * height),
    )
    if label is None:
        return parts
    return (*parts, Cylinder(label, pose((x, y, z + 0.5 * body)), radius=1.012 * radius, height=0.5 * body))


_PIECES = 3  # between two points of an outline; more bend its slope less where they meet


def turned(material: Material, foot: Point, outline: Sequence[tuple[float, float]]) -> tuple[Revolved, ...]:
    """An upright thing as a lathe or a potter's wheel makes it; `foot` is its lowest point on the axis.

    outline: (height above the foot, radius) in metres, from below upward. The squared radius runs through them as a
    monotone cubic (Fritsch, Carlson 1980), which is a sphere's near a pole, in stacked parts that are parabolas.
    """
    heights, radii = np.array(outline, float).T
    squared = PchipInterpolator(heights, radii**2)
    ends = np.interp(np.arange(_PIECES * (len(heights) - 1) + 1) / _PIECES, np.arange(len(heights)), heights)
    x, y, z = foot

    def radius(height: float) -> float:
        return float(np.sqrt(max(squared(height), 0.0)))

    def part(low: float, high: float) -> Revolved:
        middle = (low + high) / 2
        return Revolved(
            material, pose((x, y, z + middle)), radius(low), radius(middle), radius(high), height=high - low
        )

    return tuple(part(low, high) for low, high in pairwise(ends.tolist()))


def ellipsoid(material: Material, centre: Point, radius: float, height: float) -> Revolved:
    """An ellipsoid of revolution about the vertical."""
    return Revolved(material, pose(centre), 0.0, radius, 0.0, height)


def rounded_box(
    material: Material, centre: Point, size: Point, rounding: float, turn: float = 0.0, z_axis: Point = (0.0, 0.0, 1.0)
) -> Prism:
    """A cuboid with rounded edges, of `size` with the rounding, along the axes that `pose` gives."""
    x, y = size[0] / 2 - rounding, size[1] / 2 - rounding
    outline = ((-x, -y), (x, -y), (x, y), (-x, y))
    return Prism(material, pose(centre, z_axis, turn=turn), outline, size[2] - 2 * rounding, rounding)


def car(paint: Material, foot: Point, plate: Material) -> tuple[Primitive, ...]:
    """A hatchback 4 m long, its left side towards -y and its front towards +x; `foot` is below its middle."""
    window = Material("car window", albedo=0.02, eta=1.52, shininess=400.0)
    trim = Material("car trim", albedo=0.05, gloss=0.5)
    return (*_car_body(paint, window, trim, foot), *_wheels(trim, foot), *_fittings(window, plate, foot))


def _car_body(paint: Material, window: Material, trim: Material, foot: Point) -> tuple[Primitive, ...]:
    def across(material: Material, outline: tuple, width: float, rounding: float) -> Prism:
        return Prism(material, pose(foot, (0.0, -1.0, 0.0)), outline, width - 2 * rounding, rounding)

    body = ((-1.72, 0.52), (1.72, 0.48), (1.76, 0.56), (1.15, 0.68), (-1.68, 0.7))
    cabin = ((-1.62, 0.9), (0.78, 0.85), (0.02, 1.3), (-1.2, 1.32))
    roof = ((-1.32, 1.385), (0.12, 1.375), (-0.1, 1.42), (-1.1, 1.43))
    pillar = ((-0.62, 0.85), (-0.52, 0.85), (-0.56, 1.36), (-0.64, 1.36))
    sill = ((-1.4, 0.3), (1.4, 0.3), (1.4, 0.34), (-1.4, 0.34))
    return (
        across(paint, body, 1.74, 0.24),
        across(window, cabin, 1.5, 0.1),
        across(paint, roof, 1.42, 0.04),
        across(paint, pillar, 1.52, 0.015),
        across(trim, sill, 1.64, 0.06),
    )


def _wheels(rubber: Material, foot: Point) -> tuple[Primitive, ...]:
    rim = Material("rim", albedo=0.45, shininess=60.0)
    x, y, z = foot
    parts: list[Primitive] = []
    for along in (-1.22, 1.24):
        for side in (-1.0, 1.0):
            axis = (0.0, side, 0.0)
            parts.append(Cylinder(rubber, pose((x + along, y + side * 0.78, z + 0.31), axis), radius=0.31, height=0.2))
            hub = pose((x + along, y + side * 0.89, z + 0.31), axis)
            parts.append(Revolved(rim, hub, bottom=0.2, middle=0.17, top=0.05, height=0.03))
    return tuple(parts)


def _fittings(window: Material, plate: Material, foot: Point) -> tuple[Primitive, ...]:
    """Lamps, a wing mirror, number plates."""
    red = Material("rear lamp", albedo=0.12, shininess=200.0)
    x, y, z = foot
    near = y - 0.84
    return (
        rounded_box(red, (x - 1.92, y - 0.62, z + 0.74), (0.1, 0.34, 0.22), 0.04),
        rounded_box(red, (x - 1.92, y + 0.62, z + 0.74), (0.1, 0.34, 0.22), 0.04),
        rounded_box(window, (x + 1.86, y - 0.6, z + 0.62), (0.16, 0.36, 0.16), 0.06),
        rounded_box(window, (x + 0.55, near - 0.04, z + 0.98), (0.12, 0.2, 0.14), 0.05),
        rounded_box(plate, (x - 1.975, y, z + 0.6), (0.02, 0.52, 0.12), 0.005),
    )
