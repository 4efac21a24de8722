"""An evaluation as tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from polarmap.evaluation.evaluate import FINAL, Evaluation, SegmentEvaluation
from polarmap.evaluation.metrics import DepthMetrics, NormalMetrics, TrajectoryMetrics

STAGE_TITLES = {
    "stereo": "stereo",
    "inliers": "after inliers",
    "first": "first step of densification",
    FINAL: "at the end",
}


def evaluation_tables(evaluation: Evaluation, per_keyframe: bool = False) -> RenderableType:
    """Means over the keyframes as tables, with `per_keyframe` each keyframe too, to be printed by rich."""
    count = len(evaluation.keyframes)
    parts: list[RenderableType] = []
    if per_keyframe:
        parts.append(_depth_table("Depth by keyframe", {str(k.index): k.depth for k in evaluation.keyframes}))
    title = f"Depth, mean over {count} keyframe{'s' if count != 1 else ''}"
    parts.append(_depth_table(title, {"all": evaluation.depth, **evaluation.by_origin}))
    if len(evaluation.stages) > 1:
        parts.append(_stage_table(evaluation.stages))
    parts.append(_normal_table(evaluation.normals))
    if len(evaluation.segments) > 1:
        parts.append(_segment_table(evaluation.segments))
    elif evaluation.trajectory is not None:
        parts.append(_trajectory_table({"": evaluation.trajectory}))
    return Group(*parts, _notes(evaluation))


def _depth_table(title: str, rows: Mapping[str, DepthMetrics]) -> Table:
    table = _table(title, "", "AbsRel", "RMSE", "δ < 1.25", "density", "points", "within 2 %")
    for name, m in rows.items():
        table.add_row(
            name, _fixed(m.abs_rel), f"{_fixed(m.rmse)} m", _percent(m.delta1), _percent(m.density),
            f"{m.points:.0f}", _percent(m.within),
        )  # fmt: skip
    return table


def _stage_table(stages: Mapping[str, DepthMetrics]) -> Table:
    table = _table("After each stage", "", "AbsRel", "density", "within 2 %")
    for name, m in stages.items():
        table.add_row(STAGE_TITLES.get(name, name), _fixed(m.abs_rel), _percent(m.density), _percent(m.within))
    return table


def _normal_table(m: NormalMetrics) -> Table:
    table = _table("Normals", "median error", "< 11.25°", "< 22.5°", "< 30°", "pixels")
    shares = (_percent(share) for share in (m.below_11, m.below_22, m.below_30))
    table.add_row(f"{_fixed(m.median, 1)}°", *shares, f"{m.compared:.0f}")
    return table


def _trajectory_table(rows: Mapping[str, TrajectoryMetrics]) -> Table:
    headings = () if set(rows) == {""} else ("segment",)
    table = _table("Trajectory, ATE rmse", *headings, "unaligned", "SE(3)", "Sim(3)", "scale", "poses")
    for name, m in rows.items():
        lengths = (f"{_fixed(length)} m" for length in (m.unaligned, m.rigid, m.similar))
        table.add_row(*[name for _ in headings], *lengths, _fixed(m.scale), str(m.poses))
    return table


def _segment_table(segments: Sequence[SegmentEvaluation]) -> Table:
    return _trajectory_table({str(s.segment): s.trajectory for s in segments if s.trajectory is not None})


def _notes(evaluation: Evaluation) -> Text:
    lines = [
        f"Scale: {evaluation.scale.reason} (factor {evaluation.scale.factor:.6g}).",
        "Density and 'within 2 %' are shares of all pixels of the image; AbsRel, RMSE and δ are over the points with a "
        f"true depth. True normals: from {evaluation.normal_truth}.",
    ]
    if len(evaluation.segments) > 1:
        scales = [f"{s.segment}: {s.scale.factor:.6g}" for s in evaluation.segments if s.scale is not None]
        lines.append(f"Each segment has its own factor ({', '.join(scales)}).")
    if evaluation.without_scale:
        lines.append(
            f"{evaluation.without_scale} keyframes are of segments too short to find their scale, and are left out."
        )
    if evaluation.without_truth:
        lines.append(f"{evaluation.without_truth} keyframes have no true depth and are left out.")
    return Text("\n".join(lines), style="dim")


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 and not heading else "right")
    return table


def _fixed(value: float, digits: int = 4) -> str:
    return "–" if value != value else f"{value:.{digits}f}"


def _percent(share: float) -> str:
    return "–" if share != share else f"{100 * share:.1f} %"
