"""Random cameras in a scene, and the samples that they take. The same seed gives the same sample."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import look_at
from polarmap.synth import render
from training.materials import Materials, photographs
from training.rooms import Place, corridor, is_inside, islands, room
from training.streets import street

WIDTH, HEIGHT = 256, 192
VIEWS = 6  # of each scene
_KINDS = ((room, 0.38), (islands, 0.4), (corridor, 0.12), (street, 0.1))
_TRIALS = 40
_UNDER_CEILING = 0.35  # share of the eyes
_NEAREST = 0.12  # metres; what is nearer to the eye than this hides the scene

SAMPLE = np.dtype(
    [
        ("stokes", np.float16, (3, HEIGHT, WIDTH)),  # radiance
        ("depth", np.float16, (HEIGHT, WIDTH)),  # metres; infinite where nothing is hit
        ("normal", np.int8, (3, HEIGHT, WIDTH)),  # times 127
        ("reflection", np.uint8, (HEIGHT, WIDTH)),
        ("camera", np.float32, (4,)),  # fx, fy, cx, cy
    ]
)


def samples(seed: int) -> Iterator[np.ndarray]:
    """Without end, records of the dtype SAMPLE: `VIEWS` views of each scene."""
    images = photographs()
    number = 0
    while True:
        rng = np.random.default_rng([seed, number])
        place = random_place(rng, images)
        for _ in range(VIEWS):
            sample = _sample(place, rng)
            if sample is not None:
                yield sample
        number += 1


def random_place(rng: np.random.Generator, images: np.ndarray) -> Place:
    """A scene of a random kind."""
    kinds, shares = zip(*_KINDS, strict=True)
    return kinds[rng.choice(len(kinds), p=shares)](Materials(rng, len(images)), images)


def _sample(place: Place, rng: np.random.Generator) -> np.ndarray | None:
    for _ in range(_TRIALS):
        camera, T = random_camera(rng), _random_pose(place, rng)
        if T is not None and _is_worth_it(render(place.scene, camera.scaled(1 / 8), T).depth):
            return _record(place, camera, T)
    return None


def random_camera(rng: np.random.Generator) -> PinholeCamera:
    """45 to 95 degrees wide; the principal point a little off the middle, as in a crop."""
    f = WIDTH / 2 / np.tan(np.radians(rng.uniform(45, 95)) / 2)
    off = rng.normal(0.0, 0.03, 2) if rng.random() < 0.5 else (0.0, 0.0)
    return PinholeCamera(WIDTH, HEIGHT, f, f, (WIDTH - 1) / 2 + off[0] * WIDTH, (HEIGHT - 1) / 2 + off[1] * WIDTH)


def _random_pose(place: Place, rng: np.random.Generator) -> np.ndarray | None:
    """T_world_camera of a hand-held camera somewhere in the place, or None where it would stand in a wall."""
    mode = rng.random()
    focus = place.focuses[rng.integers(len(place.focuses))]
    if mode < 0.25:  # near something
        away = rng.normal(0, 1, 3) * (1, 1, 0.4) + (0, 0, 0.35)
        eye = focus + away / np.linalg.norm(away) * rng.uniform(0.4, 1.8)
        target = focus + rng.normal(0, 0.15, 3)
    else:
        low, high = place.plan.min(axis=0), place.plan.max(axis=0)
        eye = np.array([*rng.uniform(low, high), _eye_height(place, rng)])
        target = focus + rng.normal(0, 0.3, 3) if mode < 0.6 else eye + _direction(rng, up=mode > 0.85)
    if not (is_inside(place.plan, eye[:2], 0.15) and 0.1 < eye[2] < place.height):
        return None
    if np.linalg.norm(np.cross(target - eye, (0, 0, 1))) < 1e-2:
        return None
    roll = rng.normal(0, np.radians(3)) if rng.random() < 0.75 else rng.uniform(-np.radians(20), np.radians(20))
    return look_at(tuple(eye), tuple(target), (0.0, 0.0, 1.0)) @ _rolled(roll)


def _eye_height(place: Place, rng: np.random.Generator) -> float:
    """Hand-held, or close under the ceiling, as from a shelf, a stair or a drone."""
    if rng.random() < _UNDER_CEILING:
        return place.height - rng.uniform(0.15, 1.0)
    return rng.uniform(0.3, 2.2)


def _direction(rng: np.random.Generator, up: bool) -> np.ndarray:
    yaw = rng.uniform(-np.pi, np.pi)
    pitch = np.radians(rng.uniform(5, 55) if up else rng.normal(-8, 16))
    return np.array([np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)])


def _rolled(angle: float) -> np.ndarray:
    T = np.eye(4)
    T[:2, :2] = [[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]
    return T


def _is_worth_it(depth: np.ndarray) -> bool:
    """Whether a view shows a scene: mostly surfaces, none in the face, and not one plane seen from the front."""
    near = np.where(np.isfinite(depth), depth, np.inf)
    if np.isinf(near).mean() > 0.6 or (near < _NEAREST).mean() > 0.01 or np.median(near) < 0.35:
        return False
    low, high = np.quantile(1.0 / near, [0.05, 0.95])
    return bool(high > 1.2 * low)


def _record(place: Place, camera: PinholeCamera, T: np.ndarray) -> np.ndarray:
    rendering = render(place.scene, camera, T)
    sample = np.zeros((), SAMPLE)
    sample["stokes"] = np.minimum(rendering.stokes, 6e4)
    sample["depth"] = np.where(np.isfinite(rendering.depth), np.minimum(rendering.depth, 6e4), np.inf)
    sample["normal"] = np.rint(127 * np.nan_to_num(rendering.normal)).transpose(2, 0, 1)
    sample["reflection"] = rendering.reflection
    sample["camera"] = (camera.fx, camera.fy, camera.cx, camera.cy)
    return sample
