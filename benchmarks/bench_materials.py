"""What knowing materials is worth: zenith error with one refractive index, with estimated ones, and with metals.

Without PATH the built-in scenes are rendered at 640x480 with sensor noise, three views each. Normals are those of the
true depth with 0.2 % of noise, by planes over 9x9 pixels, off by 1 to 2.5 degrees (median): better than stereo's. Rows
that are `mapped` take normals and points of the mapper's keyframes, of short recordings of a matte sphere and plane. So
do those of PATH, a recording with true depth and poses. Errors are means over all pixels with a cue, in degrees.
`false` is the share of all pixels that are labelled metal and are not; of a recording all that are labelled so.

    python benchmarks/bench_materials.py [PATH [FRAMES]]
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from itertools import islice
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import NamedTuple

import numpy as np
from rich.console import Console
from rich.table import Table

from polarmap.data.codes import Reflection
from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.sensor import SensorNoise
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import normals_from_depth, zenith_of
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import open_sequence
from polarmap.materials.estimate import estimate_materials
from polarmap.pipeline.mapper import Mapper
from polarmap.polarization.cues import disambiguate
from polarmap.sensing.stokes import polarization_image
from polarmap.synth import (
    DEFAULT_CAMERA,
    Material,
    Pattern,
    Scene,
    Sensor,
    Texture,
    built_in_scene,
    render,
    render_sequence,
    scenes,
)
from polarmap.synth.recording import write_sequence

NAMES = ("metals", "bare-room", "corridor", "table", "street", "room")
VIEWS = (0, 40, 80)  # frames of a path of 120
DEPTH_NOISE = 0.002
INDICES = (1.33, 1.5, 1.8)
ANGLES = np.radians([0.0, 45.0, 90.0, 135.0])[:, None, None]


class View(NamedTuple):
    """What is seen, normals and where they are measured (None: everywhere), true depth, and which pixels are metal."""

    camera: PinholeCamera
    image: PolarizationImage
    normals: np.ndarray
    known: np.ndarray | None
    depth: np.ndarray
    is_metal: np.ndarray


def main() -> None:
    sources = {name: built_in_views(name) for name in NAMES}
    if len(sys.argv) > 1:
        frames = int(sys.argv[2]) if len(sys.argv) > 2 else None
        sources = {Path(sys.argv[1]).name: recorded_views(Path(sys.argv[1]), frames)}
    else:
        sources |= {f"matte, η {eta}": surface_views(eta) for eta in INDICES}
        sources |= {f"matte, mapped, η {eta}": mapped_views(eta) for eta in INDICES}
    table = Table(title="zenith error in degrees")
    for heading in ("views", "η 1.5", "η estimated", "and metals", "metals found", "false", "milliseconds"):
        table.add_column(heading, justify="left" if heading == "views" else "right")
    for name, views in sources.items():
        rows = np.array([measure(view) for view in views])
        errors, found, false, milliseconds = rows[:, :3].mean(axis=0), *rows[:, 3:].mean(axis=0)
        cells = [*(f"{error:.2f}" for error in errors), f"{found:.1%}", f"{false:.3%}", f"{milliseconds:.1f}"]
        table.add_row(name, *cells)
    Console().print(table)


def measure(view: View) -> list[float]:
    """Three zenith errors, shares of metal pixels found and of others labelled so, and milliseconds of the estimate."""
    arguments = (view.image, view.normals, view.camera)
    materials = estimate_materials(*arguments, known=view.known)
    truth = zenith_of(normals_from_depth(view.depth, view.camera, radius=2), view.camera)
    chosen = ((None, None), (materials.eta, None), (materials.eta, materials.metal))
    cues = [disambiguate(*arguments, eta=eta, metal=metal) for eta, metal in chosen]
    labelled = cues[-1].label == Reflection.METAL
    errors = [float(np.degrees(np.nanmean(np.abs(c.zenith - truth)))) for c in cues]
    found = float(labelled[view.is_metal].mean()) if view.is_metal.any() else 0.0
    times = []
    for _ in range(5):
        start = time.perf_counter()
        estimate_materials(*arguments, known=view.known)
        times.append(1e3 * (time.perf_counter() - start))
    return [*errors, found, float((labelled & ~view.is_metal).mean()), min(times)]


def built_in_views(name: str) -> Iterator[View]:
    built_in = built_in_scene(name)
    _, poses = built_in.path(frames=120)
    for view in VIEWS:
        yield rendered(built_in.scene, poses[view])


def surface_views(eta: float) -> Iterator[View]:
    """A sphere, a cylinder and a plane with a texture, without gloss."""
    for shape in (scenes.sphere, scenes.cylinder, scenes.plane):
        yield rendered(shape(paper(eta)), np.eye(4))


def mapped_views(eta: float) -> Iterator[View]:
    for name, shape in (("sphere", scenes.sphere), ("plane", scenes.plane)):
        timestamps, poses = built_in_scene(name).path(frames=8)
        sensor = Sensor(seed=1)
        frames = render_sequence(shape(paper(eta)), DEFAULT_CAMERA, timestamps, poses, sensor)
        with TemporaryDirectory() as folder:
            write_sequence(Path(folder) / name, frames, DEFAULT_CAMERA, sensor)
            yield from recorded_views(Path(folder) / name, None)


def paper(eta: float) -> Material:
    return Material("paper", 0.45, Texture(Pattern.NOISE, 0.2, 0.9, octaves=3, seed=1), eta=eta, gloss=0.0)


def rendered(scene: Scene, pose: np.ndarray) -> View:
    view = render(scene, DEFAULT_CAMERA, pose, supersample=2)
    metals = [i for i, material in enumerate(scene.materials) if material.is_metal]
    noise = 1.0 + DEPTH_NOISE * np.random.default_rng(0).standard_normal(view.depth.shape)
    normals = normals_from_depth((view.depth * noise).astype(np.float32), DEFAULT_CAMERA, radius=4)
    return View(DEFAULT_CAMERA, seen(view.stokes), normals, None, view.depth, np.isin(view.material, metals))


def seen(stokes: np.ndarray) -> PolarizationImage:
    """By four polarizers with sensor noise, exposed so that 97 % of the pixels are below 0.9 of the scale."""
    noise = SensorNoise()
    s0, s1, s2 = stokes * (0.9 / np.percentile(stokes[0], 97))
    channels = np.clip(0.5 * (s0 + s1 * np.cos(2 * ANGLES) + s2 * np.sin(2 * ANGLES)), 0.0, 1.0)
    sigma = np.sqrt(noise.variance(channels))
    channels = channels + sigma * np.random.default_rng(1).standard_normal(channels.shape)
    return polarization_image(channels.astype(np.float32), noise)


def recorded_views(path: Path, frames: int | None) -> Iterator[View]:
    """The keyframes of a run with true poses."""
    sequence = open_sequence(path)
    keyframes = []
    mapper = Mapper(sequence.camera_file, read_trajectory(path / "groundtruth.txt"), on_keyframe=keyframes.append)
    for frame in islice(sequence, frames):
        mapper.process(frame)
    mapper.finish()
    for k in keyframes:
        depth = read_depth_png(path / "depth" / f"{k.index:06d}.png", sequence.camera_file.depth_scale)
        normals, known = normals_from_depth(k.depth, k.camera), np.isfinite(k.stages.inliers)
        yield View(k.camera, k.image, normals, known, depth, np.zeros(depth.shape, bool))


if __name__ == "__main__":
    main()
