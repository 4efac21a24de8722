"""YAML of plain values: text, numbers, booleans, null, lists and mappings, never Python's objects.

`read_yaml` reads a file and `parse_yaml` a text; everything in the package that is YAML comes through here. It is
YAML 1.1 as PyYAML's safe loader reads it (the last of two equal keys counts, `<<` merges mappings, 1:30 is 90), but

- dates stay text, and so does `=`;
- of explicit tags only those of the plain kinds are known, and what they stand before must be of that kind;
- integers have at most 64 bits, numbers at most 100 characters, and text no lone surrogates;
- files, depth and the number of values are limited. An alias counts as all that it stands for, so that what is
  returned is never larger, for those who walk through it, than it would be written out.
"""

from __future__ import annotations

import codecs
import re
from pathlib import Path
from typing import Any

import yaml

from polarmap.errors import InputError, quoted
from polarmap.io.files import read_bytes

MAX_YAML_BYTES = 1 << 20

_MOST_VALUES = 20_000  # keys too, and what aliases stand for
_DEEPEST = 32
_LONGEST_NUMBER = 100  # characters
_LARGEST_INTEGER = 1 << 63
_KINDS = ("null", "bool", "int", "float", "str", "seq", "map", "merge")
_PREFIX = "tag:yaml.org,2002:"
_PATTERNS = {
    tag.removeprefix(_PREFIX): pattern
    for resolvers in yaml.SafeLoader.yaml_implicit_resolvers.values()
    for tag, pattern in resolvers
    if tag.removeprefix(_PREFIX) in ("null", "bool", "int")
}
_PATTERNS["float"] = re.compile(
    r"[-+]?(\d[\d_]*(:\d+)*(\.[\d_]*)?|\.\d[\d_]*)([eE][-+]?\d+)?$|[-+]?\.inf$|\.nan$", re.IGNORECASE | re.ASCII
)
_BYTE_ORDER_MARKS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"), (b"", "utf-8-sig"))


def read_yaml(path: Path, limit: int = MAX_YAML_BYTES) -> Any:
    """The values in a YAML file of at most `limit` bytes, in UTF-8 or, with a byte order mark, UTF-16.

    Raises InputError, with the line where that is known, where it cannot be read or is not as described above.
    """
    return parse_yaml(read_bytes(path, limit), str(path))


def parse_yaml(text: str | bytes, source: str) -> Any:
    """The values in a YAML text. source: the file or option that it is from, for messages.

    Raises InputError, with the line where that is known, for what is not as described above.
    """
    if isinstance(text, bytes):
        text = _decoded(text, source)
    if len(text) > MAX_YAML_BYTES:
        raise InputError(f"{source}: {len(text)} characters, more than the {MAX_YAML_BYTES} that YAML may have here")
    loader = None
    try:
        loader = _PlainLoader(text)
        return loader.get_single_data()
    except yaml.reader.ReaderError as error:
        line = text.count("\n", 0, error.position) + 1
        raise InputError(f"{source}: not valid YAML at line {line}: a control character") from None
    except yaml.YAMLError as error:
        mark, problem = getattr(error, "problem_mark", None), getattr(error, "problem", None)
        where = f" at line {mark.line + 1}" if mark else ""
        why = f": {problem}" if problem else ""
        raise InputError(f"{source}: not valid YAML{where}{why}") from None
    except (ValueError, OverflowError, RecursionError) as error:  # such as an escape beyond Unicode
        where = f" at line {loader.line + 1}" if loader else ""
        raise InputError(f"{source}: not valid YAML{where} ({error})") from None


def _decoded(data: bytes, source: str) -> str:
    encoding = next(encoding for mark, encoding in _BYTE_ORDER_MARKS if data.startswith(mark))
    try:
        return data.decode(encoding)
    except UnicodeDecodeError:
        raise InputError(f"{source}: not valid YAML (not a text in UTF-8)") from None


class _PlainLoader(yaml.SafeLoader):
    """PyYAML's safe loader with fewer kinds of values, and limits that hold before memory is taken."""

    yaml_implicit_resolvers = {  # noqa: RUF012 (a class attribute of the base)
        first: [(tag, pattern) for tag, pattern in resolvers if tag.removeprefix(_PREFIX) in _KINDS]
        for first, resolvers in yaml.SafeLoader.yaml_implicit_resolvers.items()
    }

    def __init__(self, text: str) -> None:
        super().__init__(text)
        self._depth = 0
        self._values = 0
        self._sizes: dict[int, int] = {}  # by node: the values it stands for, those of its aliases too

    def compose_node(self, parent, index):
        """A node within the limits; an alias adds to the count what its anchor has."""
        if self.check_event(yaml.AliasEvent):
            event = self.peek_event()
            node = super().compose_node(parent, index)
            if id(node) not in self._sizes:
                raise _problem(event, "an alias inside of what it stands for")
            self._count(event, self._sizes[id(node)])
            return node
        event, before = self.peek_event(), self._values
        self._depth += 1
        if self._depth > _DEEPEST:
            raise _problem(event, f"more than {_DEEPEST} lists and mappings in each other")
        self._count(event, 1)
        node = super().compose_node(parent, index)
        self._depth -= 1
        self._sizes[id(node)] = self._values - before
        _check_kind(node, event)
        return node

    def _count(self, event, values: int) -> None:
        self._values += values
        if self._values > _MOST_VALUES:
            raise _problem(event, f"more than {_MOST_VALUES} values, aliases written out")


def _check_kind(node: yaml.Node, event) -> None:
    """Raise the loader's error where a node is of no plain kind, or its text not of the kind that its tag claims."""
    kind = node.tag.removeprefix(_PREFIX)
    expected = {yaml.SequenceNode: ("seq",), yaml.MappingNode: ("map",)}.get(type(node), _KINDS[:5] + _KINDS[7:])
    if kind not in expected or node.tag == kind:
        raise _problem(event, f"the tag {node.tag} is not known, or not for this; write plain values")
    if not isinstance(node, yaml.ScalarNode):
        return
    if any("\ud800" <= character <= "\udfff" for character in node.value):
        raise _problem(event, "half of a surrogate pair, which is no character")
    if len(node.value) > _LONGEST_NUMBER and kind in ("int", "float"):
        raise _problem(event, f"a number of {len(node.value)} characters; at most {_LONGEST_NUMBER} are read")
    if kind in _PATTERNS and not _PATTERNS[kind].match(node.value):
        raise _problem(event, f"{quoted(node.value)} is no {kind}, which its tag claims")
    if kind == "int" and abs(_integer(node, event)) >= _LARGEST_INTEGER:
        raise _problem(event, "an integer of more than 64 bits")


def _integer(node: yaml.ScalarNode, event: yaml.Event) -> int:
    try:
        return yaml.constructor.SafeConstructor().construct_yaml_int(node)
    except ValueError:  # such as 0b_, which YAML's own pattern lets through
        raise _problem(event, f"{quoted(node.value)} is no int") from None


def _problem(event: yaml.Event, problem: str) -> yaml.MarkedYAMLError:
    return yaml.MarkedYAMLError(problem=problem, problem_mark=event.start_mark)
