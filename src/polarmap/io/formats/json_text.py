"""JSON of limited size: what is read is plain values, finite, writable, and no deeper than a file of ours."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

from polarmap.errors import InputError
from polarmap.io.files import read_text

MAX_JSON_BYTES = 1 << 24  # the results of some ten thousand keyframes

_DEEPEST = 32
_MOST_NAMES = 10_000  # of one mapping
_LARGEST_INTEGER = 1 << 63


def read_json(path: Path, limit: int = MAX_JSON_BYTES) -> Any:
    """The values in a JSON file of at most `limit` bytes.

    Raises InputError where it cannot be read, is not JSON, or has numbers that are not finite, integers of more than
    64 bits, text with lone surrogates, mappings of more than 10 000 names, or values deeper than 32 in each other.
    """
    return _parsed(path, read_text(path, limit))


def read_json_text(path: Path, limit: int = MAX_JSON_BYTES) -> str:
    """The text of such a file, for a parser that knows what must be in it. Raises as `read_json` does."""
    text = read_text(path, limit)
    _parsed(path, text)
    return text


def _parsed(path: Path, text: str) -> Any:
    try:
        values = json.loads(text, parse_constant=_refuse, parse_int=_integer)
    except json.JSONDecodeError as error:
        raise InputError(f"{path}: not a JSON file at line {error.lineno}: {error.msg}") from None
    except (ValueError, RecursionError) as error:
        raise InputError(f"{path}: not a JSON file ({error})") from None
    try:
        _check(values)
    except ValueError as problem:
        raise InputError(f"{path}: {problem}") from None
    return values


def _refuse(constant: str) -> None:
    raise ValueError(f"{constant} is no number of JSON")


def _integer(digits: str) -> int:
    if len(digits) > 20:  # before Python counts them
        raise ValueError(f"an integer of {len(digits)} digits")
    return int(digits)


def _check(values: Any) -> None:
    """Raise ValueError where something in the values is beyond the limits."""
    level = [values]
    for _ in range(_DEEPEST):
        for value in level:
            _check_value(value)
        nested = [value for value in level if isinstance(value, dict | list)]
        level = [part for value in nested for part in (value.values() if isinstance(value, dict) else value)]
        if not level:
            return
    raise ValueError(f"more than {_DEEPEST} lists and mappings in each other")


def _check_value(value: Any) -> None:
    if isinstance(value, float) and not math.isfinite(value):
        raise ValueError("a number is too large")
    if isinstance(value, int) and not -_LARGEST_INTEGER <= value < _LARGEST_INTEGER:
        raise ValueError("an integer has more than 64 bits")
    if isinstance(value, dict) and len(value) > _MOST_NAMES:
        raise ValueError(f"a mapping has {len(value)} names, more than {_MOST_NAMES}")
    for text in value if isinstance(value, dict) else [value]:
        if isinstance(text, str) and not text.isascii() and any("\ud800" <= c <= "\udfff" for c in text):
            raise ValueError("half of a surrogate pair, which is no character")
