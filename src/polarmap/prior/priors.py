"""The depth prior of a frame: smooth metric depth at every pixel, to be trusted within a surface only."""

from __future__ import annotations

import logging
from dataclasses import dataclass
from pathlib import Path
from typing import Protocol

import cv2
import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.polarization.types import PolarizationImage
from polarmap.prior.alignment import PriorAlignment, align
from polarmap.prior.mirrored import mirrored_points
from polarmap.prior.network import DepthNetwork
from polarmap.prior.options import PriorOptions
from polarmap.prior.polarization_network import PolarNetwork
from polarmap.prior.prediction import Prediction
from polarmap.prior.sparse import (
    MIN_POINTS,
    clip_to_points,
    interpolate_field,
    interpolate_inverse_depth,
    inverse_points,
    robust_range,
)
from polarmap.prior_names import POLARNET, SPARSE

_log = logging.getLogger(__name__)
_FLATNESS = 0.1  # what corrects a network is extrapolated as a constant, the network's own slopes are kept
_REACH = 0.03  # of the image diagonal; farther from the points a network's shape is the better guess


@dataclass(frozen=True)
class PriorDepth:
    """Depth prior of one frame.

    depth: z in metres; inverse_depth: 1/z; both float32 H×W, positive, or NaN everywhere where nothing is known.
    source: "sparse", or the network's name. verdict: one line on where it comes from and why.
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
    ) -> PriorDepth:
        """Prior depth from an image and points (z in metres, H×W, NaN where none).

        camera: of the image. confidence: weight of each point, float32 H×W >= 0, or None.
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

    name: str

    def predict(self, image: PolarizationImage, camera: PinholeCamera) -> Prediction:
        """What the network says of the image."""
        ...


class NetworkPrior:
    """A network's depth, aligned to the sparse points and bent to them; the sparse prior where it does not fit."""

    def __init__(self, network: Network, options: PriorOptions | None = None) -> None:
        self.network = network
        self.options = options or PriorOptions()
        self._fallback = SparsePrior(self.options)

    def __call__(
        self,
        image: PolarizationImage,
        sparse_depth: np.ndarray,
        camera: PinholeCamera,
        confidence: np.ndarray | None = None,
    ) -> PriorDepth:
        """See `Prior`."""
        _check_shapes(image, sparse_depth, camera)
        prediction = self.network.predict(image, camera)
        relative = prediction.relative_inverse_depth
        alignment = align(relative, sparse_depth, confidence, self.options)
        if not alignment.accepted:
            return self._fall_back(alignment, image, sparse_depth, camera, confidence)
        aligned = alignment.apply(relative)
        mirrored = mirrored_points(sparse_depth, aligned, prediction)
        points = np.where(mirrored, np.float32(np.nan), sparse_depth)
        interpolated = interpolate_inverse_depth(image.intensity, points, confidence, self.options)
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
        return NetworkPrior(PolarNetwork(threads=options.threads), options)
    return NetworkPrior(DepthNetwork(name_or_path, threads=options.threads), options)


def bend_to_points(
    inverse_depth: np.ndarray,
    interpolated: np.ndarray,
    intensity: np.ndarray,
    sparse_depth: np.ndarray,
    confidence: np.ndarray | None = None,
    options: PriorOptions | None = None,
) -> np.ndarray:
    """An aligned network's inverse depth, corrected by the points: near them theirs, far from them its shape.

    A network's scale differs from surface to surface. The ratio of the points to it, interpolated along surfaces,
    corrects that; and toward the points the result passes into the `sparse` prior, which is better there.
    inverse_depth: positive, float32 H×W in 1/m. interpolated: that of the `sparse` prior. At least three points.
    Returns float32 H×W, bounded as the `sparse` prior is.
    """
    options = options or PriorOptions()
    points, weights = inverse_points(sparse_depth, confidence)
    ratio = points / inverse_depth
    correction = interpolate_field(intensity, ratio, weights, options, _FLATNESS)
    bent = clip_to_points(inverse_depth * np.clip(correction, *robust_range(ratio[weights > 0])), points, weights)
    nearness = _nearness(weights)
    return nearness * interpolated + (1 - nearness) * bent


def _nearness(weights: np.ndarray) -> np.ndarray:
    """1 at the points, 1/2 at `_REACH` diagonals from them, float32 H×W."""
    distance = cv2.distanceTransform((weights <= 0).astype(np.uint8), cv2.DIST_L2, 5)
    return 1.0 / (1.0 + np.square(distance / np.float32(_REACH * np.hypot(*weights.shape))))


def _check_shapes(image: PolarizationImage, sparse_depth: np.ndarray, camera: PinholeCamera) -> None:
    for name, array in (("intensity", image.intensity), ("sparse depth", sparse_depth)):
        if array.shape != camera.shape:
            raise InputError(f"prior: {name} {array.shape} does not fit the camera {camera.shape}")
