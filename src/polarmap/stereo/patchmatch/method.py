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
from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.data.plane_field import PlaneField
from polarmap.data.view import View
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.sensing.noise import estimate_noise
from polarmap.stereo.options import PatchMatchOptions
from polarmap.stereo.patchmatch.kernels import SIDE, evaluate, refine, sweep
from polarmap.stereo.patchmatch.polarized_planes import polarization_field, take_off


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
    planes = None
    for level in range(levels - 1, -1, -1):
        matcher = _Matcher.at_level(
            references[level],
            source_levels[level],
            motions,
            camera.scaled(0.5**level),
            level,
            options,
            depth_range,
            noise,
            fields[level],
        )
        if planes is None:
            planes = _random_planes(matcher, initial_inverse_depth, options.seed)
        else:
            planes = _upsampled(planes, matcher.image.shape)
        stage = levels - 1 - level
        cost, chosen = matcher.search(planes, options.sweeps[stage], options.trials[stage], coarsest=stage == 0)
    sigma = matcher.refine(planes, cost, chosen)
    score = np.clip(1.0 - cost, 0.0, 1.0)
    return PlaneField(*planes, score, sigma, window=(SIDE - 1) * options.window_step + 1)


def _check(reference, sources, camera, depth_range) -> None:
    if not sources:
        raise InputError("stereo: at least one neighbouring view is needed")
    for view in (reference, *sources):
        if view.image.intensity.shape != camera.shape:
            raise InputError(f"stereo: an image is {view.image.intensity.shape}, the camera says {camera.shape}")
    near, far = depth_range
    if not 0 < near < far:
        raise InputError(f"stereo: the depth range must be 0 < near < far, not ({near}, {far})")
    if _longest_baseline(inverse(s.T_world_camera) @ reference.T_world_camera for s in sources) <= 0:
        raise InputError("stereo: no neighbouring view has moved from the reference")


def _longest_baseline(motions) -> float:
    return max(float(np.linalg.norm(T[:3, 3])) for T in motions)


def _pyramid(image: np.ndarray, levels: int) -> list[np.ndarray]:
    pyramid = [image]
    for _ in range(levels - 1):
        height, width = pyramid[-1].shape[:2]
        pyramid.append(cv2.resize(pyramid[-1], (max(width // 2, 8), max(height // 2, 8)), interpolation=cv2.INTER_AREA))
    return pyramid


def _random_planes(matcher: _Matcher, initial: np.ndarray | None, seed: int) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    shape = matcher.image.shape
    q = rng.uniform(matcher.q_min, matcher.q_max, shape).astype(np.float32)
    gradients = [(rng.uniform(-1, 1, shape) * q / f).astype(np.float32) for f in matcher.focal]
    if initial is not None:
        start = cv2.resize(initial, shape[::-1], interpolation=cv2.INTER_NEAREST)
        known = np.isfinite(start)
        q[known] = np.clip(start[known], matcher.q_min, matcher.q_max)
    return (q, *gradients)


def _upsampled(planes: tuple[np.ndarray, ...], shape: tuple[int, int]) -> tuple[np.ndarray, ...]:
    """Each fine pixel takes the plane of its coarse pixel, evaluated at its own centre."""
    q, gu, gv = (cv2.resize(p, shape[::-1], interpolation=cv2.INTER_NEAREST) for p in planes)
    gu, gv = 0.5 * gu, 0.5 * gv
    du = np.where(np.arange(shape[1]) % 2 == 0, -0.5, 0.5).astype(np.float32)
    dv = np.where(np.arange(shape[0]) % 2 == 0, -0.5, 0.5).astype(np.float32)
    return q + gu * du + gv * dv[:, None], gu, gv


@dataclass(frozen=True)
class _Matcher:
    """The images, motions and constants of one pyramid level, as the kernels take them."""

    image: np.ndarray
    sources: np.ndarray  # V·H·W, flat
    M: np.ndarray  # V×3×3
    b: np.ndarray  # V×3
    focal: tuple[float, float]
    intrinsics: np.ndarray  # fx, fy, cx, cy
    q_min: np.float32
    q_max: np.float32
    q_pixel: np.float32  # change of q that moves the longest-baseline match by one pixel
    options: PatchMatchOptions
    offsets: np.ndarray  # 2×25 pixels
    noise: np.float32  # variance
    level: int
    field: np.ndarray  # H×W×3, see `polarization_field`

    @classmethod
    def at_level(cls, image, sources, motions, camera, level, options, depth_range, noise, field=None) -> _Matcher:
        K = camera.matrix
        K_inverse = np.linalg.inv(K)
        steps = (np.arange(SIDE) - SIDE // 2) * options.window_step
        return cls(
            image=image,
            sources=np.concatenate([s.ravel() for s in sources]),
            M=np.stack([K @ T[:3, :3] @ K_inverse for T in motions]).astype(np.float32),
            b=np.stack([K @ T[:3, 3] for T in motions]).astype(np.float32),
            focal=(camera.fx, camera.fy),
            intrinsics=np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32),
            q_min=np.float32(1.0 / depth_range[1]),
            q_max=np.float32(1.0 / depth_range[0]),
            q_pixel=np.float32(1.0 / (camera.fx * _longest_baseline(motions))),
            options=options,
            offsets=np.stack([g.ravel() for g in np.meshgrid(steps, steps)]).astype(np.float32),
            noise=np.float32((noise / 2**level) ** 2),
            level=level,
            field=polarization_field(None, image.shape) if field is None else field,
        )

    def search(self, planes, sweeps: int, trials: int, coarsest: bool) -> tuple[np.ndarray, np.ndarray]:
        """Improve `planes` in place by red-black sweeps; returns their 1 - NCC, and the views that each pixel tries."""
        cost = np.empty_like(self.image)
        tried = len(self.M) if coarsest else min(len(self.M), max(self.options.tried_views, self.options.best_views))
        chosen = np.empty((*self.image.shape, tried), np.uint8)
        evaluate(*self._images(), *planes, cost, chosen, *self._window(), *self._polarization())
        for i in range(sweeps):
            wide = coarsest and i < sweeps - 2
            q_scale = (self.q_max - self.q_min) * 0.5 ** (i + 1) if wide else self.q_pixel * 0.5**i
            slope_scale = (1.0 if coarsest else 0.5) * 0.6**i
            for colour in (0, 1):
                seed = np.uint32((((self.options.seed * 31 + self.level) * 31 + i) * 2 + colour) % 2**32)
                sweep(
                    *self._images(), *planes, cost, chosen, *self._window(), *self._polarization(), self.q_min,
                    self.q_max, colour, trials, np.float32(q_scale), np.float32(slope_scale), seed,
                )  # fmt: skip
        intrinsics, field, weight = self._polarization()
        take_off(cost, weight, *planes, intrinsics, field)
        return cost, chosen

    def refine(self, planes, cost: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Move each inverse depth to the minimum of a parabola in its cost; returns its sigma."""
        sigma = np.empty_like(self.image)
        refine(
            *self._images(),
            *planes,
            cost,
            chosen,
            sigma,
            *self._window(),
            0.5 * self.q_pixel,
            self.q_min,
            np.float32(self.options.min_response),
            np.gradient(self.image, axis=1),
            np.gradient(self.image, axis=0),
        )
        return sigma

    def _polarization(self):
        return self.intrinsics, self.field, np.float32(self.options.polarization)

    def _images(self):
        return self.image, self.sources, self.M, self.b

    def _window(self):
        inverse_colour = np.float32(1.0 / self.options.colour_sigma**2)
        best = min(self.options.best_views, len(self.M))
        return self.offsets, inverse_colour, self.noise, best
