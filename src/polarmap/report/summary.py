"""What a run says of itself in the end: at most seven lines, the worst first, made of its counts alone."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Literal

from polarmap.io.files import printable
from polarmap.io.run_folder.folder import MESH_NAME, REPORT_NAME
from polarmap.io.run_folder.results import RunResults, SummaryLine
from polarmap.pipeline.poses.fit import PoseFit
from polarmap.stereo.depth_range import PILED_UP

MOST_LINES = 7

_LITTLE_STEREO = 0.015  # of the pixels; bare rooms with right poses have ten times as much
_UNFIT_STEREO = 0.05  # likewise, where the poses do not fit the pictures either
_FEW_REJECTED = 0.2  # of the keyframes, as at the start of a run: no warning
_STARTING = 0.25  # of the frames that odometry may need to begin
_MOST_REASONS = 3
_FEW_PILED = 0.2  # of the keyframes
_FASTEST = 80.0  # metres a second
_FARTHEST, _NEAREST = 250.0, 0.02  # metres: median depth of what a camera is carried through
_ORDER = ("error", "warning", "note")
_POSE_MISTAKES = (
    "poses of another convention (world-to-camera, OpenGL axes), of another clock (early or late), "
    "or of another camera than the intrinsics"
)
_PICTURE_MISTAKES = (
    "a depth range that leaves the scene out (stereo.depth_min, depth_max), motion blur, "
    "or a colour sensor that is read as a grey one (colour in the camera file)"
)


@dataclass(frozen=True)
class Evidence:
    """What is known of a run beside its counts.

    pose_fit: how given poses fit the pictures, None where that was not found out. mosaic: what is wrong with the mosaic
    and which key to set, empty if nothing seems to be.
    """

    pose_fit: PoseFit | None = None
    mosaic: str = ""


def summarize(results: RunResults, out: Path, evidence: Evidence = Evidence()) -> list[SummaryLine]:
    """The lines for a run that has ended, in the order in which they should be read."""
    ended = results.status in ("complete", "failed")
    lines = [
        _no_surface(results) if ended else None,
        _mosaic(evidence),
        _disagreement(results, evidence),
        _piled(results, "near"),
        _piled(results, "far"),
        _without_pose(results),
        _unfit(results),
        _rejected_priors(results),
        _odd_unit(results),
        _pace(results),
        _live(results),
        _places(results, out),
    ]
    found = sorted((line for line in lines if line is not None), key=lambda line: _ORDER.index(line.level))
    return _joined(found, MOST_LINES)


def nothing_mapped(results: RunResults) -> bool:
    """Whether there is no surface at all."""
    return not _faces(results)


def stereo_share(results: RunResults) -> float | None:
    """Share of the keyframes' pixels whose depth stereo defends; None without keyframes."""
    pixels = len(results.keyframes) * results.camera.width * results.camera.height
    return sum(keyframe.stereo for keyframe in results.keyframes) / pixels if pixels else None


def frames_without_pose(frames: int, posed: int, reasons: Mapping[str, int], what: str = "have no pose") -> str:
    """How many frames have no pose and why, in one phrase; empty if all have one."""
    return f"{frames - posed} of {frames} frames {what}{_because(reasons)}" if frames > posed else ""


def _no_surface(results: RunResults) -> SummaryLine | None:
    if not nothing_mapped(results):
        return None
    points = sum(keyframe.points for keyframe in results.keyframes)
    if not results.posed:
        why = "no frame has a pose"
    elif not results.keyframes:
        why = "there is no keyframe"
    elif not points:
        why = f"none of the {len(results.keyframes)} keyframes got any depth"
    else:
        why = f"what {len(results.keyframes)} keyframes show is too little or too doubtful for a mesh (fusion.*)"
    return SummaryLine(level="error", text=f"nothing was mapped: {why}")


def _mosaic(evidence: Evidence) -> SummaryLine | None:
    return SummaryLine(level="warning", text=evidence.mosaic) if evidence.mosaic else None


def _disagreement(results: RunResults, evidence: Evidence) -> SummaryLine | None:
    """Stereo that finds next to nothing, or poses that the pictures contradict, and what to look for."""
    share, fit = stereo_share(results), evidence.pose_fit
    if share is None:
        return None
    defends = f"stereo defends {100 * share:.2g} % of the pixels"
    if fit is not None and (fit.reading or (not fit.fits and share < _UNFIT_STEREO)):
        return SummaryLine(
            level="warning", text=f"stereo and poses disagree: {defends}, and {_misfit(fit)}; {_advice(fit)}"
        )
    if share >= _LITTLE_STEREO or evidence.mosaic:  # which is reason enough
        return None
    if results.poses == "odometry":
        look = f"wrong intrinsics, {_PICTURE_MISTAKES}"
    elif fit is None:
        return SummaryLine(
            level="warning",
            text=f"stereo and poses disagree, or there is nothing to match: {defends}; look for {_POSE_MISTAKES}; "
            f"{_PICTURE_MISTAKES}",
        )
    else:
        look = f"{_PICTURE_MISTAKES}; the poses fit the pictures"
    return SummaryLine(level="warning", text=f"stereo finds next to nothing: {defends}; look for {look}")


def _misfit(fit: PoseFit) -> str:
    if fit.distance == float("inf"):
        return "most matched corners would lie behind the camera"
    return f"matched corners lie {fit.distance:.2g} pixels from where the poses put them"


def _advice(fit: PoseFit) -> str:
    if fit.reading:
        return f"the poses fit {fit.reading} ({fit.corrected:.2g} pixels): correct that, or look for {_POSE_MISTAKES}"
    return f"look for {_POSE_MISTAKES}"


def _piled(results: RunResults, end: Literal["near", "far"]) -> SummaryLine | None:
    """Depths that pile up at an end of what stereo searches, as they do where things are beyond it."""
    searches = [keyframe.search for keyframe in results.keyframes if keyframe.search is not None]
    piled = [s for s in searches if (s.at_near if end == "near" else s.at_far) > PILED_UP]
    if not piled or len(piled) < _FEW_PILED * len(searches):
        return None
    unit = "" if results.poses == "odometry" else " m"
    ends = sorted(s.near if end == "near" else s.far for s in piled)
    where = f"{ends[0]:.2g}{unit}" if ends[-1] < 1.05 * ends[0] else f"{ends[0]:.2g} to {ends[-1]:.2g}{unit}"
    option, word, value = (
        ("depth_min", "nearer", 0.5 * ends[0]) if end == "near" else ("depth_max", "farther", 2.0 * ends[-1])
    )
    text = (
        f"in {len(piled)} of {len(searches)} keyframes stereo's depths pile up at the {end} end of the range "
        f"({where}): things may be {word} and the depths there wrong; try --set stereo.{option}={value:.3g}"
    )
    return SummaryLine(level="warning", text=text)


def _without_pose(results: RunResults) -> SummaryLine | None:
    what = "are not used" if results.poses == "given" else "have no pose"
    text = frames_without_pose(results.frames, results.posed, results.without_pose, what)
    if not text:
        return None
    starting = results.poses == "odometry" and len(results.segments) <= 1
    few = results.frames - results.posed <= _STARTING * results.frames
    return SummaryLine(level="note" if starting and few else "warning", text=text)


def _unfit(results: RunResults) -> SummaryLine | None:
    count = sum(results.unfit.values())
    if not count:
        return None
    text = f"{count} of {results.posed} frames with a pose were kept from being keyframes{_because(results.unfit)}"
    return SummaryLine(level="warning", text=text)


def _rejected_priors(results: RunResults) -> SummaryLine | None:
    reasons: Counter[str] = Counter()
    name = ""
    for keyframe in results.keyframes:
        source, rejected, why = keyframe.prior_verdict.partition(" rejected: ")
        if rejected:
            name = source
            reasons[why.split(" (")[0].split(";")[0]] += 1
        elif source.startswith("no prior"):
            reasons["too few stereo points"] += 1
    count, total = reasons.total(), len(results.keyframes)
    if not count:
        return None
    text = f"the prior{name and ' ' + name} was rejected in {count} of {total} keyframes{_because(reasons)}"
    return SummaryLine(level="note" if count <= _FEW_REJECTED * total else "warning", text=text)


def _odd_unit(results: RunResults) -> SummaryLine | None:
    """Poses whose unit is hardly the metre: depth has the unit of the poses."""
    if results.poses == "odometry":
        return None
    depths = sorted(k.median_depth for k in results.keyframes if k.median_depth is not None)
    median = depths[len(depths) // 2] if depths else None
    speed = results.path_length / results.recorded_seconds if results.recorded_seconds else 0.0
    signs = []
    if median is not None and not _NEAREST <= median <= _FARTHEST:
        signs.append(f"the median depth is {median:.3g} m")
    if speed > _FASTEST:
        signs.append(f"the camera moves at {speed:.3g} m/s")
    if not signs:
        return None
    return SummaryLine(
        level="warning",
        text=f"depth has the unit of the poses, taken as metres: {' and '.join(signs)}; "
        "if they are in millimetres or another unit, read the map so, or convert them (fusion.* and stereo.* too)",
    )


def _pace(results: RunResults) -> SummaryLine:
    share = stereo_share(results)
    stereo = "" if share is None else f", stereo defends {100 * share:.2g} % of their pixels"
    surface = f", {_faces(results)} triangles" if _faces(results) else ""
    text = f"{len(results.keyframes)} keyframes of {results.frames} frames{stereo}{surface}; "
    if results.recorded_seconds and results.seconds > 0:
        factor = results.recorded_seconds / results.seconds
        text += f"{results.recorded_seconds:.3g} s of recording in {results.seconds:.3g} s ({factor:.2g} of real time)"
    else:
        text += f"{results.seconds:.3g} s"
    return SummaryLine(level="note", text=text)


def _live(results: RunResults) -> SummaryLine | None:
    """How a run kept up whose frames came at their times: a warning where frames were lost."""
    live = results.live
    if live is None:
        return None
    parts = []
    if live.pose is not None:
        parts.append(f"a frame's pose came after {live.pose.median:.0f} ms (99 %: {live.pose.p99:.0f} ms)")
    if live.surface is not None:
        parts.append(f"a keyframe was in the surface after {live.surface.median / 1000:.2g} s")
    keyframes = len(results.keyframes) + live.skipped
    parts.append(f"{live.skipped} of {keyframes} keyframes were skipped since mapping was behind")
    parts += [f"{live.hurried} mapped in a hurry"] if live.hurried else []
    parts += [f"{live.untraced} frames only tracked"] if live.untraced else []
    parts.append(f"the map was done {live.after:.2g} s after the last frame")
    if not live.missed:
        return SummaryLine(level="note", text="; ".join(parts))
    lost = f"{live.missed} frames were lost, since tracking was too slow for them"
    return SummaryLine(level="warning", text="; ".join([lost, *parts]))


def _places(results: RunResults, out: Path) -> SummaryLine:
    places = [f"report: {out / REPORT_NAME}"]
    if _faces(results):
        places.append(f"mesh: {out / MESH_NAME}")
    return SummaryLine(level="note", text=printable("; ".join(places)))


def _faces(results: RunResults) -> int:
    """Triangles of all segments' meshes."""
    surfaces = [segment.map for segment in results.segments] or ([results.map] if results.map else [])
    return sum(surface.faces for surface in surfaces)


def _because(reasons: Mapping[str, int]) -> str:
    common = Counter(reasons).most_common()
    named = [f"{reason} ({count})" for reason, count in common[:_MOST_REASONS]]
    rest = sum(count for _, count in common[_MOST_REASONS:])
    named += [f"other reasons ({rest})"] if rest else []
    return f": {', '.join(named)}" if named else ""


def _joined(lines: list[SummaryLine], most: int) -> list[SummaryLine]:
    """At most so many lines: those that are too many are put on the last one that stays."""
    if len(lines) <= most:
        return lines
    kept, rest = lines[: most - 1], lines[most - 1 :]
    return [*kept, SummaryLine(level=rest[0].level, text="; ".join(line.text for line in rest))]
