"""Plots of a benchmark: one panel a sequence, one line a method and seed."""

from __future__ import annotations

from collections.abc import Callable
from statistics import fmean
from typing import Any

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.lines import Line2D

from polarmap.benchmark import published
from polarmap.benchmark.cells import CellResult, Curve
from polarmap.benchmark.spec import SequenceSpec, Spec
from polarmap.benchmark.tables import Results
from polarmap.report.plots import COLOURS, STYLE

_PER_ROW = 3
_PANEL = (4.0, 3.0)  # inches
_DASHES = ("-", "--", ":", "-.")  # where methods are more than colours
_PUBLISHED = {"marker": "D", "color": "black", "markerfacecolor": "none", "linestyle": "none"}


def confidence_plot(spec: Spec, results: Results) -> Figure | None:
    """AbsRel of the surest pixels against how many they are; None where no cell has such a curve.

    The mark is what the paper's method reached on its own sequences, its points against the mean of their AbsRel.
    """

    def finish(axes: Axes) -> None:
        density = 100 * published.POINTS_PER_IMAGE[-1] / published.PIXELS
        axes.plot(density, fmean(values[-1] for values in published.ABS_REL.values()), **_PUBLISHED)
        axes.set(xlabel="surest pixels, % of all", ylabel="AbsRel", xlim=(0, 100), ylim=(0, None))

    mark = Line2D([], [], label=f"{published.METHODS[-1]} ({published.MARK}, its own sequences)", **_PUBLISHED)
    return _panels(spec, results, "confidence", finish, (100.0, 1.0), extra=[mark])


def wall_plot(spec: Spec, results: Results) -> Figure | None:
    """Share of the points of planar parts within a distance of their plane; None where no cell has such a curve."""

    def finish(axes: Axes) -> None:
        axes.set(xlabel="distance to the plane, cm", ylabel="points of planar parts, %", xlim=(0, None), ylim=(0, 100))

    return _panels(spec, results, "wall", finish, (100.0, 100.0))


PLOTS: dict[str, Callable[[Spec, Results], Figure | None]] = {"confidence": confidence_plot, "wall": wall_plot}


def _panels(
    spec: Spec,
    results: Results,
    name: str,
    finish: Callable[[Axes], None],
    scale: tuple[float, float] = (1.0, 1.0),
    extra: list[Line2D] | None = None,
) -> Figure | None:
    """One panel for each sequence that has a curve of this name. scale: what x and y are multiplied by."""
    shown = [sequence for sequence in spec.sequences if _curves(sequence, spec, results, name)]
    if not shown:
        return None
    columns = min(len(shown), _PER_ROW)
    rows = -(-len(shown) // columns)
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(columns * _PANEL[0], rows * _PANEL[1] + 0.5), layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).ravel()
        for axes, sequence in zip(panels, shown, strict=False):
            for method, curve in _curves(sequence, spec, results, name):
                axes.plot(
                    scale[0] * np.array(curve.x),
                    scale[1] * np.array(curve.y),
                    linewidth=1.6,
                    alpha=0.85,
                    **_look(method),
                )
            axes.set_title(sequence.label, fontsize=9)
            finish(axes)
        for axes in panels[len(shown) :]:
            axes.set_axis_off()
        used = sorted({method for s in shown for method, _ in _curves(s, spec, results, name)})
        lines = [Line2D([], [], label=spec.methods[method].label, **_look(method)) for method in used]
        figure.legend(
            handles=[*lines, *(extra or [])], loc="outside lower center", ncols=columns, frameon=False, fontsize=8
        )
    return figure


def _curves(sequence: SequenceSpec, spec: Spec, results: Results, name: str) -> list[tuple[int, Curve]]:
    """(place of the method, curve) of every method and seed that has one."""
    found = []
    for place, method in enumerate(spec.methods):
        for seed in spec.seeds:
            result: CellResult | None = results.get((sequence.name, method.name, seed))
            if result is not None and name in result.curves:
                found.append((place, result.curves[name]))
    return found


def _look(place: int) -> dict[str, Any]:
    dashes = _DASHES[place // len(COLOURS) % len(_DASHES)]
    return {"color": COLOURS[place % len(COLOURS)], "linestyle": dashes}
