"""One level of the image pyramid, with all that the kernels of PatchMatch take."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from polarmap.stereo.options import PatchMatchOptions
from polarmap.stereo.patchmatch.matching import SIDE, pack
from polarmap.stereo.patchmatch.polarized_planes import polarization_field, take_off
from polarmap.stereo.patchmatch.refinement import fill, refine, responsive
from polarmap.stereo.patchmatch.search import evaluate, sweep

_SAME = 0.02  # pixels; planes that move no match by more are the same
_PARABOLAS = 0.5, 0.25  # pixels on either side, one after the other


def longest_baseline(motions: Iterable[np.ndarray]) -> float:
    """Of motions, 4×4 each, in their unit."""
    return max(float(np.linalg.norm(T[:3, 3])) for T in motions)


@dataclass(frozen=True)
class Level:
    """The images, motions and constants of one pyramid level, as the kernels take them."""

    image: np.ndarray
    sources: np.ndarray  # V·H·W, packed and flat
    M: np.ndarray  # V×3×3
    b: np.ndarray  # V×3
    focal: tuple[float, float]
    intrinsics: np.ndarray  # fx, fy, cx, cy
    q_min: np.float32
    q_max: np.float32
    q_pixel: np.float32  # change of q that moves the longest-baseline match by one pixel
    options: PatchMatchOptions
    offsets: np.ndarray  # 2×25 pixels
    unit: np.float32  # what 1 is in a packed source
    noise: np.float32  # variance
    level: int
    field: np.ndarray  # H×W×3, see `polarization_field`
    stride: int  # pixels from one that is searched to the next
    slopes: tuple[np.ndarray, np.ndarray]  # along u and v
    active: np.ndarray  # bool, of those that are searched: what the image has a structure for

    @classmethod
    def of(cls, image, sources, motions, camera, level, options, depth_range, noise, field=None, stride=1) -> Level:
        K = camera.matrix
        K_inverse = np.linalg.inv(K)
        steps = (np.arange(SIDE) - SIDE // 2) * options.window_step
        offsets = np.stack([g.ravel() for g in np.meshgrid(steps, steps)]).astype(np.float32)
        white = np.float32(max(float(s.max()) for s in sources) or 1.0)
        variance = np.float32((noise / 2**level) ** 2)
        slopes = np.gradient(image, axis=1), np.gradient(image, axis=0)
        active = np.ones([-(-size // stride) for size in image.shape], bool)
        responsive(
            image, *slopes, active, stride, offsets, _inverse_colour(options), variance,
            np.float32(options.min_response),
        )  # fmt: skip
        return cls(
            image=image,
            sources=np.concatenate([pack(s, white).ravel() for s in sources]),
            M=np.stack([K @ T[:3, :3] @ K_inverse for T in motions]).astype(np.float32),
            b=np.stack([K @ T[:3, 3] for T in motions]).astype(np.float32),
            focal=(camera.fx, camera.fy),
            intrinsics=np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float32),
            q_min=np.float32(1.0 / depth_range[1]),
            q_max=np.float32(1.0 / depth_range[0]),
            q_pixel=np.float32(1.0 / (camera.fx * longest_baseline(motions))),
            options=options,
            offsets=offsets,
            unit=np.float32(65535.0) / white,
            noise=variance,
            level=level,
            field=polarization_field(None, image.shape) if field is None else field,
            stride=stride,
            slopes=slopes,
            active=active,
        )

    @property
    def shape(self) -> tuple[int, int]:
        """How many pixels are searched, down and across."""
        return self.active.shape

    def restrict(self, wanted: np.ndarray) -> None:
        """Search only where `wanted`, bool of any size over the same view, has something."""
        share = cv2.resize(wanted.astype(np.float32), self.shape[::-1], interpolation=cv2.INTER_AREA)
        self.active[share == 0] = False

    def search(self, planes, sweeps: int, trials: int, coarsest: bool) -> tuple[np.ndarray, np.ndarray]:
        """Improve `planes` in place by red-black sweeps; returns their 1 - NCC, and the views that each pixel tries.

        At the coarsest level those are all during the first sweep, since no view can be told from another by random
        planes, and the best after it.
        """
        cost = np.empty(self.shape, np.float32)
        chosen = self._choose_views(planes, cost, len(self.M) if coarsest else self._tried)
        for i in range(sweeps):
            if i == 1 and coarsest:
                chosen = self._choose_views(planes, cost, self._tried)
            wide = coarsest and i < sweeps - 2
            q_scale = (self.q_max - self.q_min) * 0.5 ** (i + 1) if wide else self.q_pixel * 0.5**i
            slope_scale = (1.0 if coarsest else 0.5) * 0.6**i
            for colour in (0, 1):
                seed = np.uint32((((self.options.seed * 31 + self.level) * 31 + i) * 2 + colour) % 2**32)
                sweep(
                    *self._images(), *planes, cost, chosen, self.active, self.stride, *self._window(),
                    *self._polarization(), self.q_min, self.q_max, np.float32(_SAME * self.q_pixel), self.level > 0,
                    colour, trials, np.float32(q_scale), np.float32(slope_scale), seed,
                )  # fmt: skip
        intrinsics, field, weight = self._polarization()
        take_off(cost, weight, *planes, intrinsics, field, self.stride)
        return cost, chosen

    def refine(self, planes, cost: np.ndarray, chosen: np.ndarray) -> np.ndarray:
        """Move each inverse depth to the minimum of parabolas in its cost; returns its sigma."""
        sigma = np.empty(self.shape, np.float32)
        steps = np.array(_PARABOLAS, np.float32) * self.q_pixel
        refine(
            *self._images(), *planes, cost, chosen, self.active, self.stride, *self._window(), sigma, steps,
            self.q_min, np.float32(self.options.min_response), *self.slopes,
        )  # fmt: skip
        return sigma

    def dense(self, planes, cost: np.ndarray, chosen: np.ndarray, sigma: np.ndarray) -> tuple[np.ndarray, ...]:
        """Planes, cost and sigma of all pixels, float32 H×W each."""
        if self.stride == 1:
            return (*planes, cost, sigma)
        whole = tuple(np.empty(self.image.shape, np.float32) for _ in range(5))
        fill(
            *self._images(), *planes, cost, chosen, sigma, self.stride, *self._window(),
            np.float32(self.options.min_response), *self.slopes, *whole,
        )  # fmt: skip
        return whole

    @property
    def _tried(self) -> int:
        return min(len(self.M), max(self.options.tried_views, self.options.best_views))

    def _choose_views(self, planes, cost: np.ndarray, count: int) -> np.ndarray:
        """The views that match each pixel's plane best, uint8 H'×W'×count; fills its cost."""
        chosen = np.empty((*self.shape, count), np.uint8)
        evaluate(
            *self._images(), *planes, cost, chosen, self.active, self.stride, *self._window(), *self._polarization()
        )
        return chosen

    def _polarization(self):
        return self.intrinsics, self.field, np.float32(self.options.polarization)

    def _images(self):
        return self.image, self.sources, self.M, self.b

    def _window(self):
        best = min(self.options.best_views, len(self.M))
        return self.offsets, _inverse_colour(self.options), self.unit, self.noise, best


def _inverse_colour(options: PatchMatchOptions) -> np.float32:
    return np.float32(1.0 / options.colour_sigma**2)
