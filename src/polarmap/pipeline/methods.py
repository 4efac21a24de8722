"""The methods that a configuration can name. One more takes a line here, and one in the options that name it."""

from __future__ import annotations

from collections.abc import Callable

from polarmap.densify.method import Densifier
from polarmap.densify.paper.method import ByThePaper
from polarmap.densify.surfaces.method import BySurfaces
from polarmap.pipeline.config import Config
from polarmap.stereo.method import StereoMethod
from polarmap.stereo.patchmatch.method import PatchMatch

STEREO: dict[str, Callable[[Config], StereoMethod]] = {
    "patchmatch": lambda config: PatchMatch(config.patchmatch),
}
DENSIFY: dict[str, Callable[[Config], Densifier]] = {
    "surfaces": lambda config: BySurfaces(config.surfaces, config.cues),
    "paper": lambda config: ByThePaper(config.paper, config.cues),
}


def make_stereo(config: Config) -> StereoMethod:
    """The method that `stereo.method` names."""
    return STEREO[config.stereo.method](config)


def make_densifier(config: Config) -> Densifier:
    """The method that `densify.method` names."""
    return DENSIFY[config.densify.method](config)
