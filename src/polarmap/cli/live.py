"""polarmap live: what a camera sends becomes a map."""

from __future__ import annotations

from polarmap.cli.cameras import CameraOptions, open_camera, say_losses
from polarmap.cli.common import ConfigPath, Force, Out, PriorName, Settings, end_requests, read_parameters
from polarmap.cli.mapping import get_ready, map_live
from polarmap.cli.option_groups import with_option_groups
from polarmap.cli.view import DEFAULT_AT, View, ViewAt, watched
from polarmap.prior.names import DEFAULT_PRIOR


@with_option_groups
def live(
    camera: CameraOptions,
    out: Out,
    prior: PriorName = DEFAULT_PRIOR,
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
    with open_camera(camera) as (opened, camera_file), end_requests() as stop:
        require_polarization(camera_file)
        network = make_prior(prior, parameters.prior)
        get_ready(parameters)
        source = LiveCamera(opened, camera_file, ended=lambda: stop.requested, frames=camera.frames)
        try:
            with watched(view, view_at) as watcher:
                map_live(source, opened.name, network, parameters, out, force, camera.frames, stop, watcher)
        finally:
            say_losses(source.lost, 0, "")
