"""Scenes that come with the package: a mostly bare room, and single surfaces with known answers.

The single surfaces stand in the frame of a camera at the origin (z forward, y down), so that `np.eye(4)` is the pose
that sees them; the room's world has z up and its floor's centre at the origin.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.errors import InputError
from polarmap.synth.path import handheld_path
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

Point = tuple[float, float, float]

MATTE = Material("matte", albedo=0.6, gloss=0.0)  # diffuse reflection only
BLACK_GLASS = Material("black glass", albedo=0.0)  # specular reflection only
PLASTIC = Material("plastic", albedo=0.5)  # both, added
LAMP = PointLight(position=(0.6, -0.8, -0.3), intensity=4.0)  # above and beside a camera at the origin
_DOWN = (0.0, 1.0, 0.0)  # in a camera's frame
_FAR = 100.0  # metres; a half plane's extent from its border


@dataclass(frozen=True, eq=False)
class BuiltInScene:
    """A scene and from where to look at it; `up` is upward in the image."""

    scene: Scene
    eye: Point
    target: Point
    up: Point = (0.0, 0.0, 1.0)

    def path(
        self, frames: int = 24, step: float = 0.04, frame_rate: float = 30.0, seed: int = 0
    ) -> tuple[np.ndarray, np.ndarray]:
        """Timestamps and T_world_camera of a `handheld_path` through the scene."""
        return handheld_path(self.eye, self.target, self.up, frames, step, frame_rate, seed)


def built_in_scene(name: str) -> BuiltInScene:
    """The scene of that name: room, plane, sphere, cylinder, edge or corner; InputError where there is none."""
    if name == "room":
        return BuiltInScene(room(), eye=(-0.9, -1.3, 1.45), target=(1.15, 1.95, 0.95))
    makers = {"plane": plane, "sphere": sphere, "cylinder": cylinder, "edge": edge, "corner": corner}
    if name not in makers:
        raise InputError(f"synthetic scene: {name!r} is not one of room, {', '.join(makers)}")
    return BuiltInScene(makers[name](), eye=(0.0, 0.0, 0.0), target=(0.0, 0.0, 2.0), up=(0.0, -1.0, 0.0))


def plane(material: Material = MATTE, distance: float = 2.0, tilt: float = 0.6, azimuth: float = 0.5) -> Scene:
    """An infinite plane that meets the optical axis at `distance` metres.

    Its normal makes the angle `tilt` with the axis towards the camera and points in the image toward `azimuth`.
    """
    normal = (np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt))
    return Scene((Rectangle(material, _pose((0.0, 0.0, distance), normal)),), LAMP)


def sphere(material: Material = MATTE, centre: Point = (0.2, -0.1, 2.0), radius: float = 0.6) -> Scene:
    """A sphere before nothing."""
    return Scene((Sphere(material, _pose(centre), radius=radius),), LAMP)


def cylinder(
    material: Material = MATTE, centre: Point = (0.1, 0.0, 2.0), radius: float = 0.5, height: float = 1.4
) -> Scene:
    """An upright cylinder before nothing, its axis along the image's y."""
    return Scene((Cylinder(material, _pose(centre, (0.0, 1.0, 0.0)), radius=radius, height=height),), LAMP)


def edge(near: Material = MATTE, far: Material = MATTE, distance: float = 1.5, gap: float = 1.0) -> Scene:
    """A half plane on the image's left before a whole plane, `gap` metres behind it on the optical axis.

    The border is the image's column x = 0; the near plane is tilted about x, the far one about y, by 0.5 radians.
    """
    sine, cosine = np.sin(0.5), np.cos(0.5)
    near_pose = _pose((-_FAR / 2, 0.0, distance), (0.0, sine, -cosine), _DOWN)
    far_pose = _pose((0.0, 0.0, distance + gap), (-sine, 0.0, -cosine))
    return Scene((Rectangle(near, near_pose, width=_FAR), Rectangle(far, far_pose)), LAMP)


def corner(left: Material = MATTE, right: Material = MATTE, distance: float = 2.0, turn: float = 0.6) -> Scene:
    """Two half planes that meet in the image's column x = 0 at `distance` metres, without a gap.

    Either recedes from there by the angle `turn`, like the corner of a house; a negative one makes it a room's.
    """
    sine, cosine = np.sin(turn), np.cos(turn)
    middle = np.array([cosine, 0.0, sine]) * _FAR / 2
    left_pose = _pose((-middle[0], 0.0, distance + middle[2]), (-sine, 0.0, -cosine), _DOWN)
    right_pose = _pose((middle[0], 0.0, distance + middle[2]), (sine, 0.0, -cosine), _DOWN)
    return Scene((Rectangle(left, left_pose, width=_FAR), Rectangle(right, right_pose, width=_FAR)), LAMP)


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
        Rectangle(floor, _pose((0.0, 0.0, 0.0), (0.0, 0.0, 1.0)), width=5.0, height=5.0),
        Rectangle(ceiling, _pose((0.0, 0.0, 2.5), (0.0, 0.0, -1.0)), width=5.0, height=5.0),
        Rectangle(wall, _pose((0.0, 2.5, 1.25), (0.0, -1.0, 0.0)), width=5.0, height=2.5),
        Rectangle(wall, _pose((0.0, -2.5, 1.25), (0.0, 1.0, 0.0)), width=5.0, height=2.5),
        Rectangle(wainscot, _pose((-2.5, 0.0, 1.25), (1.0, 0.0, 0.0)), width=5.0, height=2.5),
        Rectangle(wainscot, _pose((2.5, 0.0, 1.25), (-1.0, 0.0, 0.0)), width=5.0, height=2.5),
    )


def _pictures() -> tuple[Primitive, ...]:
    """Two framed pictures on the far wall, a poster on either side, a rug."""
    frame = Material("frame", albedo=0.08)
    picture = Material("picture", albedo=0.45, texture=_noise(0.16, seed=1), gloss=0.9)
    poster = Material("poster", albedo=0.5, texture=_noise(0.2, seed=2), gloss=0.5)
    rug = Material("rug", albedo=0.35, texture=_noise(0.12, seed=3), gloss=0.1)
    return (
        Box(frame, _pose((-0.6, 2.485, 1.6)), size=(1.3, 0.03, 1.0)),
        Rectangle(picture, _pose((-0.6, 2.465, 1.6), (0.0, -1.0, 0.0)), width=1.2, height=0.9),
        Box(frame, _pose((1.35, 2.485, 1.55)), size=(1.4, 0.03, 1.0)),
        Rectangle(picture, _pose((1.35, 2.465, 1.55), (0.0, -1.0, 0.0)), width=1.3, height=0.9),
        Rectangle(poster, _pose((-2.495, 1.3, 1.3), (1.0, 0.0, 0.0)), width=1.2, height=1.4),
        Rectangle(poster, _pose((2.495, 1.1, 1.4), (-1.0, 0.0, 0.0)), width=1.5, height=1.2),
        Rectangle(rug, _pose((0.45, 0.75, 0.005)), width=2.6, height=1.8),
    )


def _furniture() -> tuple[Primitive, ...]:
    """A cabinet, a crate and a column, with spheres and a vase on them; half of them bare."""
    lacquer = Material("lacquer", albedo=0.1)
    plaster = Material("plaster", albedo=0.6, gloss=0.6)
    ceramic = Material("ceramic", albedo=0.3, shininess=120.0)
    wood = Material("wood", albedo=0.35, texture=_noise(0.1, seed=4), gloss=0.4)
    marble = Material("marble", albedo=0.45, texture=_noise(0.08, seed=5))
    stripes = Material("stripes", albedo=0.45, texture=Texture(Pattern.STRIPES, size=0.03, contrast=0.7))
    return (
        Box(lacquer, _pose((0.2, 2.2, 0.45)), size=(1.0, 0.5, 0.9)),
        Cylinder(stripes, _pose((0.0, 2.15, 1.08)), radius=0.11, height=0.36),
        Sphere(marble, _pose((0.45, 2.15, 1.04)), radius=0.14),
        Box(wood, _pose((1.6, 1.6, 0.3), turn=0.45), size=(0.7, 0.6, 0.6)),
        Sphere(ceramic, _pose((1.6, 1.6, 0.86)), radius=0.26),
        Cylinder(plaster, _pose((-0.65, 1.55, 0.5)), radius=0.24, height=1.0),
        Sphere(marble, _pose((-0.65, 1.55, 1.2)), radius=0.2),
        Sphere(plaster, _pose((1.1, 0.75, 0.165)), radius=0.16),
    )


def _noise(size: float, seed: int) -> Texture:
    return Texture(Pattern.NOISE, size=size, contrast=0.9, octaves=5, seed=seed)


def _pose(centre: Point, z_axis: Point = (0.0, 0.0, 1.0), up: Point = (0.0, 0.0, 1.0), turn: float = 0.0) -> np.ndarray:
    """T_world_object with the object's z along `z_axis` and its x level, then turned about z by `turn`."""
    z = np.asarray(z_axis, float)
    x = np.cross(up, z)
    x = x / np.linalg.norm(x) if np.linalg.norm(x) > 1e-6 else np.array([1.0, 0.0, 0.0])
    y = np.cross(z, x)
    T = np.eye(4)
    T[:3, :3] = np.stack([np.cos(turn) * x + np.sin(turn) * y, np.cos(turn) * y - np.sin(turn) * x, z], axis=1)
    T[:3, 3] = centre
    return T
