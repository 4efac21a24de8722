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
from types import ModuleType
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from polarmap.fusion.volume import TsdfVolume
from polarmap.fusion.voxel_size import choose_voxel_size
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.camera_file import read_camera_file
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
    console.print(f"{len(frames)} depth maps, voxels of {1e3 * voxel_size:.1f} mm, truncation 5 voxels")
    results = [run_polarmap(frames, voxel_size)]
    try:
        results.append(run_open3d(frames, voxel_size))
    except ImportError as error:
        console.print(f"Open3D left out: {error}")
    console.print(comparison_table(results))
    if len(results) == 2:
        console.print(agreement_table(*results, voxel_size))
    console.print(scaling_table())


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


class Result(NamedTuple):
    """One library's row of the table, times in milliseconds; and its mesh."""

    name: str
    integrate: float
    remove: float | None
    extract: float
    blocks: str
    vertices: np.ndarray
    faces: np.ndarray


def run_polarmap(frames: list[DepthMap], voxel_size: float) -> Result:
    integrate, remove = [], []
    for _ in range(ROUNDS):
        volume = TsdfVolume(voxel_size)
        integrate.append([milliseconds(volume.integrate, *frame, n) for n, frame in enumerate(frames)])
        blocks = f"{volume.block_count} of 8³"
        extract = min(milliseconds(volume.mesh) for _ in range(ROUNDS))
        mesh = volume.mesh()
        remove.append([milliseconds(volume.remove, *frame, n) for n, frame in enumerate(frames)])
    return Result("polarmap", typical(integrate), typical(remove), extract, blocks, mesh.vertices, mesh.faces)


def run_open3d(frames: list[DepthMap], voxel_size: float) -> Result:
    import open3d

    inputs = [open3d_input(open3d, frame) for frame in frames]
    kind = open3d.pipelines.integration.TSDFVolumeColorType.Gray32
    integrate = []
    for _ in range(ROUNDS):
        volume = open3d.pipelines.integration.ScalableTSDFVolume(voxel_size, 5.0 * voxel_size, kind)
        integrate.append([milliseconds(volume.integrate, *arguments) for arguments in inputs])
    extract = min(milliseconds(volume.extract_triangle_mesh) for _ in range(ROUNDS))
    mesh = volume.extract_triangle_mesh()
    vertices, faces = np.asarray(mesh.vertices), np.asarray(mesh.triangles)
    return Result(f"Open3D {open3d.__version__}", typical(integrate), None, extract, "", vertices, faces)


def open3d_input(open3d: ModuleType, frame: DepthMap) -> tuple:
    image, camera = open3d.geometry.Image, frame.camera
    rgbd = open3d.geometry.RGBDImage.create_from_color_and_depth(
        image(np.ascontiguousarray(frame.grey)),
        image(np.ascontiguousarray(np.nan_to_num(frame.depth))),
        depth_scale=1.0,
        depth_trunc=1e3,
        convert_rgb_to_intensity=False,
    )
    intrinsics = (camera.width, camera.height, camera.fx, camera.fy, camera.cx, camera.cy)
    return rgbd, open3d.camera.PinholeCameraIntrinsic(*intrinsics), inverse(frame.T_world_camera)


def comparison_table(results: list[Result]) -> Table:
    table = Table(title=f"milliseconds: median over the depth maps of the least of {ROUNDS} runs")
    for heading in ("", "integrate", "remove", "mesh", "blocks", "triangles"):
        table.add_column(heading, justify="right" if heading else "left")
    for r in results:
        remove = "-" if r.remove is None else f"{r.remove:.1f}"
        table.add_row(r.name, f"{r.integrate:.1f}", remove, f"{r.extract:.1f}", r.blocks, str(len(r.faces)))
    return table


def agreement_table(a: Result, b: Result, voxel_size: float) -> Table:
    table = Table(title="distance of the vertices to the other's surface, in voxels")
    for heading in ("from", "to", "median", "mean", "95 %"):
        table.add_column(heading, justify="left" if heading in ("from", "to") else "right")
    for source, target in ((a, b), (b, a)):
        d = distances(source.vertices, target) / voxel_size
        table.add_row(source.name, target.name, *(f"{x:.4f}" for x in (np.median(d), d.mean(), np.quantile(d, 0.95))))
    return table


def distances(points: np.ndarray, surface: Result) -> np.ndarray:
    import open3d

    scene = open3d.t.geometry.RaycastingScene()
    tensor = open3d.core.Tensor
    scene.add_triangles(tensor(surface.vertices.astype(np.float32)), tensor(surface.faces.astype(np.uint32)))
    return scene.compute_distance(tensor(points.astype(np.float32))).numpy()


def scaling_table() -> Table:
    table = Table(title="built-in room, voxels of 20 mm, milliseconds per depth map")
    for heading in ("image", "integrate", "microseconds per 1000 pixels"):
        table.add_column(heading, justify="right")
    for width, height in SIZES:
        time_taken = run_polarmap(list(rendered(width, height, count=4)), 0.02).integrate
        table.add_row(f"{width}x{height}", f"{time_taken:.1f}", f"{1e6 * time_taken / (width * height):.0f}")
    return table


def typical(rounds: list[list[float]]) -> float:
    return float(np.median(np.min(rounds, axis=0)))


def milliseconds(call: Callable, *arguments: object) -> float:
    start = time.perf_counter()
    call(*arguments)
    return 1e3 * (time.perf_counter() - start)


if __name__ == "__main__":
    os.environ.setdefault("OMP_WAIT_POLICY", "passive")  # or Open3D's idle threads spin beside the other's
    main()
