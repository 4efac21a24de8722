"""What a synthetic scene is made of: surfaces, their materials, and light.

A primitive stands in its own object frame, which `T_world_object` (4×4 float64) places in the world. Lengths are
in metres. Surfaces have no thickness and are opaque from both sides, so a box may be a room.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import IntEnum
from typing import ClassVar

import numpy as np

from polarmap.errors import InputError
from polarmap.polarization.metals import Metal


class Pattern(IntEnum):
    """How a texture varies with the point in the object frame."""

    CHECKER = 1
    STRIPES = 2
    NOISE = 3
    IMAGE = 4


@dataclass(frozen=True)
class Texture:
    """A solid texture: the albedo is multiplied by 1 + contrast·m(point), m in [-1, 1].

    pattern: CHECKER cubes of edge `size`; STRIPES, slabs of thickness `size` across the direction (1, 1, 1);
        NOISE, value noise whose coarsest lattice has step `size` and each octave half the step of the one before;
        IMAGE, a picture of the scene (`Scene.images`) of height `size` and its mirror images in turn, carried along
        a slant through the body so that all its sides show it.
    contrast: in [0, 1]. image: index of the picture.
    """

    pattern: Pattern
    size: float
    contrast: float = 0.6
    octaves: int = 5
    seed: int = 0
    image: int = 0

    def __post_init__(self) -> None:
        _require_positive("texture size", self.size)
        _require_share("texture contrast", self.contrast)
        if not 1 <= self.octaves <= 12:
            raise InputError(f"synthetic scene: texture octaves must be 1 to 12, not {self.octaves}")


@dataclass(frozen=True)
class Material:
    """A dielectric body under a smooth surface, or a metal, whose surface mirrors and whose body gives nothing back.

    albedo: share of the light that the body gives back, before the surface's transmittance, in [0, 1]; a metal has
        none, whatever is said here.
    texture: None for a bare surface, as a metal's must be.
    eta: refractive index relative to air, over 1; the real part n of a metal's.
    absorption: the k of a metal's index n - ik, see `polarmap.polarization.metals`; 0 for a dielectric.
    gloss: share of Fresnel's reflection that leaves in the mirror direction, in [0, 1]. 0 leaves only the diffuse
        part; albedo = 0 leaves only the specular part.
    shininess: Blinn-Phong exponent of the point light's highlight; 0 for none.
    """

    name: str
    albedo: float = 0.5
    texture: Texture | None = None
    eta: float = 1.5
    gloss: float = 1.0
    shininess: float = 0.0
    absorption: float = 0.0

    def __post_init__(self) -> None:
        _require_share(f"albedo of {self.name}", self.albedo)
        _require_share(f"gloss of {self.name}", self.gloss)
        if not (np.isfinite(self.absorption) and self.absorption >= 0.0):
            raise InputError(f"synthetic scene: absorption of {self.name} must be 0 or more, not {self.absorption}")
        if self.is_metal:
            self._check_metal()
        elif not (np.isfinite(self.eta) and self.eta > 1.0):
            raise InputError(f"synthetic scene: eta of {self.name} must be over 1, not {self.eta}")
        if not (np.isfinite(self.shininess) and self.shininess >= 0.0):
            raise InputError(f"synthetic scene: shininess of {self.name} must be 0 or more, not {self.shininess}")

    @classmethod
    def metal(cls, metal: Metal, gloss: float = 1.0, shininess: float = 0.0) -> Material:
        """The material of a polished metal."""
        return cls(metal.name, albedo=0.0, eta=metal.n, gloss=gloss, shininess=shininess, absorption=metal.k)

    @property
    def is_metal(self) -> bool:
        """Whether it absorbs what enters it."""
        return self.absorption > 0.0

    def _check_metal(self) -> None:
        if self.texture is not None:
            raise InputError(f"synthetic scene: {self.name} is a metal and has no body that a texture could vary")
        if not (np.isfinite(self.eta) and self.eta > 0.0):
            raise InputError(f"synthetic scene: eta of {self.name}, a metal, must be over 0, not {self.eta}")


class Shape(IntEnum):
    """Which intersection test a primitive needs."""

    RECTANGLE = 0
    BOX = 1
    SPHERE = 2
    CYLINDER = 3
    REVOLVED = 4
    PRISM = 5


@dataclass(frozen=True, eq=False)
class Primitive:
    """A surface with a material and a pose; InputError where the pose is no rigid motion."""

    shape: ClassVar[Shape]

    material: Material
    T_world_object: np.ndarray = field(default_factory=lambda: np.eye(4))

    def __post_init__(self) -> None:
        R = np.asarray(self.T_world_object)[:3, :3]
        if np.shape(self.T_world_object) != (4, 4) or not np.allclose(R @ R.T, np.eye(3), atol=1e-6):
            raise InputError(f"synthetic scene: the pose of a {self.shape.name.lower()} is not a rigid motion")
        for half in self.half_size:
            _require_positive(f"size of a {self.shape.name.lower()}", half)

    @property
    def half_size(self) -> tuple[float, float, float]:
        """Half the extent along the object frame's axes."""
        raise NotImplementedError

    @property
    def bounding_radius(self) -> float:
        """Radius about the object frame's origin of a sphere that holds the whole surface."""
        return float(np.linalg.norm(self.half_size))


@dataclass(frozen=True, eq=False)
class Rectangle(Primitive):
    """Part of the object frame's plane z = 0, centred; infinite sizes make it the whole plane."""

    shape = Shape.RECTANGLE
    width: float = np.inf
    height: float = np.inf

    @property
    def half_size(self) -> tuple[float, float, float]:
        return self.width / 2, self.height / 2, 1.0

    @property
    def bounding_radius(self) -> float:
        """Half the diagonal."""
        return float(np.hypot(self.width / 2, self.height / 2))


@dataclass(frozen=True, eq=False)
class Box(Primitive):
    """A cuboid centred on the object frame's origin, its sizes along x, y and z."""

    shape = Shape.BOX
    size: tuple[float, float, float] = (1.0, 1.0, 1.0)

    @property
    def half_size(self) -> tuple[float, float, float]:
        return self.size[0] / 2, self.size[1] / 2, self.size[2] / 2


@dataclass(frozen=True, eq=False)
class Sphere(Primitive):
    """A sphere round the object frame's origin."""

    shape = Shape.SPHERE
    radius: float = 1.0

    @property
    def half_size(self) -> tuple[float, float, float]:
        return self.radius, self.radius, self.radius

    @property
    def bounding_radius(self) -> float:
        """The sphere's own."""
        return self.radius


@dataclass(frozen=True, eq=False)
class Cylinder(Primitive):
    """A cylinder with caps, centred, its axis along the object frame's z."""

    shape = Shape.CYLINDER
    radius: float = 1.0
    height: float = 1.0

    @property
    def half_size(self) -> tuple[float, float, float]:
        return self.radius, self.radius, self.height / 2


@dataclass(frozen=True, eq=False)
class Revolved(Primitive):
    """A surface of revolution about the object frame's z, centred, with flat ends.

    Its squared radius is the parabola in z through those of three radii: at the lower end (z = -height/2), in the
    middle, and at the upper end. So it is a cylinder, a cone or its frustum, a part of a sphere or ellipsoid, a
    paraboloid or a waisted hyperboloid, and a stack of them is a bottle. InputError where the parabola is not positive
    between the ends.
    """

    shape = Shape.REVOLVED
    bottom: float = 1.0
    middle: float = 1.0
    top: float = 1.0
    height: float = 1.0

    def __post_init__(self) -> None:
        super().__post_init__()
        for radius in (self.bottom, self.middle, self.top):
            if not (np.isfinite(radius) and radius >= 0.0):
                raise InputError(f"synthetic scene: radii of a revolved must be 0 or more, not {radius}")
        if min(self._squared(np.linspace(-1.0, 1.0, 1001)[1:-1])) <= 0.0:
            raise InputError("synthetic scene: a revolved must have a positive radius between its ends")

    @property
    def profile(self) -> tuple[float, float, float]:
        """(c0, c1, c2) of the squared radius c0 + c1 z + c2 z², in metres."""
        half, low, mid, high = self.height / 2, self.bottom**2, self.middle**2, self.top**2
        return mid, (high - low) / 2 / half, ((high + low) / 2 - mid) / half**2

    @property
    def half_size(self) -> tuple[float, float, float]:
        radius = float(np.sqrt(max(self._squared(self._extrema()))))
        return radius, radius, self.height / 2

    def _squared(self, s: np.ndarray) -> np.ndarray:
        """Squared radius at z = s·height/2."""
        low, mid, high = self.bottom**2, self.middle**2, self.top**2
        return mid + (high - low) / 2 * s + ((high + low) / 2 - mid) * s * s

    def _extrema(self) -> np.ndarray:
        low, mid, high = self.bottom**2, self.middle**2, self.top**2
        bend = high + low - 2.0 * mid
        vertex = -(high - low) / 2 / bend if bend else 0.0
        return np.array([-1.0, 1.0, np.clip(vertex, -1.0, 1.0)])


MOST_CORNERS = 8


@dataclass(frozen=True, eq=False)
class Prism(Primitive):
    """A convex polygon of the object frame's x-y plane, extruded along z, centred, all edges rounded.

    outline: 3 to 8 corners, counter-clockwise (x toward y). The body is that prism grown by `rounding` on all sides:
    everything nearer to it than that. height: along z, before it is grown. InputError where the outline is not convex.
    """

    shape = Shape.PRISM
    outline: tuple[tuple[float, float], ...] = ((-0.5, -0.5), (0.5, -0.5), (0.5, 0.5), (-0.5, 0.5))
    height: float = 1.0
    rounding: float = 0.1

    def __post_init__(self) -> None:
        corners = np.asarray(self.outline, float)
        if corners.ndim != 2 or corners.shape[1] != 2 or not 3 <= len(corners) <= MOST_CORNERS:
            raise InputError(f"synthetic scene: the outline of a prism must have 3 to {MOST_CORNERS} corners (x, y)")
        along = np.roll(corners, -1, axis=0) - corners
        turns = along[:, 0] * np.roll(along[:, 1], -1) - along[:, 1] * np.roll(along[:, 0], -1)
        if not (np.isfinite(corners).all() and (turns > 0).all()):
            raise InputError("synthetic scene: the outline of a prism must be convex and counter-clockwise")
        if not (np.isfinite(self.rounding) and self.rounding >= 0):
            raise InputError(f"synthetic scene: rounding of a prism must be 0 or more, not {self.rounding}")
        super().__post_init__()

    @property
    def half_size(self) -> tuple[float, float, float]:
        """Half the sides of a cuboid about the origin that holds the body."""
        x, y = np.abs(self.outline).max(axis=0) + self.rounding
        return float(x), float(y), self.height / 2 + self.rounding


@dataclass(frozen=True)
class PointLight:
    """An isotropic point source: at distance r it gives the irradiance intensity·cos/r²."""

    position: tuple[float, float, float]
    intensity: float
    shadows: bool = True


@dataclass(frozen=True, eq=False)
class Scene:
    """Surfaces, point lights (one, several or None), and a surround of uniform radiance.

    The surround lights every surface as if nothing stood before it (which stands for light reflected many times),
    is what rays see that hit nothing, and what such rays' mirror reflections show.
    images: what textures of the pattern IMAGE show, float32 N×H×W in [-1, 1]; None where there are none.
    Raises InputError where a texture shows an image that is not there.
    """

    primitives: tuple[Primitive, ...]
    light: PointLight | tuple[PointLight, ...] | None = None
    surround: float = 1.0
    images: np.ndarray | None = None

    def __post_init__(self) -> None:
        known = 0 if self.images is None else len(self.images)
        for texture in {primitive.material.texture for primitive in self.primitives} - {None}:
            if texture.pattern == Pattern.IMAGE and not 0 <= texture.image < known:
                raise InputError(f"synthetic scene: a texture shows image {texture.image}, the scene has {known}")

    @property
    def lights(self) -> tuple[PointLight, ...]:
        """The point lights as a tuple."""
        if self.light is None:
            return ()
        return self.light if isinstance(self.light, tuple) else (self.light,)

    @property
    def materials(self) -> tuple[Material, ...]:
        """The distinct materials; a material id is an index into it."""
        return tuple(dict.fromkeys(primitive.material for primitive in self.primitives))


def _require_positive(what: str, value: float) -> None:
    if not value > 0:
        raise InputError(f"synthetic scene: {what} must be positive, not {value}")


def _require_share(what: str, value: float) -> None:
    if not 0.0 <= value <= 1.0:
        raise InputError(f"synthetic scene: {what} must be between 0 and 1, not {value}")
