"""Plots of a run as SVG text, to stand inside a page."""

from __future__ import annotations

import io
from collections.abc import Sequence

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator

from polarmap.io.run_folder.results import KeyframeSummary, LiveSummary
from polarmap.report.pictures import ORIGIN_COLOURS

_LARGEST = 1e30  # beyond it an axis overflows
_ORIGINS = ("stereo", "propagated", "estimated")
COLOURS = ("#4e79a7", "#f28e2b", "#e15759", "#76b7b2", "#59a14f", "#edc948", "#b07aa1", "#9c755f")
STYLE = {
    "font.family": "sans-serif",
    "font.size": 9,
    "svg.hashsalt": "polarmap",  # the same plot, the same file
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.grid": True,
    "axes.grid.axis": "y",
    "grid.color": "#e6e8eb",
    "axes.axisbelow": True,
}


def density_plot(keyframes: Sequence[KeyframeSummary]) -> str:
    """Share of the pixels that have depth, by origin, over the keyframes; SVG."""
    shares = [[_share(k, origin) for k in keyframes] for origin in _ORIGINS]
    colours = [tuple(c / 255 for c in colour) for colour in ORIGIN_COLOURS[1:]]
    return _stacked(keyframes, shares, _ORIGINS, colours, "pixels with depth, %", top=100)


def time_plot(keyframes: Sequence[KeyframeSummary]) -> str:
    """Milliseconds of each step over the keyframes; SVG."""
    steps = list(dict.fromkeys(step for k in keyframes for step in k.milliseconds))
    times = [[k.milliseconds.get(step, 0.0) for k in keyframes] for step in steps]
    return _stacked(keyframes, times, steps, COLOURS, "milliseconds per keyframe")


def live_plot(live: LiveSummary) -> str:
    """Latencies, keyframes that wait, and what was left out over a run whose frames came at their times; SVG."""
    times = [0.0, *(moment.seconds for moment in live.moments)]

    def draw(axes: Axes) -> None:
        for name, colour, what in (("pose", COLOURS[0], "pose"), ("surface", COLOURS[1], "surface")):
            shown = [(m.seconds, getattr(m, name)) for m in live.moments if getattr(m, name) > 0]
            if shown:
                axes.plot(*zip(*shown, strict=True), color=colour, linewidth=1.4, label=f"{what}, worst, ms")
        axes.set(xlabel="seconds", ylabel="latency, ms", yscale="log", xlim=(0, max(times[-1], 1e-3)))
        counts = axes.twinx()
        counts.grid(False)
        counts.spines["right"].set_visible(True)
        waiting = [m.waiting for m in live.moments]
        counts.stairs(waiting, times, color=COLOURS[3], fill=True, alpha=0.3, label="keyframes that wait")
        for name, colour, what in (("skipped", COLOURS[2], "keyframes skipped"), ("missed", "#222222", "frames lost")):
            shown = [(m.seconds, getattr(m, name)) for m in live.moments if getattr(m, name) > 0]
            if shown:
                counts.scatter(*zip(*shown, strict=True), color=colour, s=14, label=what)
        counts.set(ylabel="count", ylim=(0, None))
        counts.yaxis.set_major_locator(MaxNLocator(integer=True))
        handles = [line for a in (axes, counts) for line in a.get_legend_handles_labels()[0]]
        axes.legend(handles=handles, loc="upper left", frameon=False, ncols=3, fontsize=8)

    return _svg(draw)


def accuracy_plot(density: Sequence[float], abs_rel: Sequence[float]) -> str:
    """AbsRel of the most confident pixels against how many they are; SVG."""

    def draw(axes: Axes) -> None:
        axes.plot(100 * np.asarray(density), np.minimum(abs_rel, _LARGEST), color=COLOURS[0], linewidth=1.8)
        axes.set(xlabel="most confident pixels, % of all", ylabel="AbsRel", xlim=(0, 100), ylim=(0, None))

    return _svg(draw)


def _share(keyframe: KeyframeSummary, origin: str) -> float:
    return 100 * keyframe.density * getattr(keyframe, origin) / max(keyframe.points, 1)


def _stacked(keyframes, rows, names, colours, label, top=None) -> str:
    """Bars, one a keyframe; areas where there are too many for bars."""
    position = np.arange(len(keyframes))

    def draw(axes: Axes) -> None:
        bottom = np.zeros(len(keyframes))
        for i, (name, row) in enumerate(zip(names, rows, strict=True)):
            colour = colours[i % len(colours)]
            if len(keyframes) <= 100:
                axes.bar(position, row, 0.8, bottom, color=colour, label=name)
            else:
                axes.fill_between(position, bottom, bottom + row, color=colour, label=name, linewidth=0)
            bottom += row
        axes.xaxis.set_major_locator(MaxNLocator(12, integer=True))
        axes.xaxis.set_major_formatter(lambda x, _: str(keyframes[int(x)].index) if 0 <= x < len(keyframes) else "")
        axes.set(xlabel="frame", ylabel=label, ylim=(0, top))
        axes.legend(
            loc="upper center",
            bbox_to_anchor=(0.5, 1.2),
            ncols=6,
            columnspacing=1.0,
            handlelength=1.2,
            frameon=False,
            fontsize=8,
        )

    return _svg(draw)


def _svg(draw) -> str:
    with matplotlib.rc_context(STYLE):
        figure = Figure(figsize=(6.4, 3.0), layout="constrained")
        draw(figure.subplots())
        text = io.StringIO()
        figure.savefig(text, format="svg", metadata={"Date": None, "Creator": None})
    svg = text.getvalue()
    return svg[svg.index("<svg") :]
