"""Texts that hold keys and values: YAML, JSON, and what OpenCV's FileStorage writes, which is neither quite.

FileStorage's YAML begins with `%YAML:1.0` (`%YAML 1.2` since OpenCV 5) and tags matrices `!!opencv-matrix`; both are
taken off, and the guarded loader reads the rest. Of its XML only elements and their texts are read, never a DOCTYPE.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

from polarmap.errors import InputError
from polarmap.io.files import read_bytes
from polarmap.io.formats.yaml_text import MAX_YAML_BYTES, parse_yaml

_DIRECTIVE = re.compile(r"\A\s*%YAML[^\n]*")
_TAG = re.compile(r"!!opencv-[a-z-]+")


def read_values(path: Path) -> Any:
    """The values in such a file; InputError, with the line where it is known, where it is none."""
    data = read_bytes(path, MAX_YAML_BYTES)
    try:
        text = data.decode("utf-8-sig")
    except UnicodeDecodeError:
        return parse_yaml(data, str(path))  # which knows UTF-16, or says what it is not
    if text.lstrip().startswith("<"):
        return _parse_xml(text, path)
    if _DIRECTIVE.match(text):
        text = _TAG.sub("", _DIRECTIVE.sub("", text, count=1))
    return parse_yaml(text, str(path))


def _parse_xml(text: str, path: Path) -> dict[str, Any]:
    if "<!" in re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL):
        raise InputError(f"{path}: XML with a DOCTYPE or CDATA; OpenCV's FileStorage writes neither")
    try:
        root = ElementTree.fromstring(text.encode())
    except (ElementTree.ParseError, ValueError, LookupError) as error:
        raise InputError(f"{path}: not valid XML: {error}") from None
    if root.tag != "opencv_storage":
        raise InputError(f"{path}: XML, but not OpenCV's (opencv_storage)")
    return {child.tag: _element(child) for child in root}


def _element(element: ElementTree.Element) -> Any:
    """A text, or the mapping of a matrix; deeper than that no calibration goes."""
    if len(element):
        return {child.tag: _words(child) for child in element}
    words = _words(element)
    return words[0].strip('"') if len(words) == 1 else words


def _words(element: ElementTree.Element) -> Any:
    words = (element.text or "").split()
    return words if element.tag == "data" or len(words) != 1 else words[0]
