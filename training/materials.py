"""Random materials: bare and textured, matte and glossy, and now and then a metal."""

from __future__ import annotations

import cv2
import numpy as np

from polarmap.polarization.metals import METALS
from polarmap.synth import Material, Pattern, Texture

PHOTOGRAPHS = ("astronaut", "brick", "camera", "chelsea", "coffee", "coins", "grass", "gravel", "rocket", "text")
"""Pictures in scikit-image's wheel that are in the public domain, CC0, or without known restrictions."""

_SIDE = 256


def photographs() -> np.ndarray:
    """The photographs as textures take them, float32 N×256×256, of mean 0 in [-1, 1]."""
    import skimage.data

    return np.stack([_modulation(getattr(skimage.data, name)()) for name in PHOTOGRAPHS])


def _modulation(picture: np.ndarray) -> np.ndarray:
    grey = picture[..., :3].astype(np.float32).mean(axis=2) if picture.ndim == 3 else picture.astype(np.float32)
    small = cv2.resize(grey, (_SIDE, _SIDE), interpolation=cv2.INTER_AREA)
    small -= small.mean()
    return np.clip(small / (2.0 * small.std()), -1.0, 1.0)


class Materials:
    """Draws materials that differ, each with a name of its own. rng: where all randomness comes from."""

    def __init__(self, rng: np.random.Generator, images: int = len(PHOTOGRAPHS)) -> None:
        self.rng = rng
        self._images = images
        self._count = 0
        self._bareness = rng.uniform(0.1, 0.9)  # of this scene
        self._glossiness = rng.uniform(0.2, 1.0)

    def any(self) -> Material:
        """Of a thing."""
        if self.rng.random() < 0.04:
            return self._metal()
        return self._dielectric(self._albedo(0.03, 0.85), self._texture(1.0 - self._bareness, 0.03, 0.5))

    def wall(self) -> Material:
        """Of a wall or ceiling: mostly bright, mostly bare."""
        albedo = self._albedo(0.35, 0.9) if self.rng.random() < 0.7 else self._albedo(0.08, 0.6)
        return self._dielectric(albedo, self._texture(0.5 * (1.0 - self._bareness), 0.05, 2.0, 0.6))

    def floor(self) -> Material:
        """Of a floor: darker, often textured."""
        return self._dielectric(self._albedo(0.08, 0.6), self._texture(1.2 * (1.0 - self._bareness), 0.08, 2.0))

    def picture(self) -> Material:
        """Of something printed."""
        return self._dielectric(self._albedo(0.15, 0.6), self._texture(0.9, 0.1, 1.0, photographic=0.7))

    def bright(self) -> Material:
        """Of a lamp or a window by day: as bright as a scene without light sources may show it."""
        return self._dielectric(self.rng.uniform(0.9, 1.0), None)

    def dark_glass(self) -> Material:
        """Of a window by night, or a screen."""
        return self._dielectric(self._albedo(0.01, 0.06), None, gloss=1.0)

    def _dielectric(self, albedo: float, texture: Texture | None, gloss: float | None = None) -> Material:
        rng = self.rng
        if gloss is None:
            gloss = float(np.clip(rng.beta(0.8, 1.2) * self._glossiness * 1.3, 0.0, 1.0))
        shininess = float(np.exp(rng.uniform(np.log(4.0), np.log(500.0)))) if rng.random() < 0.5 else 0.0
        return Material(self._name(), albedo, texture, rng.uniform(1.3, 1.8), gloss, shininess)

    def _metal(self) -> Material:
        metal = METALS[self.rng.integers(len(METALS))]
        return Material(self._name(), 0.0, None, metal.n, self.rng.uniform(0.3, 1.0), 30.0, metal.k)

    def _albedo(self, low: float, high: float) -> float:
        return float(np.exp(self.rng.uniform(np.log(low), np.log(high))))

    def _texture(
        self, probability: float, smallest: float, largest: float, contrast: float = 1.0, photographic: float = 0.45
    ) -> Texture | None:
        rng = self.rng
        if rng.random() > probability:
            return None
        size = float(np.exp(rng.uniform(np.log(smallest), np.log(largest))))
        contrast = float(contrast * rng.uniform(0.1, 1.0))
        seed = int(rng.integers(1 << 20))
        if rng.random() < photographic:
            return Texture(Pattern.IMAGE, 2.0 * size, contrast, image=int(rng.integers(self._images)))
        pattern = rng.choice([Pattern.CHECKER, Pattern.STRIPES, Pattern.NOISE], p=[0.12, 0.13, 0.75])
        return Texture(Pattern(int(pattern)), size, contrast, int(rng.integers(1, 6)), seed)

    def _name(self) -> str:
        self._count += 1
        return f"material {self._count}"
