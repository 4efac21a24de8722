"""polarmap synth: polarization sequences with truth, made from RGB-D recordings and from scenes."""

from __future__ import annotations

import typer

synth_app = typer.Typer(
    help="Make polarization sequences with truth.", no_args_is_help=True, rich_markup_mode="markdown"
)
