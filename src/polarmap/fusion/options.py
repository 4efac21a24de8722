"""Parameters of fusion."""

from __future__ import annotations

from polarmap.options import Options, parameter


class FusionOptions(Options):
    """How depth maps are fused."""

    voxel_size: float | None = parameter(
        None, "side of a voxel; from the first depth map if not given", "m", ge=1e-6, le=1e4
    )
    truncation: float | None = parameter(
        None, "distance at which the surface's influence ends; 5 voxels if not given", "m", ge=1e-6, le=1e5
    )
    max_blocks: int = parameter(
        200_000, "most blocks of 8³ voxels that may be allocated, 6 KiB each", "blocks", ge=1, le=4_000_000
    )
    move_tolerance: float = parameter(
        0.5,
        "a keyframe that odometry has moved by more than this, at its median depth, is fused again at once; "
        "otherwise when its pose is final",
        "voxels",
        ge=0,
        le=1e4,
    )
    min_confidence: float = parameter(0.1, "less confident pixels are not fused", ge=0, le=1)
    min_weight: float = parameter(0.4, "summed confidence from which a voxel counts for the mesh", ge=0, le=1e4)
    min_faces: int = parameter(100, "smaller pieces of the mesh are dropped", "triangles", ge=0, le=10_000_000)
