"""Random things, each standing on the floor of its own frame: x along its front, y backwards, z up, in metres."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from polarmap.synth import Box, Cylinder, Material, Primitive, Prism, Rectangle, Revolved, Sphere
from polarmap.synth.scenes.objects import bottle, ellipsoid, rounded_box
from polarmap.synth.scenes.placement import pose
from training.materials import Materials

Parts = tuple[Primitive, ...]
FRONT = (0.0, -1.0, 0.0)


def moved(parts: Parts, T: np.ndarray) -> Parts:
    """The parts carried by a rigid motion."""
    return tuple(replace(part, T_world_object=T @ part.T_world_object) for part in parts)


def standing(x: float, y: float, z: float, turn: float = 0.0) -> np.ndarray:
    """T of a thing that stands at a point, turned about the vertical."""
    return pose((x, y, z), turn=turn)


def block(material: Material, centre: tuple, size: tuple, rng: np.random.Generator) -> Primitive:
    """A box, its edges sharp or rounded."""
    if rng.random() < 0.6:
        return Box(material, pose(centre), size=size)
    return rounded_box(material, centre, size, float(rng.uniform(0.05, 0.3)) * min(size))


def cabinet(m: Materials) -> tuple[Parts, float]:
    """A body with fronts and knobs; returns the parts and the height of its top."""
    rng = m.rng
    width, depth, height = rng.uniform(0.4, 2.0), rng.uniform(0.3, 0.65), rng.uniform(0.4, 2.1)
    body, front, knob = m.any(), m.any(), m.any()
    parts = [block(body, (0, 0, height / 2), (width, depth, height), rng)]
    columns, rows = rng.integers(1, 4), rng.integers(1, 4)
    if rng.random() < 0.7:
        w, h = width / columns, height / rows
        for i in range(columns):
            for j in range(rows):
                centre = (-width / 2 + (i + 0.5) * w, -depth / 2 - 0.005, (j + 0.5) * h)
                parts.append(Box(front, pose(centre), size=(0.94 * w, 0.03, 0.94 * h)))
                parts.append(Sphere(knob, pose((centre[0] + 0.3 * w, -depth / 2 - 0.035, centre[2])), radius=0.015))
    return tuple(parts), height


def shelf(m: Materials) -> tuple[Parts, float]:
    """Boards between sides, with books and things on them."""
    rng = m.rng
    width, depth, height = rng.uniform(0.5, 1.8), rng.uniform(0.2, 0.45), rng.uniform(0.8, 2.2)
    wood, boards = m.any(), int(rng.integers(3, 6))
    parts = [Box(wood, pose((side * width / 2, 0, height / 2)), size=(0.03, depth, height)) for side in (-1, 1)]
    if rng.random() < 0.6:
        parts.append(Box(m.any(), pose((0, depth / 2, height / 2)), size=(width, 0.02, height)))
    spacing = height / (boards - 1)
    books = [m.any() for _ in range(4)]
    for i in range(boards):
        z = min(i * spacing + 0.015, height - 0.015)
        parts.append(Box(wood, pose((0, 0, z)), size=(width, depth, 0.03)))
        if i < boards - 1 and rng.random() < 0.75:
            parts += _row_of_books(books, width, depth, z + 0.015, 0.85 * spacing, rng)
    return tuple(parts), height


def _row_of_books(books: list, width: float, depth: float, z: float, room: float, rng) -> list[Primitive]:
    parts, x = [], -width / 2 + 0.04
    end = rng.uniform(-0.2, 0.48) * width
    while x < end and len(parts) < 14:
        thickness, height = rng.uniform(0.02, 0.09), min(rng.uniform(0.14, 0.32), room)
        deep = min(rng.uniform(0.12, 0.25), 0.95 * depth)
        centre = (x + thickness / 2, -depth / 2 + deep / 2 + rng.uniform(0.0, 0.03), z + height / 2)
        parts.append(Box(books[rng.integers(len(books))], pose(centre), size=(0.95 * thickness, deep, height)))
        x += thickness
    return parts


def table(m: Materials) -> tuple[Parts, float]:
    """A top on four legs or a foot, and things on it."""
    rng = m.rng
    width, depth, height = rng.uniform(0.5, 2.2), rng.uniform(0.4, 1.1), rng.uniform(0.35, 1.05)
    top, leg, thick = m.any(), m.any(), rng.uniform(0.02, 0.07)
    if rng.random() < 0.35:
        radius = depth / 2 + 0.1
        parts = [
            Cylinder(top, pose((0, 0, height - thick / 2)), radius=radius, height=thick),
            Cylinder(leg, pose((0, 0, height / 2)), radius=rng.uniform(0.03, 0.12), height=height - thick),
            Revolved(leg, pose((0, 0, 0.03)), rng.uniform(0.2, 0.7) * radius, 0.4 * radius, 0.1, 0.06),
        ]
        width = depth = 1.3 * radius
    else:
        parts = [block(top, (0, 0, height - thick / 2), (width, depth, thick), rng)]
        size = rng.uniform(0.03, 0.09)
        for x in (-1, 1):
            for y in (-1, 1):
                at = (x * (width / 2 - size), y * (depth / 2 - size), (height - thick) / 2)
                parts.append(Box(leg, pose(at), size=(size, size, height - thick)))
    parts += things_on(m, width, depth, height, int(rng.integers(0, 8)))
    return tuple(parts), height


def desk(m: Materials) -> tuple[Parts, float]:
    """A table with a screen, a keyboard and a lamp."""
    rng = m.rng
    width, depth, height = rng.uniform(1.0, 1.9), rng.uniform(0.6, 0.9), rng.uniform(0.68, 0.8)
    top, body, screen, plastic = m.any(), m.any(), m.dark_glass(), m.any()
    parts = [block(top, (0, 0, height), (width, depth, 0.04), rng)]
    parts += [Box(body, pose((s * (width / 2 - 0.05), 0, height / 2)), size=(0.04, depth, height)) for s in (-1, 1)]
    if rng.random() < 0.5:
        parts.append(Box(body, pose((width / 2 - 0.25, 0, 0.3)), size=(0.4, 0.9 * depth, 0.58)))
    x, w = rng.uniform(-0.3, 0.3) * width, rng.uniform(0.4, 0.7)
    T = standing(x, 0.1, height + 0.02, rng.uniform(-0.4, 0.4))
    monitor = (
        Box(plastic, pose((0, 0, 0.32)), size=(w, 0.04, 0.58 * w)),
        Rectangle(screen, pose((0, -0.021, 0.32), FRONT), width=0.95 * w, height=0.54 * w),
        Box(plastic, pose((0, 0.03, 0.1)), size=(0.06, 0.03, 0.2)),
        Box(plastic, pose((0, 0.0, 0.01)), size=(0.25, 0.18, 0.02)),
        Box(m.any(), pose((0, -0.28, 0.012)), size=(0.42, 0.14, 0.024)),
    )
    parts += moved(monitor, T)
    parts += things_on(m, width, depth, height + 0.02, int(rng.integers(1, 6)))
    return tuple(parts), height


def chair(m: Materials) -> tuple[Parts, float]:
    """Four legs, a seat and a back."""
    rng = m.rng
    width, height, back = rng.uniform(0.4, 0.6), rng.uniform(0.4, 0.5), rng.uniform(0.3, 0.6)
    seat, leg = m.any(), m.any()
    size = rng.uniform(0.02, 0.05)
    parts = [block(seat, (0, 0, height), (width, width, rng.uniform(0.03, 0.1)), rng)]
    for x in (-1, 1):
        for y in (-1, 1):
            at = (x * (width / 2 - size), y * (width / 2 - size), height / 2)
            parts.append(Cylinder(leg, pose(at), radius=size / 2, height=height))
    parts.append(block(seat, (0, width / 2, height + back / 2), (width, 0.05, back), rng))
    return tuple(parts), height


def sofa(m: Materials) -> tuple[Parts, float]:
    """Rounded blocks: seat, back, arms, cushions."""
    rng = m.rng
    width, depth, seat = rng.uniform(0.8, 2.4), rng.uniform(0.75, 1.0), rng.uniform(0.35, 0.5)
    cloth, other = m.any(), m.any()
    back, arm = rng.uniform(0.3, 0.55), rng.uniform(0.12, 0.25)
    parts = [
        rounded_box(cloth, (0, 0, seat / 2), (width, depth, seat), 0.06),
        rounded_box(cloth, (0, depth / 2 - 0.12, seat + back / 2 - 0.05), (width, 0.24, back + 0.1), 0.08),
    ]
    for side in (-1, 1):
        at = (side * (width / 2), 0, (seat + 0.2) / 2)
        parts.append(rounded_box(cloth, at, (arm, depth, seat + 0.2), 0.05))
    for _ in range(int(rng.integers(0, 4))):
        lean = (rng.uniform(-0.4, 0.4), -1.0, rng.uniform(0.2, 0.8))
        at = (rng.uniform(-0.35, 0.35) * width, depth / 2 - 0.33, seat + 0.2)
        parts.append(rounded_box(other, at, (0.42, 0.42, 0.14), 0.06, z_axis=_unit(lean)))
    return tuple(parts), seat


def bed(m: Materials) -> tuple[Parts, float]:
    """A mattress on a frame, pillows, a headboard."""
    rng = m.rng
    width, depth, height = rng.uniform(0.9, 1.9), 2.0, rng.uniform(0.4, 0.65)
    sheet, frame, pillow = m.any(), m.any(), m.any()
    parts = [
        Box(frame, pose((0, 0, height / 4)), size=(width, depth, height / 2)),
        rounded_box(sheet, (0, 0, 0.72 * height), (width, depth, 0.55 * height), 0.08),
        Box(frame, pose((0, depth / 2, height)), size=(width + 0.1, 0.06, 2 * height)),
    ]
    for x in np.linspace(-0.25, 0.25, 1 + (width > 1.2)) * width:
        parts.append(rounded_box(pillow, (x, depth / 2 - 0.3, height + 0.06), (0.6, 0.4, 0.16), 0.07))
    return tuple(parts), height


def floor_lamp(m: Materials) -> tuple[Parts, float]:
    """A pole with a shade."""
    rng = m.rng
    height, pole, radius = rng.uniform(1.2, 1.9), m.any(), rng.uniform(0.12, 0.28)
    shade = m.bright() if rng.random() < 0.5 else m.any()
    return (
        Cylinder(pole, pose((0, 0, height / 2)), radius=0.015, height=height),
        Cylinder(pole, pose((0, 0, 0.015)), radius=0.14, height=0.03),
        Revolved(shade, pose((0, 0, height)), radius, 0.8 * radius, 0.6 * radius, rng.uniform(0.2, 0.4)),
    ), height


def plant(m: Materials) -> tuple[Parts, float]:
    """A pot, a stem, a crown of ellipsoids."""
    rng = m.rng
    pot, leaf, stem = m.any(), m.any(), m.any()
    high, radius = rng.uniform(0.2, 0.5), rng.uniform(0.12, 0.25)
    top = high + rng.uniform(0.3, 1.1)
    parts = [
        Revolved(pot, pose((0, 0, high / 2)), 0.75 * radius, 0.9 * radius, radius, high),
        Cylinder(stem, pose((0, 0, (high + top) / 2)), radius=0.02, height=top - high + 0.1),
    ]
    for _ in range(int(rng.integers(3, 9))):
        at = (rng.normal(0, 0.16), rng.normal(0, 0.16), top + rng.normal(0, 0.15))
        parts.append(ellipsoid(leaf, at, rng.uniform(0.08, 0.25), rng.uniform(0.1, 0.4)))
    return tuple(parts), top


def cartons(m: Materials) -> tuple[Parts, float]:
    """A stack of boxes, each turned a little."""
    rng = m.rng
    parts, z, side = [], 0.0, rng.uniform(0.3, 0.9)
    for _ in range(int(rng.integers(1, 4))):
        size = (side * rng.uniform(0.7, 1.3), side * rng.uniform(0.6, 1.0), side * rng.uniform(0.4, 1.2))
        parts.append(Box(m.any(), standing(0, 0, z + size[2] / 2, rng.uniform(-0.4, 0.4)), size=size))
        z += size[2]
        side *= 0.85
    return tuple(parts), z


def pillar(m: Materials) -> tuple[Parts, float]:
    """A round, cornered or swelling column, with or without something on it."""
    rng = m.rng
    height, radius, stone = rng.uniform(0.4, 3.0), rng.uniform(0.08, 0.4), m.any()
    kind = rng.integers(3)
    if kind == 0:
        body = Cylinder(stone, pose((0, 0, height / 2)), radius=radius, height=height)
    elif kind == 1:
        ends = rng.uniform(0.5, 1.2, 2) * radius
        body = Revolved(stone, pose((0, 0, height / 2)), ends[0], radius, ends[1], height)
    else:
        body = polygon_prism(stone, radius, height, rng)
    parts = [body]
    if height < 1.4:
        parts += things_on(m, radius, radius, height, 1, scale=2.0)
    return tuple(parts), height


def polygon_prism(material: Material, radius: float, height: float, rng: np.random.Generator) -> Prism:
    """An upright prism on the floor, over a convex polygon of 3 to 8 corners."""
    corners = int(rng.integers(3, 9))
    angles = 2 * np.pi * (np.arange(corners) + rng.uniform(-0.25, 0.25, corners)) / corners
    outline = tuple((radius * np.cos(a), radius * np.sin(a)) for a in angles)
    rounding = float(rng.uniform(0.02, 0.2)) * min(radius, height)
    return Prism(material, pose((0, 0, height / 2)), outline, max(height - 2 * rounding, 0.01), rounding)


FURNITURE = (cabinet, shelf, table, desk, chair, sofa, bed, floor_lamp, plant, cartons, pillar)
_THINGS = ("box", "ball", "can", "bottle", "vase", "bowl", "books", "prism", "lamp")


def things_on(m: Materials, width: float, depth: float, z: float, count: int, scale: float = 1.0) -> list[Primitive]:
    """Small things strewn over a top of a size, at height z."""
    rng = m.rng
    parts: list[Primitive] = []
    for _ in range(count):
        at = standing(rng.uniform(-0.42, 0.42) * width, rng.uniform(-0.42, 0.42) * depth, z, rng.uniform(-np.pi, np.pi))
        parts += moved(thing(m, scale * float(np.exp(rng.normal(0.0, 0.35)))), at)
    return parts


def thing(m: Materials, scale: float) -> Parts:
    """One small thing, some 0.2 m high times `scale`."""
    rng, a, b = m.rng, m.any(), m.any()
    kind = _THINGS[rng.integers(len(_THINGS))]
    r, h = scale * rng.uniform(0.03, 0.1), scale * rng.uniform(0.08, 0.3)
    if kind == "box":
        size = tuple(scale * rng.uniform(0.05, 0.3, 3))
        return (block(a, (0, 0, size[2] / 2), size, rng),)
    if kind == "ball":
        return (Sphere(a, pose((0, 0, r)), radius=r),)
    if kind == "can":
        return (Cylinder(a, pose((0, 0, h / 2)), radius=r, height=h),)
    if kind == "bottle":
        return bottle(a, (0, 0, 0), 1.3 * h, 0.5 * r + 0.01, b if rng.random() < 0.5 else None)
    if kind == "vase":
        belly, neck = r, r * rng.uniform(0.3, 0.8)
        middle = float(np.sqrt((belly**2 + neck**2) / 2))
        return (
            Revolved(a, pose((0, 0, h / 4)), 0.6 * belly, 0.92 * belly, belly, h / 2),
            Revolved(a, pose((0, 0, 0.7 * h)), belly, middle, neck, 0.4 * h),
        )
    if kind == "bowl":
        return (Revolved(a, pose((0, 0, h / 4)), 0.5 * r, 1.1 * r, 1.5 * r, h / 2),)
    if kind == "books":
        z, parts = 0.0, []
        for _ in range(int(rng.integers(1, 5))):
            t = rng.uniform(0.015, 0.05)
            parts.append(Box(m.any(), standing(0, 0, z + t / 2, rng.uniform(-0.5, 0.5)), size=(0.22, 0.16, t)))
            z += t
        return tuple(parts)
    if kind == "prism":
        return (polygon_prism(a, r, h, rng),)
    return (
        Cylinder(a, pose((0, 0, h / 2)), radius=0.15 * r + 0.005, height=h),
        Revolved(b, pose((0, 0, 1.2 * h)), 1.4 * r, 1.1 * r, 0.8 * r, 0.5 * h),
    )


def _unit(a: tuple) -> tuple:
    return tuple(np.asarray(a) / np.linalg.norm(a))
