"""The recording that a command is given: a sequence's folder, or a ROS bag with the options that are for bags alone."""

from __future__ import annotations

import os
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, Literal

import typer

from polarmap.cli.common import messages, read_camera
from polarmap.errors import InputError

if TYPE_CHECKING:
    from polarmap.data.trajectory import Trajectory
    from polarmap.io.recording.sequence import Sequence

_PANEL = "ROS bags (docs/bags.md)"


@dataclass(frozen=True)
class BagOptions:
    """Which images of a bag, and what is known of their camera."""

    topic: Annotated[
        str | None,
        typer.Option(
            "--topic", help="Topic of images; the only one if not given.", metavar="TOPIC", rich_help_panel=_PANEL
        ),
    ] = None
    camera_info: Annotated[
        str | None,
        typer.Option(
            "--camera-info",
            help="Topic of camera_info, where there is no camera file; that beside the images if not given.",
            metavar="TOPIC",
            rich_help_panel=_PANEL,
        ),
    ] = None
    layout: Annotated[
        str | None,
        typer.Option(
            "--layout",
            help="With camera_info: the angles of the mosaic's 2x2 block row by row, such as 90,45,135,0; none for a "
            "camera without polarizers.",
            metavar="ANGLES",
            rich_help_panel=_PANEL,
        ),
    ] = None
    angle_direction: Annotated[
        Literal["clockwise", "counterclockwise"] | None,
        typer.Option("--angle-direction", help="With camera_info: which way the angles turn.", rich_help_panel=_PANEL),
    ] = None
    bit_depth: Annotated[
        int | None,
        typer.Option(
            "--bit-depth",
            help="With camera_info: 10, 12 or 16, for 16-bit images.",
            metavar="N",
            rich_help_panel=_PANEL,
        ),
    ] = None

    def sensor(self) -> dict[str, Any]:
        """What the options say of the sensor, as keys of a camera file."""
        keys: dict[str, Any] = {"angle_direction": self.angle_direction, "bit_depth": self.bit_depth}
        if self.layout == "none":
            keys["polarization"] = "none"
        elif self.layout is not None:
            angles = self.layout.split(",")
            if not all(angle.strip().isdecimal() and len(angle) < 5 for angle in angles):
                raise InputError(f"--layout: {self.layout!r} is not a list of angles such as 90,45,135,0, or none")
            keys["mosaic"] = [int(angle) for angle in angles]
        return {key: value for key, value in keys.items() if value is not None}


@dataclass(frozen=True)
class BagPoseOptions:
    """Which poses of a bag."""

    pose_topic: Annotated[
        str | None,
        typer.Option(
            "--pose-topic",
            help="Topic of poses in the bag: Odometry, PoseStamped, Path, TransformStamped or tf.",
            metavar="TOPIC",
            rich_help_panel=_PANEL,
        ),
    ] = None
    world_frame: Annotated[
        str, typer.Option("--world-frame", help="Frame where tf is to start.", metavar="FRAME", rich_help_panel=_PANEL)
    ] = ""
    body_frame: Annotated[
        str,
        typer.Option(
            "--body-frame",
            help="Frame whose poses they are, where messages do not say.",
            metavar="FRAME",
            rich_help_panel=_PANEL,
        ),
    ] = ""
    camera_frame: Annotated[
        str,
        typer.Option(
            "--camera-frame",
            help="Optical frame of the camera; that of the images' headers if not given.",
            metavar="FRAME",
            rich_help_panel=_PANEL,
        ),
    ] = ""


def open_recording(path: Path, camera: Path | None, options: BagOptions) -> Sequence:
    """The sequence in a folder or a bag. camera: that of --camera."""
    from polarmap.io.recording.ros.recognize import is_bag
    from polarmap.io.recording.sequence import open_sequence

    if not is_bag(path):
        _refuse(options, f"{path}: no ROS bag")
        return open_sequence(path, read_camera(camera, path))
    from polarmap.io.recording.ros.camera import CameraSource
    from polarmap.io.recording.ros.opening import open_bag

    source = CameraSource(camera, options.camera_info, options.sensor())
    with messages.status(f"looking through {path.name}"):
        return open_bag(path, options.topic, source)


def read_recorded_poses(recording: Sequence, poses: Path | None, options: BagPoseOptions) -> Trajectory | None:
    """The trajectory of --poses, a file or BAG:TOPIC, or of --pose-topic; None where neither is given."""
    bag, topic = _bag_and_topic(recording, poses, options.pose_topic)
    if topic is None:
        _refuse(options, "no poses of a bag are asked for")
        return None if poses is None else recording.read_poses(poses)
    from polarmap.io.recording.ros.poses import PoseQuery, read_bag_poses

    query = PoseQuery(topic, options.world_frame, options.body_frame, options.camera_frame)
    times = [float(time) for time in recording.timestamps]
    with messages.status(f"looking through {bag.name}"):
        return read_bag_poses(bag, query, getattr(recording, "frame_id", ""), times)


def _bag_and_topic(recording: Sequence, poses: Path | None, pose_topic: str | None) -> tuple[Path, str | None]:
    from polarmap.io.recording.ros.recognize import is_bag

    if poses is not None and pose_topic is not None:
        raise InputError("--poses and --pose-topic: give one of them")
    if pose_topic is not None:
        if not is_bag(recording.path):
            raise InputError(f"{recording.path}: no ROS bag, as --pose-topic needs; write --poses BAG:TOPIC")
        return recording.path, pose_topic
    if poses is not None and not os.path.exists(poses):
        name, _, topic = str(poses).rpartition(":")
        if topic and is_bag(Path(name)):
            return Path(name), topic
    if poses is not None and is_bag(poses):
        raise InputError(f"{poses}: a ROS bag; add the topic of its poses, as in --poses {poses}:/odom")
    return recording.path, None


def _refuse(options: BagOptions | BagPoseOptions, why: str) -> None:
    """Raise InputError where an option is given that means nothing here."""
    for field in fields(options):
        if getattr(options, field.name) != field.default:
            raise InputError(f"{why}, so that --{field.name.replace('_', '-')} means nothing; leave it out")
