"""The package's own exceptions; each message is one line that names what is wrong and what to do.

Messages quote what was read and name files, both of which may be of any length and hold anything. `PolarmapError`
therefore keeps every message short and printable, wherever it is made.
"""

from __future__ import annotations

import re

LONGEST_QUOTE = 200
"""Characters that a message quotes of one word, name or value."""
LONGEST_MESSAGE = 480
"""Characters of a whole message."""

_MARK = "…"
_LONG_WORD = re.compile(rf"\S{{{LONGEST_QUOTE + 1},}}")


def quoted(value: object) -> str:
    """A value as Python writes it, cut at `LONGEST_QUOTE` characters; a list or mapping is named by its kind alone."""
    if isinstance(value, str):
        return _cut(repr(value[: LONGEST_QUOTE + 1]), LONGEST_QUOTE)
    if isinstance(value, bytes | int | float | complex | type(None)):
        return _cut(_written(value), LONGEST_QUOTE)
    return {dict: "a mapping", list: "a list", tuple: "a list"}.get(type(value), f"a {type(value).__name__}")


def concise(message: str) -> str:
    """A message on one line, printable in any terminal: long words and the whole are cut in their middle."""
    message = _cut(message, 1 << 16)
    if not message.isprintable():  # has controls, marks that turn the line around, or what no encoding can write
        message = "".join(map(_shown, message))
    message = _LONG_WORD.sub(lambda word: _cut(word.group(), LONGEST_QUOTE), message)
    return _cut(message, LONGEST_MESSAGE)


class PolarmapError(Exception):
    """Base class: something failed that is neither a bug nor bad input (a full disk, say). Exit status 1."""

    exit_status = 1

    def __init__(self, message: str = "") -> None:
        super().__init__(concise(str(message)))


class InputError(PolarmapError):
    """What the user gave cannot be used: a file, a value, an array. Exit status 2."""

    exit_status = 2


class NothingMapped(PolarmapError):
    """A run came to its end, and there is no surface."""


def _cut(text: str, longest: int) -> str:
    """Text without its middle: what it begins and ends with (a file's name, what to do) says most."""
    if len(text) <= longest:
        return text
    end = longest * 2 // 5
    return text[: longest - end - len(_MARK)] + _MARK + text[-end:]


def _written(value: object) -> str:
    try:
        return repr(value[: LONGEST_QUOTE + 1] if isinstance(value, bytes) else value)
    except ValueError:  # Python does not write integers of thousands of digits
        return f"an integer of {value.bit_length()} bits"


def _shown(character: str) -> str:
    if character.isprintable():
        return character
    return " " if character.isspace() else character.encode("unicode_escape", "surrogatepass").decode("ascii")
