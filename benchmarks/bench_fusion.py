"""Time of fusion, and agreement with Open3D's ScalableTSDFVolume where that is installed.

Both get the same depth maps, uniform weights, voxel size and truncation; their voxels lie on the same grid. Agreement
is the exact distance from each vertex of one mesh to the other mesh. Open3D is a peer, not a dependency: install it
into an environment of its own (0.19; the volume of 0.20.0 stays empty) together with this package, and run this
script there. Without --data, the depth maps are renders of the built-in room.

    python benchmarks/bench_fusion.py [--data SEQUENCE] [--every 4] [--voxel-size METRES]
"""

from __future__ import annotations

import argparse
import os
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from polarmap.fusion import Mesh, TsdfVolume, choose_voxel_size
from polarmap.geometry import PinholeCamera
from polarmap.io.camera_file import read_camera_file
from polarmap.io.depth_png import read_depth_png
from polarmap.io.trajectory import read_trajectory
from polarmap.synth.scenes import built_in_scene
from polarmap.synth.shading import render

SIZES = ((320, 240), (640, 480), (1224, 1024))
ROUNDS = 5


class DepthMap(NamedTuple):
    """The arguments of `TsdfVolume.integrate` up to the name of the frame."""

    depth: np.ndarray
    grey: np.ndarray
    confidence: np.ndarray | None
    camera: PinholeCamera
    T_world_camera: np.ndarray


def main() -> None:
    arguments = parse_arguments()
    frames = list(recorded(arguments.data, arguments.every) if arguments.data else rendered(640, 480))
    voxel_size = arguments.voxel_size or choose_voxel_size(frames[0].depth, frames[0].camera)
    console = Console()
    console.print(f"{len(frames)} depth maps, voxels of {1e3 * voxel_size:.1f} mm, milliseconds (least of {ROUNDS})")
    table = Table("", "integrate", "remove", "mesh", "blocks", "MB", "triangles")
    ours = polarmap_row(table, frames, voxel_size)
    try:
        theirs = open3d_row(table, frames, voxel_size)
    except ImportError as error:
        theirs = None
        console.print(f"Open3D is left out: {error}")
    console.print(table)
    if theirs is not None:
        print_agreement(console, ours, theirs, voxel_size)
    print_scaling(console, voxel_size)


def parse_arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--data", type=Path, help="folder with camera.yaml, groundtruth.txt and depth/*.png")
    parser.add_argument("--every", type=int, default=4, help="use every n-th depth map")
    parser.add_argument("--voxel-size", type=float, help="metres; by default chosen from the depth")
    return parser.parse_args()


def recorded(path: Path, every: int) -> Iterator[DepthMap]:
    camera_file = read_camera_file(path / "camera.yaml")
    poses = read_trajectory(path / "groundtruth.txt").poses
    names = sorted((path / "depth").glob("*.png"))
    for name, pose in list(zip(names, poses, strict=True))[::every]:
        depth = read_depth_png(name, camera_file.depth_scale)
        yield DepthMap(depth, np.zeros_like(depth), None, camera_file.camera, pose)


def rendered(width: int, height: int, count: int = 12) -> Iterator[DepthMap]:
    camera = PinholeCamera(width, height, 0.75 * width, 0.75 * width, (width - 1) / 2, (height - 1) / 2)
    room = built_in_scene("room")
    for pose in room.path(frames=count, step=0.1)[1]:
        view = render(room.scene, camera, pose)
        yield DepthMap(view.depth, np.minimum(view.stokes[0], 1.0), None, camera, pose)


def polarmap_row(table: Table, frames: list[DepthMap], voxel_size: float) -> Mesh:
    volume = TsdfVolume(voxel_size)
    integrate, remove = [], []
    for _ in range(ROUNDS):
        integrate.append([milliseconds(lambda: volume.integrate(*f, n))[0] for n, f in enumerate(frames)])  # noqa: B023
        count, size = volume.block_count, volume.bytes
        mesh_time, mesh = milliseconds(volume.mesh)
        remove.append([milliseconds(lambda: volume.remove(*f, n))[0] for n, f in enumerate(frames)])  # noqa: B023
    for n, frame in enumerate(frames):
        volume.integrate(*frame, n)
    mesh_time = min(milliseconds(volume.mesh)[0] for _ in range(ROUNDS))
    times = [np.median(np.min(t, axis=0)) for t in (integrate, remove)]
    table.add_row(
        "polarmap",
        *(f"{t:.1f}" for t in (*times, mesh_time)),
        f"{count} of 8³",
        f"{size / 1e6:.0f}",
        str(len(mesh.faces)),
    )
    return mesh
