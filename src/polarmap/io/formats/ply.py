"""Binary PLY files of meshes and point clouds, as MeshLab, CloudCompare, Open3D and trimesh read them."""

from __future__ import annotations

import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.io.files import write_bytes

_PLY_TYPES = {"f4": "float", "u1": "uchar", "i4": "int"}


def write_ply(
    path: str | os.PathLike,
    points: np.ndarray,
    *,
    faces: np.ndarray | None = None,
    normals: np.ndarray | None = None,
    grey: np.ndarray | None = None,
    properties: Mapping[str, np.ndarray] | None = None,
    offset: np.ndarray | None = None,
    comments: Sequence[str] = (),
) -> None:
    """Write a mesh, or without `faces` a point cloud; a file of that name is replaced once all is written.

    points: N×3, written as float32. faces: integer M×3, counterclockwise. normals: N×3. grey: (N,) in [0, 1],
    written as 8-bit red, green and blue alike, in proportion. properties: further numbers of each vertex by name,
    (N,) each, written as they are where they are uint8 or int32, else as float32. comments: further lines of the
    header, in ASCII. offset: (3,), what is to be added to the points to have them in their world, as the
    comment `offset X Y Z`, which `read_ply` understands; none where it is zero or None.

    Raises InputError where the arrays do not fit together, PolarmapError where the file cannot be written.
    """
    path = Path(path)
    records = [_vertex_records(path, points, normals, grey, properties or {})]
    header = ["ply", "format binary_little_endian 1.0"]
    if offset is not None and np.any(offset):
        header.append(f"comment offset {offset_text(offset)}")
    header += [f"comment {line}" for line in comments]
    header.append(f"element vertex {len(records[0])}")
    header += [f"property {_PLY_TYPES[kind[1:]]} {name}" for name, kind in records[0].dtype.descr]
    if faces is not None:
        records.append(_face_records(path, faces, len(records[0])))
        header += [f"element face {len(records[1])}", "property list uchar int vertex_indices"]
    header.append("end_header\n")
    write_bytes(path, b"".join(["\n".join(header).encode("ascii"), *(r.tobytes() for r in records)]))


def offset_text(offset: np.ndarray) -> str:
    """An offset (3,) as three numbers that read back as they are."""
    return " ".join(repr(float(number)) for number in offset)


def _vertex_records(
    path: Path,
    points: np.ndarray,
    normals: np.ndarray | None,
    grey: np.ndarray | None,
    properties: Mapping[str, np.ndarray],
) -> np.ndarray:
    n = len(points)
    arrays = [("points", points, (n, 3)), ("normals", normals, (n, 3)), ("grey", grey, (n,))]
    arrays += [(name, array, (n,)) for name, array in properties.items()]
    for name, array, shape in arrays:
        if array is not None and np.shape(array) != shape:
            raise InputError(f"{path}: {name} must be of shape {shape}, not {np.shape(array)}")
    columns = dict(zip("xyz", np.transpose(points), strict=True))
    if normals is not None:
        columns |= dict(zip(("nx", "ny", "nz"), np.transpose(normals), strict=True))
    columns |= properties
    kinds = dict.fromkeys(columns, "<f4")
    kinds |= {name: kind for name, array in properties.items() if (kind := array.dtype.str) in ("|u1", "<i4")}
    if grey is not None:
        level = np.rint(255.0 * np.clip(np.nan_to_num(grey), 0.0, 1.0))
        columns |= dict.fromkeys(("red", "green", "blue"), level)
        kinds |= dict.fromkeys(("red", "green", "blue"), "|u1")
    records = np.empty(n, list(kinds.items()))
    for name, column in columns.items():
        records[name] = column
    return records


def _face_records(path: Path, faces: np.ndarray, vertex_count: int) -> np.ndarray:
    faces = np.asarray(faces)
    if faces.ndim != 2 or faces.shape[1] != 3:
        raise InputError(f"{path}: faces must be of shape (M, 3), not {faces.shape}")
    if len(faces) and (faces.min() < 0 or faces.max() >= vertex_count):
        raise InputError(f"{path}: faces name vertices outside 0 to {vertex_count - 1}")
    records = np.empty(len(faces), [("count", "|u1"), ("vertices", "<i4", 3)])
    records["count"] = 3
    records["vertices"] = faces
    return records
