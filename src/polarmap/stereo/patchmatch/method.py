"""PatchMatch multi-view stereo with slanted planes, for one reference image and a few posed neighbours.

A hypothesis is a plane, held as the inverse depth q = 1/z at the pixel and its gradient (q_u, q_v) per pixel:
on a plane inverse depth is affine in the image, so a neighbour's plane is taken over by linear extrapolation,
and the homography it induces is p -> M p + b q(p) with M = K R K⁻¹ and b = K t.

Sources: Bleyer et al., PatchMatch Stereo, BMVC 2011 (slanted support windows, spatial propagation); Galliani
et al., ICCV 2015 (red-black propagation); Xu and Tao, CVPR 2019 (the best of several neighbours on each side);
Schönberger et al., ECCV 2016 (bilateral NCC).
"""

from __future__ import annotations

from collections.abc import Sequence

import cv2
import numpy as np

from polarmap.data.plane_field import PlaneField
from polarmap.data.view import View
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.sensing.noise import estimate_noise
from polarmap.stereo.options import PatchMatchOptions
from polarmap.stereo.patchmatch.level import Level, longest_baseline
from polarmap.stereo.patchmatch.matching import SIDE
from polarmap.stereo.patchmatch.polarized_planes import polarization_field


class PatchMatch:
    """PatchMatch as a `StereoMethod`."""

    def __init__(self, options: PatchMatchOptions | None = None) -> None:
        self.options = options or PatchMatchOptions()

    def __call__(
        self,
        reference: View,
        others: Sequence[View],
        camera: PinholeCamera,
        depth_range: tuple[float, float],
        start: np.ndarray | None = None,
    ) -> PlaneField:
        """See `StereoMethod`; the reference's polarization has a say in how planes are turned."""
        return patchmatch(reference, others, camera, depth_range, self.options, start)


def patchmatch(
    reference: View,
    sources: Sequence[View],
    camera: PinholeCamera,
    depth_range: tuple[float, float],
    options: PatchMatchOptions | None = None,
    initial_inverse_depth: np.ndarray | None = None,
) -> PlaneField:
    """Find for every pixel of `reference` the plane that matches `sources` best, coarse to fine.

    depth_range: (nearest, farthest) z that is tried, in the unit of the poses.
    initial_inverse_depth: float32 H×W, NaN where unknown; a start beside the random one.
    Raises InputError where there is no source, a size differs from the camera's, or no source has moved.
    """
    options = options or PatchMatchOptions()
    _check(reference, sources, camera, depth_range)
    motions = [inverse(s.T_world_camera) @ reference.T_world_camera for s in sources]
    levels = len(options.sweeps)
    references = _pyramid(reference.image.stable, levels)
    source_levels = list(zip(*(_pyramid(s.image.stable, levels) for s in sources), strict=True))
    noise = options.noise or estimate_noise(references[0])
    polarization = reference.image if options.polarization > 0 else None
    fields = _pyramid(polarization_field(polarization, camera.shape), levels)
    matchers = [
        Level.of(
            references[level],
            source_levels[level],
            motions,
            camera.scaled(0.5**level),
            level,
            options,
            depth_range,
            noise,
            fields[level],
            stride=1 if level else options.spacing,
        )
        for level in range(levels)
    ]
    for matcher in matchers[1:]:
        matcher.restrict(matchers[0].active)
    planes = _random_planes(matchers[-1], initial_inverse_depth, options.seed)
    for matcher, sweeps, trials in zip(reversed(matchers), options.sweeps, options.trials, strict=True):
        coarsest = matcher is matchers[-1]
        if not coarsest:
            planes = _upsampled(planes, matcher.shape, matcher.stride)
        cost, chosen = matcher.search(planes, sweeps, trials, coarsest)
    sigma = matcher.refine(planes, cost, chosen)
    q, gu, gv, cost, sigma = matcher.dense(planes, cost, chosen, sigma)
    score = np.clip(1.0 - cost, 0.0, 1.0)
    return PlaneField(q, gu, gv, score, sigma, window=(SIDE - 1) * options.window_step + 1)


def _check(reference, sources, camera, depth_range) -> None:
    if not sources:
        raise InputError("stereo: at least one neighbouring view is needed")
    for view in (reference, *sources):
        if view.image.intensity.shape != camera.shape:
            raise InputError(f"stereo: an image is {view.image.intensity.shape}, the camera says {camera.shape}")
    near, far = depth_range
    if not 0 < near < far:
        raise InputError(f"stereo: the depth range must be 0 < near < far, not ({near}, {far})")
    if longest_baseline(inverse(s.T_world_camera) @ reference.T_world_camera for s in sources) <= 0:
        raise InputError("stereo: no neighbouring view has moved from the reference")


def _pyramid(image: np.ndarray, levels: int) -> list[np.ndarray]:
    pyramid = [image]
    for _ in range(levels - 1):
        height, width = pyramid[-1].shape[:2]
        pyramid.append(cv2.resize(pyramid[-1], (max(width // 2, 8), max(height // 2, 8)), interpolation=cv2.INTER_AREA))
    return pyramid


def _random_planes(matcher: Level, initial: np.ndarray | None, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    shape = matcher.shape
    q = rng.uniform(matcher.q_min, matcher.q_max, shape).astype(np.float32)
    gradients = [(rng.uniform(-1, 1, shape) * q / f).astype(np.float32) for f in matcher.focal]
    if initial is not None:
        start = cv2.resize(initial, shape[::-1], interpolation=cv2.INTER_NEAREST)
        known = np.isfinite(start)
        q[known] = np.clip(start[known], matcher.q_min, matcher.q_max)
    return (q, *gradients)


def _upsampled(planes: tuple[np.ndarray, ...], shape: tuple[int, int], stride: int) -> tuple[np.ndarray, ...]:
    """Planes of every `stride`-th pixel: each takes its coarse pixel's, evaluated at its own centre."""
    rows, columns = (
        np.minimum(np.arange(count) * stride // 2, coarse - 1)
        for count, coarse in zip(shape, planes[0].shape, strict=True)
    )
    q, gu, gv = (plane[rows][:, columns] for plane in planes)
    gu, gv = 0.5 * gu, 0.5 * gv
    du, dv = (
        (np.arange(count) * stride - 2 * coarse - 0.5).astype(np.float32)
        for count, coarse in zip(shape[::-1], (columns, rows), strict=True)
    )
    return q + gu * du + gv * dv[:, None], gu, gv
