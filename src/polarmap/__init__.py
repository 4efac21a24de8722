"""Dense mapping with a moving polarization camera."""

import os
from importlib import import_module
from typing import TYPE_CHECKING

from polarmap.errors import InputError, PolarmapError

# OpenMP's threads wait for each other by spinning, which makes kernels several times slower where another program
# wants the cores. Read when Numba loads; with this few turns nothing is lost on an idle machine.
os.environ.setdefault("GOMP_SPINCOUNT", "10000")

if TYPE_CHECKING:
    from polarmap.config import Config
    from polarmap.geometry.camera import PinholeCamera
    from polarmap.io.sequence import open_sequence
    from polarmap.io.trajectory import read_trajectory
    from polarmap.mapper import Mapper
    from polarmap.odometry import Odometry
    from polarmap.polarization.frontend import PolarizationFrontEnd
    from polarmap.prior import make_prior
    from polarmap.results import Keyframe, Map
    from polarmap.run import odometry_poses

_HOMES = {
    "Config": "polarmap.config",
    "Keyframe": "polarmap.results",
    "Map": "polarmap.results",
    "Mapper": "polarmap.mapper",
    "Odometry": "polarmap.odometry",
    "PinholeCamera": "polarmap.geometry.camera",
    "PolarizationFrontEnd": "polarmap.polarization.frontend",
    "make_prior": "polarmap.prior",
    "odometry_poses": "polarmap.run",
    "open_sequence": "polarmap.io.sequence",
    "read_trajectory": "polarmap.io.trajectory",
}

__all__ = [
    "Config",
    "InputError",
    "Keyframe",
    "Map",
    "Mapper",
    "Odometry",
    "PinholeCamera",
    "PolarizationFrontEnd",
    "PolarmapError",
    "make_prior",
    "odometry_poses",
    "open_sequence",
    "read_trajectory",
]


def __getattr__(name: str) -> object:
    """Names are imported when first used, so that a part of the package can be used without loading the rest."""
    if name not in _HOMES:
        raise AttributeError(f"module 'polarmap' has no attribute '{name}'")
    return getattr(import_module(_HOMES[name]), name)
