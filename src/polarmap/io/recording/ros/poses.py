"""Trajectories of the camera from the messages of a bag.

nav_msgs/Odometry, geometry_msgs/TransformStamped    name the body whose poses they are
geometry_msgs/PoseStamped, PoseWithCovarianceStamped, nav_msgs/Path    do not
tf2_msgs/TFMessage    the chain from the world's frame to the camera's, at the times of the images

Poses of another body are carried to the camera by the transform between the two, which must not change. The camera's
frame is the optical one (x right, y down, z forward), which the headers of its images name.
"""

from __future__ import annotations

import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.io.files import MAX_LINES
from polarmap.io.recording.ros.bag import Bag, readable
from polarmap.io.recording.ros.stamped import pose_of, stamp_of, stamped_trajectory
from polarmap.io.recording.ros.transforms import TF_MESSAGE, read_transforms, transform_trajectory

log = logging.getLogger(__name__)

_PATH = "nav_msgs/msg/Path"


@dataclass(frozen=True)
class PoseQuery:
    """Which poses of a bag are asked for.

    topic: of one of the types that are read. world_frame: where tf is to start. body_frame: whose poses they are, where
    messages do not say or say it wrong; camera_frame: the optical frame, in place of that of the images.
    """

    topic: str
    world_frame: str = ""
    body_frame: str = ""
    camera_frame: str = ""


def read_bag_poses(path: Path, query: PoseQuery, camera_frame: str, times: list[float]) -> Trajectory:
    """T_world_camera by a topic of a bag, which need not be that of the images.

    camera_frame: that of the images' headers, "" where it is not known. times: of the frames, seconds.
    Raises InputError where the topic cannot be used, the body is not the camera and nothing connects the two, or a pose
    is none.
    """
    camera = (query.camera_frame or camera_frame).strip("/")
    with Bag(path) as bag:
        topic = bag.topic(query.topic)
        if topic.type == TF_MESSAGE:
            if not camera:
                raise InputError(
                    f"{path}: tf needs the camera's frame, which the images do not name; add --camera-frame"
                )
            return transform_trajectory(bag, query.world_frame.strip("/"), camera, times)
        if query.world_frame:
            raise InputError(f"{path}: --world-frame is for tf; the poses of {topic.name} have their own")
        body, trajectory = _body_trajectory(bag, topic.name, topic.type)
        return _of_camera(bag, topic.name, trajectory, query.body_frame.strip("/") or body, camera)


def _body_trajectory(bag: Bag, topic: str, kind: str) -> tuple[str, Trajectory]:
    """The body that messages name, "" if none, and T_world_body."""
    if kind == _PATH:
        poses: Iterator[tuple[int, Any]] = _path_poses(bag, topic)
        body, read = "", _READERS["geometry_msgs/msg/PoseStamped"]
    elif kind in _READERS:
        read = _READERS[kind]
        poses = ((message.recorded, message.fields) for message in readable(bag, topic))
    else:
        known = ", ".join(each.rpartition("/")[2] for each in (*_READERS, _PATH, TF_MESSAGE))
        raise InputError(f"{bag.path}: {topic} has messages of {kind}, which tell no poses; known are {known}")
    body, times, matrices = "", [], []
    for number, (recorded, stamped) in enumerate(poses, start=1):
        if number > MAX_LINES:
            raise InputError(f"{bag.path}: {topic} has more than the {MAX_LINES} poses that a trajectory may have")
        try:
            body, T = read(stamped)
        except InputError as problem:
            raise InputError(f"{bag.path}, {topic}, pose {number}: {problem}") from None
        times.append(stamp_of(stamped.header) or recorded)
        matrices.append(T)
    source = f"{bag.path}, {topic}"
    if not times:
        raise InputError(f"{source}: no poses")
    return body, stamped_trajectory(source, times, np.array(matrices))


def _of_camera(bag: Bag, topic: str, trajectory: Trajectory, body: str, camera: str) -> Trajectory:
    """T_world_camera of T_world_body."""
    if not body:
        log.warning(
            "%s: %s does not name whose poses it has; they are taken for those of the camera's optical frame "
            "(--body-frame names another)", bag.path, topic,
        )  # fmt: skip
        return trajectory
    if body == camera:
        return trajectory
    if not camera:
        raise InputError(
            f"{bag.path}: {topic} has the poses of {body}, and the images do not name the camera's frame; add "
            "--camera-frame"
        )
    T_body_camera = read_transforms(bag).fixed(body, camera)
    return Trajectory(
        trajectory.timestamps, trajectory.poses @ T_body_camera, trajectory.source, trajectory.nanoseconds
    )


def _path_poses(bag: Bag, topic: str) -> Iterator[tuple[int, Any]]:
    """The poses of the last path, which holds those of the earlier ones as they are known in the end."""
    last = None
    for message in readable(bag, topic):
        last = message if len(message.fields.poses) else last
    if last is not None:
        for stamped in last.fields.poses:
            if stamp_of(stamped.header) == 0:
                raise InputError(f"{bag.path}: the poses of {topic} have no times of their own; take another topic")
            yield last.recorded, stamped


def _odometry(message: Any) -> tuple[str, np.ndarray]:
    return message.child_frame_id.strip("/"), pose_of(message.pose.pose.position, message.pose.pose.orientation)


def _transform(message: Any) -> tuple[str, np.ndarray]:
    return message.child_frame_id.strip("/"), pose_of(message.transform.translation, message.transform.rotation)


def _pose(message: Any) -> tuple[str, np.ndarray]:
    return "", pose_of(message.pose.position, message.pose.orientation)


def _pose_with_covariance(message: Any) -> tuple[str, np.ndarray]:
    return "", pose_of(message.pose.pose.position, message.pose.pose.orientation)


_READERS: dict[str, Callable[[Any], tuple[str, np.ndarray]]] = {
    "nav_msgs/msg/Odometry": _odometry,
    "geometry_msgs/msg/PoseStamped": _pose,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "geometry_msgs/msg/TransformStamped": _transform,
}
