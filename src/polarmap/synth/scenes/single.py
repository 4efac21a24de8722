"""Single surfaces with known answers.

They stand in the frame of a camera at the origin (z forward, y down), so that `np.eye(4)` is the pose that sees them.
"""

from __future__ import annotations

import numpy as np

from polarmap.synth.scene import Cylinder, Material, PointLight, Rectangle, Scene, Sphere
from polarmap.synth.scenes.placement import Point, pose

MATTE = Material("matte", albedo=0.6, gloss=0.0)  # diffuse reflection only
BLACK_GLASS = Material("black glass", albedo=0.0)  # specular reflection only
PLASTIC = Material("plastic", albedo=0.5)  # both, added
LAMP = PointLight(position=(0.6, -0.8, -0.3), intensity=4.0)  # above and beside a camera at the origin
_DOWN = (0.0, 1.0, 0.0)  # in a camera's frame
_FAR = 100.0  # metres; a half plane's extent from its border


def plane(material: Material = MATTE, distance: float = 2.0, tilt: float = 0.6, azimuth: float = 0.5) -> Scene:
    """An infinite plane that meets the optical axis at `distance` metres.

    Its normal makes the angle `tilt` with the axis towards the camera and points in the image toward `azimuth`.
    """
    normal = (np.sin(tilt) * np.cos(azimuth), np.sin(tilt) * np.sin(azimuth), -np.cos(tilt))
    return Scene((Rectangle(material, pose((0.0, 0.0, distance), normal)),), LAMP)


def sphere(material: Material = MATTE, centre: Point = (0.2, -0.1, 2.0), radius: float = 0.6) -> Scene:
    """A sphere before nothing."""
    return Scene((Sphere(material, pose(centre), radius=radius),), LAMP)


def cylinder(
    material: Material = MATTE, centre: Point = (0.1, 0.0, 2.0), radius: float = 0.5, height: float = 1.4
) -> Scene:
    """An upright cylinder before nothing, its axis along the image's y."""
    return Scene((Cylinder(material, pose(centre, (0.0, 1.0, 0.0)), radius=radius, height=height),), LAMP)


def edge(near: Material = MATTE, far: Material = MATTE, distance: float = 1.5, gap: float = 1.0) -> Scene:
    """A half plane on the image's left before a whole plane, `gap` metres behind it on the optical axis.

    The border is the image's column x = 0; the near plane is tilted about x, the far one about y, by 0.5 radians.
    """
    sine, cosine = np.sin(0.5), np.cos(0.5)
    near_pose = pose((-_FAR / 2, 0.0, distance), (0.0, sine, -cosine), _DOWN)
    far_pose = pose((0.0, 0.0, distance + gap), (-sine, 0.0, -cosine))
    return Scene((Rectangle(near, near_pose, width=_FAR), Rectangle(far, far_pose)), LAMP)


def corner(left: Material = MATTE, right: Material = MATTE, distance: float = 2.0, turn: float = 0.6) -> Scene:
    """Two half planes that meet in the image's column x = 0 at `distance` metres, without a gap.

    Either recedes from there by the angle `turn`, like the corner of a house; a negative one makes it a room's.
    """
    sine, cosine = np.sin(turn), np.cos(turn)
    middle = np.array([cosine, 0.0, sine]) * _FAR / 2
    left_pose = pose((-middle[0], 0.0, distance + middle[2]), (-sine, 0.0, -cosine), _DOWN)
    right_pose = pose((middle[0], 0.0, distance + middle[2]), (sine, 0.0, -cosine), _DOWN)
    return Scene((Rectangle(left, left_pose, width=_FAR), Rectangle(right, right_pose, width=_FAR)), LAMP)
