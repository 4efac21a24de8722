"""Maps for robots: an occupancy grid for Nav2's map server, and a grid of signed distances."""

from __future__ import annotations

import io
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from matplotlib import colormaps

from polarmap.errors import InputError
from polarmap.export.distances import UNOBSERVED, signed_distances
from polarmap.export.grid import Grid, make_grid
from polarmap.export.occupancy import FREE, OCCUPIED, UNKNOWN, occupancy
from polarmap.export.output import make_folder, prepare_folder, remarks, require_room, write_record
from polarmap.export.source import MapSource
from polarmap.geometry.origin import shifted
from polarmap.io.files import write_bytes
from polarmap.io.formats.images import write_image

_SHADES = np.array([205, 254, 0], np.uint8)  # of the PGM, by state: unknown, free, occupied
_OCCUPIED_FROM, _FREE_BELOW = 0.65, 0.196  # 205 is 0.1961 occupied: not free
_BAND = (0.1, 1.0)  # of the cameras' height over the floor, where no heights are given
_SLICES = 5
_SLICE_PIXELS = 900  # along the longer side, at least half of it
_NOWHERE = (90, 90, 90)
_VOXELS_OF_MAP = 4.0  # in a voxel here
_MEDIAN_SHARE = 0.02  # of the median depth, where the map has no voxels
_TRUNCATION = 40.0  # voxels


@dataclass(frozen=True, eq=False)
class NavigationMap:
    """What was written. state: uint8 [x, y, z]. band: the heights that count, in the grid's z. plan: uint8 [x, y]."""

    grid: Grid
    state: np.ndarray
    distances: np.ndarray
    band: tuple[float, float]
    plan: np.ndarray


def export_navigation(
    source: MapSource,
    out: Path,
    up: np.ndarray,
    *,
    height: tuple[float, float] | None = None,
    voxel_size: float | None = None,
    truncation: float | None = None,
    min_confidence: float = 0.1,
    force: bool = False,
) -> NavigationMap:
    """Write occupancy.pgm and .yaml, esdf.npz and pictures of slices into the folder `out`.

    up: (3,), world. height: lowest and highest height over the floor where things are in a robot's way; from a tenth
    of the cameras' height to all of it where None. voxel_size: in the map's unit, four of the map's where None.
    truncation: of distances, 40 voxels where None. Raises InputError as `prepare_folder` and `make_grid` do, and
    where `height` holds no voxel.
    """
    require_room(out, force)
    voxel_size = voxel_size or _voxel_size(source)
    truncation = truncation or _TRUNCATION * voxel_size
    grid = make_grid(source, up, voxel_size, min_confidence)
    band, layers = _band(grid, height)
    prepare_folder(out, force)
    slices = np.unique(np.linspace(layers[0], layers[-1], _SLICES).round().astype(int))
    write_record(
        out,
        source,
        "esdf",
        voxel_size=voxel_size,
        up=up.tolist(),
        floor=grid.floor,
        heights_over_floor=[edge - grid.floor for edge in band],
        slices_over_floor=(grid.heights[slices] - grid.floor).tolist(),
    )
    state = occupancy(source, grid, min_confidence)
    distances = signed_distances(state, voxel_size, truncation)
    plan = floor_plan(state[:, :, layers])
    _write_plan(out, source, grid, plan, band)
    _write_distances(out / "esdf.npz", source, grid, state, distances, truncation)
    farthest = max(float(distances[state == FREE].max(initial=0.0)), voxel_size)
    for number, layer in enumerate(slices):
        picture = slice_picture(state[:, :, layer], distances[:, :, layer], farthest)
        write_image(make_folder(out / "slices") / f"{number:02d}_distance.png", picture)
    return NavigationMap(grid, state, distances, band, plan)


def floor_plan(state: np.ndarray) -> np.ndarray:
    """uint8 [x, y] of layers [x, y, z]: occupied where any is, free where any of the others is, else unknown."""
    plan = np.full(state.shape[:2], UNKNOWN, np.uint8)
    plan[(state == FREE).any(axis=2)] = FREE
    plan[(state == OCCUPIED).any(axis=2)] = OCCUPIED
    return plan


def slice_picture(state: np.ndarray, distances: np.ndarray, farthest: float) -> np.ndarray:
    """A layer [x, y] as a picture, BGR uint8, x to the right and y up: occupied black, unknown grey.

    Distances are red where near, to dark blue at `farthest`. Enlarged by a whole number where it is small.
    """
    share = np.clip(1.0 - distances / farthest, 0.0, 1.0)
    colours = (255.0 * colormaps["turbo"](share)[..., 2::-1]).astype(np.uint8)
    colours[state == OCCUPIED] = 0
    colours[state == UNKNOWN] = _NOWHERE
    picture = _seen_from_above(colours)
    factor = max(1, _SLICE_PIXELS // max(picture.shape[:2]))
    return cv2.resize(picture, None, fx=factor, fy=factor, interpolation=cv2.INTER_NEAREST)


def _voxel_size(source: MapSource) -> float:
    if source.map is not None and source.map.voxel_size:
        return _VOXELS_OF_MAP * source.map.voxel_size
    medians = [k.median_depth for k in source.results.keyframes if k.index in source.files and k.median_depth]
    if not medians:
        raise InputError(f"{source.folder}: no keyframe has depth, so that there is nothing to export")
    return _MEDIAN_SHARE * float(np.median(medians))


def _band(grid: Grid, height: tuple[float, float] | None) -> tuple[tuple[float, float], np.ndarray]:
    """The band's heights in the grid's z, and the numbers of its layers."""
    eye = grid.eye - grid.floor
    low, high = height or (_BAND[0] * eye, _BAND[1] * eye)
    if not low < high:
        raise InputError(f"--height: from {low:g} to {high:g} is no band; give the lower one first, over the floor")
    over_floor = grid.heights - grid.floor
    layers = np.flatnonzero((over_floor >= low) & (over_floor <= high))
    if not len(layers):
        raise InputError(
            f"--height: no voxel of {grid.voxel_size:g} is {low:g} to {high:g} over the floor; "
            f"the map is from {over_floor[0]:.3g} to {over_floor[-1]:.3g}"
        )
    return (grid.floor + low, grid.floor + high), layers


def _write_plan(out: Path, source: MapSource, grid: Grid, plan: np.ndarray, band: tuple[float, float]) -> None:
    write_image(out / "occupancy.pgm", _SHADES[_seen_from_above(plan)])
    rows = "\n".join(f"#   {' '.join(f'{number:.9g}' for number in row)}" for row in _T_world_grid(source, grid))
    notes = "\n".join(f"# {line}" for line in remarks(source))
    text = f"""{notes}
# heights {band[0] - grid.floor:.4g} to {band[1] - grid.floor:.4g} over the floor
# From this map's axes (x right, y up in the picture, z upward) to the world of the run's poses, T_world_grid:
{rows}
image: occupancy.pgm
mode: trinary
resolution: {grid.voxel_size!r}
origin: [{float(grid.corner[0])!r}, {float(grid.corner[1])!r}, 0.0]
negate: 0
occupied_thresh: {_OCCUPIED_FROM}
free_thresh: {_FREE_BELOW}
"""
    write_bytes(out / "occupancy.yaml", text.encode())


def _write_distances(
    path: Path, source: MapSource, grid: Grid, state: np.ndarray, distances: np.ndarray, truncation: float
) -> None:
    buffer = io.BytesIO()
    np.savez_compressed(
        buffer,
        distances=distances,
        observed=state != UNKNOWN,
        occupied=state == OCCUPIED,
        origin=grid.corner,
        voxel_size=np.float64(grid.voxel_size),
        truncation=np.float64(truncation),
        unobserved_value=np.float32(UNOBSERVED),
        T_world_grid=_T_world_grid(source, grid),
        floor=np.float64(grid.floor),
        remarks=np.array(remarks(source)),
    )
    write_bytes(path, buffer.getbuffer())


def _T_world_grid(source: MapSource, grid: Grid) -> np.ndarray:
    """Into the world of the run's poses, with the offset."""
    return shifted(grid.T_world_grid, source.origin)


def _seen_from_above(layer: np.ndarray) -> np.ndarray:
    """[x, y] as a picture: x to the right, y up."""
    return np.ascontiguousarray(np.moveaxis(layer, 0, 1)[::-1])
