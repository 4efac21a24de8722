"""How an RGB-D surface reflects: the paper's Blinn-Phong model, and one by Fresnel's equations."""

from __future__ import annotations

import math
from dataclasses import asdict, dataclass
from typing import Any, ClassVar

from polarmap.errors import InputError

_LIGHT = (0.5, 0.0, -0.5)  # to the right of and behind the first camera, metres


@dataclass(frozen=True)
class BlinnPhong:
    """The paper's Section IV-A: Blinn-Phong shading, whose dominant part decides the polarization of all light.

    Diffuse light is a·(ambient + (1 - ambient)·n·l), a the picture's value as albedo; specular light is
    specular·(n·h)^shininess, h halfway between the directions to the light l and to the camera. Where the
    diffuse part is larger the degree of polarization is that of the paper's equation (5) and the angle lies in the
    plane of incidence, else by equation (6) and across it.
    light: the point light in the first frame's camera frame (x right, y down, z forward), metres; it stands still.
    eta: refractive index. Raises InputError where a value is out of range.
    """

    name: ClassVar[str] = "blinn-phong"

    light: tuple[float, float, float] = _LIGHT
    ambient: float = 0.4
    specular: float = 0.5
    shininess: float = 8.0
    eta: float = 1.5

    def __post_init__(self) -> None:
        _check_light(self.light)
        _check_range("ambient", self.ambient, 0.0, 1.0)
        _check_range("specular", self.specular, 0.0, 100.0)
        _check_range("shininess", self.shininess, 0.0, 10_000.0)
        _check_eta(self.eta)

    def parameters(self) -> dict[str, Any]:
        """Name and values, as plain ones."""
        return _parameters(self)


@dataclass(frozen=True)
class Fresnel:
    """Body and surface reflection of a smooth dielectric, polarized by Fresnel's equations and added.

    The body gives back a·(surround + E/π), a the picture's value as albedo and E the irradiance by the point light,
    times Fresnel's transmittances. The surface mirrors gloss·surround, and the point light as a highlight of Blinn and
    Phong's lobe, times Fresnel's reflectances. No shadows are cast: the picture has its own.
    light: as for `BlinnPhong`. Its E/π on a surface that faces it is 2 D²/(d² + D²) at distance d, D the sequence's
        typical one: a point light's from afar, bounded near by, as that of a lamp of some size.
    surround: radiance of the uniform surround, relative to that.
    gloss: share of Fresnel's reflection that leaves in the mirror direction, in [0, 1].
    shininess: exponent of the highlight; 0 for none. Raises InputError where a value is out of range.
    """

    name: ClassVar[str] = "fresnel"

    light: tuple[float, float, float] = _LIGHT
    surround: float = 1.0
    gloss: float = 0.5
    shininess: float = 30.0
    eta: float = 1.5

    def __post_init__(self) -> None:
        _check_light(self.light)
        _check_range("surround", self.surround, 0.0, 1000.0)
        _check_range("gloss", self.gloss, 0.0, 1.0)
        _check_range("shininess", self.shininess, 0.0, 10_000.0)
        _check_eta(self.eta)

    def parameters(self) -> dict[str, Any]:
        """Name and values, as plain ones."""
        return _parameters(self)


Model = BlinnPhong | Fresnel


def _parameters(model: Model) -> dict[str, Any]:
    values = {key: float(value) for key, value in asdict(model).items() if key != "light"}
    return {"name": model.name, "light": [float(x) for x in model.light], **values}


def _check_light(light: tuple[float, float, float]) -> None:
    if len(light) != 3 or not all(math.isfinite(x) for x in light):
        raise InputError(f"light: {light} is not a position X,Y,Z in metres")


def _check_range(name: str, value: float, least: float, most: float) -> None:
    if not least <= value <= most:
        raise InputError(f"{name}: {value} is not in [{least:g}, {most:g}]")


def _check_eta(eta: float) -> None:
    if not 1.0 < eta < 10.0:
        raise InputError(f"eta: {eta} is not between 1 and 10; dielectrics have 1.3 to 1.8")
