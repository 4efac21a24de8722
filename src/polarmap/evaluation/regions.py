"""Where it is hard: on curved surfaces, and beside steps of depth."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.evaluation.metrics import RegionMetrics

_SPAN = 8  # pixels over which normals turn
_TURN = (2.0, 30.0)  # degrees over that span that make a surface curved: less is flat, more an edge
_NEAR = 8  # pixels from a step of depth
_STEP = 0.03  # relative second difference of inverse depth, which vanishes on planes, that is a step
_WITHIN = 0.02
_NONE = float("nan")


def region_metrics(
    depth: np.ndarray, normal: np.ndarray, true_depth: np.ndarray, true_normal: np.ndarray
) -> RegionMetrics:
    """Compare depth, float H×W, and normals, H×W×3, with the true ones in curved regions and near steps of depth."""
    edges = near_steps(true_depth)
    curved = is_curved(true_normal) & ~edges
    edges &= np.isfinite(true_depth)
    within = np.abs(depth - true_depth) < _WITHIN * true_depth
    cosine = np.einsum("hwc,hwc->hw", normal, true_normal)[curved]
    degrees = np.degrees(np.arccos(np.clip(cosine[np.isfinite(cosine)], -1.0, 1.0)))
    return RegionMetrics(
        curved=float(np.count_nonzero(curved)),
        curved_within=float(within[curved].mean()) if curved.any() else _NONE,
        curved_normals=float(np.median(degrees)) if degrees.size else _NONE,
        edges=float(np.count_nonzero(edges)),
        edges_within=float(within[edges].mean()) if edges.any() else _NONE,
    )


def near_steps(depth: np.ndarray) -> np.ndarray:
    """Pixels within 8 pixels of a step of depth, or of where depth is not known, bool H×W."""
    q = np.where(np.isfinite(depth), 1.0 / depth, 0.0).astype(np.float32)
    step = np.zeros(depth.shape, bool)
    for axis in (0, 1):
        middle, before, after = (np.moveaxis(q, axis, 0)[part] for part in (np.s_[1:-1], np.s_[:-2], np.s_[2:]))
        jump = np.abs(before + after - 2.0 * middle) > _STEP * np.maximum(middle, 1e-12)
        np.moveaxis(step, axis, 0)[1:-1] |= jump
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (2 * _NEAR + 1, 2 * _NEAR + 1))
    return cv2.dilate(step.astype(np.uint8), around).astype(bool)


def is_curved(normal: np.ndarray) -> np.ndarray:
    """Pixels whose normals, H×W×3, turn by 2 to 30 degrees over 8 pixels, across or down, bool H×W."""
    turn = np.zeros(normal.shape[:2], np.float32)
    half = _SPAN // 2
    for axis in (0, 1):
        along = np.moveaxis(normal, axis, 0)
        cosine = np.einsum("hwc,hwc->hw", along[: -2 * half], along[2 * half :])
        angle = np.degrees(np.arccos(np.clip(np.nan_to_num(cosine, nan=1.0), -1.0, 1.0)))
        inner = np.moveaxis(turn, axis, 0)[half:-half]
        np.maximum(inner, angle, out=inner)
    return (turn > _TURN[0]) & (turn < _TURN[1]) & np.isfinite(normal).all(axis=-1)
