"""The depth prior of a frame: smooth metric depth at every pixel, to be trusted within a surface only."""

from __future__ import annotations

import logging
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

import numpy as np

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.prior.alignment import PriorAlignment, Verdict, align
from polarmap.prior.bending import bend_to_points
from polarmap.prior.held_out import judge_held_out
from polarmap.prior.mirrored import mirrored_points
from polarmap.prior.names import POLARNET, SPARSE
from polarmap.prior.network import DepthNetwork
from polarmap.prior.options import PriorOptions
from polarmap.prior.polarization_network import PolarNetwork
from polarmap.prior.prediction import Prediction
from polarmap.prior.space_check import SpaceCheck, other_way
from polarmap.prior.sparse import MIN_POINTS, interpolate_inverse_depth, inverse_points

_log = logging.getLogger(__name__)


@dataclass(frozen=True)
class PriorDepth:
    """Depth prior of one frame.

    depth: z in metres; inverse_depth: 1/z; both float32 H×W, positive, or NaN everywhere where nothing is known.
    source: "sparse", or the network's name. verdict: one line on where it comes from and why: "NAME accepted
    (figures)", "NAME rejected: REASON (figures); what took its place", "interpolated from N sparse points", or "no
    prior: REASON".
    alignment: of the network, rejected or not; None where there is no network.
    by_points: what the points alone would give beside a network, z in metres, float32 H×W; None where `depth` is that.
    prediction: what an accepted network says of the view, aligned_depth: its depth in metres, float32 H×W, not bent
    to the points, and mirrored: bool H×W, the points that it takes for mirrored ones, which nothing here is bent to;
    None where there is none.
    """

    depth: np.ndarray
    inverse_depth: np.ndarray
    source: str
    verdict: str
    alignment: PriorAlignment | None = None
    by_points: np.ndarray | None = None
    prediction: Prediction | None = None
    aligned_depth: np.ndarray | None = None
    mirrored: np.ndarray | None = None


class Prior(Protocol):
    """Makes the prior of a frame."""

    def __call__(
        self,
        image: PolarizationImage,
        sparse_depth: np.ndarray,
        camera: PinholeCamera,
        confidence: np.ndarray | None = None,
        hurry: bool = False,
    ) -> PriorDepth:
        """Prior depth from an image and points (z in metres, H×W, NaN where none).

        camera: of the image. confidence: weight of each point, float32 H×W >= 0, or None. hurry: what takes less time
        will do, such as one look of polarnet's three, whatever `PriorOptions.looks` says.
        Raises InputError where shapes differ from the camera's.
        """
        ...


class SparsePrior:
    """Interpolates the sparse points along the surfaces that the image's edges delimit."""

    def __init__(self, options: PriorOptions | None = None) -> None:
        self.options = options or PriorOptions()

    def __call__(
        self,
        image: PolarizationImage,
        sparse_depth: np.ndarray,
        camera: PinholeCamera,
        confidence: np.ndarray | None = None,
        hurry: bool = False,
    ) -> PriorDepth:
        """See `Prior`. Fewer than three points give NaN everywhere."""
        _check_shapes(image, sparse_depth, camera)
        inverse_depth = interpolate_inverse_depth(image.intensity, sparse_depth, confidence, self.options)
        n_points = int(np.count_nonzero(inverse_points(sparse_depth, confidence)[1]))
        if n_points < MIN_POINTS:
            verdict = f"no prior: {n_points} sparse points, {MIN_POINTS} are needed"
        else:
            verdict = f"interpolated from {n_points} sparse points"
        return PriorDepth(1.0 / inverse_depth, inverse_depth, SPARSE, verdict)


class Network(Protocol):
    """`DepthNetwork` for grey pictures, `PolarNetwork`."""

    @property
    def name(self) -> str:
        """What a run calls it."""
        ...

    def predict(self, image: PolarizationImage, camera: PinholeCamera, hurry: bool = False) -> Prediction:
        """What the network says of the image. hurry: as of `Prior`."""
        ...


class NetworkPrior:
    """A network's depth, aligned to the sparse points and bent to them; the sparse prior where it is no better.

    A network that does not know its own errors must prove in each frame that it looks (`held_out`). One whose output
    space is known by its name alone may turn out to give the other (`space_check`); that is remembered from frame to
    frame, so that each sequence wants a prior of its own.
    """

    def __init__(self, network: Network, options: PriorOptions | None = None) -> None:
        self.network = network
        self.options = options or PriorOptions()
        self._fallback = SparsePrior(self.options)
        guessed = isinstance(network, DepthNetwork) and not network.declared
        self._space = SpaceCheck(network) if guessed else None

    def __call__(
        self,
        image: PolarizationImage,
        sparse_depth: np.ndarray,
        camera: PinholeCamera,
        confidence: np.ndarray | None = None,
        hurry: bool = False,
    ) -> PriorDepth:
        """See `Prior`."""
        _check_shapes(image, sparse_depth, camera)
        prediction = self.network.predict(image, camera, hurry)
        prediction, alignment = self._aligned(prediction, image, sparse_depth, confidence, camera)
        if not alignment.accepted:
            return self._fall_back(alignment, image, sparse_depth, camera, confidence)
        aligned = alignment.apply(prediction.relative_inverse_depth)
        mirrored = mirrored_points(sparse_depth, aligned, prediction)
        points = np.where(mirrored, np.float32(np.nan), sparse_depth)
        interpolated = interpolate_inverse_depth(image.intensity, points, confidence, self.options)
        aligned = _completed(aligned, interpolated, alignment)
        inverse_depth = aligned
        if self.options.refine and np.isfinite(interpolated).all():
            inverse_depth = bend_to_points(aligned, interpolated, image.intensity, points, confidence, self.options)
        return PriorDepth(
            depth=1.0 / inverse_depth,
            inverse_depth=inverse_depth,
            source=self.network.name,
            verdict=f"{self.network.name} {alignment}",
            alignment=alignment,
            by_points=1.0 / interpolated,
            prediction=prediction,
            aligned_depth=1.0 / aligned,
            mirrored=mirrored,
        )

    def _aligned(self, prediction, image, sparse_depth, confidence, camera) -> tuple[Prediction, PriorAlignment]:
        """The prediction, read the way in use, and its alignment with the verdict."""

        def judged(read: Callable[[np.ndarray], np.ndarray]) -> tuple[Prediction, PriorAlignment]:
            found = replace(prediction, relative_inverse_depth=read(prediction.relative_inverse_depth))
            return found, self._judged(found, read, image, sparse_depth, confidence, camera)

        if self._space is None:
            return judged(lambda relative: relative)
        swapped, other = self._space.swapped, None
        in_use = judged(self._space.read)
        if in_use[1].verdict is Verdict.INVERTED:
            other = judged(lambda relative: other_way(self._space.read(relative)))
        self._space.note(in_use[1], other and other[1])
        return other if self._space.swapped != swapped else in_use

    def _judged(self, prediction, read, image, sparse_depth, confidence, camera) -> PriorAlignment:
        """The alignment of a prediction, rejected where it is no better than without looking at the image."""
        alignment = align(prediction.relative_inverse_depth, sparse_depth, confidence, self.options)
        if not alignment.accepted or prediction.sigma_depth is not None:
            return alignment

        def of_other_picture() -> np.ndarray:
            upside_down = PolarizationImage.unpolarized(np.ascontiguousarray(image.intensity[::-1]))
            return read(self.network.predict(upside_down, camera).relative_inverse_depth)

        aligned = alignment.apply(prediction.relative_inverse_depth)
        points = np.where(inverse_points(sparse_depth, confidence)[1] > 0, sparse_depth, np.float32(np.nan))
        errors = judge_held_out(aligned, image.intensity, points, of_other_picture, self.options)
        return alignment.judged(errors.network, errors.not_looking, self.options.min_gain)

    def _fall_back(self, alignment, image, sparse_depth, camera, confidence) -> PriorDepth:
        sparse = self._fallback(image, sparse_depth, camera, confidence)
        verdict = f"{self.network.name} rejected: {alignment}; {sparse.verdict}"
        _log.info("prior: %s", verdict)
        return PriorDepth(sparse.depth, sparse.inverse_depth, sparse.source, verdict, alignment)


def make_prior(name_or_path: str | Path, options: PriorOptions | None = None) -> Prior:
    """The prior `sparse`, `polarnet` (the package's own network), or that of the ONNX network at a path.

    Raises InputError where the file is missing or is no relative depth network.
    """
    options = options or PriorOptions()
    if str(name_or_path) == SPARSE:
        return SparsePrior(options)
    if str(name_or_path) == POLARNET:
        own = PolarNetwork(threads=options.threads, time_limit=options.time_limit, looks=options.looks)
        return NetworkPrior(own, options)
    network = DepthNetwork(name_or_path, threads=options.threads, time_limit=options.time_limit)
    return NetworkPrior(network, options)


def _completed(aligned: np.ndarray, interpolated: np.ndarray, alignment: PriorAlignment) -> np.ndarray:
    """With what the points give, else far away, where the network says nothing, such as in the sky."""
    missing = np.isnan(aligned)
    if not missing.any():
        return aligned
    else_far = np.where(np.isnan(interpolated), np.float32(alignment.min_inverse_depth), interpolated)
    return np.where(missing, else_far, aligned)


def _check_shapes(image: PolarizationImage, sparse_depth: np.ndarray, camera: PinholeCamera) -> None:
    for name, array in (("intensity", image.intensity), ("sparse depth", sparse_depth)):
        if array.shape != camera.shape:
            raise InputError(f"prior: {name} {array.shape} does not fit the camera {camera.shape}")
