"""The map of a run put into the true world, and what is measured on it: surface and walls.

Everything is counted from the first true pose, and so are the grids that points are averaged in, so that figures are
the same wherever that world has its zero.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from polarmap.errors import InputError
from polarmap.evaluation.alignment import Similarity, align_poses
from polarmap.evaluation.imported import ImportedRun
from polarmap.evaluation.planes import Plane
from polarmap.evaluation.records import Evaluation
from polarmap.evaluation.surface import (
    MAX_POINTS,
    THRESHOLDS,
    MapMetrics,
    VoxelMeans,
    sample_triangles,
    surface_metrics,
)
from polarmap.evaluation.truth import Truth
from polarmap.evaluation.walls import WallCollector, WallMetrics, true_walls, walls_of_points
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.origin import shifted
from polarmap.io.formats.ply_reader import PlyFile, read_ply
from polarmap.io.run_folder.folder import CLOUD_NAME, MESH_NAME, read_keyframes, read_results

MOST_TRUE_FRAMES = 100
LEAST_THRESHOLD = 1e-4  # metres; the grid of finer ones would not hold a building
_WALL_SPACING = 0.02  # metres between the points that walls are found by
_WALL_STRIDE = 7  # of the pixels that they are made of


@dataclass(frozen=True, eq=False)
class RunDepth:
    """A depth map of a run: depth float32 H×W in the run's unit; T_world_camera 4×4 in its world, None if unknown."""

    index: int
    depth: np.ndarray
    T_world_camera: np.ndarray | None


@dataclass(frozen=True, eq=False)
class Reconstruction:
    """A run's map, in its own world and unit.

    depth_maps: gives them one by one. surface: a PLY, or None. to_truth: takes its world to the true one as it is
    from its first pose, and its scale depth to metres; where the run has no poses, the worlds are taken to be the
    same. origin: float64 (3,), of the surface in the run's world, where its PLY does not say it itself.
    """

    source: Path
    depth_maps: Callable[[], Iterator[RunDepth]]
    surface: Path | None
    to_truth: Similarity
    origin: np.ndarray = field(default_factory=lambda: np.zeros(3))


def run_reconstruction(out: Path, truth: Truth, evaluation: Evaluation) -> Reconstruction:
    """The map of a run's folder, with odometry that of the segment that the evaluation's scale is of."""
    out, results = Path(out), read_results(Path(out))
    segment = results.segment
    if results.poses == "odometry":
        segment = next(s.segment for s in evaluation.segments if s.scale is not None)
    indices = {k.index for k in results.keyframes if k.segment == segment}

    def depth_maps() -> Iterator[RunDepth]:
        for keyframe in read_keyframes(out, results.camera.size):
            if keyframe.index in indices:
                yield RunDepth(keyframe.index, keyframe.depth, keyframe.T_world_camera)

    surface = None
    if segment == results.segment:
        surface = next((out / name for name in (MESH_NAME, CLOUD_NAME) if (out / name).is_file()), None)
    poses = {k.index: k.T_world_camera for k in read_keyframes(out, results.camera.size) if k.index in indices}
    origin = np.zeros(3) if results.map is None else np.array(results.map.origin)
    return Reconstruction(out, depth_maps, surface, _alignment(poses, truth, evaluation.scale.factor), origin)


def imported_reconstruction(run: ImportedRun, truth: Truth, evaluation: Evaluation) -> Reconstruction:
    """The map of an imported run; frames without a pose are put where the true poses say."""

    def depth_maps() -> Iterator[RunDepth]:
        for frame in run.frames:
            yield RunDepth(frame.index, frame.read().depth, run.poses.get(frame.index))

    return Reconstruction(run.path, depth_maps, run.surface, _alignment(run.poses, truth, evaluation.scale.factor))


def measure_map(reconstruction: Reconstruction, truth: Truth, thresholds: tuple[float, ...] = THRESHOLDS) -> MapMetrics:
    """Accuracy and completeness of a run's surface; of its depth maps' points where it has no surface.

    The true surface is that of the true depth of at most 100 frames, spread evenly over the sequence, and so is the
    same for all methods. Both surfaces are points half the least threshold apart, or more if they were too many.
    Raises InputError where a threshold is below 0.1 mm, there is no true depth with a true pose, or no surface at all.
    """
    if not thresholds or not all(LEAST_THRESHOLD <= threshold < np.inf for threshold in thresholds):
        listed = ", ".join(f"{threshold:g}" for threshold in thresholds)
        raise InputError(f"map: thresholds must be lengths in metres from {LEAST_THRESHOLD:g} on, not {listed}")
    spacing = 0.5 * min(thresholds)
    surface, frames = _true_surface(truth, spacing)
    points, source = _surface_points(reconstruction, truth, spacing)
    return surface_metrics(points, surface.means(), thresholds, spacing=surface.size, source=source, frames=frames)


def measure_walls(reconstruction: Reconstruction, truth: Truth) -> WallMetrics:
    """The wall experiment on a run's depth maps; where the sequence has no true depth or poses, on its points.

    Raises InputError where there are no points.
    """
    frames = _true_frames(truth)
    if not frames or not any(True for _ in reconstruction.depth_maps()):
        points = VoxelMeans(_WALL_SPACING)
        points.add(_surface_points(reconstruction, truth, _WALL_SPACING)[0])
        return _in_true_world(walls_of_points(points.means()), truth)
    collector = WallCollector(_find_true_walls(truth, frames))
    camera = truth.camera
    poses = _true_poses(truth)
    scale = reconstruction.to_truth.scale
    for own in reconstruction.depth_maps():
        true = truth.image(own.index)
        if true is None or own.index not in poses:
            continue
        T = poses[own.index]
        placed = world_points(np.float32(scale) * own.depth, camera, T)
        points = placed if own.T_world_camera is None else _own_points(own, camera, reconstruction.to_truth)
        normals = true.normal.reshape(-1, 3) @ T[:3, :3].T
        collector.add(world_points(true.depth, camera, T), normals, points, placed)
    return _in_true_world(collector.metrics(), truth)


def world_points(depth: np.ndarray, camera: PinholeCamera, T_world_camera: np.ndarray) -> np.ndarray:
    """Every pixel as a point in the world, float64 N×3 row by row, NaN where depth is. depth: float H×W."""
    x, y = camera.normalized().reshape(-1, 2).astype(float).T
    z = depth.ravel().astype(float)
    points = np.empty((z.size, 3))
    for i, (a, b, c, t) in enumerate(T_world_camera[:3].tolist()):
        points[:, i] = z * (a * x + b * y + c) + t
    return points


def _own_points(own: RunDepth, camera: PinholeCamera, to_truth: Similarity) -> np.ndarray:
    return to_truth.apply(world_points(own.depth, camera, own.T_world_camera))


def _in_true_world(metrics: WallMetrics, truth: Truth) -> WallMetrics:
    """The same with the walls' planes as they are in the true world, not from its first pose."""
    origin = _true_origin(truth)
    walls = (replace(wall, offset=float(wall.offset + np.array(wall.normal) @ origin)) for wall in metrics.walls)
    return replace(metrics, walls=tuple(walls))


def _alignment(poses: dict[int, np.ndarray], truth: Truth, scale: float) -> Similarity:
    true_poses = _true_poses(truth)
    shared = [index for index in poses if index in true_poses]
    if not shared:
        return Similarity(scale, np.eye(3), -_true_origin(truth))
    return align_poses(np.array([poses[i] for i in shared]), np.array([true_poses[i] for i in shared]), scale)


def _true_origin(truth: Truth) -> np.ndarray:
    return np.zeros(3) if truth.trajectory is None else truth.trajectory.poses[0, :3, 3].copy()


def _true_poses(truth: Truth) -> dict[int, np.ndarray]:
    """By index of the frame, from the first one."""
    origin = _true_origin(truth)
    return {index: shifted(pose, -origin) for index, pose in truth.poses.items()}


def _true_frames(truth: Truth) -> list[tuple[int, np.ndarray]]:
    """(index, true pose) of the frames that make the true surface."""
    poses = _true_poses(truth)
    usable = [f.index for f in truth.frames if f.index in poses and f.depth is not None]
    places = np.unique(np.linspace(0, max(len(usable) - 1, 0), MOST_TRUE_FRAMES).round().astype(int)) if usable else []
    return [(usable[place], poses[usable[place]]) for place in places]


def _true_surface(truth: Truth, spacing: float) -> tuple[VoxelMeans, int]:
    frames = _true_frames(truth)
    if not frames:
        raise InputError(f"{truth.source}: no frame has both a true depth (depth/NAME.png) and a true pose")
    surface = VoxelMeans(spacing)
    for index, pose in frames:
        surface.add(world_points(truth.depth(index), truth.camera, pose))
    return surface, len(frames)


def _find_true_walls(truth: Truth, frames: list[tuple[int, np.ndarray]]) -> list[Plane]:
    surface = VoxelMeans(_WALL_SPACING, channels=6)
    for index, pose in frames:
        true = truth.image(index)
        points = world_points(true.depth, truth.camera, pose)[::_WALL_STRIDE]
        normals = true.normal.reshape(-1, 3)[::_WALL_STRIDE] @ pose[:3, :3].T
        surface.add(np.hstack([points, normals]))
    means = surface.means()
    length = np.linalg.norm(means[:, 3:], axis=1)
    flat = length > 0.9  # normals that agree within the cell
    return true_walls(means[flat, :3], means[flat, 3:] / length[flat, None])


def _surface_points(reconstruction: Reconstruction, truth: Truth, spacing: float) -> tuple[np.ndarray, str]:
    """Points of the reconstructed surface in the true world, and what they are from."""
    to_truth = reconstruction.to_truth
    if reconstruction.surface is not None:
        ply = read_ply(reconstruction.surface)
        points = to_truth.apply(_in_world(ply, reconstruction.origin))
        if len(ply.faces):
            return sample_triangles(points, ply.faces, spacing), reconstruction.surface.name
        cloud = VoxelMeans(spacing)
        cloud.add(points)
        return _some(cloud.means(), reconstruction), reconstruction.surface.name
    cloud, camera, poses = VoxelMeans(spacing), truth.camera, _true_poses(truth)
    for own in reconstruction.depth_maps():
        if own.T_world_camera is not None:
            cloud.add(_own_points(own, camera, to_truth))
        elif own.index in poses:
            cloud.add(world_points(np.float32(to_truth.scale) * own.depth, camera, poses[own.index]))
    return _some(cloud.means(), reconstruction), "depth maps"


def _in_world(ply: PlyFile, origin: np.ndarray) -> np.ndarray:
    """A surface's points in the run's world, also where another program has saved it without the comment on its offset.

    Then they are from the origin still if that is where they are nearer to.
    """
    finite = ply.points[np.isfinite(ply.points).all(axis=1)]
    if ply.offset.any() or not origin.any() or not len(finite):
        return ply.points
    middle = np.median(finite, axis=0)
    return ply.points + origin if np.linalg.norm(middle) < np.linalg.norm(middle - origin) else ply.points


def _some(points: np.ndarray, reconstruction: Reconstruction) -> np.ndarray:
    if not len(points):
        raise InputError(f"{reconstruction.source}: no points, neither a PLY nor depth with poses; nothing to measure")
    return points[:MAX_POINTS]
