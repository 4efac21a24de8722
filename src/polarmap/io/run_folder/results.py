"""The records in `results.json`: a run in figures (see docs/output.md)."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, FailFast, Field

_MOST_STEPS = 100
_MOST_REASONS = 1000
_MOST_MOMENTS = 10_000
Milliseconds = Annotated[float, Field(ge=0, le=1e15)]
StepName = Annotated[str, Field(pattern=r"^[^$]{1,60}$")]
"""Stands in plots, where $ would begin a formula."""


class _Record(BaseModel):
    model_config = ConfigDict(frozen=True, ser_json_inf_nan="null")


class Weights(_Record):
    """How far one kind of reflection was believed, in [0, 1]: for its azimuth and its zenith."""

    azimuth: float
    zenith: float


class SearchSummary(_Record):
    """The depths that stereo searched for a keyframe, from near to far, in metres (or units of the poses).

    at_near, at_far: share of its well matched pixels that lie at that end, where next to none should.
    """

    near: float = Field(gt=0)
    far: float = Field(gt=0)
    at_near: float = Field(ge=0, le=1)
    at_far: float = Field(ge=0, le=1)


class KeyframeSummary(_Record):
    """A keyframe in figures. Counts are of pixels; milliseconds by step.

    stereo, propagated, estimated: points by origin. beyond_png: points too far for the depth picture's scale.
    segment: which world and scale its pose and depth are in. median_depth: in the unit of the poses.
    search: None where stereo had no neighbour that has moved.
    diffuse_weights, specular_weights, surfaces_weight: see `polarmap.data.keyframe.CueBeliefs`.
    """

    index: int
    timestamp: float | None
    points: int
    density: float = Field(ge=0, le=1)
    stereo: int
    propagated: int
    estimated: int
    diffuse: int
    specular: int
    beyond_png: int
    prior_verdict: str
    diffuse_weights: Weights
    specular_weights: Weights
    milliseconds: dict[StepName, Milliseconds] = Field(max_length=_MOST_STEPS)
    segment: int = 0
    surfaces_weight: float = 0.0
    metal: int = 0
    median_depth: float | None = None
    search: SearchSummary | None = None


class StepTime(_Record):
    """Milliseconds of one step: median over keyframes (None for what is not done per keyframe), and in total."""

    median: Milliseconds | None
    total: Milliseconds


class MapSummary(_Record):
    """The fused map. voxel_size in metres (or units of the poses).

    origin: of mesh and cloud in the world of the poses: add it to their coordinates. left_out: points of depth maps
    that are too far from there to be in the map.
    """

    voxel_size: float | None
    blocks: int
    vertices: int
    faces: int
    points: int
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0)
    left_out: int = 0


class SegmentSummary(_Record):
    """A segment of a run with odometry, with a world and scale of its own: posed frames, keyframes, surface."""

    segment: int
    posed: int
    keyframes: int
    map: MapSummary


class SummaryLine(_Record):
    """One line of what a run says of itself in the end.

    level: "error" if nothing came out, "warning" where something should be looked after, else "note".
    """

    level: Literal["error", "warning", "note"]
    text: str


class LatencySummary(_Record):
    """Milliseconds that something came late: median, what 99 % stay below, and the largest, of `count`."""

    count: int = Field(ge=0)
    median: Milliseconds
    p99: Milliseconds
    largest: Milliseconds


class MomentSummary(_Record):
    """A stretch of a live run that ends at `seconds`; see `polarmap.data.live.Moment`."""

    seconds: float = Field(ge=0, le=1e12)
    pose: Milliseconds
    surface: Milliseconds
    waiting: int = Field(ge=0)
    skipped: int = Field(ge=0)
    missed: int = Field(ge=0)


class LiveSummary(_Record):
    """How a run kept up whose frames came at their times; see `polarmap.data.live.LiveFigures`.

    pose, surface: from exposure to the frame's pose, and from a keyframe's to the surface with it.
    """

    pose: LatencySummary | None = None
    surface: LatencySummary | None = None
    missed: int = Field(ge=0)
    skipped: int = Field(ge=0)
    hurried: int = Field(ge=0)
    untraced: int = Field(ge=0)
    after: float
    moments: list[MomentSummary] = Field([], max_length=_MOST_MOMENTS)


class Intrinsics(_Record):
    """The undistorted camera that all images of the run are of, in pixels."""

    width: int = Field(gt=0)
    height: int = Field(gt=0)
    fx: float = Field(gt=0, allow_inf_nan=False)
    fy: float = Field(gt=0, allow_inf_nan=False)
    cx: float = Field(allow_inf_nan=False)
    cy: float = Field(allow_inf_nan=False)

    @property
    def size(self) -> tuple[int, int]:
        """(width, height)."""
        return self.width, self.height


class PictureRanges(_Record):
    """What the colours of all pictures of a run span.

    white: intensity shown as white. dolp: DoLP with the brightest colour. nearest, farthest: depth in metres.
    """

    white: float
    dolp: float
    nearest: float
    farthest: float


class RunResults(_Record):
    """The content of results.json.

    status: how far the run came; "failed" if it came to its end and no surface came out. reason: what interrupted it,
        or why it failed. summary: what it says of itself, worst first.
    poses: "given" if they came from pose_source, so that depth has its unit; "odometry" if the run found them
        itself, up to one scale. seconds: wall time. depth_scale: pixel values per metre of depth/*.png, None
        before any keyframe had depth. frames: given; posed: those with a pose; without_pose: how many of the others for
        which reason; unfit: how many posed ones were kept from being keyframes, likewise. recorded_seconds: from the
        first frame to the last, None where they have no times. path_length: of the camera's way, metres (or units
        of the poses). live: None for a recording that was mapped in its own time.
    segment: the one that the files without a segment in their names are of. segments: all of a run with odometry,
        that one first; empty until the end, and where poses were given.
    """

    status: Literal["running", "complete", "interrupted", "failed"]
    reason: str | None = None
    summary: list[SummaryLine] = []
    command: str = ""
    sequence: str = ""
    poses: Literal["given", "odometry"]
    pose_source: str = ""
    started: str
    seconds: float
    camera: Intrinsics
    depth_scale: float | None = Field(default=None, gt=0)
    picture_ranges: PictureRanges | None = None
    frames: int
    posed: int
    without_pose: dict[str, int] = Field({}, max_length=_MOST_REASONS)
    unfit: dict[str, int] = Field({}, max_length=_MOST_REASONS)
    recorded_seconds: float | None = None
    path_length: float = 0.0
    live: LiveSummary | None = None
    milliseconds: dict[StepName, StepTime] = Field(max_length=_MOST_STEPS)
    map: MapSummary | None = None
    segment: int = 0
    segments: Annotated[list[SegmentSummary], FailFast()] = []
    versions: dict[str, str]
    machine: str
    cpu_count: int | None
    keyframes: Annotated[list[KeyframeSummary], FailFast()]
