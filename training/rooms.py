"""Random rooms and corridors: a plan, walls, a ceiling of some shape, and what stands, hangs and lies in them."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from polarmap.synth import Box, Cylinder, Material, PointLight, Primitive, Rectangle, Revolved, Scene
from polarmap.synth.scenes.objects import rounded_box
from polarmap.synth.scenes.placement import pose
from training.furniture import FRONT, FURNITURE, Parts, moved, standing, table, thing, things_on
from training.materials import Materials

_ABOVE = 3.0  # metres by which walls pass the height at which ceilings begin, which hides what is over them


@dataclass(frozen=True)
class Place:
    """A scene, and where cameras may be in it.

    plan: corners of the free floor, counter-clockwise, N×2. height: largest height of the eye, metres.
    focuses: points worth looking at, N×3.
    """

    scene: Scene
    plan: np.ndarray
    height: float
    focuses: np.ndarray


def room(m: Materials, images: np.ndarray) -> Place:
    """A room: box, L-shape or one with cut corners, furnished."""
    rng = m.rng
    width, depth = np.exp(rng.uniform(np.log(2.2), np.log(9.0), 2))
    return _furnished(m, _plan(width, depth, rng), rng.uniform(2.1, 3.8), images, things=int(rng.integers(2, 20)))


def islands(m: Materials, images: np.ndarray) -> Place:
    """A room with a few pieces, mostly tables, that stand free in the middle and have things on them."""
    rng = m.rng
    width, depth = np.exp(rng.uniform(np.log(3.0), np.log(8.0), 2))
    place = _furnished(m, _plan(width, depth, rng), rng.uniform(2.2, 4.0), images, things=int(rng.integers(0, 8)))
    parts, focuses = [], []
    for _ in range(int(rng.integers(1, 5))):
        piece, top = (table if rng.random() < 0.6 else FURNITURE[rng.integers(len(FURNITURE))])(m)
        if top < 1.3:
            piece += tuple(things_on(m, 0.6, 0.4, top, int(rng.integers(0, 6))))
        x, y = _inside(0.6 * (place.plan - place.plan.mean(axis=0)) + place.plan.mean(axis=0), rng)
        parts += moved(piece, standing(x, y, 0.0, rng.uniform(-np.pi, np.pi)))
        focuses.append((x, y, top))
    scene = replace(place.scene, primitives=(*place.scene.primitives, *parts))
    return Place(scene, place.plan, place.height, np.array(focuses))


def corridor(m: Materials, images: np.ndarray) -> Place:
    """Long and narrow, with doors, few things on the floor."""
    rng = m.rng
    width, depth = rng.uniform(1.2, 2.8), rng.uniform(5.0, 20.0)
    plan = np.array([(0, 0), (width, 0), (width, depth), (0, depth)]) - (width / 2, depth / 2)
    return _furnished(m, plan, rng.uniform(2.1, 3.2), images, things=int(rng.integers(0, 8)), doors=0.5)


def _plan(width: float, depth: float, rng: np.random.Generator) -> np.ndarray:
    w, d = width / 2, depth / 2
    kind = rng.random()
    if kind < 0.6:
        return np.array([(-w, -d), (w, -d), (w, d), (-w, d)])
    cut_w, cut_d = rng.uniform(0.2, 0.6) * width, rng.uniform(0.2, 0.6) * depth
    if kind < 0.85:
        corners = [(-w, -d), (w, -d), (w, d - cut_d), (w - cut_w, d - cut_d), (w - cut_w, d), (-w, d)]
    else:
        corners = [(-w, -d), (w, -d), (w, d - cut_d), (w - cut_w, d), (-w, d)]
    plan = np.array(corners)
    if rng.random() < 0.5:
        plan = plan[::-1] * (-1.0, 1.0)
    return plan * 1.0


def _furnished(
    m: Materials, plan: np.ndarray, height: float, images: np.ndarray, things: int, doors: float = 0.2
) -> Place:
    rng = m.rng
    parts = [*_floor(m, plan), *_walls(m, plan, height, doors), *_ceiling(m, plan, height)]
    focuses = []
    for _ in range(things):
        placed, focus = _placed(m, plan)
        parts += placed
        focuses.append(focus)
    for _ in range(int(rng.integers(0, 6))):
        x, y = _inside(plan, rng)
        parts += moved(thing(m, rng.uniform(0.5, 2.5)), standing(x, y, 0.0, rng.uniform(-3, 3)))
    focuses.append((*plan.mean(axis=0), height / 2))
    return Place(Scene(tuple(parts), _lights(plan, height, rng), rng.uniform(0.3, 2.0), images), plan, height,
                 np.array(focuses))  # fmt: skip


def _lights(plan: np.ndarray, height: float, rng: np.random.Generator) -> tuple[PointLight, ...]:
    """Lamps under the ceiling or elsewhere; several near each other make soft shadows."""
    lights = []
    for _ in range(int(rng.integers(0, 5))):
        x, y = _inside(plan, rng)
        z = 0.93 * height if rng.random() < 0.6 else rng.uniform(0.4, 0.93) * height
        power, spread = np.exp(rng.uniform(np.log(2.0), np.log(40.0))), rng.uniform(0.02, 0.4)
        copies = int(rng.integers(1, 4))
        for _ in range(copies):
            at = tuple(np.array([x, y, z]) + rng.normal(0, spread, 3) * (1, 1, 0.2))
            lights.append(PointLight(at, power / copies, shadows=bool(rng.random() < 0.85)))
    return tuple(lights)


def _floor(m: Materials, plan: np.ndarray) -> list[Primitive]:
    rng = m.rng
    parts: list[Primitive] = [Rectangle(m.floor(), pose((0, 0, 0), turn=rng.choice([0.0, 0.0, 0.6])))]
    for _ in range(int(rng.integers(0, 3))):
        x, y = _inside(plan, rng)
        at = pose((x, y, rng.uniform(0.003, 0.02)), turn=rng.uniform(-0.3, 0.3))
        parts.append(Rectangle(m.picture(), at, width=rng.uniform(0.8, 3.0), height=rng.uniform(0.8, 2.5)))
    return parts


def _ceiling(m: Materials, plan: np.ndarray, height: float) -> list[Primitive]:
    rng, paint = m.rng, m.wall()
    low, high = plan.min(axis=0), plan.max(axis=0)
    kind = rng.random()
    parts: list[Primitive] = []
    if kind < 0.7:
        parts.append(Rectangle(paint, pose((0, 0, height))))
    else:
        axis, slope = int(rng.integers(2)), np.tan(np.radians(rng.uniform(8, 45)))
        along = np.eye(2)[axis]
        sides = (1.0, -1.0) if kind < 0.85 else (1.0,)
        for side in sides:  # rising from the eaves at one wall, or from both to a ridge
            eaves = low if side > 0 else high
            normal = np.array([*(-side * slope * along), 1.0])
            at = (*(along * eaves), max(0.55 * height, 0.9))
            parts.append(
                Rectangle(m.wall() if rng.random() < 0.3 else paint, pose(at, tuple(normal / np.linalg.norm(normal))))
            )
        if rng.random() < 0.5:
            parts.append(Rectangle(paint, pose((0, 0, height))))
    parts += _under_ceiling(m, low, high, height)
    return parts


def _under_ceiling(m: Materials, low: np.ndarray, high: np.ndarray, height: float) -> list[Primitive]:
    """Beams, panels, pipes and lamps."""
    rng, size, middle = m.rng, high - low, (low + high) / 2
    parts: list[Primitive] = []
    if rng.random() < 0.25:
        wood, thick, axis = m.any(), rng.uniform(0.08, 0.3), int(rng.integers(2))
        for s in np.arange(low[axis], high[axis], rng.uniform(0.6, 2.0))[:12]:
            centre, extent = middle.copy(), np.array([thick, thick])
            centre[axis], extent[1 - axis] = s, size[1 - axis]
            parts.append(Box(wood, pose((*centre, height - thick / 2)), size=(*extent, thick)))
    if rng.random() < 0.4:
        panel, w, d = m.bright(), rng.uniform(0.15, 0.7), rng.uniform(0.3, 1.4)
        pitch = np.array([w, d]) + rng.uniform(0.5, 1.8)
        for x in np.arange(low[0] + pitch[0] / 2, high[0], pitch[0])[:4]:
            for y in np.arange(low[1] + pitch[1] / 2, high[1], pitch[1])[:5]:
                parts.append(Box(panel, pose((x, y, height)), size=(w, d, 0.08)))
    if rng.random() < 0.3:
        parts += _tile_joints(m.any(), low, high, height, rng.uniform(0.4, 1.3, 2))
    if rng.random() < 0.2:
        pipe, radius = m.any(), rng.uniform(0.04, 0.25)
        for _ in range(int(rng.integers(1, 4))):
            x = rng.uniform(low[0], high[0])
            at = pose((x, middle[1], height - radius - rng.uniform(0, 0.3)), (0, 1, 0))
            parts.append(Cylinder(pipe, at, radius=radius, height=size[1]))
    for _ in range(int(rng.integers(0, 3)) if rng.random() < 0.5 else 0):
        x, y = rng.uniform(low, high)
        drop, radius = rng.uniform(0.1, 1.0), rng.uniform(0.1, 0.35)
        parts += [
            Cylinder(m.any(), pose((x, y, height - drop / 2)), radius=0.01, height=drop),
            Revolved(m.bright(), pose((x, y, height - drop)), radius, 0.8 * radius, 0.2 * radius, 0.8 * radius),
        ]
    return parts


def _tile_joints(material: Material, low: np.ndarray, high: np.ndarray, height: float, pitch) -> list[Primitive]:
    """The thin strips between the panels of a suspended ceiling."""
    parts: list[Primitive] = []
    for axis in (0, 1):
        for s in np.arange(low[axis], high[axis], pitch[axis])[:16]:
            centre, size = (low + high) / 2, np.array([0.02, 0.02])
            centre[axis], size[1 - axis] = s, high[1 - axis] - low[1 - axis]
            parts.append(Box(material, pose((*centre, height)), size=(*size, 0.012)))
    return parts


def _walls(m: Materials, plan: np.ndarray, height: float, doors: float) -> list[Primitive]:
    rng, common = m.rng, m.wall()
    parts: list[Primitive] = []
    board = m.any() if rng.random() < 0.5 else None
    rail = m.any() if rng.random() < 0.2 else None
    alike = rng.random() < 0.5
    for start, end in zip(plan, np.roll(plan, -1, axis=0), strict=True):
        length = float(np.linalg.norm(end - start))
        paint = common if alike or rng.random() < 0.5 else m.wall()
        T = _against(start, end, 0.5 * length)
        own = [Rectangle(paint, pose((0, 0, (height + _ABOVE) / 2), FRONT), width=length, height=height + _ABOVE)]
        if board is not None:
            own.append(Box(board, pose((0, -0.01, 0.05)), size=(length, 0.02, 0.1)))
        if rail is not None:
            own.append(Box(rail, pose((0, -0.02, 1.0)), size=(length, 0.04, 0.08)))
        parts += moved(tuple(own), T)
        slots = np.arange(0.2, length - 0.6, rng.uniform(0.9, 2.2))
        for slot in slots[:10]:
            parts += moved(_on_wall(m, height, doors), _against(start, end, slot + rng.uniform(0.4, 0.8)))
    return parts


def _against(start: np.ndarray, end: np.ndarray, along: float) -> np.ndarray:
    """T of what stands against a wall of a counter-clockwise plan, its back (+y) at the wall."""
    t = (end - start) / np.linalg.norm(end - start)
    T = np.eye(4)
    T[:2, 0], T[:2, 1] = -t, (t[1], -t[0])
    T[:2, 3] = start + along * t
    return T


def _on_wall(m: Materials, height: float, doors: float) -> Parts:
    rng = m.rng
    if rng.random() < doors:
        return _door(m)
    kinds = (_picture, _window, _radiator, _wall_shelf, _curtain, _clock, _niche)
    return kinds[rng.integers(len(kinds))](m, height) if rng.random() < 0.45 else ()


def _door(m: Materials) -> Parts:
    rng = m.rng
    width, high = rng.uniform(0.7, 1.1), rng.uniform(1.9, 2.2)
    leaf, frame, knob = m.any(), m.any(), m.any()
    parts = [
        Box(frame, pose((0, -0.02, high / 2)), size=(width + 0.16, 0.06, high + 0.08)),
        Box(leaf, pose((0, -0.045, high / 2)), size=(width, 0.05, high - 0.02)),
        Cylinder(knob, pose((0.4 * width, -0.09, 1.0), (1, 0, 0)), radius=0.012, height=0.12),
    ]
    if rng.random() < 0.5:
        for z in (0.28, 0.7):
            parts.append(rounded_box(leaf, (0, -0.07, z * high), (0.7 * width, 0.03, 0.3 * high), 0.01))
    return tuple(parts)


def _picture(m: Materials, height: float) -> Parts:
    rng = m.rng
    w, h, z = rng.uniform(0.25, 1.4), rng.uniform(0.25, 1.1), rng.uniform(1.2, 1.8)
    return (
        Box(m.any(), pose((0, -0.01, z)), size=(w + 0.08, 0.03, h + 0.08)),
        Rectangle(m.picture(), pose((0, -0.027, z), FRONT), width=w, height=h),
    )


def _window(m: Materials, height: float) -> Parts:
    rng = m.rng
    w, h = rng.uniform(0.6, 2.4), rng.uniform(0.6, 1.6)
    z = max(rng.uniform(0.8, 1.1) + h / 2, 0.0)
    frame, pane = m.any(), m.bright() if rng.random() < 0.6 else m.dark_glass()
    parts = [Rectangle(pane, pose((0, -0.005, z), FRONT), width=w, height=h)]
    for side in (-1, 1):
        parts.append(Box(frame, pose((side * w / 2, -0.03, z)), size=(0.06, 0.06, h + 0.06)))
        parts.append(Box(frame, pose((0, -0.03, z + side * h / 2)), size=(w, 0.06, 0.06)))
    for x in np.linspace(-w / 2, w / 2, int(rng.integers(2, 5)))[1:-1]:
        parts.append(Box(frame, pose((x, -0.02, z)), size=(0.04, 0.04, h)))
    if rng.random() < 0.5:
        parts.append(Box(frame, pose((0, -0.1, z - h / 2 - 0.05)), size=(w + 0.2, 0.2, 0.04)))
    return tuple(parts)


def _radiator(m: Materials, height: float) -> Parts:
    rng, paint, n = m.rng, m.any(), 12
    w = rng.uniform(0.6, 1.6)
    fins = [Box(paint, pose((x, -0.08, 0.4)), size=(0.6 * w / n, 0.1, 0.6)) for x in np.linspace(-w / 2, w / 2, n)]
    return (*fins, Box(paint, pose((0, -0.05, 0.4)), size=(w, 0.02, 0.5)))


def _wall_shelf(m: Materials, height: float) -> Parts:
    rng = m.rng
    w, z, deep = rng.uniform(0.5, 1.6), rng.uniform(1.0, 1.8), rng.uniform(0.15, 0.35)
    board = Box(m.any(), pose((0, -deep / 2, z)), size=(w, deep, 0.03))
    things = things_on(m, w, 0.5 * deep, z + 0.015, int(rng.integers(1, 6)))
    return (board, *moved(tuple(things), standing(0, -deep / 2, 0)))


def _curtain(m: Materials, height: float) -> Parts:
    rng, cloth = m.rng, m.any()
    w, n = rng.uniform(0.4, 1.5), int(rng.integers(4, 10))
    r = 0.6 * w / n
    top = min(height - 0.1, 2.4)
    return tuple(
        Cylinder(cloth, pose((x, -0.08 - rng.uniform(0, 0.03), top / 2)), radius=r, height=top)
        for x in np.linspace(-w / 2, w / 2, n)
    )


def _clock(m: Materials, height: float) -> Parts:
    return (Cylinder(m.any(), pose((0, -0.02, 1.7), FRONT), radius=m.rng.uniform(0.1, 0.25), height=0.05),)


def _niche(m: Materials, height: float) -> Parts:
    """A block of wall that stands out: a chimney breast or a pier."""
    rng = m.rng
    deep, high = rng.uniform(0.1, 0.7), rng.choice([height + _ABOVE, 1.2])
    return (Box(m.wall(), pose((0, -deep / 2, high / 2)), size=(rng.uniform(0.3, 1.6), deep, high)),)


def _placed(m: Materials, plan: np.ndarray) -> tuple[Parts, tuple]:
    """A piece of furniture against a wall or anywhere, and the middle of its top."""
    rng = m.rng
    parts, top = FURNITURE[rng.integers(len(FURNITURE))](m)
    if top < 1.3 and rng.random() < 0.4:
        parts += tuple(things_on(m, 0.5, 0.3, top, int(rng.integers(1, 4))))
    if rng.random() < 0.65:
        i = int(rng.integers(len(plan)))
        start, end = plan[i], plan[(i + 1) % len(plan)]
        length = np.linalg.norm(end - start)
        T = _against(start, end, rng.uniform(0.05, 0.95) * length)
        T[:2, 3] -= T[:2, 1] * rng.uniform(0.2, 0.5)
        T[:3, :3] = T[:3, :3] @ standing(0, 0, 0, rng.normal(0, 0.05))[:3, :3]
    else:
        x, y = _inside(plan, rng)
        T = standing(x, y, 0.0, rng.uniform(-np.pi, np.pi))
    return moved(parts, T), (T[0, 3], T[1, 3], top)


def _inside(plan: np.ndarray, rng: np.random.Generator, margin: float = 0.0) -> np.ndarray:
    """A point within a plan, drawn evenly from it."""
    low, high = plan.min(axis=0), plan.max(axis=0)
    for _ in range(200):
        point = rng.uniform(low, high)
        if is_inside(plan, point, margin):
            return point
    return plan.mean(axis=0)


def is_inside(plan: np.ndarray, point: np.ndarray, margin: float) -> bool:
    """Whether a point is within a counter-clockwise plan, `margin` from all its walls. Even-odd rule."""
    a, b = plan, np.roll(plan, -1, axis=0)
    along = b - a
    s = np.clip(((point - a) * along).sum(axis=1) / (along * along).sum(axis=1), 0.0, 1.0)
    if np.linalg.norm(point - a - s[:, None] * along, axis=1).min() < margin:
        return False
    crosses = (a[:, 1] > point[1]) != (b[:, 1] > point[1])
    with np.errstate(divide="ignore", invalid="ignore"):
        x = a[:, 0] + (point[1] - a[:, 1]) / along[:, 1] * along[:, 0]
    return bool(np.count_nonzero(crosses & (x > point[0])) % 2)
