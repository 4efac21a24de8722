"""The gradient that depth is spread along: cues are believed as far as stereo confirms them, and no further."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import TYPICAL, WIDE, gradient_of, plane_depth, polarization_of, sphere_depth, view_of

from polarmap.data.codes import Reflection
from polarmap.data.cues import Cues
from polarmap.data.keyframe import CueWeights
from polarmap.densify.paper.guidance import guide, plane_gradient, prior_gradient
from polarmap.geometry.surface import log_range_gradient, normals_from_depth
from polarmap.polarization.cues import disambiguate

KIND = {"matte": "diffuse", "glass": "specular"}
both_kinds = pytest.mark.parametrize("material", KIND)


def surface(camera):
    return plane_depth(camera, (np.sin(0.6) * np.cos(0.5), np.sin(0.6) * np.sin(0.5), -np.cos(0.6)), 2.0)


TRUE_GRADIENT = gradient_of(surface, WIDE).astype(np.float32)
V, U = np.indices(WIDE.shape)
PRIORS = {
    "true": surface(WIDE),
    "flattened": 2.0 + 0.3 * (surface(WIDE) - 2.0),
    "bumpy": surface(WIDE) * (1 + 0.01 * np.sin(U / 3) * np.cos(V / 4)),
    "constant": np.full(WIDE.shape, 2.0),
}


def stereo_gradient(share: float = 0.3, noise: float = 0.0) -> np.ndarray:
    """The truth at a share of the pixels, NaN elsewhere."""
    rng = np.random.default_rng(0)
    gradient = TRUE_GRADIENT + noise * rng.standard_normal(TRUE_GRADIENT.shape).astype(np.float32)
    gradient[rng.random(WIDE.shape) > share] = np.nan
    return gradient


def cues_of(material: str, prior: np.ndarray, seed: int | None = None) -> Cues:
    image = (
        polarization_of(view_of("plane", material), TYPICAL, seed)
        if seed
        else polarization_of(view_of("plane", material))
    )
    return disambiguate(image, normals_from_depth(prior, WIDE), WIDE)


def error(gradient) -> float:
    return float(np.nanmedian(np.linalg.norm(gradient - TRUE_GRADIENT, axis=-1)))


def prior_of(name: str) -> np.ndarray:
    return PRIORS[name].astype(np.float32)


def test_the_gradient_of_stereo_planes_is_exact():
    q = 1 / surface(WIDE)
    slopes = [np.full(WIDE.shape, s) for s in (q[0, 1] - q[0, 0], q[1, 0] - q[0, 0])]
    np.testing.assert_allclose(plane_gradient(q, *slopes, WIDE), TRUE_GRADIENT, atol=1e-6)


def test_the_gradient_of_a_prior_is_that_of_its_log_range():
    depth = sphere_depth(WIDE)
    found, expected = prior_gradient(depth, WIDE), gradient_of(sphere_depth, WIDE)
    gentle = np.isfinite(found).all(-1) & (np.linalg.norm(expected, axis=-1) < 0.01)
    assert gentle.sum() > 500
    np.testing.assert_allclose(found[gentle], expected[gentle], atol=2e-4)
    np.testing.assert_allclose(prior_gradient(3.7 * depth, WIDE), found, atol=1e-6)  # scale drops out


@both_kinds
@pytest.mark.parametrize("prior", ["flattened", "bumpy"])
def test_exact_cues_are_believed_and_mend_the_prior(material, prior):
    depth = prior_of(prior)
    guidance = guide(depth, cues_of(material, depth), stereo_gradient(), WIDE)
    weights = getattr(guidance, KIND[material])
    assert weights.azimuth > 0.95 and weights.zenith > 0.95
    assert error(guidance.gradient) < (0.1 if prior == "bumpy" else 0.75) * error(prior_gradient(depth, WIDE))


@both_kinds
def test_cues_under_noise_still_mend_a_bad_prior(material):
    depth = prior_of("bumpy")
    guidance = guide(depth, cues_of(material, depth, seed=1), stereo_gradient(noise=0.002), WIDE)
    assert error(guidance.gradient) < 0.9 * error(prior_gradient(depth, WIDE))


def random_cues(label: np.ndarray, seed: int = 2) -> Cues:
    rng = np.random.default_rng(seed)
    return Cues(
        azimuth=rng.uniform(-np.pi, np.pi, WIDE.shape).astype(np.float32),
        zenith=rng.uniform(0.0, 1.2, WIDE.shape).astype(np.float32),
        label=label.astype(np.uint8),
        confidence=np.ones(WIDE.shape, np.float32),
    )


@pytest.mark.parametrize("kind", [Reflection.DIFFUSE, Reflection.SPECULAR])
def test_random_cues_leave_the_prior_alone(kind):
    depth = prior_of("bumpy")
    guidance = guide(depth, random_cues(np.full(WIDE.shape, kind)), stereo_gradient(noise=0.002), WIDE)
    for weights in (guidance.diffuse, guidance.specular):
        assert weights.azimuth < 0.1 and weights.zenith < 0.1
    assert error(guidance.gradient) < 1.1 * error(prior_gradient(depth, WIDE))


def test_each_kind_of_reflection_is_judged_by_itself():
    depth = prior_of("bumpy")
    left, good, bad = U < 60, cues_of("matte", depth), random_cues(np.full(WIDE.shape, Reflection.SPECULAR))
    mixed = Cues(*(np.where(left, a, b) for a, b in zip(vars(good).values(), vars(bad).values(), strict=True)))
    guidance = guide(depth, mixed, stereo_gradient(), WIDE)
    assert guidance.diffuse.azimuth > 0.95 and guidance.diffuse.zenith > 0.95
    assert guidance.specular.azimuth < 0.1 and guidance.specular.zenith < 0.1
    assert error(np.where(left[..., None], guidance.gradient, np.nan)) < 0.3 * error(prior_gradient(depth, WIDE))


@pytest.mark.parametrize("expected", [CueWeights(0.6, 0.3), CueWeights(1.0, 0.5), CueWeights(0.8, 0.8), CueWeights()])
def test_the_weights_are_those_of_the_model(expected):
    """g = g' + κ (β₁ (a - g') + β₂ (c - a)), with a tenth of the stereo points far off."""
    depth = prior_of("flattened")
    rng = np.random.default_rng(1)
    cues = random_cues(np.full(WIDE.shape, Reflection.DIFFUSE))
    cues = replace(cues, confidence=rng.uniform(0.2, 1.0, WIDE.shape).astype(np.float32))
    prior, cue = prior_gradient(depth, WIDE), log_range_gradient(cues.azimuth, cues.zenith, WIDE)
    turned = cue * (np.linalg.norm(prior, axis=-1) / np.linalg.norm(cue, axis=-1))[..., None]
    model = expected.azimuth * (turned - prior) + expected.zenith * (cue - turned)
    model = prior + cues.confidence[..., None] * model
    stereo = np.where(rng.random((*WIDE.shape, 1)) < 0.1, rng.normal(0, 0.1, model.shape), model)
    guidance = guide(depth, cues, stereo.astype(np.float32), WIDE)
    assert guidance.diffuse.azimuth == pytest.approx(expected.azimuth, abs=0.01)
    assert guidance.diffuse.zenith == pytest.approx(expected.zenith, abs=0.01)
    np.testing.assert_allclose(guidance.gradient, model, atol=2e-3)


def test_few_stereo_points_prove_nothing():
    depth = prior_of("bumpy")
    for gradient in (np.full_like(TRUE_GRADIENT, np.nan), stereo_gradient(share=0.01)):
        guidance = guide(depth, cues_of("matte", depth), gradient, WIDE)
        assert guidance.diffuse == guidance.specular == CueWeights()
        np.testing.assert_array_equal(guidance.gradient, prior_gradient(depth, WIDE))


def test_pixels_without_a_cue_follow_the_prior():
    depth = prior_of("bumpy")
    cues = cues_of("matte", depth)
    blind = U % 3 == 0
    for name, nothing in (("azimuth", np.nan), ("zenith", np.nan), ("label", 0), ("confidence", 0.0)):
        getattr(cues, name)[blind] = nothing
    guidance = guide(depth, cues, stereo_gradient(), WIDE)
    np.testing.assert_array_equal(guidance.gradient[blind], prior_gradient(depth, WIDE)[blind])
    assert guidance.diffuse.azimuth > 0.95


@pytest.mark.parametrize("material", KIND)
@pytest.mark.parametrize("prior", PRIORS)
def test_whatever_the_prior_the_gradient_is_finite(material, prior):
    depth = prior_of(prior)
    assert np.isfinite(guide(depth, cues_of(material, depth), stereo_gradient(), WIDE).gradient).all()


def test_a_prior_that_says_nothing_gives_no_gradient():
    depth = np.full(WIDE.shape, np.nan, np.float32)
    guidance = guide(depth, cues_of("matte", depth), stereo_gradient(), WIDE)
    assert np.isnan(guidance.gradient).all()
    assert guidance.diffuse == guidance.specular == CueWeights()


def test_a_hole_in_the_prior_stays_a_hole():
    depth = prior_of("bumpy")
    depth[40:44, 60:64] = np.nan
    guidance = guide(depth, cues_of("matte", depth), stereo_gradient(share=1.0), WIDE)
    assert guidance.diffuse.azimuth > 0.95
    assert np.isnan(guidance.gradient).any(-1).sum() < 60
