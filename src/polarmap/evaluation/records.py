"""What an evaluation finds, as records, and their file."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from polarmap.errors import InputError
from polarmap.evaluation.metrics import (
    ConfidenceCurve,
    DepthMetrics,
    NormalMetrics,
    RegionMetrics,
    SigmaMetrics,
    TrajectoryMetrics,
)
from polarmap.evaluation.surface import MapMetrics
from polarmap.evaluation.walls import WallMetrics
from polarmap.io.files import write_bytes
from polarmap.io.formats.json_text import read_json_text

FINAL = "final"
"""The stage that is a keyframe's depth."""


@dataclass(frozen=True)
class KeyframeEvaluation:
    """One keyframe; index is its frame's. by_origin: stereo, propagated, estimated. stages: those that the run kept
    (stereo, inliers, first) and "final", which is `depth`."""

    index: int
    depth: DepthMetrics
    by_origin: dict[str, DepthMetrics]
    stages: dict[str, DepthMetrics]
    normals: NormalMetrics
    sigma: SigmaMetrics | None = None
    regions: RegionMetrics | None = None


@dataclass(frozen=True)
class Scale:
    """What depth was multiplied by before it was compared, and why."""

    factor: float
    reason: str


@dataclass(frozen=True)
class SegmentEvaluation:
    """A segment of a run with odometry. scale: its own; None where it has too few true poses, or did not move.

    keyframes: how many it has. trajectory: None where it has no true poses.
    """

    segment: int
    keyframes: int
    scale: Scale | None
    trajectory: TrajectoryMetrics | None


@dataclass(frozen=True)
class Evaluation:
    """A run against the truth. depth, by_origin, stages, normals, sigma, regions: means over the keyframes.

    scale, trajectory: of a run with odometry, those of its first segment that has a scale, which is the largest or,
    where that is too short, the next.
    segments: of a run with odometry, all of them. without_scale: keyframes of segments whose scale is not known, which
    are left out.
    without_truth: keyframes that have no true depth and are left out.
    normal_truth: what the true normals are from.
    trajectory: None where the sequence has no true poses at the run's times.
    format: "polarmap", or that of another program's results (`polarmap.evaluation.imported`), which may lack depth:
        then keyframes is empty. sparse: whether their depth is that of sparse points alone.
    map, walls, sigma, regions: None where they were not measured.
    """

    run: str
    sequence: str
    scale: Scale
    depth: DepthMetrics
    by_origin: dict[str, DepthMetrics]
    stages: dict[str, DepthMetrics]
    normals: NormalMetrics
    normal_truth: str
    trajectory: TrajectoryMetrics | None
    curve: ConfidenceCurve
    without_truth: int
    keyframes: tuple[KeyframeEvaluation, ...]
    segments: tuple[SegmentEvaluation, ...] = ()
    without_scale: int = 0
    format: str = "polarmap"
    sparse: bool = False
    map: MapMetrics | None = None
    walls: WallMetrics | None = None
    sigma: SigmaMetrics | None = None
    regions: RegionMetrics | None = None


def write_evaluation(path: Path | str, evaluation: Evaluation) -> None:
    """Write an evaluation as JSON, NaN as null; PolarmapError where that fails."""
    write_bytes(Path(path), _JSON.dump_json(evaluation, indent=1) + b"\n")


def read_evaluation(path: Path | str) -> Evaluation:
    """An evaluation from JSON; InputError where the file is none."""
    try:
        return _JSON.validate_json(read_json_text(Path(path)), strict=True)
    except ValidationError as error:
        problem = error.errors()[0]
        where = ".".join(str(part) for part in problem["loc"]) or "its whole"
        raise InputError(
            f"{path}: not an evaluation as 'polarmap eval' writes it ({where}: {problem['msg']})"
        ) from None


_JSON = TypeAdapter(Evaluation)
