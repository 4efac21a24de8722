"""Parameters of densification."""

from __future__ import annotations

from typing import Literal

import numpy as np

from polarmap.options import Options, parameter


class DensifyOptions(Options):
    """Which method spreads sparse depth; each has a section of its own name."""

    method: Literal["surfaces", "paper"] = parameter(
        "surfaces", "'surfaces' gives cells to planes and a free surface; 'paper' is the paper's loop"
    )


class PaperOptions(Options):
    """How the paper's loop spreads sparse depth."""

    max_turn: float = parameter(np.pi / 6, "change of direction that ends a walk", "rad", "III-D", ge=0.01, le=1.57)
    max_steps: int = parameter(32, "longest walk in one iteration", "pixels", ge=1, le=10_000)
    max_iterations: int = parameter(10, "bound on the iterations", source="III-D", ge=0, le=1000)
    min_growth: float = parameter(0.1, "stop when new points are a smaller share of all", source="III-D", ge=0, le=1)
    edge: float = parameter(
        0.06, "gradient of sqrt(intensity) that no walk crosses", "1/pixel at full scale", ge=1e-4, le=10
    )
    depth_tolerance: float = parameter(
        0.03,
        "two-view disagreement that rejects a new depth, as a share of the depth range",
        source="III-C",
        ge=1e-4,
        le=1,
    )
    intensity_tolerance: float = parameter(
        0.015,
        "difference of sqrt(intensity) in all other views that rejects a new depth",
        "1 at full scale",
        ge=1e-4,
        le=1,
    )
    smoothing: float = parameter(0.3, "λ of the total variation", source="III-D", ge=0, le=100)
    edge_decay: float = parameter(3.0, "ζ in τ = exp(-ζ|∇I|)", source="III-D", ge=0, le=1000)
    smoothing_step: float = parameter(
        0.05, "relative step of range that smoothing leaves alone, as an edge", ge=1e-4, le=10
    )
    smoothing_iterations: int = parameter(3, "inner iterations of the total variation", source="III-E", ge=0, le=100)


class SurfaceOptions(Options):
    """How cells of the image are given to surfaces."""

    cells: int = parameter(
        19200, "cells that the image is cut into, about (4×4 pixels at 640×480)", ge=100, le=1_000_000
    )
    tolerance: float = parameter(
        0.01, "relative error that a point may have; down to 0.7 of it where stereo is more precise", ge=1e-4, le=0.19
    )
    max_planes: int = parameter(16, "planes that may explain a view", ge=0, le=64)
    least_share: float = parameter(0.01, "share of the points that a plane must explain", ge=1e-4, le=1)
    free_cost: float = parameter(1.0, "what a cell of a free surface costs, in squared errors", ge=0, le=1e4)
    hole_cost: float = parameter(
        2.0,
        "what a cell costs whose label lies behind a plane that nothing else is behind, in squared errors",
        ge=0,
        le=1e4,
    )
    hiding_cost: float = parameter(
        4.0,
        "what a cell costs, for each of up to two other keyframes, whose label would hide points that these see, in "
        "squared errors",
        ge=0,
        le=1e4,
    )
    boundary_cost: float = parameter(16.0, "what a change of label costs per cell, in squared errors", ge=0, le=1e4)
    contrast: float = parameter(
        0.03, "step of sqrt(intensity) that lowers the cost of a change e-fold", "1 at full scale", ge=1e-3, le=10
    )
    polarization_contrast: float = parameter(
        0.05, "step of (S1, S2)/S0 beyond noise that does the same", ge=1e-3, le=10
    )
    edge_cost: float = parameter(0.03, "share of that cost which is left at the strongest edge", ge=0, le=1)
    polarization: float = parameter(
        1.0, "weight of polarization, times what its agreement with stereo gives", ge=0, le=100
    )
    systematic: float = parameter(
        0.015, "standard deviation of (S1, S2)/S0 beyond noise, by light that was polarized before", ge=1e-3, le=1
    )
    expected_depth: float = parameter(0.1, "weight of depth that a network expects, per squared error", ge=0, le=100)
    expected_normals: float = parameter(
        0.3, "weight of normals that a network expects, per squared error", ge=0, le=100
    )
    lasting_share: float = parameter(
        0.005, "share of the pixels that a plane must hold to be tried in the next keyframe, too", ge=0, le=1
    )
    rounds: int = parameter(3, "sweeps of belief propagation on each grid", ge=1, le=200)
