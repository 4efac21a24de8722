"""Writes the tables and plots of a benchmark beside its cells."""

from __future__ import annotations

import io
from pathlib import Path

import matplotlib
from matplotlib.figure import Figure

from polarmap.benchmark.formats import FORMATS, markdown
from polarmap.benchmark.plots import PLOTS
from polarmap.benchmark.spec import Spec
from polarmap.benchmark.tables import Results, Table, tables_of
from polarmap.errors import PolarmapError
from polarmap.io.files import reason, write_bytes
from polarmap.report.plots import STYLE

PAGE_NAME = "tables.md"

_DPI = 150


def write_outputs(spec: Spec, results: Results, out: Path) -> list[Table]:
    """Write tables/NAME.md, .csv, .tex and .json, plots/NAME.png and .svg, and tables.md with all of them.

    results: of every cell, None where it was not run. Returns the tables; PolarmapError where a file cannot be written.
    """
    tables = tables_of(spec, results)
    for table in tables:
        for suffix, text in FORMATS.items():
            _write(out / "tables" / f"{table.name}.{suffix}", text(table).encode())
    parts = [markdown(table) for table in tables]
    for name in spec.tables:
        figure = PLOTS[name](spec, results) if name in PLOTS else None
        if figure is not None:
            _write_plot(out / "plots" / name, figure)
            parts.append(f"![{name}](plots/{name}.svg)\n")
    _write(out / PAGE_NAME, "\n".join(parts).encode())
    return tables


def _write_plot(path: Path, figure: Figure) -> None:
    with matplotlib.rc_context(STYLE):
        for suffix, metadata in (("svg", {"Date": None, "Creator": None}), ("png", None)):
            data = io.BytesIO()
            figure.savefig(data, format=suffix, dpi=_DPI, metadata=metadata)
            _write(path.with_suffix(f".{suffix}"), data.getvalue())


def _write(path: Path, data: bytes) -> None:
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise PolarmapError(f"{path.parent}: cannot be made ({reason(error)})") from None
    write_bytes(path, data)
