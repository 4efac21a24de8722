"""Robust alignment of relative inverse depth to sparse points, and the verdict whether it is worth anything.

Networks predict inverse depth up to an affine map, so per frame 1/z = a d + b with a > 0 is fitted to the points: the
best of many lines through two points (least median of squares) starts a reweighted fit with Cauchy's weights. Errors
are relative to 1/z, hence errors of depth in percent.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum

import numpy as np
from scipy.stats import rankdata

from polarmap.errors import InputError
from polarmap.prior.options import PriorOptions
from polarmap.prior.sparse import inverse_points

_MAX_ANCHORS = 2000
_BUCKETS = 32  # per side; anchors are drawn evenly from them
_CANDIDATES = 256
_CANDIDATE_ANCHORS = 400
_CAUCHY = 2.385  # 95 % efficient on Gaussian errors
_REWEIGHTINGS = 10
_CONSTANT = 1e-4  # spread as a share of magnitude
_LEAST_VALID = 0.5  # of the pixels; the sky, which has no depth, may be the rest
_FARTHEST = 4.0  # times the depth of the farthest anchor


class Verdict(str, Enum):
    """What became of an alignment."""

    ACCEPTED = "accepted"
    TOO_FEW_ANCHORS = "too few anchors"
    NOT_FINITE = "not finite"
    CONSTANT = "constant"
    INVERTED = "inverted"
    POOR_FIT = "poor fit"
    NO_GAIN = "no better than the points"


@dataclass(frozen=True)
class PriorAlignment:
    """1/z = scale · d + offset, in 1/m; NaN where the verdict came before a fit.

    rank_correlation: Spearman's, of d with the anchors' inverse depth. residual: median relative error of depth at
    the anchors. min_inverse_depth: what non-positive inverse depths are raised to, 1/m. held_out, blind: mean relative
    error at points held out, of the network and of the better of two that do not look (`judge_held_out`).
    """

    verdict: Verdict
    n_anchors: int
    scale: float = np.nan
    offset: float = np.nan
    rank_correlation: float = np.nan
    residual: float = np.nan
    min_inverse_depth: float = np.nan
    held_out: float = np.nan
    blind: float = np.nan

    @property
    def accepted(self) -> bool:
        """Whether the prior may be used."""
        return self.verdict is Verdict.ACCEPTED

    def apply(self, relative: np.ndarray) -> np.ndarray:
        """Positive metric inverse depth of relative inverse depth, float32, same shape; NaN stays."""
        aligned = np.float32(self.scale) * relative + np.float32(self.offset)
        return np.maximum(aligned, np.float32(self.min_inverse_depth))

    def judged(self, held_out: float, blind: float, min_gain: float) -> PriorAlignment:
        """With the errors at points held out, and rejected unless that of the network is smaller by `min_gain`.

        Where they are NaN, since the points lie too close together to hold some out, it is rejected, too.
        """
        if np.isnan(held_out):
            return replace(self, verdict=Verdict.TOO_FEW_ANCHORS)
        gains = held_out < (1.0 - min_gain) * blind
        return replace(self, verdict=self.verdict if gains else Verdict.NO_GAIN, held_out=held_out, blind=blind)

    def __str__(self) -> str:
        if self.verdict in (Verdict.NOT_FINITE, Verdict.TOO_FEW_ANCHORS):
            return f"{self.verdict.value} ({self.n_anchors} anchors)"
        figures = f"rank correlation {self.rank_correlation:.2f}, {self.n_anchors} anchors"
        if np.isfinite(self.residual):
            figures += f", median error {100 * self.residual:.1f} %"
        if np.isfinite(self.held_out):
            figures += f", held out {100 * self.held_out:.1f} % against {100 * self.blind:.1f} %"
        return f"{self.verdict.value} ({figures})"


def align(
    relative: np.ndarray,
    sparse_depth: np.ndarray,
    confidence: np.ndarray | None = None,
    options: PriorOptions | None = None,
) -> PriorAlignment:
    """Fit relative inverse depth to sparse depth (metres, H×W, NaN where none).

    relative: float32 H×W, near is large, NaN where the network says nothing, which may be half of it.
    confidence: weight of each point, H×W, or None. Deterministic. Raises InputError where shapes differ.
    """
    options = options or PriorOptions()
    if relative.shape != sparse_depth.shape:
        raise InputError(
            f"prior: relative depth {relative.shape} and sparse depth {sparse_depth.shape} differ in shape"
        )
    valid = np.isfinite(relative)
    inverse_depth, point_weights = inverse_points(sparse_depth, confidence)
    d, q, weights = _anchors(relative, inverse_depth, np.where(valid, point_weights, 0))
    if np.count_nonzero(valid) < _LEAST_VALID * valid.size:
        return PriorAlignment(Verdict.NOT_FINITE, d.size)
    if d.size < options.min_anchors:
        return PriorAlignment(Verdict.TOO_FEW_ANCHORS, d.size)
    if _is_constant(d):
        return PriorAlignment(Verdict.CONSTANT, d.size)
    rank_correlation = _rank_correlation(d, q)
    if rank_correlation < options.min_rank_correlation:
        inverted = rank_correlation <= -options.min_rank_correlation
        verdict = Verdict.INVERTED if inverted else Verdict.POOR_FIT
        return PriorAlignment(verdict, d.size, rank_correlation=rank_correlation)
    scale, offset = _robust_line(d, q, weights)
    return PriorAlignment(
        Verdict.ACCEPTED if scale > 0 else Verdict.POOR_FIT,
        d.size,
        scale,
        offset,
        rank_correlation,
        float(np.median(np.abs(scale * d + offset - q) / q)),
        float(np.quantile(q, 0.005) / _FARTHEST),
    )


def _anchors(
    relative: np.ndarray, inverse_depth: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """d, 1/z and weight, float64, of at most `_MAX_ANCHORS` points spread evenly over the image."""
    index = np.flatnonzero(weights)
    index = index[:: index.size // (4 * _MAX_ANCHORS) + 1]
    if index.size > _MAX_ANCHORS:
        index = _spread(index, relative.shape)
    return tuple(a.ravel()[index].astype(np.float64) for a in (relative, inverse_depth, weights))


def _spread(index: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """The first few of each bucket of the image, in random order, until there are `_MAX_ANCHORS`."""
    index = np.random.default_rng(0).permutation(index)
    v, u = np.divmod(index, shape[1])
    bucket = v * _BUCKETS // shape[0] * _BUCKETS + u * _BUCKETS // shape[1]
    order = np.argsort(bucket, kind="stable")
    first = np.searchsorted(bucket[order], bucket[order])
    turn = np.empty(index.size, np.int64)
    turn[order] = np.arange(index.size) - first
    return index[np.argsort(turn, kind="stable")[:_MAX_ANCHORS]]


def _is_constant(d: np.ndarray) -> bool:
    low, high = np.quantile(d, [0.02, 0.98])
    return bool(high - low <= _CONSTANT * np.abs(d).max())


def _rank_correlation(d: np.ndarray, q: np.ndarray) -> float:
    if q.min() == q.max():  # a flat scene says nothing about order
        return 0.0
    return float(np.corrcoef(rankdata(d), rankdata(q))[0, 1])


def _robust_line(d: np.ndarray, q: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    """a, b of q = a d + b; a <= 0 where no rising line fits."""
    centre, spread = np.median(d), np.ptp(np.quantile(d, [0.05, 0.95]))
    x = (d - centre) / max(spread, np.finfo(np.float64).tiny)
    a, b = _least_median_line(x, q)
    for _ in range(_REWEIGHTINGS):
        error = (a * x + b) / q - 1.0
        width = _CAUCHY * max(1.4826 * np.median(np.abs(error)), 1e-6)
        w = weights / (1.0 + np.square(error / width)) / q**2
        a, b = _weighted_line(x, q, w)
    return float(a / spread), float(b - a * centre / spread)


def _least_median_line(x: np.ndarray, q: np.ndarray) -> tuple[float, float]:
    """The rising line through two points that has the least median relative error."""
    rng = np.random.default_rng(0)
    i, j = rng.integers(x.size, size=(2, _CANDIDATES))
    with np.errstate(divide="ignore", invalid="ignore"):
        a = (q[i] - q[j]) / (x[i] - x[j])
    a = np.where(np.isfinite(a) & (a > 0), a, 0.0)
    b = q[i] - a * x[i]
    some = rng.permutation(x.size)[:_CANDIDATE_ANCHORS]
    errors = np.abs((a[:, None] * x[some] + b[:, None]) / q[some] - 1.0)
    best = np.argmin(np.median(errors, axis=1))
    return a[best], b[best]


def _weighted_line(x: np.ndarray, q: np.ndarray, weights: np.ndarray) -> tuple[float, float]:
    total = weights.sum()
    x_mean, q_mean = weights @ x / total, weights @ q / total
    variance = weights @ np.square(x - x_mean)
    a = weights @ ((x - x_mean) * (q - q_mean)) / variance if variance > 0 else 0.0
    return a, q_mean - a * x_mean
