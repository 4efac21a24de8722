"""A finished run in a room whose geometry is a formula, for the tests of exports."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache
from pathlib import Path

import numpy as np
from run_samples import sample_image, sample_keyframe, sample_map, true_depth

from polarmap.data.keyframe import Keyframe
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import look_at
from polarmap.pipeline.config import Config
from polarmap.report.run_writer import RunWriter
from polarmap.synth import Box, Material, Rectangle, Scene, render
from polarmap.synth.scenes.placement import pose

CAMERA = PinholeCamera(120, 90, 60.0, 61.0, 58.5, 45.0)
HALF = np.array([2.0, 1.5])  # of the floor's sides; its centre is the origin, z is up
HEIGHT = 2.4
PILLAR_CENTRE, PILLAR_HALF = np.array([0.9, 0.3, 0.5]), np.array([0.2, 0.25, 0.5])
FAR = np.array([451_200.0, 5_212_300.0, 500.0])
SIGMA = 0.004  # share of the depth


def to_surface(points: np.ndarray) -> np.ndarray:
    """From points N×3 inside the room to the nearest wall, floor, ceiling or side of the pillar."""
    walls = (HALF - np.abs(points[:, :2])).min(axis=1)
    level = np.minimum(points[:, 2], HEIGHT - points[:, 2])
    outside = np.maximum(np.abs(points - PILLAR_CENTRE) - PILLAR_HALF, 0.0)
    return np.minimum(np.minimum(walls, level), np.linalg.norm(outside, axis=1))


def in_pillar(points: np.ndarray) -> np.ndarray:
    return (np.abs(points - PILLAR_CENTRE) < PILLAR_HALF).all(axis=1)


def room_keyframes() -> list[Keyframe]:
    """From four places in the room, in ten directions each; every surface is seen."""
    return [
        replace(
            sample_keyframe(10 * i, true_depth(0)),
            depth=rendering.depth,
            T_world_camera=T,
            camera=CAMERA,
            image=replace(_image(), intensity=np.clip(rendering.stokes[0] / 2.0, 0, 1)),
            normal=rendering.normal,
            label=np.full(CAMERA.shape, 1 + i % 2, np.uint8),
            azimuth=np.full(CAMERA.shape, 0.5, np.float32),
            zenith=np.full(CAMERA.shape, np.nan, np.float32),
            origin=np.ones(CAMERA.shape, np.uint8),
            sigma=np.full(CAMERA.shape, SIGMA, np.float32),
            confidence=np.full(CAMERA.shape, 1 / (1 + SIGMA / 0.01), np.float32),
        )
        for i, (T, rendering) in enumerate(_views())
    ]


def write_room(out: Path, shift: np.ndarray | None = None, finished: bool = True, most: int = 100, **options) -> Path:
    """A run of the room's first keyframes. shift: of the world. finished: whether it came to its map."""
    shift = np.zeros(3) if shift is None else shift
    with RunWriter(out, Config(), CAMERA, **options) as writer:
        for keyframe in room_keyframes()[:most]:
            T = keyframe.T_world_camera.copy()
            T[:3, 3] += shift
            writer.add_frame(keyframe.timestamp, T)
            writer.add_keyframe(replace(keyframe, T_world_camera=T))
        if finished:
            writer.add_map(replace(sample_map(), origin=shift))
    return out


def _image():
    image = sample_image()
    size = (CAMERA.height, CAMERA.width)
    changes = {name: np.zeros(size, np.asarray(value).dtype) for name, value in vars(image).items()}
    return replace(image, **changes)


@lru_cache
def _views() -> list[tuple]:
    plain = Material("plain", albedo=0.5)
    x, y = HALF
    scene = Scene(
        (
            Rectangle(plain, pose((0.0, 0.0, 0.0)), width=2 * x, height=2 * y),
            Rectangle(plain, pose((0.0, 0.0, HEIGHT), (0.0, 0.0, -1.0)), width=2 * x, height=2 * y),
            Rectangle(plain, pose((0.0, y, HEIGHT / 2), (0.0, -1.0, 0.0)), width=2 * x, height=HEIGHT),
            Rectangle(plain, pose((0.0, -y, HEIGHT / 2), (0.0, 1.0, 0.0)), width=2 * x, height=HEIGHT),
            Rectangle(plain, pose((x, 0.0, HEIGHT / 2), (-1.0, 0.0, 0.0)), width=2 * y, height=HEIGHT),
            Rectangle(plain, pose((-x, 0.0, HEIGHT / 2), (1.0, 0.0, 0.0)), width=2 * y, height=HEIGHT),
            Box(plain, pose(tuple(PILLAR_CENTRE)), size=tuple(2 * PILLAR_HALF)),
        ),
        (),
        surround=1.0,
    )
    views = []
    for place in ((-1.0, -0.8, 1.2), (1.6, -1.1, 1.5), (1.5, 1.2, 1.3), (-1.4, 1.0, 1.1)):
        eye = np.array(place)
        for turn in np.radians([0.0, 60.0, 120.0, 180.0, 240.0, 300.0]):
            for rise in (-0.35, 0.0, 0.35) if turn in (0.0, np.pi) else (-0.35,):
                T = look_at(eye, eye + np.array([np.cos(turn), np.sin(turn), rise]))
                views.append((T, render(scene, CAMERA, T)))
    return views
