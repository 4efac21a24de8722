"""An evaluation as tables for the terminal."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from rich.console import Group, RenderableType
from rich.table import Table
from rich.text import Text

from polarmap.evaluation.metrics import DepthMetrics, NormalMetrics, RegionMetrics, SigmaMetrics, TrajectoryMetrics
from polarmap.evaluation.records import FINAL, Evaluation, SegmentEvaluation
from polarmap.evaluation.surface import MapMetrics
from polarmap.evaluation.trajectories import LEAST_POSES
from polarmap.evaluation.walls import WallMetrics

_SAME = 1e-6  # metres; poses that were given, and read back

STAGE_TITLES = {
    "stereo": "stereo",
    "inliers": "after inliers",
    "first": "first step of densification",
    FINAL: "at the end",
}


def evaluation_tables(evaluation: Evaluation, per_keyframe: bool = False) -> RenderableType:
    """Means over the keyframes as tables, with `per_keyframe` each keyframe too, to be printed by rich."""
    parts: list[RenderableType] = []
    if per_keyframe and evaluation.keyframes:
        parts.append(_depth_table("Depth by keyframe", {str(k.index): k.depth for k in evaluation.keyframes}))
    if evaluation.keyframes:
        parts += _depth_parts(evaluation)
    if len(evaluation.segments) > 1:
        parts.append(_segment_table(evaluation.segments))
    elif evaluation.trajectory is not None:
        parts.append(_trajectory_table({"": evaluation.trajectory}))
    if evaluation.trajectory is not None:
        parts += [_motion_table(evaluation.trajectory)] if evaluation.trajectory.unaligned > _SAME else []
    if evaluation.map is not None:
        parts.append(_map_table(evaluation.map))
    if evaluation.walls is not None:
        parts.append(_wall_table(evaluation.walls))
    return Group(*parts, _notes(evaluation))


def _depth_parts(evaluation: Evaluation) -> list[RenderableType]:
    count = len(evaluation.keyframes)
    what = "Depth of sparse points" if evaluation.sparse else "Depth"
    title = f"{what}, mean over {count} keyframe{'s' if count != 1 else ''}"
    parts: list[RenderableType] = [_depth_table(title, {"all": evaluation.depth, **evaluation.by_origin})]
    parts.append(_share_table({"all": evaluation.depth, **evaluation.by_origin}))
    if len(evaluation.stages) > 1:
        parts.append(_stage_table(evaluation.stages))
    if evaluation.normals.compared:
        parts.append(_normal_table(evaluation.normals))
    if evaluation.regions is not None:
        parts.append(_region_table(evaluation.regions))
    if evaluation.sigma is not None:
        parts.append(_sigma_table(evaluation.sigma))
    return parts


def _depth_table(title: str, rows: Mapping[str, DepthMetrics]) -> Table:
    table = _table(title, "", "AbsRel", "RMSE", "δ < 1.25", "density", "points", "within 2 %")
    for name, m in rows.items():
        table.add_row(
            name, _fixed(m.abs_rel), f"{_fixed(m.rmse)} m", _percent(m.delta1), _percent(m.density),
            f"{m.points:.0f}", _percent(m.within),
        )  # fmt: skip
    return table


def _share_table(rows: Mapping[str, DepthMetrics]) -> Table:
    headings = ("1.25", "1.25²", "1.25³", "1 %", "2 %", "5 %")
    table = _table("Share of the points with δ below 1.25ⁿ, of all pixels within p %", "", *headings)
    for name, m in rows.items():
        shares = (m.delta1, m.delta2, m.delta3, m.within_1, m.within, m.within_5)
        table.add_row(name, *map(_percent, shares))
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


def _region_table(m: RegionMetrics) -> Table:
    headings = ("curved: within 2 %", "normals, median", "near steps: within 2 %")
    table = _table("Where it is hard", *headings)
    table.add_row(_percent(m.curved_within), f"{_fixed(m.curved_normals, 1)}°", _percent(m.edges_within))
    return table


def _sigma_table(m: SigmaMetrics) -> Table:
    table = _table("Errors of depth against its standard deviation", "< 1 σ", "< 2 σ", "pixels")
    table.add_row(_percent(m.within_one), _percent(m.within_two), f"{m.compared:.0f}")
    return table


def _trajectory_table(rows: Mapping[str, TrajectoryMetrics]) -> Table:
    headings = () if set(rows) == {""} else ("segment",)
    table = _table("Trajectory, ATE rmse", *headings, "unaligned", "SE(3)", "Sim(3)", "scale", "poses")
    for name, m in rows.items():
        lengths = (f"{_fixed(length)} m" for length in (m.unaligned, m.rigid, m.similar))
        table.add_row(*[name for _ in headings], *lengths, _fixed(m.scale), f"{m.poses} of {m.of}")
    return table


def _motion_table(m: TrajectoryMetrics) -> Table:
    """Further figures of the absolute error and of the motion from pose to pose."""
    table = _table("Trajectory, further errors", "", "rmse", "mean", "median", "max")
    rows = {"ATE, SE(3)": (m.ate_rigid, " m"), "ATE, Sim(3)": (m.ate_similar, " m")}
    for kind, error in (("as it is", m.rpe), ("scaled", m.rpe_similar)):
        if error is not None:
            rows[f"RPE translation, {kind}"] = error.translation, " m"
            rows[f"RPE rotation, {kind}"] = error.rotation, "°"
    for name, (errors, unit) in rows.items():
        if errors is not None:
            figures = (errors.rmse, errors.mean, errors.median, errors.max)
            table.add_row(name, *(f"{_fixed(value, 5)}{unit}" for value in figures))
    return table


def _map_table(m: MapMetrics) -> Table:
    table = _table(f"Map ({m.source})", "", *(f"{limit:g} m" for limit in m.thresholds))
    table.add_row("precision (accuracy)", *map(_percent, m.precision))
    table.add_row("recall (completeness)", *map(_percent, m.recall))
    table.add_row("F-score", *map(_percent, m.fscore))
    return table


def _wall_table(m: WallMetrics) -> Table:
    title = f"Walls: points within a distance of the {len(m.walls)} planes of {m.found_in}"
    table = _table(title, "", *(f"{limit:g} m" for limit in m.thresholds))
    table.add_row("fitted plane", *map(_percent, m.within))
    if any(share == share for share in m.of_all):
        table.add_row("of all pixels", *map(_percent, m.of_all))
        table.add_row("true plane", *map(_percent, m.of_truth))
    return table


def _segment_table(segments: Sequence[SegmentEvaluation]) -> Table:
    return _trajectory_table({str(s.segment): s.trajectory for s in segments if s.trajectory is not None})


def _notes(evaluation: Evaluation) -> Text:
    lines = [f"Scale: {evaluation.scale.reason} (factor {evaluation.scale.factor:.6g})."]
    if evaluation.keyframes:
        lines.append(
            "Density and 'within 2 %' are shares of all pixels of the image; AbsRel, RMSE and δ are over the points "
            f"with a true depth. True normals: from {evaluation.normal_truth}."
        )
    if evaluation.map is not None:
        m = evaluation.map
        lines.append(
            f"Map: {m.points} points of {m.source}, accuracy {_fixed(m.accuracy.median)} m (median), against "
            f"{m.true_points} points of the true depth of {m.frames} frames, completeness "
            f"{_fixed(m.completeness.median)} m, {m.spacing:.4g} m apart."
        )
    if evaluation.walls is not None:
        lines.append(
            "Walls: share of the reconstructed points within a distance of the plane fitted to them; the same as a "
            "share of all pixels that show a wall; and of the true plane, at the true poses."
        )
    lines += _trajectory_notes(evaluation)
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


def _trajectory_notes(evaluation: Evaluation) -> list[str]:
    """What there is to say where not all poses could be compared."""
    segments = {f" of segment {s.segment}": s.trajectory for s in evaluation.segments}
    compared = segments if len(segments) > 1 else {"": evaluation.trajectory}
    notes = []
    for what, m in compared.items():
        if m is not None and m.poses < max(m.of, LEAST_POSES):
            result = "its error is that of these alone"
            if m.poses < LEAST_POSES:
                result = f"no error is given from fewer than {LEAST_POSES}"
            notes.append(f"Trajectory{what}: {m.poses} of {m.of} poses have a true pose at their time; {result}.")
    return notes


def _table(title: str, *headings: str) -> Table:
    table = Table(title=title, title_justify="left")
    for i, heading in enumerate(headings):
        table.add_column(heading, justify="left" if i == 0 and not heading else "right")
    return table


def _fixed(value: float, digits: int = 4) -> str:
    return "–" if value != value else f"{value:.{digits}f}"


def _percent(share: float) -> str:
    return "–" if share != share else f"{100 * share:.1f} %"
