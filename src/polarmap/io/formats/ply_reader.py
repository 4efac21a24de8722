"""PLY files of any program: points with normals, triangles; ASCII and binary in either byte order.

A header in text (`ply`, `format KIND 1.0`, `element NAME COUNT`, `property TYPE NAME` or `property list COUNT_TYPE TYPE
NAME`, `end_header`), then the elements one after the other. `vertex` needs x, y and z; `face` gives a list
`vertex_indices` or `vertex_index`, polygons are split into triangles around their first corner. Further properties
are read over, and so are further elements, unless they hold a surface in another form (such as `tristrips`). A comment
`offset X Y Z` is added to the points: the file then counts them from there, since single precision does not hold
coordinates such as UTM.
"""

from __future__ import annotations

import io
import logging
import math
import re
import warnings
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field
from itertools import islice
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.geometry.origin import LARGEST_STEP, steps_of
from polarmap.io.files import read_bytes
from polarmap.io.formats.binary import MAX_BYTES

log = logging.getLogger(__name__)

_TYPES = {
    "char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4",
    "int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4",
    "float": "f4", "double": "f8", "float32": "f4", "float64": "f8",
}  # fmt: skip
_ORDERS = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
_WANTED = ("x", "y", "z", "nx", "ny", "nz")
_FACE_LISTS = ("vertex_indices", "vertex_index")
_NUMBER = r"[ \t]+([+-]?[0-9]*\.?[0-9]+(?:[eE][+-]?[0-9]{1,3})?)"
_OFFSET = re.compile(rf"comment[ \t]+offset:?{_NUMBER * 3}[ \t]*", re.IGNORECASE)
_FARTHEST = 1e12  # that an offset may be
_MAX_HEADER = 1 << 16
_MAX_TEXT = 1 << 27
_MOST_POLYGONS = 1 << 22  # that are not all triangles, and so are read one by one
_MAX_NUMBER = 1 << 53  # of a vertex


@dataclass(frozen=True, eq=False)
class PlyFile:
    """What a PLY holds: points float64 N×3; faces int64 M×3, M may be 0; normals float64 N×3, or None.

    offset: float64 (3,), what was added to the points since a comment says so; zero without one.
    properties: further numbers of each vertex that were asked for and are there, float64 (N,), by name.
    """

    points: np.ndarray
    faces: np.ndarray
    normals: np.ndarray | None
    offset: np.ndarray
    properties: dict[str, np.ndarray] = field(default_factory=dict)


@dataclass(frozen=True)
class _Property:
    """counts: the type of a list's length; None for a single number."""

    name: str
    kind: str
    counts: str | None


@dataclass(frozen=True)
class _Element:
    name: str
    count: int
    properties: tuple[_Property, ...]


def read_ply(path: Path, properties: Collection[str] = ()) -> PlyFile:
    """The points and triangles in a file. properties: the names of further numbers of a vertex that are wanted.

    Raises InputError where it is no PLY, has no points, is shorter than its header says, a face names a vertex that is
    not there, or it has a surface in another form than faces. Points that are not finite are kept. Warns where they are
    of single precision and so far from zero that this has cost them more than a millimetre.
    """
    path = Path(path)
    data = read_bytes(path, MAX_BYTES)
    order, elements, offset = _header(path, data)
    if order == "" and len(data) > _MAX_TEXT:
        raise InputError(f"{path}: {len(data)} bytes of text, more than {_MAX_TEXT}; save it as a binary PLY")
    body = _AsciiBody(path, data[offset:]) if order == "" else _BinaryBody(path, data, offset, order)
    vertices, faces = None, np.empty((0, 3), np.int64)
    _require_understood(path, elements)
    for element in elements:
        if element.name == "vertex":
            vertices = body.table(element, (*_WANTED, *properties))
        elif element.name == "face":
            faces = _triangles(path, body.lists(element))
        elif element.count and not all(p.counts is None for p in element.properties):
            break  # of what is neither points nor surface, after both
        else:
            body.table(element)
    if vertices is None or any(axis not in vertices for axis in "xyz"):
        raise InputError(f"{path}: no vertices with x, y and z")
    points = np.stack([vertices[axis] for axis in "xyz"], axis=1)
    _warn_of_lost_digits(path, order, elements, points)
    offset = _offset(path, data[:offset])
    points += offset
    if len(faces) and (faces.min() < 0 or faces.max() >= len(points)):
        raise InputError(f"{path}: a face names a vertex outside 0 to {len(points) - 1}")
    named = all(axis in vertices for axis in ("nx", "ny", "nz"))
    normals = np.stack([vertices[axis] for axis in ("nx", "ny", "nz")], axis=1) if named else None
    further = {name: vertices[name] for name in properties if name in vertices}
    return PlyFile(points, faces, normals, offset, further)


def _require_understood(path: Path, elements: list[_Element]) -> None:
    """InputError where there is more than points and faces that could be a surface, or these come twice or too late."""
    names = [element.name for element in elements]
    twice = next((name for name in ("vertex", "face") if names.count(name) > 1), None)
    if twice is not None:
        raise InputError(f"{path}: element {twice!r} comes twice; save each object to a file of its own")
    for position, element in enumerate(elements):
        lists = [p.name for p in element.properties if p.counts is not None]
        if element.name in ("vertex", "face") or not element.count or not lists:
            continue
        if any("vert" in name or "index" in name or "indices" in name for name in lists):
            raise InputError(
                f"{path}: element {element.name!r} has a surface in a form that is not read here; save it as triangles"
            )
        if {"vertex", "face"} & set(names[position + 1 :]):
            raise InputError(f"{path}: element {element.name!r} before the vertices or faces; save it without")


def _header(path: Path, data: bytes) -> tuple[str, list[_Element], int]:
    """Byte order ("" for text), elements, and where the content begins."""
    end = data.find(b"end_header", 0, _MAX_HEADER)
    start = data.find(b"\n", end) + 1
    if not data.startswith(b"ply") or end < 0 or start == 0:
        raise InputError(f"{path}: not a PLY file (begins with 'ply', has end_header within {_MAX_HEADER} bytes)")
    order, elements = None, []
    for line in data[:end].decode("ascii", errors="replace").splitlines()[1:]:
        words = line.split()
        if words[:1] == ["format"] and len(words) == 3 and words[1] in _ORDERS:
            order = _ORDERS[words[1]]
        elif words[:1] == ["element"] and len(words) == 3 and words[2].isdecimal() and len(words[2]) < 12:
            elements.append(_Element(words[1], int(words[2]), ()))
        elif words[:1] == ["property"] and elements and (found := _property(words)) is not None:
            last = elements[-1]
            elements[-1] = _Element(last.name, last.count, (*last.properties, found))
        elif words and words[0] not in ("comment", "obj_info"):
            raise InputError(f"{path}: its header has a line that is not understood: {line[:60]!r}")
    if order is None:
        raise InputError(f"{path}: its header names no format; expected one of {', '.join(_ORDERS)}")
    return order, elements, start


def _offset(path: Path, header: bytes) -> np.ndarray:
    """What the header's comments say is to be added to the points, float64 (3,)."""
    lines = header.decode("ascii", errors="replace").splitlines()
    found = [[float(number) for number in match.groups()] for line in lines if (match := _OFFSET.fullmatch(line))]
    if not found:
        return np.zeros(3)
    if any(other != found[0] for other in found) or not all(abs(number) < _FARTHEST for number in found[0]):
        raise InputError(f"{path}: its comments give no single offset of its points, or an absurd one; leave one there")
    return np.array(found[0])


def _warn_of_lost_digits(path: Path, order: str, elements: list[_Element], points: np.ndarray) -> None:
    kinds = {p.name: p.kind for e in elements if e.name == "vertex" for p in e.properties}
    single = [i for i, axis in enumerate("xyz") if kinds[axis] == "f4"] if order else []
    step = max((steps_of(points[:, i].astype(np.float32)) for i in single), default=0.0)
    if step > LARGEST_STEP:
        log.warning(
            "%s: its points are so far from zero that single precision has steps of %.3g there; what is smaller is "
            "lost: save them as double, or from an origin of their own with the comment 'offset X Y Z'",
            path, step,
        )  # fmt: skip


def _property(words: list[str]) -> _Property | None:
    if len(words) == 3 and words[1] in _TYPES:
        return _Property(words[2], _TYPES[words[1]], None)
    if len(words) == 5 and words[1] == "list" and _TYPES.get(words[2], "f")[0] in "iu" and words[3] in _TYPES:
        return _Property(words[4], _TYPES[words[3]], _TYPES[words[2]])
    return None


class _BinaryBody:
    """Elements in binary, read one after the other."""

    def __init__(self, path: Path, data: bytes, offset: int, order: str) -> None:
        self.path, self.data, self.offset, self.order = path, data, offset, order

    def table(self, element: _Element, wanted: Collection[str] = ()) -> dict[str, np.ndarray]:
        """The properties that are wanted and there, as float64 N, by name."""
        kind = np.dtype([(p.name, self.order + p.kind) for p in _scalars(self.path, element)])
        if not kind.names:
            return {}
        records = self._array(kind, element.count, element.name)
        return {name: records[name].astype(np.float64) for name in kind.names if name in wanted}

    def lists(self, element: _Element) -> Iterator[np.ndarray]:
        """The vertex numbers of every face: one array M×3 if all are triangles, else an array a face."""
        if self._all_triangles(element):
            records = self._array(self._triangle(element), element.count, element.name)
            yield records[_face_list(self.path, element).name]
            return
        left, least = len(self.data) - self.offset, self._least_bytes(element)
        if element.count * least > left:
            raise InputError(f"{self.path}: truncated: {element.count} of {element.name}, {left} bytes are left")
        if element.count > _MOST_POLYGONS:
            raise InputError(
                f"{self.path}: {element.count} faces that are not all triangles, more than {_MOST_POLYGONS}; "
                "save it with triangles"
            )
        for _ in range(element.count):
            yield self._polygon(element)

    def _all_triangles(self, element: _Element) -> bool:
        faces, kind = _face_list(self.path, element), self._triangle(element)
        if len(self.data) - self.offset < kind.itemsize * element.count or not element.count:
            return False
        counts = np.frombuffer(self.data, kind, element.count, self.offset)["count of " + faces.name]
        return bool((counts == 3).all())

    def _least_bytes(self, element: _Element) -> int:
        """What an element takes whose lists are empty."""
        return sum(np.dtype(p.kind if p.counts is None else p.counts).itemsize for p in element.properties)

    def _triangle(self, element: _Element) -> np.dtype:
        """The record of a face if every list has three items."""
        fields: list[tuple] = []
        for p in element.properties:
            if p.counts is not None:
                fields.append(("count of " + p.name, self.order + p.counts))
            fields.append((p.name, self.order + p.kind, 1 if p.counts is None else 3))
        return np.dtype(fields)

    def _polygon(self, element: _Element) -> np.ndarray:
        corners = np.empty(0, np.int64)
        for p in element.properties:
            count = 1 if p.counts is None else int(self._array(np.dtype(self.order + p.counts), 1, element.name)[0])
            if count < 0:
                raise InputError(f"{self.path}: a {element.name} claims {count} numbers")
            values = self._array(np.dtype(self.order + p.kind), count, element.name)
            if p.name in _FACE_LISTS:
                corners = values.astype(np.int64)
        return corners

    def _array(self, kind: np.dtype, count: int, what: str) -> np.ndarray:
        size, left = kind.itemsize * count, len(self.data) - self.offset
        if size > left:
            raise InputError(f"{self.path}: truncated: {count} of {what} take {size} bytes, {left} are left")
        self.offset += size
        return np.frombuffer(self.data, kind, count, self.offset - size)


class _AsciiBody:
    """Elements in text, a line each."""

    def __init__(self, path: Path, data: bytes) -> None:
        self.path, self.size = path, len(data)
        lines = (line.decode("ascii", errors="replace").strip() for line in io.BytesIO(data))
        self.lines = (line for line in lines if line)

    def table(self, element: _Element, wanted: Collection[str] = ()) -> dict[str, np.ndarray]:
        """The properties that are wanted and there, as float64 N, by name."""
        names = [p.name for p in _scalars(self.path, element)]
        if 2 * element.count > self.size + 1:
            raise InputError(f"{self.path}: truncated: {element.count} of {element.name} in {self.size} bytes")
        if not element.count:
            return {name: np.empty(0) for name in names}
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # of no rows, which is said below
                values = np.loadtxt(islice(self.lines, element.count), ndmin=2, comments=None)
        except ValueError as error:
            raise InputError(f"{self.path}: a {element.name} is malformed ({str(error)[:100]})") from None
        if len(values) < element.count:
            raise InputError(f"{self.path}: truncated: {element.count} of {element.name}, only {len(values)} are there")
        if values.shape[1] != len(names):
            raise InputError(
                f"{self.path}: a {element.name} has {values.shape[1]} numbers, its header names {len(names)}"
            )
        return {name: column for name, column in zip(names, values.T, strict=True) if name in wanted}

    def lists(self, element: _Element) -> Iterator[np.ndarray]:
        """The vertex numbers of every face."""
        wanted = _face_list(self.path, element)
        for row in self._rows(element):
            position = 0
            for p in element.properties:
                size = 1 if p.counts is None else 1 + int(row[position] if position < len(row) else 0)
                if position + size > len(row) or size < 1:
                    raise InputError(f"{self.path}: a {element.name} has fewer numbers than it claims")
                if p is wanted:
                    yield self._corners(element, row[position : position + size])
                position += size

    def _corners(self, element: _Element, numbers: list[float]) -> np.ndarray:
        """A list's items; numbers: its length before them."""
        if any(number % 1 for number in numbers):
            raise InputError(f"{self.path}: a {element.name} has a number that is not whole")
        return np.array(numbers[1:], np.int64)

    def _rows(self, element: _Element) -> Iterator[list[float]]:
        for number in range(element.count):
            line = next(self.lines, None)
            if line is None:
                raise InputError(f"{self.path}: truncated: {element.count} of {element.name}, only {number} are there")
            try:
                row = [float(word) for word in line.split()]
            except ValueError:
                row = [math.inf]
            if not all(abs(number) < _MAX_NUMBER for number in row):  # nor NaN
                raise InputError(f"{self.path}: {line[:40]!r} is no {element.name} of numbers")
            yield row


def _scalars(path: Path, element: _Element) -> tuple[_Property, ...]:
    names = [p.name for p in element.properties]
    if any(p.counts is not None for p in element.properties) or len(set(names)) < len(names):
        raise InputError(f"{path}: element {element.name!r} has a list, or a property twice")
    return element.properties


def _face_list(path: Path, element: _Element) -> _Property:
    found = next((p for p in element.properties if p.name in _FACE_LISTS and p.counts is not None), None)
    if found is not None and found.kind[0] not in "iu":
        raise InputError(f"{path}: its faces name vertices by numbers that need not be whole; save it again")
    if found is None or len({p.name for p in element.properties}) < len(element.properties):
        raise InputError(f"{path}: its faces need one list {' or '.join(_FACE_LISTS)}")
    return found


def _triangles(path: Path, faces: Iterator[np.ndarray]) -> np.ndarray:
    parts = []
    for corners in faces:
        if corners.ndim == 2:
            parts.append(corners.astype(np.int64))
        elif len(corners) >= 3:
            fan = np.column_stack([np.repeat(corners[0], len(corners) - 2), corners[1:-1], corners[2:]])
            parts.append(fan)
    return np.concatenate(parts) if parts else np.empty((0, 3), np.int64)
