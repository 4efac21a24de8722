"""Scenes that come with the package, by name: whole ones that are mostly bare, and single surfaces."""

from __future__ import annotations

from collections.abc import Callable

from polarmap.errors import InputError
from polarmap.synth.scene import Scene
from polarmap.synth.scenes.bare_room import built_in_bare_room
from polarmap.synth.scenes.built_in import BuiltInScene
from polarmap.synth.scenes.corridor import built_in_corridor
from polarmap.synth.scenes.metals import built_in_metals
from polarmap.synth.scenes.room import built_in_room, room
from polarmap.synth.scenes.single import BLACK_GLASS, LAMP, MATTE, PLASTIC, corner, cylinder, edge, plane, sphere
from polarmap.synth.scenes.street import built_in_street
from polarmap.synth.scenes.table import built_in_table
from polarmap.synth.scenes.things import built_in_things

__all__ = [
    "BLACK_GLASS",
    "LAMP",
    "MATTE",
    "PLASTIC",
    "SCENES",
    "BuiltInScene",
    "built_in_scene",
    "corner",
    "cylinder",
    "edge",
    "plane",
    "room",
    "sphere",
]


def built_in_scene(name: str) -> BuiltInScene:
    """The scene of that name, one of `SCENES`; InputError where there is none."""
    if name not in SCENES:
        raise InputError(f"synthetic scene: {name!r} is not one of {', '.join(SCENES)}")
    make, _ = SCENES[name]
    return make()


def _before_the_camera(make: Callable[[], Scene]) -> Callable[[], BuiltInScene]:
    return lambda: BuiltInScene(make(), eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, 2.0), up=(0.0, -1.0, 0.0), step=0.04)


SCENES: dict[str, tuple[Callable[[], BuiltInScene], str]] = {
    "bare-room": (built_in_bare_room, "a living room with bare walls and a few textured things"),
    "corridor": (built_in_corridor, "an office corridor with texture only at its ends"),
    "table": (built_in_table, "a lacquered table top with bottles, ceramics and fruit"),
    "things": (built_in_things, "glossy, curved things close together on a table; has an arc"),
    "metals": (built_in_metals, "metal and plastic spheres and cylinders on a table"),
    "street": (built_in_street, "a street side under an overcast sky: a car, garage doors, house walls that recede"),
    "room": (built_in_room, "the small room of the demo"),
    "plane": (_before_the_camera(plane), "one matte surface before the camera"),
    "sphere": (_before_the_camera(sphere), "one matte surface before the camera"),
    "cylinder": (_before_the_camera(cylinder), "one matte surface before the camera"),
    "edge": (_before_the_camera(edge), "a half plane before another"),
    "corner": (_before_the_camera(corner), "two half planes that meet"),
}
"""What makes each scene, and what it shows in a line."""
