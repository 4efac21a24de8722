"""Small keyframes, runs and sequences with known content, for the tests of what a run writes."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from polarmap.data.camera_file import CameraFile
from polarmap.data.keyframe import CueBeliefs, CueWeights, Keyframe, Stages
from polarmap.data.map import Map
from polarmap.data.mesh import Mesh, PointCloud
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import AngleDirection, SensorLayout
from polarmap.data.trajectory import Trajectory
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.formats.depth_png import write_depth_png
from polarmap.io.formats.images import write_image
from polarmap.io.formats.trajectory import write_trajectory
from polarmap.io.recording.camera_file import write_camera_file
from polarmap.io.recording.sequence import Sequence, open_sequence
from polarmap.pipeline.config import Config
from polarmap.report.run_writer import RunWriter

CAMERA = PinholeCamera(64, 48, 60.0, 60.0, 31.5, 23.5)
DEPTH_SCALE = 5000.0
PERIOD = 0.1  # seconds between frames


def pose_at(index: int, scale: float = 1.0) -> np.ndarray:
    """T_world_camera of a camera that moves along a bent path without turning."""
    T = np.eye(4)
    T[:3, 3] = scale * np.array([0.1 * index, 0.02 * index**2, 0.3 * (index % 2)])
    return T


def true_depth(index: int) -> np.ndarray:
    """A slanted plane about 2 m away, a little farther in each frame, with no truth in the first two columns."""
    depth = 2.0 + 0.1 * index + 0.4 * CAMERA.normalized()[..., 0]
    depth[:, :2] = np.nan
    return depth.astype(np.float32)


def sample_image() -> PolarizationImage:
    rng = np.random.default_rng(0)
    values = [rng.random(CAMERA.shape, np.float32) for _ in range(5)]
    none = np.zeros(CAMERA.shape, bool)
    return PolarizationImage(*values, none, none)


def sample_keyframe(index: int, depth: np.ndarray, **changes) -> Keyframe:
    """A keyframe whose upper rows are stereo, the middle ones propagated, and the lower ones estimated."""
    known = np.isfinite(depth)
    origin = np.repeat(np.array([1, 2, 3], np.uint8), 16)[:, None] * known.astype(np.uint8)
    stereo = np.where(origin == 1, depth, np.float32(np.nan))
    values = {
        "index": index,
        "timestamp": index * PERIOD,
        "T_world_camera": pose_at(index),
        "camera": CAMERA,
        "image": sample_image(),
        "depth": depth,
        "normal": np.broadcast_to(np.float32([0, 0, -1]), (*CAMERA.shape, 3)).copy(),
        "azimuth": np.full(CAMERA.shape, 0.5, np.float32),
        "zenith": np.full(CAMERA.shape, np.nan, np.float32),
        "label": np.full(CAMERA.shape, 2, np.uint8),
        "origin": origin.astype(np.uint8),
        "confidence": (known / np.maximum(origin, 1)).astype(np.float32),
        "sigma": (0.01 * depth).astype(np.float32),
        "stages": Stages(1.1 * stereo, stereo, depth),
        "prior_verdict": "sparse: <b>interpolated</b> & good",
        "beliefs": CueBeliefs(diffuse=CueWeights(0.5, 0.25), surfaces=0.3),
        "milliseconds": {"stereo": 100.0 + index, "densify": 50.0},
    }
    return Keyframe(**(values | changes))


def sample_map() -> Map:
    """A square of two triangles that faces the cameras."""
    vertices = np.float32([[-1, -1, 2], [1, -1, 2], [1, 1, 2], [-1, 1, 2]])
    faces = np.int32([[0, 3, 2], [0, 2, 1]])
    normals = np.tile(np.float32([0, 0, -1]), (4, 1))
    grey = np.full(4, 0.5, np.float32)
    return Map(
        mesh=Mesh(vertices, faces, normals, grey),
        cloud=PointCloud(vertices, normals, grey),
        frames=2,
        posed=2,
        keyframes=2,
        voxel_size=0.01,
        blocks=7,
        milliseconds={"stereo": 201.0, "densify": 100.0, "mesh": 12.0},
    )


def write_run(out: Path, keyframes: list[Keyframe], scale: float = 1.0, **options) -> Path:
    """A complete run of these keyframes, the camera's path being `scale` times the true one."""
    with RunWriter(out, Config(), CAMERA, **options) as writer:
        for keyframe in keyframes:
            writer.add_frame(keyframe.timestamp, pose_at(keyframe.index, scale))
            writer.add_keyframe(keyframe)
        writer.add_map(sample_map())
    return out


def write_sequence(folder: Path, count: int = 4, depth: bool = True, poses: bool = True) -> Sequence:
    """A sequence with `true_depth` and `pose_at` as its truth, or without."""
    for name in ("raw", "depth"):
        (folder / name).mkdir(parents=True)
    write_camera_file(
        folder / "camera.yaml",
        CameraFile(CAMERA, SensorLayout.SONY_POLARSENS, AngleDirection.CLOCKWISE, 8, depth_scale=DEPTH_SCALE),
    )
    times = PERIOD * np.arange(count)
    (folder / "timestamps.txt").write_text("".join(f"{t!r}\n" for t in times.tolist()))
    for i in range(count):
        write_image(folder / "raw" / f"{i:06d}.png", np.full((2 * CAMERA.height, 2 * CAMERA.width), 100, np.uint8))
        if depth:
            write_depth_png(folder / "depth" / f"{i:06d}.png", true_depth(i), DEPTH_SCALE)
    if poses:
        write_trajectory(folder / "groundtruth.txt", Trajectory(times, np.array([pose_at(i) for i in range(count)])))
    return open_sequence(folder)
