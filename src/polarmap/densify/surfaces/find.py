"""Dense depth from the surfaces of a view: a few planes, and whatever is curved, each where the evidence wants it.

    points ──────> dominant planes ─┐
    polarization ─> planes of bare ─┼──> costs per cell ──> labels ──> depth and its standard deviation per pixel
                       regions      │      edges of the image ┘
    planes of the last view ────────┤
    prior (what is not planar) ─────┘
    what a network expects, what encloses the view, and what other views have seen are costs, too

Bare surfaces have no points of their own, but most of them are parts of planes that have points elsewhere, and their
borders are edges of the image. So the image is cut into small cells, and each gets the label of a plane that explains
points somewhere in the view, or that of a free surface, such as the prior's. Points and polarization speak for labels
where they can; neighbouring cells want the same label unless an edge of the image parts them. A plane is affine in
inverse depth, so that all of it is exact under perspective, and scale drops out.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numba import prange

from polarmap.data.codes import Origin
from polarmap.data.dense_depth import DenseDepth
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.view import Neighbour, Sighting
from polarmap.densify.options import SurfaceOptions
from polarmap.densify.sigma import extrapolation_sigma
from polarmap.densify.surfaces.bare_regions import region_planes
from polarmap.densify.surfaces.dominant_planes import dominant_planes
from polarmap.densify.surfaces.enclosure import behind_enclosure
from polarmap.densify.surfaces.evidence import (
    MIRRORED,
    PointWeights,
    before_outlines,
    cell_stokes,
    depth_costs,
    local_doubt,
    mirrored_texture,
    normal_costs,
    point_weights,
    polarization_costs,
    polarization_weight,
    stereo_costs,
)
from polarmap.densify.surfaces.expected import Expected
from polarmap.densify.surfaces.free_space import hidden_points
from polarmap.densify.surfaces.labels import best_labels, label_cells
from polarmap.densify.surfaces.planes import Candidates, candidate_at, evaluate_planes, in_image, in_space
from polarmap.densify.surfaces.polarized_normals import turned_normals
from polarmap.densify.surfaces.uncertainty import surface_sigma, undecided_sigma
from polarmap.densify.validate import contradicted
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.cells import cell_camera, cell_means
from polarmap.geometry.surface import normals_at, normals_from_depth
from polarmap.jit import njit

_BEYOND = (0.6, 1.5)  # inverse depths that a plane may have, as shares of the least and the largest of the points
_BEYOND_COST = 3.0
_RANGE = [0.005, 0.995]  # quantiles of the points' inverse depths that count as the least and the largest
_RANGE_POINTS = 20_000  # that those are taken of
_BEHIND_COST = 30.0  # of planes that have no depth in a cell
_NO_DEPTH = 0.02  # of the points' least inverse depth, below which a plane is about parallel to the ray, or behind
_NORMAL_RADIUS = 2  # pixels, over which depth is fitted for a normal
_CONTRADICTED = np.float32(2.0)  # factor of the standard deviation where another view disagrees
_DIFFERENCE = 0.015  # of sqrt(intensity)
_DISAGREEMENT = 0.03  # of depth, as a share of it
_STEP_OF_NOISE = 0.01  # of (S1, S2)/S0, means of 3×3 cells
_TOLERANCE = 5.0  # relative error that a point may have, in standard deviations by noise
_LEAST_TOLERANCE = 0.7  # share of `options.tolerance`, for what noise does not account for
_SUPPORT = np.float32(0.015)  # relative error below which a point supports a surface
_OUTLINE_COST = np.float32(1.0)  # of a cell without points whose surface shows no outline of its own
_MOST_HIDDEN = np.float32(2.0)  # other views that count where a surface hides what they see
_PLACES = 9  # in a row and a column of the image, where planes are compared
_ALIKE = 0.5  # tolerances by which two planes differ up to which they are one
_ANY_VOTE = 0.05  # of each of a pixel's four cells, beside up to 1 by distance: with none of that, looks alone decide
_LOOK = 25.0  # how fast a vote falls with the pixel's difference from its cell: half at a fifth of `options.contrast`
_CLEAR_DEGREE = 0.05  # of polarization, above which it speaks for itself: walls lit by others stay below
_CLEAR_WEIGHT = 0.07  # of its costs to planes there, set by hand on seven sequences
_COUPLING = 0.1  # how independent neighbouring cells' polarization is: errors of the model are the same all over a wall


@dataclass(frozen=True)
class Surfaces:
    """The surfaces of a view, and which is where.

    dense: depth and its standard deviation, NaN everywhere where nothing is known.
    label: int16 H×W, an index into `planes`, and beyond them into the free surfaces.
    planes: (q₀, q_u, q_v) float64 N×3, see `planes.py` beside. lasting: those that hold a share of the view, as
    (α, β, γ) float64 M×3. polarization_weight: from 0 to 0.5, how far polarization agrees with stereo.
    """

    dense: DenseDepth
    label: np.ndarray
    planes: np.ndarray
    lasting: np.ndarray
    polarization_weight: float


def find_surfaces(
    points: np.ndarray,
    free: Sequence[np.ndarray],
    image: PolarizationImage,
    stable: np.ndarray,
    camera: PinholeCamera,
    others: Sequence[Neighbour] = (),
    options: SurfaceOptions | None = None,
    expected: Expected | None = None,
    known: np.ndarray | None = None,
    window: int = 9,
    sightings: Sequence[Sighting] = (),
    point_sigma: float = 0.002,
) -> Surfaces:
    """Dense depth of a view from sparse points, guesses of what is not planar, and the polarization image.

    points: float32 H×W z, NaN where none. free: any number of depth maps such as a prior's, float32 H×W z, NaN where
    one says nothing; each competes with the planes, so that a bad one does no harm where another explains the points.
    stable: sqrt(intensity), float32 H×W. others: views that may contradict. expected: what planes should be like.
    known: planes that another view has found, (α, β, γ) in this camera's frame, float64 N×3 (`Surfaces.lasting`); each
    is tried beside this view's own, since which planes are found in one view is partly chance.
    window: side of what stereo compared to find the points, in pixels (`PlaneField.window`).
    sightings: points that other views have surely seen, which a surface does not hide. point_sigma: relative standard
    deviation of a point by noise.
    Where nothing else is known the depth is that of the points. Raises InputError where shapes differ from the
    camera's.
    """
    options = options or SurfaceOptions()
    named = [("points", points), ("image", stable), ("polarization", image.dolp), *(("surface", z) for z in free)]
    if expected:
        named += [("expected depth", expected.depth), ("its sigma", expected.sigma_depth)]
        named += [("expected normal", expected.normal[..., 0]), ("its sigma", expected.sigma_normal)]
        named += [("expected mirrored", expected.mirrored)] * (expected.mirrored is not None)
    for name, array in named:
        if array.shape != camera.shape:
            raise InputError(f"surfaces: {name} {array.shape} does not fit the camera {camera.shape}")
    weights, mirrored = _point_weights(points, image, stable, expected, options, window)
    reliability = weights.reliability
    tolerance = float(np.clip(_TOLERANCE * point_sigma, _LEAST_TOLERANCE * options.tolerance, options.tolerance))
    inverse_depth = np.where(reliability > 0, 1.0 / points, np.nan).astype(np.float32)
    cell = max(1, round((stable.size / options.cells) ** 0.5))
    grey = cell_means(stable, cell)
    stokes, variance = _polarization(image, cell, options)
    dominant, _ = dominant_planes(inverse_depth, tolerance, options.max_planes, options.least_share)
    bare = region_planes(inverse_depth, reliability, grey, stokes, variance, camera, cell, tolerance)
    planes = np.concatenate([dominant, bare])
    if known is not None:
        planes = np.concatenate([planes, _news(in_image(known, camera), planes, camera, tolerance)])
    surfaces = Candidates.of(planes, free, camera.shape)
    if not len(surfaces) or np.isnan(inverse_depth).all():
        return _points_alone(points, planes, camera)
    costs = stereo_costs(inverse_depth, weights, surfaces, cell, tolerance)
    weight = _add_polarization(costs, planes, free, stokes, variance, cell, camera, options)
    middles = surfaces.middles(cell)
    costs += _bounds(middles, len(planes), inverse_depth)
    costs += options.hole_cost * behind_enclosure(middles, planes, inverse_depth, reliability, mirrored, cell)
    costs += _OUTLINE_COST * before_outlines(middles, np.where(mirrored, np.float32(np.nan), inverse_depth), cell)
    hidden = hidden_points(middles, sightings, camera, cell)
    costs += np.float32(options.hiding_cost) * np.minimum(hidden, _MOST_HIDDEN, out=hidden)
    if expected:
        doubt = local_doubt(expected.depth, inverse_depth, reliability, cell)
        costs[..., : len(planes)] += _unexpected(expected, doubt, planes, middles, camera, cell, options)
    costs[..., len(planes) :] += options.free_cost
    beliefs = label_cells(costs, *_boundaries(grey, stokes, options), options.rounds)
    label, depth = _compose(best_labels(beliefs), surfaces, stable, grey, cell, options)
    sigma = undecided_sigma(costs, beliefs, middles, label, cell)
    normal = _normals(label, depth, planes, camera)
    polarized = image if options.polarization > 0.0 else None
    normal = turned_normals(normal, label >= len(planes), polarized, camera, expected and expected.normal)
    depth = np.where(np.isnan(depth), points, depth)
    distance = _distance_from_support(depth, points)
    by_surface = surface_sigma(distance, label < len(planes), point_sigma)
    against = contradicted(depth, stable, others, camera, _DIFFERENCE, _DISAGREEMENT)
    origin = np.empty(depth.shape, np.uint8)
    _finish(depth, label, len(planes), distance, by_surface, against, sigma, origin)
    added = int(np.count_nonzero(np.isnan(points) & np.isfinite(depth)))
    first = free[0] if len(free) else points
    lasting = in_space(planes[_shares(label, len(planes)) >= options.lasting_share], camera)
    return Surfaces(DenseDepth(depth, normal, sigma, origin, distance, first, (added,)), label, planes, lasting, weight)


def _news(known: np.ndarray, planes: np.ndarray, camera: PinholeCamera, tolerance: float) -> np.ndarray:
    """Those of the known planes that differ from each of `planes` somewhere in the image."""
    places = np.ix_(np.linspace(0, camera.height - 1, _PLACES), np.linspace(0, camera.width - 1, _PLACES))
    v, u = np.broadcast_arrays(*places)
    a, b = evaluate_planes(known, camera.shape, u, v), evaluate_planes(planes, camera.shape, u, v)
    differ = np.abs(a[:, None] - b[None]) > _ALIKE * tolerance * np.abs(a[:, None])
    return known[differ.any(axis=(2, 3)).all(axis=1)]


def _shares(label: np.ndarray, count: int) -> np.ndarray:
    """Of the pixels, that each of the first `count` labels has."""
    return np.bincount(label.ravel(), minlength=count)[:count] / label.size


def _point_weights(points, image, stable, expected, options, window) -> tuple[PointWeights, np.ndarray]:
    """How far the points are believed, not at all where there is none, and which of them may be mirrored."""
    mirrored = mirrored_texture(image) if options.polarization > 0.0 else np.zeros(points.shape, bool)
    if expected and expected.mirrored is not None:
        mirrored |= expected.mirrored
    weights = point_weights(stable, window)
    reliability = np.where(points > 0, weights.reliability, np.float32(0.0))
    reliability[mirrored] *= MIRRORED
    return PointWeights(reliability, weights.behind), mirrored


def _points_alone(points: np.ndarray, planes: np.ndarray, camera: PinholeCamera) -> Surfaces:
    known = points > 0
    depth = np.where(known, points, np.nan).astype(np.float32)
    distance = np.where(known, 0.0, np.nan).astype(np.float32)
    origin = np.where(known, Origin.STEREO, Origin.NONE).astype(np.uint8)
    normal = normals_from_depth(depth, camera, radius=_NORMAL_RADIUS)
    dense = DenseDepth(depth, normal, extrapolation_sigma(distance), origin, distance, depth, ())
    return Surfaces(dense, np.full(points.shape, len(planes), np.int16), planes, planes[:0], 0.0)


def _unexpected(expected, doubt, planes, middles, camera, cell, options) -> np.ndarray:
    """Costs of planes that are not as a network expects, less 1, the mean of right ones; free surfaces pay none."""
    found = middles[..., : len(planes)]
    inverse_depth, normal = (cell_means(image, cell) for image in (1.0 / expected.depth, expected.normal))
    sigma_depth, sigma_normal = (cell_means(sigma, cell) for sigma in (expected.sigma_depth, expected.sigma_normal))
    sigma_depth = np.hypot(sigma_depth, doubt)
    costs = options.expected_depth * (depth_costs(inverse_depth, sigma_depth, found) - 1.0)
    return costs + options.expected_normals * (normal_costs(normal, sigma_normal, _unit_normals(planes, camera)) - 1.0)


def _normals(label: np.ndarray, depth: np.ndarray, planes: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Of the planes where these are, else of the depth, float32 H×W×3."""
    free = (label >= len(planes)) | np.isnan(depth)
    normal = normals_from_depth(depth, camera, radius=_NORMAL_RADIUS, where=free)
    _fill_normals(label, free, _unit_normals(planes, camera), normal)
    return normal


def _unit_normals(planes: np.ndarray, camera: PinholeCamera) -> np.ndarray:
    """Toward the camera, float32 N×3."""
    normals = in_space(planes, camera).astype(np.float32)
    return normals / -np.linalg.norm(normals, axis=1, keepdims=True)


def _polarization(image: PolarizationImage, cell: int, options: SurfaceOptions) -> tuple[np.ndarray, np.ndarray]:
    """(S1, S2)/S0 of the cells and the variance of its errors, without polarization if that is not to count."""
    stokes, variance = cell_stokes(image, cell)
    variance = variance + np.float32(options.systematic**2)
    return (stokes if options.polarization > 0.0 else np.zeros_like(stokes)), variance


def _add_polarization(costs, planes, free, stokes, variance, cell, camera, options) -> float:
    """Add polarization's costs to those of stereo; returns its weight."""
    cells = cell_camera(camera, cell)
    rows, columns = (np.arange(count) * size // count for count, size in zip(cells.shape, camera.shape, strict=True))
    normals = [normals_at(depth, camera, rows, columns, radius=_NORMAL_RADIUS, stride=2) for depth in free]
    polarization = polarization_costs(stokes, variance, in_space(planes, camera), normals, cells)
    weight = polarization_weight(polarization[..., : len(planes)], costs[..., : len(planes)])
    costs += np.float32(options.polarization * _COUPLING * weight) * polarization
    clear = np.linalg.norm(stokes, axis=-1, keepdims=True) > _CLEAR_DEGREE
    costs[..., : len(planes)] += (
        np.float32(options.polarization * _CLEAR_WEIGHT) * clear * polarization[..., : len(planes)]
    )
    return weight


def _bounds(middles: np.ndarray, planes: int, inverse_depth: np.ndarray) -> np.ndarray:
    """Costs of planes far beyond the depths of all points, and of surfaces without depth, float32 rows×columns×N."""
    values = inverse_depth[np.isfinite(inverse_depth)]
    low, high = np.quantile(values[:: values.size // _RANGE_POINTS + 1], _RANGE).astype(np.float32)
    costs = np.where(middles <= np.float32(_NO_DEPTH) * low, np.float32(_BEHIND_COST), np.float32(0.0))
    of_planes = middles[..., :planes]
    beyond = (of_planes < np.float32(_BEYOND[0]) * low) | (of_planes > np.float32(_BEYOND[1]) * high)
    costs[..., :planes] += np.float32(_BEYOND_COST) * beyond
    return costs


def _boundaries(grey: np.ndarray, stokes: np.ndarray, options: SurfaceOptions) -> tuple[np.ndarray, np.ndarray]:
    """Cost of a change of label to the right and lower neighbour, float32 rows×columns each.

    It is low where brightness or polarization has a step: two walls of the same paint are polarized differently.
    """
    polarized = cv2.blur(stokes, (3, 3))
    right, down = np.zeros_like(grey), np.zeros_like(grey)
    for cost, axis, part in ((right, 1, np.s_[:, :-1]), (down, 0, np.s_[:-1])):
        step = np.abs(np.diff(grey, axis=axis)) / options.contrast
        turn = np.linalg.norm(np.diff(polarized, axis=axis), axis=-1) - _STEP_OF_NOISE
        step = np.maximum(step, turn / options.polarization_contrast)
        cost[part] = options.boundary_cost * (options.edge_cost + np.exp(-step))
    return right, down


def _compose(best, surfaces, stable, grey, cell, options) -> tuple[np.ndarray, np.ndarray]:
    """Label and depth of every pixel from the labels of cells."""
    label, depth = np.empty(stable.shape, np.int16), np.empty(stable.shape, np.float32)
    sharpness = np.float32(1.0 / options.contrast)
    _label_pixels(best.astype(np.int16), *surfaces, stable, grey, cell, sharpness, label, depth)
    return label, depth


def _distance_from_support(depth: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Of each pixel from the nearest point that agrees with the depth there, float32 H×W in pixels."""
    supported = np.abs(points / depth - 1.0) < _SUPPORT
    return cv2.distanceTransform((~supported).astype(np.uint8), cv2.DIST_L2, 5)


@njit(parallel=True)
def _fill_normals(label, free, normals, normal):
    """Of the planes, where the surface is not free."""
    for v in prange(label.shape[0]):
        for u in range(label.shape[1]):
            if not free[v, u]:
                normal[v, u] = normals[label[v, u]]


@njit(parallel=True)
def _finish(depth, label, planes, distance, by_surface, against, sigma, origin):
    """Standard deviation, by what else could be there and by the surface, twice that where other views are against it;
    and where depth is from.
    """
    for v in prange(depth.shape[0]):
        for u in range(depth.shape[1]):
            if np.isnan(depth[v, u]):
                sigma[v, u], origin[v, u] = np.nan, Origin.NONE
                continue
            total = np.sqrt(sigma[v, u] * sigma[v, u] + by_surface[v, u] * by_surface[v, u])
            sigma[v, u] = _CONTRADICTED * total if against[v, u] else total
            spread = Origin.PROPAGATED if label[v, u] < planes else Origin.ESTIMATED
            origin[v, u] = Origin.STEREO if distance[v, u] == 0.0 else spread


@njit(parallel=True)
def _label_pixels(best, planes, free, stable, grey, cell, sharpness, label, depth):
    """Each pixel takes the label that most of the four nearest cells have, those that look like it most of all."""
    height, width = stable.shape
    rows, columns = best.shape
    for v in prange(height):
        row = (v + 0.5) / cell - 0.5
        top = int(np.floor(row))
        upper, lower = max(top, 0), min(top + 1, rows - 1)
        for u in range(width):
            column = (u + 0.5) / cell - 0.5
            left = int(np.floor(column))
            right = min(left + 1, columns - 1)
            own = best[upper, max(left, 0)]
            if own == best[upper, right] and own == best[lower, max(left, 0)] and own == best[lower, right]:
                q = candidate_at(planes, free, own, np.int64(v), u)
                label[v, u] = own
                depth[v, u] = 1.0 / q if q > 0 else np.nan
            else:
                _vote(best, planes, free, stable, grey, cell, sharpness, np.int64(v), u, row, column, label, depth)


@njit
def _vote(best, planes, free, stable, grey, cell, sharpness, v, u, row, column, label, depth):
    """Of one pixel, between the four nearest cells."""
    rows, columns = best.shape
    top, left = int(np.floor(row)), int(np.floor(column))
    most, found = -1.0, np.float32(np.nan)
    label[v, u] = best[v // cell, u // cell]
    for a in range(4):
        i, j = min(max(top + a // 2, 0), rows - 1), min(max(left + a % 2, 0), columns - 1)
        votes = 0.0
        for b in range(4):
            k, m = min(max(top + b // 2, 0), rows - 1), min(max(left + b % 2, 0), columns - 1)
            if best[k, m] == best[i, j]:
                weight = (1.0 - abs(row - top - b // 2)) * (1.0 - abs(column - left - b % 2)) + _ANY_VOTE
                difference = sharpness * (stable[v, u] - grey[k, m])
                votes += weight / (1.0 + _LOOK * difference * difference)
        if votes > most:
            q = candidate_at(planes, free, best[i, j], v, u)
            if q > 0:
                most, found = votes, q
                label[v, u] = best[i, j]
    depth[v, u] = 1.0 / found
