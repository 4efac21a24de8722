"""What polarization says of the planes that stereo tries, against the costs of whole cells and in stereo itself."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import MATERIALS, polarization_of

from polarmap.data.polarization_image import PolarizationImage
from polarmap.data.view import View
from polarmap.densify.surfaces.evidence import polarization_costs
from polarmap.geometry.camera import PinholeCamera
from polarmap.stereo.options import PatchMatchOptions
from polarmap.stereo.patchmatch.method import patchmatch
from polarmap.stereo.patchmatch.polarized_planes import plane_misfit, polarization_field, take_off
from polarmap.synth import Texture, render, scenes
from polarmap.synth.scene import Pattern

CAMERA = PinholeCamera(width=120, height=90, fx=100.0, fy=104.0, cx=50.0, cy=40.0)
INTRINSICS = np.float32([CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy])


def random_image(rng: np.random.Generator) -> PolarizationImage:
    shape = CAMERA.shape
    flags = np.zeros(shape, bool)
    sigma = np.full(shape, 0.01, np.float32)
    dolp, aolp = (rng.uniform(0.0, top, shape).astype(np.float32) for top in (0.1, np.pi))
    return PolarizationImage(np.full(shape, 0.5, np.float32), dolp, aolp, sigma, sigma, flags, flags)


def test_the_misfit_is_that_of_whole_cells():
    rng = np.random.default_rng(0)
    field = polarization_field(random_image(rng), CAMERA.shape)
    for _ in range(5):
        alpha, beta, gamma = rng.uniform(-0.5, 0.5), rng.uniform(-0.5, 0.5), 1.0
        plane = np.float32([[alpha, beta, gamma]])
        expected = polarization_costs(field[..., :2], 1.0 / field[..., 2], plane, (), CAMERA)[..., 0]
        xy = CAMERA.normalized()
        q = (alpha * xy[..., 0] + beta * xy[..., 1] + gamma).astype(np.float32)
        slopes = [np.full(CAMERA.shape, s, np.float32) for s in (alpha / CAMERA.fx, beta / CAMERA.fy)]
        cost = np.zeros(CAMERA.shape, np.float32)
        take_off(cost, np.float32(-1.0), q, *slopes, INTRINSICS, field, 1)
        np.testing.assert_allclose(cost, np.minimum(expected, 4.0), atol=2e-3)
        assert np.ptp(cost) > 1.0


def test_what_cannot_be_used_fits_every_plane():
    image = random_image(np.random.default_rng(1))
    clipped = np.zeros(CAMERA.shape, bool)
    clipped[:30] = True
    field = polarization_field(replace(image, saturated=clipped), CAMERA.shape)
    assert not field[:31].any() and field[40:].all()
    assert not polarization_field(None, CAMERA.shape).any()
    assert plane_misfit(np.float32(0.5), np.float32(0.01), np.float32(0.0), 5, 5, INTRINSICS, field) == 0.0


def views(polarized: bool) -> tuple[list[View], np.ndarray]:
    material = replace(MATERIALS["matte"], texture=Texture(Pattern.NOISE, 0.1, 0.3, seed=3))
    moved = np.eye(4)
    moved[:3, 3] = (0.12, -0.05, 0.0)
    poses = (np.eye(4), moved)
    renderings = [render(scenes.plane(material, tilt=0.9), CAMERA, pose) for pose in poses]
    images = [polarization_of(rendering) for rendering in renderings]
    made = [
        View(i if polarized else PolarizationImage.unpolarized(i.intensity), T)
        for i, T in zip(images, poses, strict=True)
    ]
    return made, renderings[0].normal


@pytest.mark.parametrize("weight", [0.0, 0.03])
def test_without_polarization_its_weight_changes_nothing(weight):
    (reference, source), _ = views(polarized=False)
    plain = patchmatch(reference, [source], CAMERA, (0.5, 8.0), PatchMatchOptions(polarization=0.0))
    other = patchmatch(reference, [source], CAMERA, (0.5, 8.0), PatchMatchOptions(polarization=weight))
    for name in ("inverse_depth", "gradient_u", "score", "sigma"):
        np.testing.assert_array_equal(getattr(plain, name), getattr(other, name))


def test_polarization_turns_the_planes_that_stereo_finds():
    (reference, source), normal = views(polarized=True)

    def error(weight: float) -> float:
        found = patchmatch(reference, [source], CAMERA, (0.5, 8.0), PatchMatchOptions(polarization=weight))
        cosine = np.einsum("hwc,hwc->hw", found.normals(CAMERA), normal)
        return float(np.degrees(np.nanmedian(np.arccos(np.clip(cosine, -1.0, 1.0)))))

    assert error(0.03) < 0.85 * error(0.0)
