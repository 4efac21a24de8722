"""Random streets: house fronts, cars, trees and poles under an open sky."""

from __future__ import annotations

import numpy as np

from polarmap.synth import Box, Cylinder, Material, PointLight, Primitive, Rectangle, Scene
from polarmap.synth.scenes.objects import car, ellipsoid
from polarmap.synth.scenes.placement import pose
from training.furniture import FRONT, moved, standing, thing
from training.materials import Materials
from training.rooms import Place


def street(m: Materials, images: np.ndarray) -> Place:
    """A street along x, houses on both sides, seen from a pavement or the road."""
    rng = m.rng
    half = rng.uniform(3.0, 8.0)
    parts: list[Primitive] = [Rectangle(m.floor(), pose((0, 0, 0)))]
    for side in (0.0, np.pi):
        T = standing(0, 0, 0, side)
        parts += moved(tuple(_side(m, half)), T)
    if rng.random() < 0.6:
        parts.append(Box(m.wall(), pose((rng.choice([-1, 1]) * rng.uniform(12, 40), 0, 4)), size=(4, 40, 8)))
    sun = np.array([rng.uniform(-1, 1), rng.uniform(-1, 1), rng.uniform(0.3, 1.2)]) * 60.0
    lights = (PointLight(tuple(sun), rng.uniform(0.5, 4.0) * float(sun @ sun)),) if rng.random() < 0.75 else ()
    plan = np.array([(-9.0, -half + 0.8), (9.0, -half + 0.8), (9.0, half - 0.8), (-9.0, half - 0.8)])
    focuses = rng.uniform((-9, -half, 0.2), (9, half, 3.0), (6, 3))
    return Place(Scene(tuple(parts), lights, rng.uniform(0.6, 2.0), images), plan, 2.3, focuses)


def _side(m: Materials, half: float) -> list[Primitive]:
    rng = m.rng
    parts: list[Primitive] = [Box(m.floor(), pose((0, half, 0.06)), size=(80, 3.0, 0.12))]
    x = -30.0
    while x < 30.0:
        width, high, deep = rng.uniform(5, 14), rng.uniform(2.5, 12), rng.uniform(4, 8)
        if rng.random() < 0.85:
            parts += _house(m, x + width / 2, half + 1.2 + rng.uniform(0, 1.5), (width, deep, high))
        x += width + (rng.uniform(0.5, 4.0) if rng.random() < 0.3 else 0.0)
    for _ in range(int(rng.integers(0, 5))):
        x, y = rng.uniform(-14, 14), half - rng.uniform(1.2, 2.6)
        plate, paint = m.picture(), m.any()
        parts += moved(
            car(paint, (0, 0, 0), plate), standing(x, y, 0.0, rng.choice([0.0, np.pi]) + rng.normal(0, 0.05))
        )
    for _ in range(int(rng.integers(0, 6))):
        parts += _kerbside(m, rng.uniform(-12, 12), half - rng.uniform(0.2, 1.0))
    return parts


def _house(m: Materials, x: float, front: float, size: tuple) -> list[Primitive]:
    rng = m.rng
    width, deep, high = size
    wall, frame = m.wall(), m.any()
    parts: list[Primitive] = [Box(wall, pose((x, front + deep / 2, high / 2)), size=size)]
    columns, w, h = int(width / rng.uniform(1.6, 3.5)), rng.uniform(0.7, 1.4), rng.uniform(0.8, 1.7)
    for level in range(int(high / 2.8)):
        for i in range(columns):
            at = (x - width / 2 + (i + 0.5) * width / columns, front, 1.6 + 2.8 * level)
            if rng.random() < 0.85 and len(parts) < 60:
                parts += _opening(m, at, w, h, frame, level)
    if rng.random() < 0.4:
        ledge = pose((x, front - 0.1, rng.uniform(0.3, 0.95) * high))
        parts.append(Box(frame, ledge, size=(width, 0.25, 0.2)))
    return parts


def _opening(m: Materials, at: tuple, w: float, h: float, frame: Material, level: int) -> list[Primitive]:
    x, y, z = at
    if level == 0 and m.rng.random() < 0.3:
        return [Box(m.any(), pose((x, y, 1.05)), size=(1.3 * w, 0.1, 2.1))]
    return [
        Box(frame, pose((x, y, z)), size=(w + 0.16, 0.12, h + 0.16)),
        Rectangle(m.dark_glass(), pose((x, y - 0.065, z), FRONT), width=w, height=h),
    ]


def _kerbside(m: Materials, x: float, y: float) -> list[Primitive]:
    """A tree, a post, a hedge, a bin or a passer-by."""
    rng, kind = m.rng, m.rng.integers(5)
    if kind == 0:
        leaf, top = m.any(), rng.uniform(2.0, 4.5)
        crown = [
            ellipsoid(leaf, (x + rng.normal(0, 0.5), y + rng.normal(0, 0.5), top + rng.normal(0, 0.5)),
                      rng.uniform(0.4, 1.1), rng.uniform(0.8, 1.8))
            for _ in range(6)
        ]  # fmt: skip
        return [Cylinder(m.any(), pose((x, y, top / 2)), radius=rng.uniform(0.06, 0.2), height=top), *crown]
    if kind == 1:
        high = rng.uniform(0.8, 6.0)
        return [Cylinder(m.any(), pose((x, y, high / 2)), radius=rng.uniform(0.03, 0.1), height=high)]
    if kind == 2:
        size = (rng.uniform(0.8, 4.0), 0.5, rng.uniform(0.5, 1.5))
        return [Box(m.any(), pose((x, y, size[2] / 2)), size=size)]
    if kind == 3:
        return list(moved(thing(m, 4.0), standing(x, y, 0.1)))
    cloth = m.any()
    return [
        ellipsoid(cloth, (x, y, 0.45), 0.17, 1.0),
        ellipsoid(m.any(), (x, y, 1.15), 0.24, 0.75),
        ellipsoid(m.any(), (x, y, 1.62), 0.11, 0.28),
    ]
