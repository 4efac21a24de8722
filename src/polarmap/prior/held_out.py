"""Whether a network says more about depth than the points and the place in the image do: told by points held out.

A fit to the points cannot tell: a ramp by image row that never looked at the image correlates with depth wherever the
camera sees a floor. So the image is cut into a chessboard of large squares. From the points of one colour the prior is
made and bent to them, and compared at the points of the other colour with two that do not look. One is the `sparse`
prior made from the same points. The other is what the place in the image explains of the network's answer to another
picture: a function of the row, one of the column, and a polynomial of both. That picture is this one upside down. A
network that looks is better than either. Points count by the weight that a network has where they are, which is little
beside the points that it was bent to.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.prior.alignment import align
from polarmap.prior.bending import bend_to_points, nearness
from polarmap.prior.options import PriorOptions
from polarmap.prior.sparse import MIN_POINTS, interpolate_inverse_depth

_PIXELS = 320 * 240  # what is judged on; a network is smooth
_SQUARE = 0.2  # of the image diagonal: as wide as bare surfaces, or interpolation would always win
_WORST = 0.3  # relative error at which a point counts as wrong, whatever it is
_DEGREE = 4  # of the polynomial of place
_STRIDE = 4


@dataclass(frozen=True)
class HeldOut:
    """Mean relative error of inverse depth at points held out, errors above 30 % counted as that; NaN if not judged.

    Points that both the network and the `sparse` prior miss by more are taken for outliers and left out.

    network: of the network, bent. not_looking: of the better of the two that do not look at the image.
    """

    network: float = np.nan
    not_looking: float = np.nan


@dataclass(frozen=True)
class _Half:
    """Known and judged points of one colour of the chessboard, and the `sparse` prior of the known."""

    intensity: np.ndarray
    known: np.ndarray
    judged: np.ndarray
    depth: np.ndarray  # of the judged, N
    weights: np.ndarray  # of the judged, N
    sparse: np.ndarray
    options: PriorOptions

    def errors(self, inverse_depth: np.ndarray) -> np.ndarray:
        """At the judged points, N."""
        return np.minimum(np.abs(inverse_depth[self.judged] * self.depth - 1.0), _WORST)

    def bent_errors(self, aligned: np.ndarray) -> np.ndarray:
        """Of a network bent to the known points."""
        return self.errors(bend_to_points(aligned, self.sparse, self.intensity, self.known, None, self.options))


def judge_held_out(
    aligned: np.ndarray,
    intensity: np.ndarray,
    sparse_depth: np.ndarray,
    of_other_picture: Callable[[], np.ndarray],
    options: PriorOptions,
) -> HeldOut:
    """Judge an aligned network, float32 H×W inverse depth in 1/m, positive or NaN, at each half of the points.

    intensity: linear grey, float32 H×W. sparse_depth: metres, float32 H×W, NaN where there is no point. Points where
    the network says nothing do not count. of_other_picture: gives the network's relative inverse depth of another
    picture, float32 H×W; asked for only where the network is better than the `sparse` prior.
    All NaN where either colour of the chessboard has too few points.
    """
    said = np.isfinite(aligned)
    points = np.where(said, sparse_depth, np.float32(np.nan))
    step = max(1, int(np.sqrt(aligned.size / _PIXELS)))
    points = _first_points(points, step)
    reduced = _reduced(_without_gaps(aligned), points.shape)
    halves = _halves(_reduced(intensity, points.shape), points, options)
    if not halves:
        return HeldOut()
    of_network = _joined(half.bent_errors(reduced) for half in halves)
    of_sparse = _joined(half.errors(half.sparse) for half in halves)
    weights = _joined(half.weights for half in halves) * ((of_network < _WORST) | (of_sparse < _WORST))
    if not weights.any():
        return HeldOut()
    network, sparse = np.average(of_network, weights=weights), np.average(of_sparse, weights=weights)
    if network >= (1.0 - options.min_gain) * sparse:
        return HeldOut(network, sparse)
    other = of_other_picture()
    if not np.isfinite(other).any():
        return HeldOut(network, sparse)
    blind = _by_place(_reduced(_without_gaps(other), points.shape))
    alignment = align(blind, points, None, options)
    if not alignment.accepted:
        return HeldOut(network, sparse)
    of_blind = _joined(half.bent_errors(alignment.apply(blind)) for half in halves)
    return HeldOut(network, min(sparse, np.average(of_blind, weights=weights)))


def _halves(intensity: np.ndarray, points: np.ndarray, options: PriorOptions) -> list[_Half]:
    """Both colours of the chessboard as the known half; none where one of them has too few points."""
    side = max(1, round(_SQUARE * np.hypot(*points.shape)))
    v, u = np.indices(points.shape) // side
    white, there = (v + u) % 2 == 0, np.isfinite(points)
    if min(np.count_nonzero(there & white), np.count_nonzero(there & ~white)) < MIN_POINTS:
        return []
    halves = []
    for colour in (white, ~white):
        known, judged = np.where(colour, points, np.float32(np.nan)), there & ~colour
        sparse = interpolate_inverse_depth(intensity, known, None, options)
        weights = 1.0 - nearness(np.isfinite(known))[judged]
        halves.append(_Half(intensity, known, judged, points[judged], weights, sparse, options))
    return halves


def _joined(parts: Iterable[np.ndarray]) -> np.ndarray:
    return np.concatenate(list(parts)).astype(np.float64)


def _reduced(field: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    return cv2.resize(field, shape[::-1], interpolation=cv2.INTER_AREA)


def _without_gaps(field: np.ndarray) -> np.ndarray:
    """With the median where there is no value, float32 H×W."""
    known = np.isfinite(field)
    return field if known.all() else np.where(known, field, np.float32(np.median(field[known])))


def _first_points(depth: np.ndarray, step: int) -> np.ndarray:
    """One point of each `step`×`step` pixels that has any, float32 H/step×W/step, NaN elsewhere."""
    if step == 1:
        return depth
    height, width = depth.shape[0] // step, depth.shape[1] // step
    blocks = depth[: height * step, : width * step].reshape(height, step, width, step).swapaxes(1, 2)
    blocks = blocks.reshape(height, width, step * step)
    return np.take_along_axis(blocks, np.isfinite(blocks).argmax(axis=2)[..., None], axis=2)[..., 0]


def _by_place(field: np.ndarray) -> np.ndarray:
    """What of a field the place in the image explains, float32 H×W."""
    additive = field.mean(axis=1, keepdims=True) + field.mean(axis=0, keepdims=True) - field.mean()
    return additive + _nearest_polynomial(field - additive)


def _nearest_polynomial(field: np.ndarray) -> np.ndarray:
    """Of row and column, by least squares, float32 H×W."""
    v, u = (2.0 * i / n - 1.0 for i, n in zip(np.indices(field.shape, np.float32), field.shape, strict=True))
    terms = np.stack([v**i * u**j for i in range(_DEGREE + 1) for j in range(_DEGREE + 1 - i)], axis=-1)
    some = (slice(None, None, _STRIDE),) * 2
    coefficients, *_ = np.linalg.lstsq(terms[some].reshape(-1, terms.shape[-1]), field[some].ravel(), rcond=None)
    return (terms @ coefficients).astype(np.float32)
