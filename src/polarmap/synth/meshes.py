"""Triangle meshes of the curved shapes, with exact normals at their vertices."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from polarmap.synth.scene import Prism, Revolved

_TURNS = 96  # round the axis
_HEIGHTS = 48  # along it
_CORNER = 16  # on the arc round a corner, and over an edge


@dataclass(frozen=True)
class ShapeMesh:
    """vertices and unit normals: float64 N×3 in the object frame; faces: int M×3, counter-clockwise from outside."""

    vertices: np.ndarray
    normals: np.ndarray
    faces: np.ndarray


def shape_mesh(primitive: Revolved | Prism) -> ShapeMesh:
    """The surface of one of the two shapes; vertices lie on it."""
    rings = _revolved_rings(primitive) if isinstance(primitive, Revolved) else _prism_rings(primitive)
    vertices, normals = (np.concatenate(parts) for parts in zip(*rings, strict=True))
    return ShapeMesh(vertices, normals, _faces(vertices, normals, len(rings), len(rings[0][0])))


def _revolved_rings(revolved: Revolved) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rings of points and normals from below upward; those of the flat ends are separate from the side's."""
    c0, c1, c2 = revolved.profile
    half = revolved.height / 2
    around = np.linspace(0.0, 2.0 * np.pi, _TURNS + 1)
    circle = np.stack([np.cos(around), np.sin(around), np.zeros_like(around)], axis=1)
    up = np.array([0.0, 0.0, 1.0])
    rings = [_flat_ring(0.0 * circle - half * up, -up), _flat_ring(revolved.bottom * circle - half * up, -up)]
    for z in half * -np.cos(np.linspace(0.0, np.pi, _HEIGHTS + 1)):
        radius = np.sqrt(max(c0 + z * (c1 + c2 * z), 0.0))
        normal = radius * circle - (0.5 * c1 + c2 * z) * up
        length = np.linalg.norm(normal, axis=1, keepdims=True)
        rings.append((radius * circle + z * up, normal / np.where(length > 0.0, length, 1.0)))
    rings += [_flat_ring(revolved.top * circle + half * up, up), _flat_ring(0.0 * circle + half * up, up)]
    return rings


def _prism_rings(prism: Prism) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rings round the rounded outline, over the lower edge, up the side, over the upper edge; flat ends."""
    foot, outward = _rounded_outline(np.asarray(prism.outline, float))
    up = np.array([0.0, 0.0, 1.0])
    half, r = prism.height / 2, prism.rounding
    middle = np.broadcast_to(foot.mean(axis=0), foot.shape)
    rings = [_flat_ring(middle - (half + r) * up, -up), _flat_ring(foot - (half + r) * up, -up)]
    for side in (-1.0, 1.0):
        bends = np.linspace(0.0, np.pi / 2, _CORNER + 1)
        for bend in bends[::-1] if side < 0 else bends:
            normal = np.cos(bend) * outward + side * np.sin(bend) * up
            rings.append((foot + side * half * up + r * normal, normal))
    rings += [_flat_ring(foot + (half + r) * up, up), _flat_ring(middle + (half + r) * up, up)]
    return rings


def _rounded_outline(corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Corners, each repeated along the arc of its normals, and those normals, N×3 with z = 0; closed."""
    along = np.roll(corners, -1, axis=0) - corners
    leaving = np.arctan2(-along[:, 0], along[:, 1])  # angle of the normal of the edge from each corner
    arriving = np.roll(leaving, 1)
    turn = (leaving - arriving) % (2.0 * np.pi)
    angle = (arriving[:, None] + turn[:, None] * np.linspace(0.0, 1.0, _CORNER + 1)).ravel()
    normals = np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    feet = np.concatenate([np.repeat(corners, _CORNER + 1, axis=0), np.zeros((len(angle), 1))], axis=1)
    return np.concatenate([feet, feet[:1]]), np.concatenate([normals, normals[:1]])


def _flat_ring(points: np.ndarray, normal: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    return points, np.broadcast_to(normal, points.shape)


def _faces(vertices: np.ndarray, normals: np.ndarray, rings: int, length: int) -> np.ndarray:
    """Two triangles between neighbours on neighbouring rings, without those that have no area."""
    index = np.arange(rings * length).reshape(rings, length)
    a, b, c, d = (part.ravel() for part in (index[:-1, :-1], index[:-1, 1:], index[1:, 1:], index[1:, :-1]))
    faces = np.concatenate([np.stack([a, b, c], axis=1), np.stack([a, c, d], axis=1)])
    edge1, edge2 = (vertices[faces[:, i]] - vertices[faces[:, 0]] for i in (1, 2))
    return faces[np.linalg.norm(np.cross(edge1, edge2), axis=1) > 1e-14]
