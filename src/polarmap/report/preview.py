"""Pictures of a map as seen from outside: a z-buffer renderer for triangle meshes under parallel projection."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.data.mesh import Mesh
from polarmap.jit import njit

PATH_COLOUR = (226, 60, 50)

_SUPERSAMPLE = 2
_AMBIENT = 0.45  # share of the light that falls on every side alike
_TILT = np.radians(35.0)  # of the slanted view below the horizon
_TURN = np.radians(25.0)  # of the slanted view away from the cameras' direction
_MARGIN = 0.04


def render_map(mesh: Mesh, poses: np.ndarray, size: tuple[int, int] = (960, 720)) -> dict[str, np.ndarray]:
    """The mesh with the cameras' path, from outside ("outside") and from above ("top"), RGB uint8.

    poses: T_world_camera of the keyframes in the world of the mesh, N×4×4, N at least 1; their mean tells what is up
    and ahead. Surfaces are seen from their front only, so that walls and ceilings do not hide a room. size: (width,
    height) pixels.
    """
    up, ahead = _directions(poses)
    right = np.cross(ahead, up)
    turned = np.cos(_TURN) * ahead + np.sin(_TURN) * right
    slanted = np.cos(_TILT) * turned - np.sin(_TILT) * up
    views = {"outside": _looking(slanted, up), "top": _looking(-up, ahead)}
    return {name: render_view(mesh, R, poses[:, :3, 3], size) for name, R in views.items()}


def render_view(mesh: Mesh, R_view_world: np.ndarray, path: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """The mesh under parallel projection along the view's z axis, fitted into the picture, RGB uint8.

    R_view_world: 3×3 rotation to right, down, away. path: points N×3 that are joined by a line over the picture.
    """
    width, height = (_SUPERSAMPLE * side for side in size)
    points = mesh.vertices.astype(np.float64) @ R_view_world.T
    path = path @ R_view_world.T
    scale, offset = _fit(points[:, :2], path[:, :2], width, height)
    projected = np.ascontiguousarray(np.column_stack([points[:, :2] * scale + offset, points[:, 2]]), np.float32)
    level = np.ones((height, width), np.float32)
    _rasterize(projected, mesh.faces, _shade(mesh, R_view_world), np.full_like(level, np.inf), level)
    grey = cv2.resize((255.0 * level).astype(np.uint8), size, interpolation=cv2.INTER_AREA)
    picture = cv2.cvtColor(grey, cv2.COLOR_GRAY2RGB)
    _draw_path(picture, (path[:, :2] * scale + offset) / _SUPERSAMPLE)
    return picture


def _directions(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Unit up and horizontal ahead of the cameras, on average; any ahead where they look all around."""
    up = -poses[:, :3, 1].mean(axis=0)
    up = _unit(up) if np.linalg.norm(up) > 1e-3 else np.array([0.0, 0.0, 1.0])
    for candidate in (poses[:, :3, 2].mean(axis=0), poses[0, :3, 2], np.eye(3)[np.argmin(np.abs(up))]):
        ahead = candidate - (candidate @ up) * up
        if np.linalg.norm(ahead) > 0.1:
            break
    return up, _unit(ahead)


def _looking(away: np.ndarray, up: np.ndarray) -> np.ndarray:
    """R_view_world whose z axis is `away` and whose y axis points down."""
    right = _unit(np.cross(away, up))
    return np.stack([right, np.cross(away, right), away])


def _fit(points: np.ndarray, path: np.ndarray, width: int, height: int) -> tuple[float, np.ndarray]:
    """Pixels per metre and offset that show nearly all points, and all of the path."""
    low, high = np.percentile(points[:: max(1, len(points) // 100_000)], (0.5, 99.5), axis=0)
    low, high = np.minimum(low, path.min(axis=0)), np.maximum(high, path.max(axis=0))
    frame = np.array([width, height], float)
    scale = float(((1 - 2 * _MARGIN) * frame / np.maximum(high - low, 1e-9)).min())
    return scale, frame / 2 - scale * (low + high) / 2


def _shade(mesh: Mesh, R_view_world: np.ndarray) -> np.ndarray:
    """Display brightness of each vertex in [0, 1], float32: its grey under a light beside the viewer."""
    light = _unit(np.array([-0.3, -0.5, -1.0])) @ R_view_world
    lambert = np.clip(mesh.normals @ light.astype(np.float32), 0.0, 1.0)
    white = max(float(np.percentile(mesh.grey, 90)), 1e-3)
    albedo = np.clip(mesh.grey / white, 0.02, 1.0) ** (1 / 2.2)
    return (albedo * (_AMBIENT + (1 - _AMBIENT) * lambert)).astype(np.float32)


def _draw_path(picture: np.ndarray, points: np.ndarray) -> None:
    vertices = np.rint(points).astype(np.int32)
    cv2.polylines(picture, [vertices], False, PATH_COLOUR, 2, cv2.LINE_AA)
    cv2.circle(picture, tuple(int(i) for i in vertices[0]), 5, PATH_COLOUR, cv2.FILLED, cv2.LINE_AA)


def _unit(vector: np.ndarray) -> np.ndarray:
    return vector / np.linalg.norm(vector)


@njit
def _rasterize(points, faces, shade, z_buffer, level):
    """Front faces, counterclockwise as seen from in front, nearest wins. points: pixels u, v and distance."""
    height, width = level.shape
    for f in range(faces.shape[0]):
        a, b, c = faces[f, 0], faces[f, 1], faces[f, 2]
        ua, va, za = points[a, 0], points[a, 1], points[a, 2]
        ub, vb, zb = points[b, 0], points[b, 1], points[b, 2]
        uc, vc, zc = points[c, 0], points[c, 1], points[c, 2]
        area = (ub - ua) * (vc - va) - (uc - ua) * (vb - va)
        if not area < 0.0:  # v points down, which turns counterclockwise into a negative area
            continue
        first_u = max(int(np.ceil(min(ua, ub, uc))), 0)
        last_u = min(int(np.floor(max(ua, ub, uc))), width - 1)
        first_v = max(int(np.ceil(min(va, vb, vc))), 0)
        last_v = min(int(np.floor(max(va, vb, vc))), height - 1)
        for v in range(first_v, last_v + 1):
            for u in range(first_u, last_u + 1):
                wb = ((u - ua) * (vc - va) - (uc - ua) * (v - va)) / area
                wc = ((ub - ua) * (v - va) - (u - ua) * (vb - va)) / area
                if wb < 0.0 or wc < 0.0 or wb + wc > 1.0:
                    continue
                z = za + wb * (zb - za) + wc * (zc - za)
                if z < z_buffer[v, u]:
                    z_buffer[v, u] = z
                    level[v, u] = shade[a] + wb * (shade[b] - shade[a]) + wc * (shade[c] - shade[a])
