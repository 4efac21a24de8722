"""A depth map with its camera, checked and made ready for the fusion kernels."""

from __future__ import annotations

import zlib
from typing import NamedTuple

import numpy as np
from numba import prange

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import is_rotation
from polarmap.jit import njit

_ROTATION_TOLERANCE = 1e-4  # of each product of axes, which depth of a hundred metres turns into a centimetre


class DepthView(NamedTuple):
    """What the kernels take of a depth map.

    depth: float32 H×W, z in metres, 0 where there is none. weight, grey: float32 H×W in [0, 1].
    intrinsics: fx, fy, cx, cy in pixels, float64 (4,). rotation, centre: of T_world_camera, float64 3×3 and (3,).
    """

    depth: np.ndarray
    weight: np.ndarray
    grey: np.ndarray
    intrinsics: np.ndarray
    rotation: np.ndarray
    centre: np.ndarray

    def checksum(self) -> int:
        """CRC-32 of all the values."""
        checksum = 0
        for values in self:
            checksum = zlib.crc32(values, checksum)
        return checksum


def prepare_view(
    depth: np.ndarray,
    grey: np.ndarray,
    confidence: np.ndarray | None,
    camera: PinholeCamera,
    T_world_camera: np.ndarray,
) -> DepthView:
    """The arguments of `TsdfVolume.integrate`, checked and cleaned.

    Raises InputError where a shape is not the camera's, or the pose is not a finite rigid motion.
    """
    confidence = np.broadcast_to(np.float32(1.0), camera.shape) if confidence is None else confidence
    for name, image in (("depth", depth), ("grey", grey), ("confidence", confidence)):
        if np.shape(image) != camera.shape:
            raise InputError(f"fusion: {name} is {np.shape(image)}, but the camera's images are {camera.shape}")
    images = _clean(*(np.ascontiguousarray(image, np.float32) for image in (depth, confidence, grey)))
    intrinsics = np.array([camera.fx, camera.fy, camera.cx, camera.cy], np.float64)
    return DepthView(*images, intrinsics, *_rotation_and_centre(T_world_camera))


def _rotation_and_centre(T_world_camera: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    T = np.array(T_world_camera, np.float64)
    if T.shape != (4, 4) or not np.isfinite(T).all():
        raise InputError("fusion: T_world_camera must be 4x4 and finite")
    R, centre = np.ascontiguousarray(T[:3, :3]), np.ascontiguousarray(T[:3, 3])
    if not is_rotation(R, _ROTATION_TOLERANCE):
        raise InputError("fusion: T_world_camera is not a rigid motion: its rotation is not orthonormal")
    return R, centre


@njit(parallel=True)
def _clean(depth, confidence, grey):
    """Depth with 0 for none, weight and grey within [0, 1]; a pixel without depth or weight has neither."""
    height, width = depth.shape
    out_depth, out_weight, out_grey = np.zeros((3, height, width), np.float32)
    for v in prange(height):
        for u in range(width):
            z, c, g = depth[v, u], confidence[v, u], grey[v, u]
            if 0.0 < z < np.inf and c > 0.0:
                out_depth[v, u] = z
                out_weight[v, u] = min(c, np.float32(1.0))
                out_grey[v, u] = min(g, np.float32(1.0)) if g > 0.0 else np.float32(0.0)
    return out_depth, out_weight, out_grey
