"""Which way is up in a world that poses gave no name to."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from polarmap.errors import InputError
from polarmap.export.source import MapSource

_NEAR, _NEARER = np.cos(np.radians([35.0, 10.0]))
_TURNS = 6
_LEAST_SHARE = 0.02  # of the normals, that makes them a floor
_EVERY = 8  # pixels along either side that are asked
_PARALLEL = 0.9  # cosine from which the world's x axis is no horizontal direction


@dataclass(frozen=True, eq=False)
class Up:
    """A unit vector (3,), world, and where it is from."""

    direction: np.ndarray
    reason: Literal["as given", "the cameras' mean", "level surfaces near the cameras' mean"]


def given_up(direction: tuple[float, float, float]) -> Up:
    """What the user says; InputError where that is no direction."""
    vector = np.asarray(direction, float)
    length = float(np.linalg.norm(vector))
    if not np.isfinite(length) or length < 1e-9:
        raise InputError("--up: three numbers that are not all zero are needed, such as 0 0 1")
    return Up(vector / length, "as given")


def found_up(source: MapSource) -> Up:
    """The mean of the cameras' -y, or where enough surfaces are level to within 35° of it, their common normal.

    A camera that looks down a little has a mean that leans; floors, tables and ceilings do not.
    Raises InputError where there are no keyframes.
    """
    if not source.files:
        raise InputError(f"{source.folder}: no keyframes that tell which way is up; say it with --up X Y Z")
    normals, ups = [], []
    for keyframe in source.keyframes("looking for up"):
        R = keyframe.T_world_camera[:3, :3]
        found = keyframe.normal[::_EVERY, ::_EVERY].reshape(-1, 3)
        normals.append(found[np.isfinite(found).all(axis=1)] @ R.T)
        ups.append(-R[:, 1])
    mean = np.mean(ups, axis=0)
    if np.linalg.norm(mean) < 1e-3:
        raise InputError(f"{source.folder}: its cameras point up every way; say which way is up with --up X Y Z")
    mean /= np.linalg.norm(mean)
    level = _common_normal(np.concatenate(normals), mean)
    return Up(mean, "the cameras' mean") if level is None else Up(level, "level surfaces near the cameras' mean")


def upright(up: np.ndarray) -> np.ndarray:
    """T_world_grid, float64 4×4: a frame with z along `up` and x as near to the world's x (or y) as can be."""
    x = np.array([1.0, 0.0, 0.0]) if abs(up[0]) < _PARALLEL else np.array([0.0, 1.0, 0.0])
    x = x - (x @ up) * up
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(up, x), up], axis=1)
    return T


def _common_normal(normals: np.ndarray, start: np.ndarray) -> np.ndarray | None:
    """The direction around `start` that most level surfaces share, seen from either side; None without any."""
    direction, least = start, _NEAR
    for _ in range(_TURNS):
        along = normals @ direction
        near = np.abs(along) > least
        if np.count_nonzero(near) <= _LEAST_SHARE * len(normals):
            return None
        total = (normals[near] * np.sign(along[near])[:, None]).sum(axis=0)
        direction, least = total / np.linalg.norm(total), _NEARER
    return direction if direction @ start > _NEAR else None
