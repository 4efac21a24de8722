"""Dense mapping with a moving polarization camera."""

import os
from importlib import import_module
from typing import TYPE_CHECKING

from polarmap.errors import InputError, PolarmapError

# OpenMP's threads wait for each other by spinning, which makes kernels several times slower where another program
# wants the cores. Read when Numba loads; with this few turns nothing is lost on an idle machine.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

if TYPE_CHECKING:
    from polarmap.data.keyframe import Keyframe
    from polarmap.data.map import Map
    from polarmap.geometry.camera import PinholeCamera
    from polarmap.io.formats.trajectory import read_trajectory
    from polarmap.io.recording.ros.opening import open_bag
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.odometry.odometry import Odometry
    from polarmap.pipeline.config import Config
    from polarmap.pipeline.mapper import Mapper
    from polarmap.pipeline.poses.found import odometry_poses
    from polarmap.prior.priors import make_prior
    from polarmap.sensing.front_end import FrontEnd

_HOMES = {
    "Config": "polarmap.pipeline.config",
    "FrontEnd": "polarmap.sensing.front_end",
    "Keyframe": "polarmap.data.keyframe",
    "Map": "polarmap.data.map",
    "Mapper": "polarmap.pipeline.mapper",
    "Odometry": "polarmap.odometry.odometry",
    "PinholeCamera": "polarmap.geometry.camera",
    "make_prior": "polarmap.prior.priors",
    "odometry_poses": "polarmap.pipeline.poses.found",
    "open_bag": "polarmap.io.recording.ros.opening",
    "open_sequence": "polarmap.io.recording.sequence",
    "read_trajectory": "polarmap.io.formats.trajectory",
}

__all__ = [
    "Config",
    "FrontEnd",
    "InputError",
    "Keyframe",
    "Map",
    "Mapper",
    "Odometry",
    "PinholeCamera",
    "PolarmapError",
    "make_prior",
    "odometry_poses",
    "open_bag",
    "open_sequence",
    "read_trajectory",
]


def __getattr__(name: str) -> object:
    """Names are imported when first used, so that a part of the package can be used without loading the rest."""
    if name not in _HOMES:
        raise AttributeError(f"module 'polarmap' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
