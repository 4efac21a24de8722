"""Numbers in columns of a text file: separated by blanks, tabs, commas or semicolons, with or without a header."""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from polarmap.io.files import text_lines
from polarmap.io.formats.times import parse_date, parse_number

_COMMENTS = ("#", "%", "//")
_UNIT = re.compile(r"\s*[\[(]\s*([^\])]*?)\s*[\])]")
_DECIMAL_COMMA = re.compile(r"[+-]?\d+,\d+(?:[eE][+-]?\d+)?")


@dataclass(frozen=True)
class TextTable:
    """The lines of a file that hold data, as fields.

    rows: (line number from 1, fields without blanks around). separator: "," or ";"; None for blanks and tabs.
    headers: what may name the columns, the most likely first: a first line without numbers, and comments before the
        data. Units stay with their names, as `timestamp[ns]`.
    titled: whether the first of `headers` is a line of its own, which must name columns. first_comment: the text of
        the first comment, "" where there is none.
    """

    path: Path
    rows: tuple[tuple[int, tuple[str, ...]], ...]
    separator: str | None = None
    headers: tuple[tuple[str, ...], ...] = ()
    titled: bool = False
    first_comment: str = ""

    def where(self, row: int) -> str:
        """File and line of a row, for messages."""
        return f"{self.path}, line {self.rows[row][0]}"


def read_table(path: Path) -> TextTable:
    """The table in a text file; empty lines and comments (#, %, //) are skipped. InputError where it cannot be read."""
    path = Path(path)
    lines = text_lines(path)
    comments = [text for _, text in lines if text.startswith(_COMMENTS)]
    first = next((i for i, (_, text) in enumerate(lines) if not text.startswith(_COMMENTS)), len(lines))
    before = [text for _, text in lines[:first]]
    data = [(number, text) for number, text in lines[first:] if not text.startswith(_COMMENTS)]
    titled = len(data) > 1 and not _has_number(data[0][1])
    titles = [data.pop(0)[1]] if titled else []
    separator = _separator(data[0][1] if data else (titles or before or [""])[0])
    headers = tuple(_names(text, separator) for text in [*titles, *reversed(before)])
    rows = tuple((number, _fields(text, separator)) for number, text in data)
    return TextTable(path, rows, separator, headers, titled, comments[0] if comments else "")


def split_unit(name: str) -> tuple[str, str]:
    """A column's name and the unit in brackets behind it, "" where there is none."""
    found = _UNIT.search(name)
    return (name, "") if found is None else (_UNIT.sub("", name), found[1])


def _has_number(text: str) -> bool:
    fields = _fields(text, _separator(text))
    return any(parse_number(field) is not None for field in fields) or parse_date(text.partition(",")[0]) is not None


def _separator(text: str) -> str | None:
    return next((mark for mark in (";", ",") if mark in text), None)


def _fields(text: str, separator: str | None) -> tuple[str, ...]:
    fields = [field.strip().strip('"').strip() for field in text.split(separator)]
    while fields and not fields[-1]:
        fields.pop()
    if separator == ";":
        fields = [field.replace(",", ".") if _DECIMAL_COMMA.fullmatch(field) else field for field in fields]
    return tuple(fields)


def _names(text: str, separator: str | None) -> tuple[str, ...]:
    bare = _UNIT.sub(lambda found: f"[{found[1].replace(' ', '')}]", text.lstrip("#%/ \t"))
    separator = separator if separator is None or separator in bare else _separator(bare)
    return tuple(name.strip().strip('",.;').strip() for name in bare.split(separator))
