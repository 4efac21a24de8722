"""polarmap live: what a camera sends becomes a map."""

from __future__ import annotations

from typing import Annotated

import typer

from polarmap.cli.cameras import Basler, Cti, DeviceName, Features, Frames, LiveCameraPath, open_camera, say_losses
from polarmap.cli.common import ConfigPath, Force, Out, Settings, end_requests, read_parameters
from polarmap.cli.mapping import get_ready, map_live
from polarmap.cli.view import DEFAULT_AT, View, ViewAt, watched
from polarmap.prior.names import DEFAULT_PRIOR


def live(
    camera: LiveCameraPath,
    out: Out,
    cti: Cti = None,
    basler: Basler = False,
    device: DeviceName = None,
    feature: Features = None,
    frames: Frames = None,
    prior: Annotated[
        str, typer.Option(help="'polarnet', 'sparse', or a relative depth network as an ONNX file (docs/priors.md).")
    ] = DEFAULT_PRIOR,
    config: ConfigPath = None,
    settings: Settings = None,
    view: View = False,
    view_at: ViewAt = DEFAULT_AT,
    force: Force = False,
) -> None:
    """Map what a polarization camera sees, while it moves.

    Poses come from odometry, so that lengths are in units of its own. Ctrl-C ends the recording; the map is then
    completed and written, with the same files as by 'polarmap run'. Give the camera a short, fixed exposure, gain 0 and
    no automatic functions; docs/live.md says how, and where each maker's .cti file is.

    Examples: polarmap live --camera camera.yaml --cti producer.cti --feature ExposureTime=4000 --view --out map

    polarmap live --camera camera.yaml --basler --feature PixelFormat=Mono12p --out map
    """
    from polarmap.io.cameras.live_camera import LiveCamera
    from polarmap.prior.priors import make_prior
    from polarmap.sensing.front_end import require_polarization

    parameters = read_parameters(config, settings)
    with open_camera(camera, cti, basler, device, feature) as (opened, camera_file), end_requests() as stop:
        require_polarization(camera_file)
        network = make_prior(prior, parameters.prior)
        get_ready(parameters)
        source = LiveCamera(opened, camera_file, ended=lambda: stop.requested, frames=frames)
        try:
            with watched(view, view_at) as watcher:
                map_live(source, opened.name, network, parameters, out, force, frames, stop, watcher)
        finally:
            say_losses(source.lost, 0, "")
