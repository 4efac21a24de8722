"""The tables of a benchmark: the paper's with its own columns beside, and one of all figures."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

from polarmap.benchmark import published
from polarmap.benchmark.cells import CellKey, CellResult
from polarmap.benchmark.entries import Entry, Figure, Notes, mean, measured, printed
from polarmap.benchmark.spec import MappingMethod, SequenceSpec, Spec
from polarmap.evaluation.walls import THRESHOLDS as WALL_THRESHOLDS

Results = Mapping[CellKey, CellResult | None]

ABS_REL = Figure("depth.abs_rel", "AbsRel", 4)
POINTS = Figure("depth.points", "points per image", 0)
DENSITY = Figure("depth.density", "density, %", 1, 100.0)

STEPS = {
    "sparse": "sparse points",
    "stereo": "stereo",
    "inliers": "inliers",
    "first": "first step",
    "final": "at the end",
}
"""Steps of the ablation, by their names in an evaluation."""

DEPTH_FIGURES = (
    ABS_REL,
    Figure("depth.rmse", "RMSE, m", 4),
    Figure("depth.delta1", "δ < 1.25, %", 1, 100.0),
    DENSITY,
    Figure("depth.within_1", "% within 1 %", 1, 100.0),
    Figure("depth.within", "% within 2 %", 1, 100.0),
    Figure("depth.within_5", "% within 5 %", 1, 100.0),
    Figure("sigma.within_one", "% within 1 σ", 1, 100.0),
)
SURFACE_FIGURES = (
    Figure("normals.median", "normals, median error, °", 1),
    Figure("normals.below_11", "% < 11.25°", 1, 100.0),
    Figure("normals.below_22", "% < 22.5°", 1, 100.0),
    Figure("normals.below_30", "% < 30°", 1, 100.0),
    Figure("map.accuracy.mean", "map, accuracy, m", 4),
    Figure("map.completeness.mean", "completeness, m", 4),
    Figure("map.precision.0.02", "precision at 2 cm, %", 1, 100.0),
    Figure("map.recall.0.02", "recall at 2 cm, %", 1, 100.0),
    Figure("map.fscore.0.01", "F at 1 cm, %", 1, 100.0),
    Figure("map.fscore.0.02", "F at 2 cm, %", 1, 100.0),
    Figure("map.fscore.0.05", "F at 5 cm, %", 1, 100.0),
)
PATH_FIGURES = (
    Figure("run.posed", "frames with a pose", 0),
    Figure("run.keyframes", "keyframes", 0),
    Figure("trajectory.similar", "ATE Sim(3), m", 4),
    Figure("trajectory.rigid", "ATE SE(3), m", 4),
    Figure("trajectory.rpe_similar.translation.rmse", "RPE Sim(3), m", 4),
    Figure("trajectory.rpe_similar.rotation.rmse", "RPE, °", 3),
    Figure("run.ms_per_keyframe", "ms per keyframe", 0),
    Figure("run.seconds", "run, s", 1),
)
WALL_FIGURES = (
    *(Figure(f"walls.within.{limit}", f"% within {100 * limit:g} cm", 1, 100.0) for limit in WALL_THRESHOLDS),
    *(Figure(f"walls.of_all.{limit}", f"% of all within {100 * limit:g} cm", 1, 100.0) for limit in (0.02, 0.05)),
)


@dataclass(frozen=True)
class Column:
    """A column's heading, and whether all in it is published."""

    title: str
    published: bool = False


@dataclass(frozen=True)
class Row:
    """What a row is of, one label under each of the table's label headings, and its entries; None where it has none."""

    labels: tuple[str, ...]
    entries: tuple[Entry | None, ...]
    published: bool = False


@dataclass(frozen=True)
class Table:
    """A table of figures. notes: those that entries are marked with, by their number from 1. remarks: on all of it."""

    name: str
    title: str
    label_headings: tuple[str, ...]
    columns: tuple[Column, ...]
    rows: tuple[Row, ...]
    notes: tuple[str, ...] = ()
    remarks: tuple[str, ...] = ()


def tables_of(spec: Spec, results: Results) -> list[Table]:
    """The tables that the spec asks for, in its order. results: of every cell, None where it was not run."""
    board = _Board(spec, results)
    return [table for name in spec.tables if name in _BUILDERS for table in _BUILDERS[name](board)]


@dataclass(frozen=True)
class _Board:
    spec: Spec
    results: Results

    def seeds(self, sequence: SequenceSpec, method) -> list[CellResult | None]:
        """The results of all seeds that there are for a sequence and a method."""
        keys = [(sequence.name, method.name, seed) for seed in self.spec.seeds]
        return [self.results[key] for key in keys if key in self.results]

    def row(self, sequence: SequenceSpec, figure: Figure, notes: Notes) -> tuple[Entry | None, ...]:
        """A figure of a sequence by all methods."""
        return tuple(measured(self.seeds(sequence, method), figure, notes) for method in self.spec.methods)

    @property
    def columns(self) -> tuple[Column, ...]:
        """All methods, and those of the paper."""
        ours = [Column(method.label) for method in self.spec.methods]
        return (*ours, *(Column(name, published=True) for name in published.METHODS))

    def remarks(self) -> tuple[str, ...]:
        """What they were measured with."""
        done = [result for result in self.results.values() if result is not None]
        versions = sorted({result.versions["polarmap"] for result in done if "polarmap" in result.versions})
        processors = sorted({f"{r.processor or r.machine} ({r.cpu_count} processors)" for r in done})
        lines = [f"Measured with polarmap {', '.join(versions)}."] if versions else []
        lines += [f"Measured on {'; '.join(processors)}."] if processors else []
        if any(len(self.seeds(s, m)) > 1 for s in self.spec.sequences for m in self.spec.methods):
            lines.append("Figures are medians over the seeds, with the smallest and the largest in brackets.")
        return tuple(lines)


def _accuracy(board: _Board) -> list[Table]:
    """Table I: accuracy and density by sequence and method."""
    notes = Notes()
    rows = _accuracy_rows(board, notes)
    for figure, factor in ((POINTS, 1.0), (DENSITY, 100.0 / published.PIXELS)):
        rows += _count_rows(board, figure, factor, notes)
    title = "Accuracy and density (the paper's Table I)"
    remarks = (
        *board.remarks(),
        f"Columns and rows marked {published.MARK} are the paper's own figures, on its own sequences of 640×480.",
    )
    return [Table("accuracy", title, ("figure", "sequence"), board.columns, tuple(rows), tuple(notes.lines), remarks)]


def _accuracy_rows(board: _Board, notes: Notes) -> list[Row]:
    rows, taken = [], set()
    for sequence in board.spec.sequences:
        theirs = published.ABS_REL.get(sequence.published or "", (None,) * len(published.METHODS))
        taken.add(sequence.published)
        entries = (*board.row(sequence, ABS_REL, notes), *(printed(value, 4) for value in theirs))
        rows.append(Row((ABS_REL.title, sequence.label), entries))
    for name, values in published.ABS_REL.items():
        if name not in taken:
            rows.append(_published_row(board, (ABS_REL.title, published.SEQUENCES[name]), values, 4))
    return rows


def _count_rows(board: _Board, figure: Figure, factor: float, notes: Notes) -> list[Row]:
    """Rows of each sequence, and the mean over all beside the paper's."""
    nothing = (None,) * len(published.METHODS)
    measured_rows = [board.row(sequence, figure, notes) for sequence in board.spec.sequences]
    rows = [
        Row((figure.title, sequence.label), (*entries, *nothing))
        for sequence, entries in zip(board.spec.sequences, measured_rows, strict=True)
    ]
    means = tuple(mean(entries, figure.digits) for entries in zip(*measured_rows, strict=True))
    theirs = tuple(printed(value, figure.digits, factor) for value in published.POINTS_PER_IMAGE)
    return [*rows, Row((figure.title, "mean of all"), (*means, *theirs))]


def _ablation(board: _Board) -> list[Table]:
    """Table II: what each step adds."""
    notes, rows = Notes(), []
    methods = [method for method in board.spec.methods if isinstance(method, MappingMethod)]
    for sequence in board.spec.sequences:
        for method in methods:
            results = board.seeds(sequence, method)
            for key, title, digits in (("abs_rel", ABS_REL.title, 4), ("points", POINTS.title, 0)):
                figures = [Figure(f"stages.{step}.{key}", title, digits) for step in STEPS]
                entries = tuple(measured(results, figure, notes) for figure in figures)
                rows.append(Row((sequence.label, method.label, title), entries))
    for place, (title, digits) in enumerate(((ABS_REL.title, 4), (POINTS.title, 0))):
        values = (published.ABLATION.get(step) for step in STEPS)
        entries = tuple(printed(value and value[place], digits) for value in values)
        labels = (published.SEQUENCES[published.ABLATION_SEQUENCE], published.METHODS[-1], title)
        rows.append(Row(labels, entries, published=True))
    columns = tuple(Column(title) for title in STEPS.values())
    title = "After each step (the paper's Table II)"
    headings = ("sequence", "method", "figure")
    return [Table("ablation", title, headings, columns, tuple(rows), tuple(notes.lines), board.remarks())]


def _points(board: _Board) -> list[Table]:
    """Table III: reconstructed points."""
    notes, rows = Notes(), []
    nothing = (None,) * len(published.METHODS)
    for figure in (
        Figure("run.map_points", "fused map", 0),
        Figure("run.depth_points", "all depth maps", 0),
    ):
        for sequence in board.spec.sequences:
            rows.append(Row((figure.title, sequence.label), (*board.row(sequence, figure, notes), *nothing)))
    rows += [_published_row(board, ("reconstructed", name), v, 0) for name, v in published.POINTS.items()]
    title = "Number of reconstructed points (the paper's Table III)"
    headings = ("points of", "sequence")
    return [Table("points", title, headings, board.columns, tuple(rows), tuple(notes.lines), board.remarks())]


def _figures(board: _Board) -> list[Table]:
    """Everything that was measured."""
    return [
        _figure_table(board, "figures_depth", "Depth", DEPTH_FIGURES),
        _figure_table(board, "figures_surface", "Normals and map", SURFACE_FIGURES),
        _figure_table(board, "figures_path", "Path and time", PATH_FIGURES),
    ]


def _wall(board: _Board) -> list[Table]:
    """The wall experiment: points of planar parts by their distance from a plane fitted to them."""
    return [
        _figure_table(
            board, "wall", "Points of planar parts near their plane (the paper's wall experiment)", WALL_FIGURES
        )
    ]


def _figure_table(board: _Board, name: str, title: str, figures: Sequence[Figure]) -> Table:
    notes, rows = Notes(), []
    for sequence in board.spec.sequences:
        for method in board.spec.methods:
            results = board.seeds(sequence, method)
            entries = tuple(measured(results, figure, notes) for figure in figures)
            rows.append(Row((sequence.label, method.label), entries))
    said = [
        f"{result.sequence}, {result.method}, seed {result.seed}: {note}."
        for result in board.results.values()
        if result is not None
        for note in result.notes
    ]
    columns = tuple(Column(figure.title) for figure in figures)
    remarks = (*board.remarks(), *said)
    return Table(name, title, ("sequence", "method"), columns, tuple(rows), tuple(notes.lines), remarks)


def _published_row(board: _Board, labels: tuple[str, str], values: Sequence[float | None], digits: int) -> Row:
    ours = (None,) * len(board.spec.methods)
    return Row(labels, (*ours, *(printed(value, digits) for value in values)), published=True)


_BUILDERS: dict[str, Callable[[_Board], list[Table]]] = {
    "accuracy": _accuracy,
    "ablation": _ablation,
    "points": _points,
    "wall": _wall,
    "figures": _figures,
}
