"""polarmap synth and its commands."""

from __future__ import annotations

import typer

from polarmap.cli.synth.mitsuba import synth_mitsuba
from polarmap.cli.synth.rgbd import synth_rgbd
from polarmap.cli.synth.scene import synth_scene

synth_app = typer.Typer(
    help="Make polarization sequences with truth.", no_args_is_help=True, rich_markup_mode="markdown"
)
synth_app.command("rgbd")(synth_rgbd)
synth_app.command("scene", no_args_is_help=True)(synth_scene)
synth_app.command("mitsuba", no_args_is_help=True)(synth_mitsuba)
