"""The mesh as glTF, for Blender, browsers and game engines."""

from __future__ import annotations

from pathlib import Path
from typing import Literal

import numpy as np

from polarmap.data.mesh import Mesh
from polarmap.export.output import prepare_file, remarks
from polarmap.export.source import MapSource
from polarmap.export.upright import upright
from polarmap.geometry.pose import inverse
from polarmap.io.formats.glb import write_glb

Z_UP_TO_Y_UP = np.array([[1.0, 0.0, 0.0, 0.0], [0.0, 0.0, 1.0, 0.0], [0.0, -1.0, 0.0, 0.0], [0.0, 0.0, 0.0, 1.0]])
"""From axes with z up to glTF's."""

_WHITE_SHARE = 99.0  # percentile of the grey values that is shown as white
_DISPLAY_GAMMA = 2.2


def export_glb(
    source: MapSource, out: Path, up: np.ndarray, *, colour: Literal["grey", "normal"] = "grey", force: bool = False
) -> Mesh:
    """Write the file `out`, *.glb; returns the mesh.

    up: (3,), world. Vertices stay as they are, and the node's matrix turns `up` to glTF's +y. colour: of the
    vertices, the pictures' grey or where the normals point: +x red, up green, toward the viewer blue.
    Raises InputError as `prepare_file` does, and where there is no mesh.
    """
    prepare_file(out, ".glb", force)
    mesh = source.mesh()
    T_root_mesh = Z_UP_TO_Y_UP @ inverse(upright(up))
    normals = _unit(mesh.normals, up)
    colours = _grey(mesh) if colour == "grey" else _of_normals(normals @ T_root_mesh[:3, :3].T)
    extras = {"remarks": remarks(source), "unit": source.unit, "offset": source.origin.tolist()}
    write_glb(out, mesh.vertices, mesh.faces, normals, colours, T_root_mesh, "polarmap", extras)
    return mesh


def _unit(normals: np.ndarray, instead: np.ndarray) -> np.ndarray:
    """Of length 1, as glTF demands; `instead` where a normal has no direction."""
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.where(length > 0, normals / np.maximum(length, 1e-12), instead).astype(np.float32)


def _grey(mesh: Mesh) -> np.ndarray:
    """Linear, as the map has it, the brightest being white."""
    white = max(float(np.percentile(mesh.grey, _WHITE_SHARE)), 1e-3)
    level = np.rint(255.0 * np.clip(mesh.grey / white, 0.0, 1.0)).astype(np.uint8)
    return np.repeat(level[:, None], 3, axis=1)


def _of_normals(normals: np.ndarray) -> np.ndarray:
    """Linear values that a display shows as half of 1 + the normal."""
    return np.rint(255.0 * np.clip(0.5 + 0.5 * normals, 0.0, 1.0) ** _DISPLAY_GAMMA).astype(np.uint8)
