"""Parameters of stereo: neighbours and depth range, PatchMatch, and which depths are kept."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, model_validator

from polarmap.options import Options, parameter


class ConsistencyOptions(Options):
    """When a stereo depth is kept."""

    min_score: float = parameter(0.5, "least score of a match, of 0 to 1 (for PatchMatch NCC)", ge=0, le=0.999)
    max_relative_sigma: float = parameter(
        0.02, "largest standard deviation of the depth by noise, as its share", ge=1e-5, le=1
    )
    min_region: int = parameter(40, "smaller islands of smooth depth are dropped", "pixels", ge=1, le=1_000_000)
    max_step: float = parameter(0.02, "largest relative step of depth inside an island", ge=1e-5, le=1)


class InlierOptions(Options):
    """Which stereo points become inliers (the paper's Section III-C)."""

    tolerance: float = parameter(
        0.02, "largest difference between two keyframes, as a share of the depth", "", "III-C", ge=1e-5, le=1
    )
    min_score_unseen: float = parameter(
        0.7, "least score of points that no other keyframe has seen", "", ge=0, le=0.999
    )


class StereoOptions(Options):
    """Method, neighbouring keyframes and depth range of stereo. A method has a section of its own name."""

    method: Literal["patchmatch"] = parameter("patchmatch", "what matches a keyframe with its neighbours")
    past: int = parameter(4, "earlier keyframes that a keyframe is matched with", "keyframes", "III-A", ge=0, le=8)
    future: int = parameter(
        1,
        "later ones; each delays the map by a keyframe, and sees what the earlier ones do not",
        "keyframes",
        ge=0,
        le=8,
    )
    depth_min: float | None = parameter(
        None, "nearest depth tried; by the shortest baseline and known points if not given", "m", ge=1e-6, le=1e6
    )
    depth_max: float | None = parameter(
        None, "farthest depth tried; by the longest baseline and known points if not given", "m", ge=1e-6, le=1e6
    )

    @model_validator(mode="after")
    def _range_is_not_empty(self) -> StereoOptions:
        if self.depth_min and self.depth_max and self.depth_min >= self.depth_max:
            raise ValueError("depth_min must be below depth_max")
        return self


_Count = Annotated[int, Field(ge=0, le=64)]


class PatchMatchOptions(Options):
    """How PatchMatch searches; sweeps and trials are given per pyramid level, coarsest first."""

    window_step: int = parameter(2, "distance of the 5×5 samples of a support window", "pixels", ge=1, le=8)
    sweeps: tuple[_Count, ...] = parameter(
        (2, 1, 1), "red-black sweeps per level; their number is that of levels", min_length=1, max_length=6
    )
    trials: tuple[_Count, ...] = parameter(
        (4, 2, 1), "random trials per pixel and sweep, per level", min_length=1, max_length=6
    )
    spacing: int = parameter(
        2, "of pixels that are searched at full size; those between take a neighbour's plane", "pixels", ge=1, le=2
    )
    best_views: int = parameter(2, "views whose cost counts, best first; others may be occluded", ge=1, le=8)
    tried_views: int = parameter(
        2, "views that a pixel is matched with after the first sweep, those that matched best", ge=1, le=16
    )
    colour_sigma: float = parameter(
        0.05, "difference of sqrt(intensity) at which a sample's weight is a quarter", "1 at full scale", ge=1e-3, le=10
    )
    noise: float | None = parameter(
        None,
        "noise of sqrt(intensity), flatter patches match nothing; from the image if not given",
        "1 at full scale",
        ge=1e-5,
        le=1,
    )
    min_response: float = parameter(
        1.5,
        "least mean square gradient of a window along the epipolar line",
        "noise variances per pixel²",
        ge=0.6,
        le=1e4,
    )
    polarization: float = parameter(
        0.01, "cost of a plane whose normal polarization contradicts, per squared standard deviation", ge=0, le=100
    )
    seed: int = parameter(0, "seed of the random trials", ge=0, le=2**31 - 1)

    @model_validator(mode="after")
    def _levels_match(self) -> PatchMatchOptions:
        if len(self.sweeps) != len(self.trials):
            raise ValueError("sweeps and trials need one number for each level, and at least one level")
        return self
