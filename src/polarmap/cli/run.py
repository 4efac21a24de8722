"""polarmap run: a recorded sequence becomes a map."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from polarmap.cli.common import (
    CameraPath,
    ConfigPath,
    Force,
    Out,
    PriorName,
    RecordingPath,
    Settings,
    read_parameters,
)
from polarmap.cli.mapping import map_recording
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.recording import BagOptions, BagPoseOptions, open_recording, read_recorded_poses
from polarmap.cli.view import DEFAULT_AT, View, ViewAt, watched
from polarmap.prior.names import DEFAULT_PRIOR


@with_option_groups
def run(
    sequence: RecordingPath,
    out: Out,
    poses: Annotated[
        Path | None,
        typer.Option(
            help="Trajectory of the camera: TUM, KITTI, EuRoC or log file, or BAG:TOPIC; odometry if not given.",
            metavar="FILE",
        ),
    ] = None,
    prior: PriorName = DEFAULT_PRIOR,
    config: ConfigPath = None,
    settings: Settings = None,
    camera: CameraPath = None,
    stages: Annotated[
        bool, typer.Option("--stages", help="Also keep the depth after each step, which 'eval' then compares.")
    ] = False,
    realtime: Annotated[
        bool,
        typer.Option(
            "--realtime",
            help="Play the recording at its own pace, as a camera would send it: frames do not wait, and keyframes are "
            "skipped where mapping is behind.",
        ),
    ] = False,
    view: View = False,
    view_at: ViewAt = DEFAULT_AT,
    force: Force = False,
    *,
    bag: BagOptions,
    bag_poses: BagPoseOptions,
) -> None:
    """Map a recorded sequence.

    Reads raw polarization mosaics; writes depth maps, normals, a mesh, figures, and a report to look at
    (OUT/report.html). Poses come from a trajectory, or without --poses from odometry, up to one scale: lengths
    are then in units of odometry, not in metres. The true depth and poses of a sequence are never read unless --poses
    names them.

    Examples: polarmap run livingroom --out out

    polarmap run livingroom --poses livingroom/groundtruth.txt --out out

    polarmap run livingroom --realtime --view --out out

    polarmap run drive.mcap --topic /camera/image_raw --camera camera.yaml --pose-topic /odom --out out
    """
    from polarmap.prior.priors import make_prior
    from polarmap.sensing.front_end import require_polarization

    parameters = read_parameters(config, settings)
    recording = open_recording(sequence, camera, bag)
    require_polarization(recording.camera_file)
    trajectory = read_recorded_poses(recording, poses, bag_poses)
    prior_method = make_prior(prior, parameters.prior)
    with watched(view, view_at) as watcher:
        map_recording(recording, trajectory, prior_method, parameters, out, stages, force, realtime, watcher)
