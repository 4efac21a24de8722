"""Every numeric option at its least and at its greatest value, one at a time, on a tiny recording.

    python tests/option_walk.py [section.name ...]

runs them all, or those named, and prints one line for each; `make options` does.
"""

from __future__ import annotations

import math
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Annotated, Any, get_args, get_origin

import numpy as np
from pydantic.fields import FieldInfo

from polarmap.data.frame import Frame
from polarmap.data.keyframe import Keyframe
from polarmap.errors import PolarmapError
from polarmap.geometry.camera import PinholeCamera
from polarmap.odometry.odometry import Odometry
from polarmap.options import Options
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.sensing.front_end import FrontEnd
from polarmap.synth import Sensor, SynthFrame, built_in_scene, render_sequence
from polarmap.synth.recording import camera_file

SENSOR = Sensor(bit_depth=12, seed=1)
KEYFRAMES = 4


@dataclass(frozen=True)
class Extreme:
    """One option at one end of its range."""

    section: str
    name: str
    value: Any

    def __str__(self) -> str:
        return f"{self.section}.{self.name}={self.value}"

    def config(self) -> Config:
        """The defaults with this value; the options of the paper's loop with that loop."""
        settings = {self.name: self.value, **_with(self.section, self.name, self.value)}
        return Config.from_mapping({self.section: settings}, str(self))


def _with(section: str, name: str, value: Any) -> dict[str, Any]:
    if section == "densify":
        return {"method": "paper"}
    if name in ("sweeps", "trials"):  # one number for each level
        other = "trials" if name == "sweeps" else "sweeps"
        return {other: (1,) * len(value)}
    return {}


def extremes() -> Iterator[Extreme]:
    """Both ends of every numeric option of a run."""
    for section, part in Config.model_fields.items():
        for name, field in part.annotation.model_fields.items():
            if is_numeric(field):
                for value in ends(field):
                    yield Extreme(section, name, value)


def is_numeric(field: FieldInfo) -> bool:
    """Whether an option holds a number, or numbers."""
    return any(kind in (int, float) for kind in _kinds(field.annotation))


def ends(field: FieldInfo) -> tuple[Any, Any]:
    """The least and the greatest value; infinite where there is no bound."""
    annotation, item = field.annotation, None
    for part in (annotation, *get_args(annotation)):  # of a tuple, or of what may be a tuple or None
        if found := [a for a in get_args(part) if get_origin(a) is Annotated]:
            annotation, item = part, found[0]
            break
    if item is None:
        return _bounds(field.metadata, int in _kinds(field.annotation))
    inner = [m for extra in get_args(item)[1:] for m in getattr(extra, "metadata", [])]
    low, high = _bounds(inner, int in _kinds(item))
    if get_origin(annotation) is not tuple:
        return low, high
    if Ellipsis in get_args(annotation):
        return (low,) * _limit(field.metadata, "min_length", 0), (high,) * _limit(
            field.metadata, "max_length", math.inf
        )
    count = len(get_args(annotation))
    return (low,) * count, (high,) * count


def _bounds(metadata: list, whole: bool) -> tuple[Any, Any]:
    low, high = _limit(metadata, "ge", -math.inf), _limit(metadata, "le", math.inf)
    above, below = _limit(metadata, "gt", -math.inf), _limit(metadata, "lt", math.inf)
    low = max(low, above + 1 if whole else np.nextafter(above, math.inf)) if math.isfinite(above) else low
    high = min(high, below - 1 if whole else np.nextafter(below, -math.inf)) if math.isfinite(below) else high
    return low, high


def _limit(metadata: list, name: str, default: Any) -> Any:
    return next((getattr(m, name) for m in metadata if getattr(m, name, None) is not None), default)


def _kinds(annotation: Any) -> set[type]:
    """The plain types in an annotation, however deep."""
    if isinstance(annotation, type) and not get_args(annotation):
        return {annotation}
    return set().union(*(_kinds(part) for part in get_args(annotation))) if get_args(annotation) else set()


def all_options() -> list[type[Options]]:
    """Every class of options in the package but the sum of them."""
    import polarmap.odometry.start.two_view
    import polarmap.prior.network_spec  # noqa: F401 (these are not part of a run's configuration)

    return [kind for kind in Options.__subclasses__() if kind.__module__.startswith("polarmap.") and kind is not Config]


@lru_cache
def recording(width: int, height: int, count: int, step: float) -> tuple[PinholeCamera, list[SynthFrame]]:
    """Frames of the room seen by a small camera."""
    camera = PinholeCamera(width, height, 0.75 * width, 0.75 * width, (width - 1) / 2, (height - 1) / 2)
    room = built_in_scene("room")
    return camera, list(render_sequence(room.scene, camera, *room.path(frames=count, step=step), SENSOR, supersample=1))


def map_tiny(config: Config) -> list[Keyframe]:
    """Map a few frames of 64×48, each a keyframe if the options let it; the mesh is checked too."""
    camera, frames = recording(64, 48, KEYFRAMES, 0.15)
    poses = {frame.timestamp: frame.T_world_camera for frame in frames}
    done: list[Keyframe] = []
    mapper = Mapper(camera_file(camera, SENSOR), poses.get, config=config, on_keyframe=done.append)
    for frame in frames:
        mapper.process(_raw(frame))
    mesh = mapper.finish().mesh
    assert mesh is None or np.isfinite(mesh.vertices).all(), "a vertex of the mesh is not finite"
    return done


def track_tiny(config: Config) -> int:
    """Odometry on a few frames; how many got a pose, all of which are finite."""
    camera, frames = recording(320, 240, 12, 0.04)
    front_end = FrontEnd(camera_file(camera, SENSOR))
    odometry = Odometry(camera, config.odometry, np.ones(camera.shape, bool), 0)
    for frame in frames:
        odometry.process(front_end.polarization(_raw(frame)).intensity, frame.timestamp, frame.index, math.nan)
    odometry.finish()
    result = odometry.result()
    for posed in result.frames:
        assert np.isfinite(posed.T_world_camera).all(), "a pose is not finite"
    return len(result.frames)


def _raw(frame: SynthFrame) -> Frame:
    return Frame(frame.index, frame.timestamp, f"{frame.index}", Path(f"raw/{frame.index}.png"), frame.mosaic)


def check_keyframe(keyframe: Keyframe) -> None:
    """No infinite depth, and all that belongs to a valid pixel finite and in its range."""
    depth, valid = keyframe.depth, np.isfinite(keyframe.depth)
    assert not np.isinf(depth).any(), "an infinite depth"
    assert (depth[valid] > 0).all(), "a depth that is not positive"
    assert np.isfinite(keyframe.confidence).all(), "a confidence that is not finite"
    assert ((keyframe.confidence >= 0) & (keyframe.confidence <= 1)).all(), "a confidence out of range"
    assert np.isfinite(keyframe.sigma[valid]).all(), "a standard deviation that is not finite"


def walk(extreme: Extreme) -> str:
    """What came of an option at one end: the share of valid pixels, or the package's own error."""
    with warnings.catch_warnings():
        warnings.simplefilter("error", RuntimeWarning)
        try:
            config = extreme.config()
            if extreme.section == "odometry":
                return f"{track_tiny(config)} frames posed"
            keyframes = map_tiny(config)
        except PolarmapError as error:
            return f"refused: {error}"
    for keyframe in keyframes:
        check_keyframe(keyframe)
    share = np.mean([np.isfinite(keyframe.depth).mean() for keyframe in keyframes]) if keyframes else 0.0
    return f"{len(keyframes)} keyframes, {share:.0%} of the pixels"


def main(names: list[str]) -> int:
    """Walk over all options, or those named; exit status 1 if one fails."""
    failed = 0
    for extreme in extremes():
        if names and f"{extreme.section}.{extreme.name}" not in names:
            continue
        start = time.perf_counter()
        try:
            outcome = walk(extreme)
        except Exception as error:  # what must not happen, whatever it is
            failed += 1
            outcome = f"FAILED: {type(error).__name__}: {error}"
        print(f"{extreme!s:45} {time.perf_counter() - start:6.1f} s  {outcome}", flush=True)
    return 1 if failed else 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
