"""Parameters of the depth prior."""

from __future__ import annotations

from polarmap.options import Options, parameter


class PriorOptions(Options):
    """How a prior is made, aligned and judged."""

    min_anchors: int = parameter(50, "fewer sparse points cannot align a network's depth", "points", ge=3, le=1_000_000)
    min_rank_correlation: float = parameter(
        0.4, "a network whose order of depths agrees less with the sparse points is rejected", ge=0.01, le=0.99
    )
    min_gain: float = parameter(
        0.05,
        "a network is rejected unless its error at sparse points held out is smaller by this share than without "
        "looking at the image; not asked of polarnet, which knows its own errors",
        ge=0,
        lt=1,
    )
    refine: bool = parameter(True, "bend an accepted network's depth to the sparse points, along surfaces")
    contrast: float = parameter(
        0.04, "a step of the square root of intensity (white is 1) that loosens two surfaces e-fold", ge=1e-3, le=10
    )
    point_noise: float = parameter(
        0.005, "relative error of inverse depth that a sparse point may have", ge=1e-4, le=0.9
    )
    looks: int = parameter(
        1, "sizes at which polarnet sees each picture, whose mean it gives; three take a third longer", ge=1, le=3
    )
    threads: int = parameter(2, "threads that a network may use", ge=1, le=256)
    time_limit: float = parameter(60.0, "a network that takes longer for a picture is given up", "s", ge=0.1, le=86400)
