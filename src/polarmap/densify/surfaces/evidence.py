"""What stereo, polarization and guesses of a network say of surfaces that a cell of the image may belong to.

All are costs in units of a squared error over its variance, capped, since any may be wrong altogether.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

import cv2
import numpy as np
from numba import prange

from polarmap.data.polarization_image import PolarizationImage
from polarmap.densify.surfaces.planes import Candidates
from polarmap.geometry.camera import PinholeCamera
from polarmap.jit import FAST_MATH, njit
from polarmap.sensing.noise import estimate_noise

MIRRORED = np.float32(0.3)  # weight of points on mirrored texture
FULL_CELL = 16.0  # a cell full of points counts as this many independent ones, whatever its size
_POINT_CAP = np.float32(9.0)
_POINT_SCALE = np.float32(0.25)
_POLARIZATION_CAP = 9.0
_BORROWED = np.float32(0.2)  # weight of points whose support window sees much stronger texture than they have
_BORROWED_RATIO = np.float32(8.0)
_OWN_TEXTURE = np.float32(2.0)  # gradient in noise standard deviations that makes a point reliable
_LEAST_RELIABILITY = np.float32(0.3)
_OUTLINE_RATIOS = (0.25, 0.6)  # of a pixel's texture to the strongest near: surely beside an outline, surely on it
_BARE_SHARE = np.float32(0.25)  # of the window without texture, from which an outline may part it from something bare
_OUTLINE_REACH = 3  # cells about a bare one in which points show the outlines of its surface
_BARE_CELL = 0.05  # share of a cell's pixels with points, below which it is bare
_BEFORE = np.float32(1.04)  # inverse depth over that of points, from which a surface is before them
_BEHIND_OUTLINE = np.float32(0.2)  # what a point beside an outline counts against surfaces behind it
_RIM = 2  # pixels about a window, over which texture just outside it spreads into it
_MIRROR_DEGREES = (0.3, 1.0)  # of polarization; a body's texture stays below, and nothing lies above
_LEAST_MIRRORED = -0.05  # share of the light that is mirrored, as polarization has it, times its degree
_TEXTURE_SIGMA = 3.0  # pixels, of the Gaussian window that texture's polarization is taken over

_GUESS_CAP = np.float32(4.0)  # of the cost of a guess
_LEAST_NORMAL_SIGMA = np.float32(0.15)  # radians, of guessed normals; their errors are the same all over a wall
_LEAST_DEPTH_SIGMA = np.float32(0.1)  # relative, of guessed depth, for the same reason

_DOUBT = np.float32(2.5)  # standard deviations of a guess per mean error at the points around
_DOUBT_REACH = 0.12  # of the image width; sigma of the Gaussian in which points count as around
_LARGEST_ERROR = np.float32(0.4)  # of a guess at a point, relative, since some points are wrong altogether
_FEWEST_AROUND = np.float32(0.002)  # mean reliability of the pixels there, below which nothing is doubted
_TRIED_WEIGHTS = (0.0, 0.01, 0.02, 0.05, 0.1, 0.2, 0.3, 0.5)  # 0.5: errors as Gaussian and independent as they could be
_LEAST_CELLS = 50
_CLEAR = 4.0  # cost by which stereo must prefer one plane before a cell takes part in calibration


class PointWeights(NamedTuple):
    """How far stereo points are believed, float32 H×W in [0, 1] each.

    reliability: that the point's depth is the pixel's. behind: that no surface behind it is seen there, if the first is
    so: at an outline the point is the nearer side's, and a bare pixel beside it may be the farther side's.
    """

    reliability: np.ndarray
    behind: np.ndarray


def point_weights(image: np.ndarray, window: int = 9) -> PointWeights:
    """How far stereo points are believed, by the texture of the pixel itself.

    image: sqrt(intensity), float32 H×W. window: side of what stereo compares, in pixels (`PlaneField.window`).

    A bare surface beside a textured one is matched by the other's texture, at the other's depth: points without texture
    of their own are wrong several times more often. Their reliability is 0 where it would be below 0.3.
    """
    dx, dy = (cv2.Sobel(image, cv2.CV_32F, i, 1 - i, ksize=3, scale=0.125) for i in (1, 0))
    own = np.sqrt(cv2.blur(dx * dx + dy * dy, (3, 3))) / np.float32(estimate_noise(image))
    texture = cv2.dilate(own, np.ones((3, 3), np.uint8))
    strongest = cv2.dilate(texture, np.ones((window + _RIM, window + _RIM), np.uint8))
    bare = cv2.blur((own < _OWN_TEXTURE).astype(np.float32), (window, window))
    weights = PointWeights(np.empty_like(own), np.empty_like(own))
    _point_weights(own, texture, strongest, bare, *weights)
    return weights


@njit(parallel=True)
def _point_weights(own, texture, strongest, bare, reliability, behind):
    zero, one = np.float32(0.0), np.float32(1.0)
    low, high = np.float32(_OUTLINE_RATIOS[0]), np.float32(_OUTLINE_RATIOS[1])
    for v in prange(own.shape[0]):
        for u in range(own.shape[1]):
            ratio = texture[v, u] / _OWN_TEXTURE
            reliable = min(one, ratio * ratio)
            reliable *= _BORROWED if strongest[v, u] > _BORROWED_RATIO * texture[v, u] else one
            reliability[v, u] = zero if reliable < _LEAST_RELIABILITY else reliable
            beside = (high - own[v, u] / max(strongest[v, u], np.float32(1e-6))) / (high - low)
            doubt = min(max(beside, zero), one) * min(bare[v, u] / _BARE_SHARE, one)
            behind[v, u] = one - (one - _BEHIND_OUTLINE) * doubt


def mirrored_texture(image: PolarizationImage) -> np.ndarray:
    """Where what varies in the picture is polarized as a mirror polarizes, bool H×W.

    Stereo finds the depth of what a glossy surface mirrors, behind the surface. What is mirrored adds its polarization
    in proportion to its brightness, so S1 and S2 rise with S0 over mirrored texture at the surface's specular degree,
    0.3 to 1 at most angles; over texture of the body they rise at the diffuse one, mostly below 0.2. At an edge between
    two surfaces the slopes may be anything; those that would have a negative amount of light mirrored are told apart.
    """
    stokes = halved_stokes(image)
    mean = cv2.GaussianBlur(stokes, (0, 0), 0.5 * _TEXTURE_SIGMA)
    covariance = cv2.GaussianBlur(stokes[..., :1] * stokes, (0, 0), 0.5 * _TEXTURE_SIGMA) - mean[..., :1] * mean
    mirrored = np.zeros(image.dolp.shape, bool)
    _judge_mirrored(mean, covariance, image.usable, mirrored)
    return mirrored


@njit(parallel=True, error_model="numpy")
def _judge_mirrored(mean, covariance, usable, mirrored):
    """Where the slope of (S1, S2) over S0 is one of a mirror, of usable pixels of each 2×2."""
    height, width = usable.shape
    low, high = np.float32(_MIRROR_DEGREES[0]), np.float32(_MIRROR_DEGREES[1])
    tiny, least = np.float32(1e-12), np.float32(_LEAST_MIRRORED)
    for v in prange(height):
        i = min(v // 2, mean.shape[0] - 1)
        for u in range(width):
            j = min(u // 2, mean.shape[1] - 1)
            spread = max(covariance[i, j, 0], tiny)
            first, second = covariance[i, j, 1] / spread, covariance[i, j, 2] / spread
            degree = np.sqrt(first * first + second * second)
            if usable[v, u] and degree > low and degree < high:
                along = first * mean[i, j, 1] + second * mean[i, j, 2]
                mirrored[v, u] = along > least * max(degree * mean[i, j, 0], tiny)


def halved_stokes(image: PolarizationImage) -> np.ndarray:
    """S0/2, S1/2 and S2/2, means of 2×2 pixels, float32 H/2×W/2×3, rounded down."""
    stokes = np.empty((image.dolp.shape[0] // 2, image.dolp.shape[1] // 2, 3), np.float32)
    _halved_stokes(image.intensity, *image.components, stokes)
    return stokes


@njit(parallel=True)
def _halved_stokes(intensity, s1, s2, stokes):
    for i in prange(stokes.shape[0]):
        for j in range(stokes.shape[1]):
            stokes[i, j] = 0.0
            for v in range(2 * i, 2 * i + 2):
                for u in range(2 * j, 2 * j + 2):
                    light = np.float32(0.25) * intensity[v, u]
                    stokes[i, j, 0] += light
                    stokes[i, j, 1] += light * s1[v, u]
                    stokes[i, j, 2] += light * s2[v, u]


def stereo_costs(
    inverse_depth: np.ndarray, weights: PointWeights, surfaces: Candidates, cell: int, tolerance: float
) -> np.ndarray:
    """Cost of each surface in each cell by the points in it, float32 rows×columns×N.

    inverse_depth: points, float32 H×W, NaN where none. cell: its side in pixels. tolerance: relative standard deviation
    of a point.
    """
    height, width = inverse_depth.shape
    costs = np.empty((-(-height // cell), -(-width // cell), len(surfaces)), np.float32)
    scale = _POINT_SCALE * np.float32(FULL_CELL / cell**2)
    planes = np.ascontiguousarray(surfaces.planes.T, np.float32)
    _stereo_costs(inverse_depth, *weights, planes, surfaces.free, cell, np.float32(1.0 / tolerance), scale, costs)
    return costs


@njit(parallel=True, fastmath=FAST_MATH)
def _stereo_costs(inverse_depth, reliability, behind, planes, free, cell, sharpness, scale, costs):
    height, width = inverse_depth.shape
    rows, columns, _ = costs.shape
    count = planes.shape[1]
    half = np.float32(0.5)
    for i in prange(rows):
        for j in range(columns):
            of_cell = costs[i, j]
            of_cell[:] = 0.0
            for v in range(i * cell, min((i + 1) * cell, height)):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    q, weight = inverse_depth[v, u], scale * reliability[v, u]
                    if not (q > 0 and weight > 0):
                        continue
                    before, steps = behind[v, u] * weight, sharpness / q
                    x, y = np.float32(u) - half * np.float32(width - 1), np.float32(v) - half * np.float32(height - 1)
                    for k in range(count):
                        error = (planes[0, k] + planes[1, k] * x + planes[2, k] * y) * steps - sharpness
                        side = before if error < 0 else weight
                        of_cell[k] += side * min(error * error, _POINT_CAP)
                    for k in range(free.shape[0]):
                        error = free[k, v, u] * steps - sharpness
                        side = before if error < 0 else weight
                        of_cell[count + k] += side * min(error * error, _POINT_CAP)


def before_outlines(surfaces: np.ndarray, points: np.ndarray, cell: int) -> np.ndarray:
    """Where a surface without points lies before all points around, which then show outlines of its own, bool
    rows×columns×N.

    surfaces: inverse depth in the middle of the cells, float32 rows×columns×N. points: inverse depth, float32 H×W, NaN
    where none. cell: side in pixels. Where one thing ends before another stereo finds the depth of the nearer one: at
    the edges about a bare surface that stood before all else it would have found that surface's.
    """
    nearest, share = np.empty(surfaces.shape[:2], np.float32), np.empty(surfaces.shape[:2], np.float32)
    _nearest_points(points, cell, nearest, share)
    side = 2 * _OUTLINE_REACH + 1
    around = cv2.dilate(nearest, np.ones((side, side), np.uint8))
    ahead = np.where((share < _BARE_CELL) & (around > 0.0), _BEFORE * around, np.float32(np.inf))
    return surfaces > ahead[..., None]


@njit(parallel=True)
def _nearest_points(points, cell, nearest, share):
    """Largest inverse depth of each cell's points, 0 where there is none, and the share of its pixels that have one."""
    height, width = points.shape
    for i in prange(share.shape[0]):
        for j in range(share.shape[1]):
            found, most = 0, np.float32(0.0)
            for v in range(i * cell, min((i + 1) * cell, height)):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    if np.isfinite(points[v, u]):
                        found += 1
                        most = max(most, points[v, u])
            pixels = (min((i + 1) * cell, height) - i * cell) * (min((j + 1) * cell, width) - j * cell)
            nearest[i, j], share[i, j] = most, found / pixels


def cell_stokes(image: PolarizationImage, cell: int) -> tuple[np.ndarray, np.ndarray]:
    """Mean (S1, S2)/S0 of each cell's usable pixels, float32 rows×columns×2, and its variance by sensor noise.

    The variance is infinite where a cell has no usable pixel.
    """
    rows, columns = -(-image.dolp.shape[0] // cell), -(-image.dolp.shape[1] // cell)
    mean = np.empty((rows, columns, 2), np.float32)
    variance = np.empty((rows, columns), np.float32)
    _cell_stokes(*image.components, image.sigma_dolp, image.usable, cell, mean, variance)
    return mean, variance


@njit(parallel=True)
def _cell_stokes(first, second, sigma, usable, cell, mean, variance):
    height, width = sigma.shape
    for i in prange(variance.shape[0]):
        for j in range(variance.shape[1]):
            n, s1, s2, noise = 0, np.float32(0.0), np.float32(0.0), np.float32(0.0)
            for v in range(i * cell, min((i + 1) * cell, height)):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    if usable[v, u]:
                        n += 1
                        s1 += first[v, u]
                        s2 += second[v, u]
                        noise += sigma[v, u] * sigma[v, u]
            mean[i, j, 0] = s1 / n if n else 0.0
            mean[i, j, 1] = s2 / n if n else 0.0
            variance[i, j] = noise / (n * n) if n else np.inf


def polarization_costs(
    stokes: np.ndarray, variance: np.ndarray, planes: np.ndarray, free: Sequence[np.ndarray], camera: PinholeCamera
) -> np.ndarray:
    """How badly polarization fits surfaces, whether it is diffuse or specular, float32 rows×columns×(N+M).

    stokes: (S1, S2)/S0 of cells, rows×columns×2. variance: of it, by noise and by what the model leaves out, such as
    light that was polarized before, rows×columns. planes: their normals, N×3, of any length, toward the camera or away
    from it. free: such normals of M other surfaces, float32 rows×columns×3 each. camera: whose pixels are the cells.

    A normal says along which line through the origin (S1, S2) lies: diffuse light on one side of it, specular light on
    the other, and mixed light anywhere between, so that only the distance from the line counts, and no decision between
    the two kinds is needed. (Under perspective the line has a slight bend at the origin.)
    """
    costs = np.empty((*camera.shape, len(planes) + len(free)), np.float32)
    normals = np.ascontiguousarray(np.reshape(planes, (-1, 3)).T, np.float32)
    _plane_costs(stokes, variance, normals, camera.normalized(), costs)
    for k, of_free in enumerate(free):
        _free_costs(stokes, variance, of_free, camera.normalized(), len(planes) + k, costs)
    return costs


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _plane_costs(stokes, variance, normals, xy, costs):
    height, width, _ = costs.shape
    for i in prange(height):
        for j in range(width):
            x, y = xy[i, j]
            s1, s2 = stokes[i, j]
            sharpness = np.float32(1.0) / variance[i, j]  # 0 where nothing is known
            for k in range(normals.shape[1]):
                squared = _squared_distances(s1, s2, x, y, normals[0, k], normals[1, k], normals[2, k])
                costs[i, j, k] = min(squared * sharpness, np.float32(_POLARIZATION_CAP))


@njit(parallel=True, error_model="numpy", fastmath=FAST_MATH)
def _free_costs(stokes, variance, normals, xy, k, costs):
    """Nothing where there is no normal."""
    height, width, _ = costs.shape
    for i in prange(height):
        for j in range(width):
            x, y = xy[i, j]
            s1, s2 = stokes[i, j]
            n = normals[i, j]
            cost = _squared_distances(s1, s2, x, y, n[0], n[1], n[2]) / variance[i, j]
            costs[i, j, k] = min(cost, np.float32(_POLARIZATION_CAP)) if np.isfinite(cost) else np.float32(0.0)


@njit(inline="always", error_model="numpy")
def _squared_distances(s1, s2, x, y, nx, ny, nz):
    """The less of (s1, s2) from where diffuse and from where specular light of a normal lies."""
    dx, dy = nx - nz * x, ny - nz * y
    along = (dx * x + dy * y) / (np.float32(1.0) + x * x + y * y)
    diffuse = _squared_distance(s1, s2, dx, dy)
    specular = _squared_distance(-s1, -s2, dx - along * x, dy - along * y)  # the gradient of range
    return min(diffuse, specular)


@njit(inline="always", error_model="numpy")
def _squared_distance(s1, s2, x, y):
    """Of (s1, s2) from the half line along twice the angle of (x, y)."""
    forward = (s1 * (x * x - y * y) + s2 * np.float32(2.0) * x * y) / max(x * x + y * y, np.float32(1e-12))
    forward = max(forward, np.float32(0.0))
    return s1 * s1 + s2 * s2 - forward * forward


def normal_costs(expected: np.ndarray, sigma: np.ndarray, normals: np.ndarray) -> np.ndarray:
    """Squared angle between guessed normals and those of N planes, in its variance, float32 rows×columns×N, at most 4.

    expected: of cells, rows×columns×3, of any length. sigma: standard deviation of their angle in radians,
    rows×columns. normals: of the planes, N×3, of unit length, toward the camera.
    """
    length = np.maximum(np.linalg.norm(expected, axis=-1, keepdims=True), 1e-6)
    angle = np.arccos(np.clip((expected / length) @ normals.T.astype(np.float32), -1.0, 1.0))
    variance = sigma * sigma + _LEAST_NORMAL_SIGMA**2
    return np.minimum(angle * angle / variance[..., None], _GUESS_CAP).astype(np.float32)


def depth_costs(expected: np.ndarray, sigma: np.ndarray, found: np.ndarray) -> np.ndarray:
    """Squared difference of log depth between a guess and N planes, in its variance, rows×columns×N, at most 4.

    expected: inverse depth in cells, float32 rows×columns, positive. sigma: its relative standard deviation,
    rows×columns. found: inverse depth of the planes, float32 rows×columns×N, of any sign.
    """
    ratio = np.log(np.maximum(found / expected[..., None], np.float32(1e-6)))
    variance = sigma * sigma + _LEAST_DEPTH_SIGMA**2
    return np.minimum(ratio * ratio / variance[..., None], _GUESS_CAP).astype(np.float32)


def local_doubt(expected: np.ndarray, inverse_depth: np.ndarray, reliability: np.ndarray, cell: int) -> np.ndarray:
    """How far guessed depth is off at the points around each cell, relative, float32 rows×columns.

    expected: guessed depth, float32 H×W. inverse_depth: points, float32 H×W, NaN where none. reliability: float32 H×W.
    A guess is wrong over whole surfaces at once: where points on one say so, its bare parts are doubted, too.
    """
    height, width = expected.shape
    weight, total = np.empty((2, -(-height // cell), -(-width // cell)), np.float32)
    _errors_of_guess(expected, inverse_depth, reliability, cell, weight, total)
    reach = _DOUBT_REACH * weight.shape[1]
    weight, total = (cv2.GaussianBlur(image, (0, 0), reach) for image in (weight, total))
    return _DOUBT * total / (weight + _FEWEST_AROUND)


@njit(parallel=True)
def _errors_of_guess(expected, inverse_depth, reliability, cell, weight, total):
    """Mean reliability of each cell's pixels, and of that times the error of depth at their points."""
    height, width = expected.shape
    for i in prange(weight.shape[0]):
        for j in range(weight.shape[1]):
            sure, wrong = np.float32(0.0), np.float32(0.0)
            for v in range(i * cell, min((i + 1) * cell, height)):
                for u in range(j * cell, min((j + 1) * cell, width)):
                    if reliability[v, u] > 0:
                        error = abs(np.log(inverse_depth[v, u] * expected[v, u]))
                        sure += reliability[v, u]
                        wrong += reliability[v, u] * min(error, _LARGEST_ERROR)
            pixels = (min((i + 1) * cell, height) - i * cell) * (min((j + 1) * cell, width) - j * cell)
            weight[i, j], total[i, j] = sure / pixels, wrong / pixels


def polarization_weight(polarization: np.ndarray, stereo: np.ndarray) -> float:
    """How far polarization tells surfaces apart where stereo knows them, from 0 to 0.5.

    polarization, stereo: costs of N planes, rows×columns×N. The weight w of polarization that makes the planes that
    stereo clearly prefers most likely, by Π exp(-w c_own)/Σ_k exp(-w c_k), is 0.5 for independent Gaussian errors of
    the stated size, and 0 where polarization says nothing.
    """
    if stereo.shape[-1] < 2:
        return 0.0
    best, lead = np.empty(stereo.shape[:2], np.int64), np.empty(stereo.shape[:2], np.float32)
    _leaders(stereo, best, lead)
    clear = lead > _CLEAR
    if np.count_nonzero(clear) < _LEAST_CELLS:
        return 0.0
    costs, own = polarization[clear].astype(np.float64), best[clear]
    weight = 1.0 / np.sqrt(np.bincount(own)[own])  # so that the largest plane does not decide alone
    own_cost = np.take_along_axis(costs, own[:, None], axis=1)[:, 0]
    likelihood = [np.average(-w * own_cost - np.log(np.exp(-w * costs).mean(axis=1)), weights=weight)
                  for w in _TRIED_WEIGHTS]  # fmt: skip
    return _TRIED_WEIGHTS[int(np.argmax(likelihood))]


@njit(parallel=True)
def _leaders(costs, best, lead):
    """Which label costs least in each cell, and by how much the next one costs more."""
    for i in prange(best.shape[0]):
        for j in range(best.shape[1]):
            least, second, first = np.float32(np.inf), np.float32(np.inf), 0
            for k in range(costs.shape[2]):
                cost = costs[i, j, k]
                if cost < least:
                    least, second, first = cost, least, k
                elif cost < second:
                    second = cost
            best[i, j], lead[i, j] = first, second - least
