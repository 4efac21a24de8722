"""Tables as Markdown, CSV, LaTeX and JSON."""

from __future__ import annotations

import csv
import io
import json
import math
from collections.abc import Callable
from dataclasses import asdict
from typing import Any

from polarmap.benchmark import published
from polarmap.benchmark.entries import Entry
from polarmap.benchmark.tables import Column, Row, Table

_MARKED = f" ({published.MARK})"
_LATEX = {
    "\\": r"\textbackslash{}", "&": r"\&", "%": r"\%", "$": r"\$", "#": r"\#", "_": r"\_", "{": r"\{", "}": r"\}",
    "~": r"\textasciitilde{}", "^": r"\textasciicircum{}", "<": "$<$", ">": "$>$", "|": r"\textbar{}", "–": "--",
    "δ": r"$\delta$", "°": r"$^\circ$", "×": r"$\times$",
}  # fmt: skip
_CSV_COLUMNS = ("column", "source", "median", "min", "max", "seeds", "notes")


def markdown(table: Table) -> str:
    """A heading, the table, and its notes. What is published is in italics and says so in its heading or label."""
    headings = [_markdown_text(text) for text in (*table.label_headings, *map(_heading, table.columns))]
    rules = [":--"] * len(table.label_headings) + ["--:"] * len(table.columns)
    rows = [[*map(_markdown_text, _labels(row)), *map(_markdown_entry, row.entries)] for row in table.rows]
    lines = [f"### {_markdown_text(table.title)}", "", _line(headings), _line(rules), *map(_line, rows)]
    notes = [f"{number}. {_markdown_text(note)}" for number, note in enumerate(table.notes, start=1)]
    for part in (notes, [_markdown_text(" ".join(table.remarks))] if table.remarks else []):
        lines += ["", *part] if part else []
    return "\n".join(lines) + "\n"


def latex(table: Table) -> str:
    """A tabular with its notes below, for \\input into a table of a paper; needs no package."""
    headings = [*table.label_headings, *map(_heading, table.columns)]
    alignment = "l" * len(table.label_headings) + "r" * len(table.columns)
    rows = [[*_labels(row), *map(_latex_entry, row.entries)] for row in table.rows]
    lines = [f"% {' '.join(table.title.split())}", rf"\begin{{tabular}}{{{alignment}}}", r"\hline"]
    lines += [_latex_line(map(latex_text, headings)), r"\hline"]
    labels = len(table.label_headings)
    lines += [_latex_line([*map(latex_text, row[:labels]), *row[labels:]]) for row in rows]
    lines += [r"\hline", r"\end{tabular}"]
    notes = [f"({number}) {latex_text(note)}" for number, note in enumerate(table.notes, start=1)]
    lines += [rf"\par\footnotesize {note}" for note in [*notes, *map(latex_text, table.remarks)]]
    return "\n".join(lines) + "\n"


def csv_text(table: Table) -> str:
    """One line per entry: labels, column, where it is from, median, min and max, number of seeds, notes."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow([*table.label_headings, *_CSV_COLUMNS])
    for row in table.rows:
        for column, entry in zip(table.columns, row.entries, strict=True):
            if entry is not None:
                notes = "; ".join(table.notes[mark - 1] for mark in entry.marks)
                numbers = ["" if math.isnan(n) else repr(n) for n in (entry.median, entry.low, entry.high)]
                writer.writerow([*row.labels, column.title, entry.source, *numbers, entry.seeds or "", notes])
    return text.getvalue()


def json_text(table: Table) -> str:
    """The table as it is in memory, NaN as null."""
    return json.dumps(_nulls(asdict(table)), ensure_ascii=False, indent=1, allow_nan=False) + "\n"


FORMATS: dict[str, Callable[[Table], str]] = {"md": markdown, "csv": csv_text, "tex": latex, "json": json_text}
"""By the suffix of their files."""


def entry_text(entry: Entry | None, spread: bool = True) -> str:
    """An entry in words: its median, with `spread` and more than one seed its range, and the numbers of its notes."""
    if entry is None:
        return "–"
    text: str = entry.source
    if not math.isnan(entry.median):
        text = _number(entry.median, entry)
        if spread and entry.seeds > 1:
            text += f" [{_number(entry.low, entry)}–{_number(entry.high, entry)}]"
    return " ".join([text, *(f"({mark})" for mark in entry.marks)])


def latex_text(text: str) -> str:
    """Text with all that LaTeX would read as commands escaped."""
    return "".join(_LATEX.get(character, character) for character in " ".join(text.split()))


def _number(value: float, entry: Entry) -> str:
    return f"{value:.{entry.digits}f}"


def _heading(column: Column) -> str:
    return column.title + _MARKED * column.published


def _labels(row: Row) -> list[str]:
    return [*row.labels[:-1], row.labels[-1] + _MARKED] if row.published else list(row.labels)


def _markdown_entry(entry: Entry | None) -> str:
    text = _markdown_text(entry_text(entry))
    return f"*{text}*" if entry is not None and entry.source == "published" else text


def _markdown_text(text: str) -> str:
    escaped = "".join("\\" + character if character in "\\|*_`<" else character for character in text)
    return " ".join(escaped.split())


def _line(cells: list[str]) -> str:
    return "| " + " | ".join(cells) + " |"


def _latex_entry(entry: Entry | None) -> str:
    text = latex_text(entry_text(entry))
    return rf"\textit{{{text}}}" if entry is not None and entry.source == "published" else text


def _latex_line(cells) -> str:
    return " & ".join(cells) + r" \\"


def _nulls(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _nulls(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_nulls(part) for part in value]
    return None if isinstance(value, float) and math.isnan(value) else value
