"""The paper's loop (Section III-D): propagate, estimate, validate and smooth until few new points come."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from polarmap.data.codes import Origin
from polarmap.data.dense_depth import DenseDepth
from polarmap.data.view import Neighbour
from polarmap.densify.options import PaperOptions
from polarmap.densify.paper.smooth import edge_weights, smooth_total_variation
from polarmap.densify.paper.trace import Arrivals, trace
from polarmap.densify.sigma import extrapolation_sigma
from polarmap.densify.validate import contradicts_depth, contradicts_intensity, local_mean
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_depth, range_factor


def densify(
    seeds: np.ndarray,
    gradient: np.ndarray,
    image: np.ndarray,
    others: Sequence[Neighbour],
    camera: PinholeCamera,
    options: PaperOptions | None = None,
) -> DenseDepth:
    """Spread the depth of `seeds` along and across the contours of a gradient field.

    seeds: float32 H×W z, NaN where unknown. gradient: ∇ log range per pixel, float32 H×W×2, NaN where no walk may
    pass. image: sqrt(intensity), float32 H×W. others: views that new depths must not contradict.
    Raises InputError where shapes differ from the camera's.
    """
    options = options or PaperOptions()
    arrays = [("seeds", seeds), ("gradient", gradient), ("image", image)]
    arrays += [("other image", view.image) for view in others]
    arrays += [("other depth", view.depth) for view in others if view.depth is not None]
    for name, array in arrays:
        if array.shape[:2] != camera.shape:
            raise InputError(f"densify: {name} have shape {array.shape}, the camera says {camera.shape}")
    spread = _Spread(seeds, gradient, image, others, camera, options)
    added: list[int] = []
    first = seeds
    while len(added) < options.max_iterations:
        added.append(spread.iterate())
        if len(added) == 1:
            first = spread.depth()
        if added[-1] <= options.min_growth * max(spread.known(), 1):
            break
    depth, sigma = spread.depth(), extrapolation_sigma(spread.distance)
    normal = normals_from_depth(depth, camera, radius=4, stride=2)
    return DenseDepth(depth, normal, sigma, spread.origin, spread.distance, first, tuple(added))


class _Spread:
    """The state of the loop, in log range, in which contours are level and slopes are sums."""

    def __init__(self, seeds, gradient, image, others, camera, options):
        self.options = options
        self.camera = camera
        self.image = local_mean(image)
        self.images = [(local_mean(view.image), view.T_other_this) for view in others]
        self.depths = [(view.depth, view.T_other_this) for view in others if view.depth is not None]
        self.gradient = np.ascontiguousarray(gradient, np.float32)
        self.log_factor = np.log(range_factor(camera))
        known = seeds > 0
        seeds = np.where(known, seeds, np.float32(np.nan))
        self.log_range = (np.log(seeds) + self.log_factor).astype(np.float32)
        self.distance = np.where(known, np.float32(0.0), np.float32(np.nan))
        self.origin = np.where(known, Origin.STEREO, Origin.NONE).astype(np.uint8)
        self.uphill = _unit(self.gradient)
        self.contour = np.stack([-self.uphill[..., 1], self.uphill[..., 0]], axis=-1)
        self.barrier = _gradient_size(image) > options.edge
        self.smoothness = edge_weights(image**2, options.edge_decay)
        self.depth_range = np.ptp(np.percentile(seeds[known], (1, 99))) if known.any() else 0.0

    def known(self) -> int:
        return int(np.count_nonzero(self.origin))

    def depth(self) -> np.ndarray:
        return np.exp(self.log_range - self.log_factor)

    def iterate(self) -> int:
        """One round; returns how many points it added."""
        propagated = self._walk(self.contour, None)
        estimated = self._walk(self.uphill, self.gradient)
        new_range, distance, origin = _merge(propagated, estimated)
        rejected = self._contradicted(new_range)
        self.barrier |= rejected
        fresh = np.isfinite(new_range) & ~rejected
        np.copyto(self.log_range, new_range, where=fresh)
        np.copyto(self.distance, distance, where=fresh)
        np.copyto(self.origin, origin, where=fresh)
        self._smooth()
        return int(np.count_nonzero(fresh))

    def _walk(self, direction, gradient) -> Arrivals:
        options = self.options
        return trace(
            self.log_range, self.distance, direction, gradient, self.barrier, options.max_turn, options.max_steps
        )

    def _contradicted(self, log_range: np.ndarray) -> np.ndarray:
        depth = np.exp(log_range - self.log_factor)
        rejected = contradicts_intensity(depth, self.image, self.images, self.camera, self.options.intensity_tolerance)
        tolerance = self.options.depth_tolerance * self.depth_range
        for other, T_other_this in self.depths:
            rejected |= contradicts_depth(depth, other, self.camera, T_other_this, tolerance)
        return rejected

    def _smooth(self) -> None:
        options = self.options
        self.log_range = smooth_total_variation(
            self.log_range, self.smoothness, options.smoothing, options.smoothing_iterations, options.smoothing_step
        )


def _merge(propagated: Arrivals, estimated: Arrivals) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Log range, distance and origin where either walk arrived; both are weighted by 1/distance."""
    near = [np.nan_to_num(1.0 / a.distance, nan=0.0) for a in (propagated, estimated)]
    total = near[0] + near[1]
    arrived = total > 0
    values = near[0] * np.nan_to_num(propagated.log_range) + near[1] * np.nan_to_num(estimated.log_range)
    merged = np.where(arrived, values / np.where(arrived, total, 1.0), np.nan).astype(np.float32)
    distance = np.fmin(propagated.distance, estimated.distance)
    origin = np.where(near[0] >= near[1], Origin.PROPAGATED, Origin.ESTIMATED)
    return merged, distance, np.where(arrived, origin, Origin.NONE).astype(np.uint8)


def _unit(gradient: np.ndarray) -> np.ndarray:
    length = np.sqrt(gradient[..., 0] ** 2 + gradient[..., 1] ** 2)
    return gradient / np.maximum(length, 1e-12)[..., None]


def _gradient_size(image: np.ndarray) -> np.ndarray:
    gu, gv = np.gradient(image, axis=1), np.gradient(image, axis=0)
    return np.hypot(gu, gv)
