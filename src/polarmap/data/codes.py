"""Codes that images of labels hold."""

from __future__ import annotations

from enum import Enum, IntEnum


class Origin(IntEnum):
    """Where a pixel's depth comes from.

    STEREO: a stereo point, which the depth agrees with. PROPAGATED: a walk along contours, or a plane that stereo
    points elsewhere lie on. ESTIMATED: a walk across contours, or the free surface.
    """

    NONE = 0
    STEREO = 1
    PROPAGATED = 2
    ESTIMATED = 3


class Status(Enum):
    """What odometry knows about a frame."""

    STARTING = "starting"  # no map yet: waiting for parallax
    TRACKED = "tracked"
    LOST = "lost"


class Reflection(IntEnum):
    """Kind of reflection that dominates a pixel's polarization."""

    NONE = 0
    DIFFUSE = 1
    SPECULAR = 2
    METAL = 3
