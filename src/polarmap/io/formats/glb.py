"""Writes meshes as glTF 2.0 in one binary file, .glb (registry.khronos.org/glTF/specs/2.0/glTF-2.0.html)."""

from __future__ import annotations

import json
import struct
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from polarmap.io.files import write_bytes

_ARRAY_BUFFER, _ELEMENT_ARRAY_BUFFER = 34962, 34963
_UNSIGNED_BYTE, _UNSIGNED_INT, _FLOAT = 5121, 5125, 5126
_KINDS = {"|u1": _UNSIGNED_BYTE, "<u4": _UNSIGNED_INT, "<f4": _FLOAT}
_SHAPES = {(): "SCALAR", (3,): "VEC3", (4,): "VEC4"}


def write_glb(
    path: Path,
    vertices: np.ndarray,
    faces: np.ndarray,
    normals: np.ndarray,
    colours: np.ndarray,
    T_root_mesh: np.ndarray,
    name: str = "map",
    extras: Mapping[str, object] | None = None,
) -> None:
    """Write a mesh with a colour for each vertex, which viewers show as it is, without lights.

    vertices: N×3, in metres. faces: integer M×3, counterclockwise. normals: N×3, unit. colours: uint8 N×3, linear.
    T_root_mesh: float64 4×4, from the vertices to glTF's axes (y up); written as the node's matrix. extras: further
    information, as JSON. Raises PolarmapError where the file cannot be written.
    """
    opaque = np.full((len(colours), 4), 255, np.uint8)
    opaque[:, :3] = colours
    buffers = _Buffers()
    position = np.ascontiguousarray(vertices, "<f4")
    bounds = {"min": position.min(axis=0).tolist(), "max": position.max(axis=0).tolist()}
    attributes = {
        "POSITION": buffers.add(position, _ARRAY_BUFFER, **bounds),
        "NORMAL": buffers.add(np.ascontiguousarray(normals, "<f4"), _ARRAY_BUFFER),
        "COLOR_0": buffers.add(opaque, _ARRAY_BUFFER, normalized=True),
    }
    indices = buffers.add(np.ascontiguousarray(faces.reshape(-1), "<u4"), _ELEMENT_ARRAY_BUFFER)
    matrix = np.asarray(T_root_mesh, float).T.reshape(-1).tolist()  # column by column
    document = {
        "asset": {"version": "2.0", "generator": "polarmap", "extras": dict(extras or {})},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"name": name, "mesh": 0, "matrix": matrix}],
        "meshes": [{"name": name, "primitives": [{"attributes": attributes, "indices": indices, "material": 0}]}],
        "materials": [
            {
                "name": "vertex colours",
                "doubleSided": True,
                "pbrMetallicRoughness": {"metallicFactor": 0.0, "roughnessFactor": 1.0},
                "extensions": {"KHR_materials_unlit": {}},
            }
        ],
        "accessors": buffers.accessors,
        "bufferViews": buffers.views,
        "buffers": [{"byteLength": buffers.size}],
    }
    text = json.dumps(document, separators=(",", ":")).encode()
    chunks = [(b"JSON", text + b" " * (-len(text) % 4)), (b"BIN\0", b"".join(buffers.parts))]
    body = b"".join(struct.pack("<I", len(data)) + kind + data for kind, data in chunks)
    write_bytes(path, b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body)


class _Buffers:
    """Arrays one after the other in one buffer; every item of theirs takes a multiple of four bytes."""

    def __init__(self) -> None:
        self.parts: list[bytes] = []
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.size = 0

    def add(self, values: np.ndarray, target: int, **further: object) -> int:
        """The number of the array's accessor."""
        data = values.tobytes()
        self.views.append({"buffer": 0, "byteOffset": self.size, "byteLength": len(data), "target": target})
        kind = {"componentType": _KINDS[values.dtype.str], "type": _SHAPES[values.shape[1:]], "count": len(values)}
        self.accessors.append({"bufferView": len(self.views) - 1, **kind, **further})
        self.parts.append(data)
        self.size += len(data)
        return len(self.accessors) - 1
