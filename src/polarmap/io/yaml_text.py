"""YAML of plain values: numbers, texts, lists and mappings, never Python's objects."""

from __future__ import annotations

from typing import Any

import yaml

from polarmap.errors import InputError

_LONGEST = 200  # characters of a source in a message


def parse_yaml(text: str | bytes, source: str) -> Any:
    """The values in a YAML text. source: the file or option that it is from, for messages.

    Raises InputError, with the line where that is known, for what is not YAML or asks for an object.
    """
    try:
        return yaml.safe_load(text)
    except (yaml.YAMLError, ValueError, RecursionError) as error:
        source = source if len(source) <= _LONGEST else source[:_LONGEST] + "..."
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        where = f" at line {mark.line + 1}" if mark else ""
        why = f": {problem}" if problem else ""
        raise InputError(f"{source}: not valid YAML{where}{why}") from None
