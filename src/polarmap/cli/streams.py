"""Output streams that never fail for a character: what they cannot hold is written in ASCII."""

from __future__ import annotations

import codecs
import sys
import unicodedata

HANDLER = "polarmap.ascii"

_ASCII = {
    "–": "-", "—": "-", "−": "-", "‐": "-", "‑": "-", "×": "x", "·": ".", "•": "*", "…": "...", "°": " deg", "µ": "u",
    "∇": "grad ", "√": "sqrt", "≤": "<=", "≥": ">=", "≈": "~", "±": "+-", "→": "->", "←": "<-", "‹": "<", "›": ">",
    "‘": "'", "’": "'", "“": '"', "”": '"', "ß": "ss", "æ": "ae", "ø": "o", "ł": "l", "∥": "||", "⟂": "_|_",
    "²": "^2", "³": "^3", "⁴": "^4", "⁵": "^5", "¹": "^1", "⁻": "^-", "½": "1/2", "¼": "1/4", "ᵀ": "^T",
}  # fmt: skip
_HORIZONTAL, _VERTICAL = "─━═╌╍┄┅┈┉╴╸╶╺╼╾", "│┃║╎╏┆┇┊┋╵╹╷╻╽╿"


def make_streams_tolerant() -> None:
    """Have stdout and stderr write every text; call it before anything is written.

    With an encoding that lacks a character, the nearest ASCII takes its place; bytes of a file name that are no text
    are shown as in \\xff. Where the streams are not Python's own nothing is changed.
    """
    codecs.register_error(HANDLER, _replace)
    for stream in (sys.stdout, sys.stderr):
        if hasattr(stream, "reconfigure"):
            stream.reconfigure(errors=HANDLER)


def ascii_of(character: str) -> str:
    """The nearest in ASCII."""
    if character in _ASCII:
        return _ASCII[character]
    if character in _HORIZONTAL:
        return "-"
    if character in _VERTICAL:
        return "|"
    code = ord(character)
    if 0x2500 <= code < 0x2580:  # corners and crossings of boxes
        return "+"
    if 0xDC80 <= code < 0xDD00:
        return f"\\x{code - 0xDC00:02x}"
    name = unicodedata.name(character, "").split()
    if name[:1] == ["GREEK"] and "LETTER" in name:
        return name[name.index("LETTER") + 1].lower()
    plain = unicodedata.normalize("NFKD", character).encode("ascii", "ignore").decode()
    return plain or ("" if unicodedata.combining(character) else "?")


def _replace(error: UnicodeError) -> tuple[str, int]:
    if not isinstance(error, UnicodeEncodeError):
        raise error
    return "".join(map(ascii_of, error.object[error.start : error.end])), error.end
