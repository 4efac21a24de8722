"""The tree of coordinate frames that tf and tf_static tell: where one frame is in another, at a time."""

from __future__ import annotations

import logging
from array import array
from collections import defaultdict
from collections.abc import Iterator
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from polarmap.data.times import nanoseconds_of
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.geometry.pose import inverse
from polarmap.io.recording.ros.bag import Bag, readable
from polarmap.io.recording.ros.stamped import pose_of, stamp_of, stamped_trajectory

log = logging.getLogger(__name__)

TF_MESSAGE = "tf2_msgs/msg/TFMessage"
_STATIC = "tf_static"
_MOST = 4_000_000  # transforms
_UNMOVED = 1e-6  # metres, and of the elements of a rotation
_NAMED = 12  # frames, in messages


class TransformTree:
    """Transforms of a bag. Frames are named without the slash that ROS 1 puts before them.

    Poses between the times of a transform are interpolated as in a `Trajectory`; static ones hold always, and so does a
    moving one that was told but once or never changes.
    """

    def __init__(self, path: Path) -> None:
        self._path = path
        self._parents: dict[str, str] = {}
        self._static: dict[str, np.ndarray] = {}
        self._times: defaultdict[str, array] = defaultdict(lambda: array("q"))
        self._poses: defaultdict[str, array] = defaultdict(lambda: array("d"))
        self._count = 0
        self._several: dict[str, str] = {}  # second parents
        self._edge = cache(self._trajectory)
        self._moves = cache(self._changes)

    def add(self, parent: str, child: str, T_parent_child: np.ndarray, nanoseconds: int | None) -> None:
        """Add a transform, 4×4, at a time; without one it holds always. Raises InputError where there are too many."""
        if self._parents.setdefault(child, parent) != parent:
            self._several[child] = parent
            return
        if nanoseconds is None:
            self._static[child] = T_parent_child
            return
        self._count += 1
        if self._count > _MOST:
            raise InputError(f"{self._path}: more than the {_MOST} transforms that a bag may have")
        self._times[child].append(nanoseconds)
        self._poses[child].extend(T_parent_child[:3].ravel().tolist())

    def ancestors(self, frame: str) -> list[str]:
        """The frame, its parent, and so on to the root; InputError where they go round in a circle."""
        found = [frame]
        while (parent := self._parents.get(found[-1])) is not None:
            if found[-1] in self._several:
                raise InputError(
                    f"{self._path}: the frame {found[-1]} has two parents, {parent} and {self._several[found[-1]]}; "
                    "one publisher of tf too many"
                )
            if parent in found:
                raise InputError(f"{self._path}: the frame {parent} is its own ancestor in tf")
            found.append(parent)
        return found

    def require_chain(self, a: str, b: str) -> None:
        """Raise InputError, telling what is missing, where nothing connects two frames."""
        for frame in (a, b):
            if frame not in self._parents and frame not in self._parents.values():
                known = sorted({*self._parents, *self._parents.values()})
                some = ", ".join(known[:_NAMED]) + (" ..." if len(known) > _NAMED else "")
                raise InputError(
                    f"{self._path}: no transform from {a} to {b}: tf and tf_static do not know {frame}; they know "
                    f"{some or 'none'}"
                )
        up_a, up_b = self.ancestors(a), self.ancestors(b)
        if up_a[-1] != up_b[-1]:
            raise InputError(
                f"{self._path}: no transform from {a} to {b}: {a} hangs on {up_a[-1]}, {b} on {up_b[-1]}, and nothing "
                "connects these"
            )

    def at(self, a: str, b: str, time: float) -> np.ndarray | None:
        """T_a_b at a time, float64 4×4; None where a transform between them is not known then."""
        up_a, up_b = self.ancestors(a), self.ancestors(b)
        shared = set(up_a) & set(up_b)
        sides = [self._down([frame for frame in up if frame not in shared], time) for up in (up_a, up_b)]
        return None if sides[0] is None or sides[1] is None else inverse(sides[0]) @ sides[1]

    def fixed(self, a: str, b: str) -> np.ndarray:
        """T_a_b of frames that do not move against each other; InputError where they do, or nothing connects them."""
        self.require_chain(a, b)
        up_a, up_b = self.ancestors(a), self.ancestors(b)
        for frame in set(up_a) ^ set(up_b):
            if self._moves(frame):
                raise InputError(
                    f"{self._path}: {b} moves against {a} ({frame} in {self._parents[frame]} changes); take the poses "
                    "from tf: --pose-topic /tf --world-frame FRAME"
                )
        T = self.at(a, b, 0.0)
        assert T is not None  # all edges are constant
        return T

    def times(self, a: str, b: str) -> tuple[float, float] | None:
        """Seconds in which all moving transforms between two frames were told; None where none moves."""
        chain = set(self.ancestors(a)) ^ set(self.ancestors(b))
        moving = [self._edge(frame) for frame in chain if self._moves(frame)]
        if not moving:
            return None
        return max(float(e.timestamps[0]) for e in moving), min(float(e.timestamps[-1]) for e in moving)

    def _down(self, frames: list[str], time: float) -> np.ndarray | None:
        """T_ancestor_frame through these frames, each the parent of that before it."""
        T = np.eye(4)
        for frame in frames:
            edge = self._static[frame] if frame in self._static else self._pose(frame, time)
            if edge is None:
                return None
            T = edge @ T
        return T

    def _pose(self, frame: str, time: float) -> np.ndarray | None:
        edge = self._edge(frame)
        return edge.at(time) if self._moves(frame) else edge.poses[0]

    def _changes(self, frame: str) -> bool:
        poses = None if frame in self._static else self._edge(frame).poses
        return poses is not None and bool(np.abs(poses - poses[0]).max() > _UNMOVED)

    def _trajectory(self, frame: str) -> Trajectory:
        poses = np.tile(np.eye(4), (len(self._times[frame]), 1, 1))
        poses[:, :3] = np.array(self._poses[frame]).reshape(-1, 3, 4)
        source = f"{self._path}, {frame} in {self._parents[frame]}"
        return stamped_trajectory(source, self._times[frame].tolist(), poses)


def read_transforms(bag: Bag) -> TransformTree:
    """All that a bag's topics of tf and tf_static tell; what is no transform is left out, with a warning."""
    tree = TransformTree(bag.path)
    for topic in bag.of_type(TF_MESSAGE):
        static = topic.name.rpartition("/")[2] == _STATIC
        wrong: list[str] = []
        for recorded, stamped in _transforms(bag, topic.name):
            parent, child = stamped.header.frame_id.strip("/"), stamped.child_frame_id.strip("/")
            try:
                T = pose_of(stamped.transform.translation, stamped.transform.rotation)
            except InputError as problem:
                wrong.append(f"{child} in {parent}: {problem}")
                continue
            tree.add(parent, child, T, None if static else stamp_of(stamped.header) or recorded)
        if wrong:
            log.warning("%s: %d transforms of %s are left out (%s)", bag.path, len(wrong), topic.name, wrong[0])
    return tree


def transform_trajectory(bag: Bag, world: str, camera: str, times: list[float]) -> Trajectory:
    """T_world_camera by tf at these times (seconds), as far as they are known.

    Raises InputError where the frames are not connected, or at no time.
    """
    tree = read_transforms(bag)
    if not world:
        above = ", ".join(reversed(tree.ancestors(camera)[1:])) or "none"
        raise InputError(f"{bag.path}: name the frame of the world with --world-frame; above {camera} are {above}")
    tree.require_chain(world, camera)
    known = [(time, T) for time in times if (T := tree.at(world, camera, time)) is not None]
    if not known:
        begin, end = tree.times(world, camera) or (0.0, 0.0)
        raise InputError(
            f"{bag.path}: tf connects {world} and {camera} from {begin:.6f} to {end:.6f} s, but frames are from "
            f"{min(times):.6f} to {max(times):.6f} s"
        )
    source = f"{bag.path}, tf of {camera} in {world}"
    return stamped_trajectory(source, [nanoseconds_of(time) for time, _ in known], np.array([T for _, T in known]))


def _transforms(bag: Bag, topic: str) -> Iterator[tuple[int, Any]]:
    for message in readable(bag, topic):
        for transform in message.fields.transforms:
            yield message.recorded, transform
