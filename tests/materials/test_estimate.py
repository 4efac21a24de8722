"""Refractive index and metals by region: what is found on surfaces of known material, and that all else stays."""

from __future__ import annotations

from dataclasses import replace
from functools import lru_cache

import numpy as np
import pytest
from scenes import TYPICAL, WIDE, polarization_of

from polarmap.data.codes import Reflection
from polarmap.data.sensor import SensorNoise
from polarmap.errors import InputError
from polarmap.geometry.surface import zenith_of
from polarmap.materials.estimate import estimate_materials
from polarmap.materials.metal_regions import find_metals
from polarmap.materials.refractive_index import estimate_refractive_index, shrunk
from polarmap.materials.regions import RegionFits, fit_regions, smooth_regions
from polarmap.materials.samples import DIFFUSE, SPECULAR, material_samples
from polarmap.pipeline.config import Config
from polarmap.pipeline.mapper import Mapper
from polarmap.polarization.cues import disambiguate
from polarmap.polarization.fresnel import (
    diffuse_dolp,
    diffuse_zenith,
    metal_dolp,
    metal_zeniths,
    specular_dolp,
    specular_zeniths,
)
from polarmap.polarization.metals import COPPER, METALS, STEEL
from polarmap.polarization.options import CueOptions
from polarmap.synth import DEFAULT_CAMERA, Material, Pattern, Texture, built_in_scene, render, scenes

QUIET = SensorNoise(full_well=200_000.0, read_noise=2.5)
NOISE = Texture(Pattern.NOISE, 0.2, 0.9, octaves=3, seed=1)
STEEL_ID = 1 + METALS.index(STEEL)


def perturbed(normals: np.ndarray, degrees: float) -> np.ndarray:
    """Normals turned by Gaussian angles, independently at each pixel."""
    turned = normals + np.random.default_rng(5).normal(size=normals.shape) * np.tan(np.radians(degrees))
    return (turned / np.linalg.norm(turned, axis=-1, keepdims=True)).astype(np.float32)


def papered(eta: float, gloss: float = 0.0, albedo: float = 0.45) -> Material:
    return Material("papered", albedo=albedo, texture=NOISE, eta=eta, gloss=gloss)


def seen(shape: str, material: Material, noise: SensorNoise = QUIET):
    """Truth, polarization image and noisy normals of a single surface."""
    truth = render(getattr(scenes, shape)(material), WIDE, np.eye(4))
    return truth, polarization_of(truth, noise, seed=2), perturbed(truth.normal, 1.0)


@lru_cache
def metal_table():
    """The scene of metals at a small size, with its polarization and noisy normals."""
    built_in = built_in_scene("metals")
    camera = DEFAULT_CAMERA.scaled(0.5)
    truth = render(built_in.scene, camera, built_in.path(frames=2)[1][0])
    metals = [i for i, material in enumerate(built_in.scene.materials) if material.is_metal]
    return camera, truth, polarization_of(truth, TYPICAL, seed=1), perturbed(truth.normal, 1.0), metals


def zenith_error(cues, truth, camera=WIDE) -> np.ndarray:
    return np.degrees(np.abs(cues.zenith - zenith_of(truth.normal, camera)))


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "plane"])
@pytest.mark.parametrize(("eta", "low", "high"), [(1.33, 1.3, 1.4), (1.5, 1.499, 1.501), (1.8, 1.65, 1.85)])
def test_the_index_of_a_matte_surface_is_found(shape, eta, low, high):
    truth, image, normals = seen(shape, papered(eta))
    found = estimate_refractive_index(image, normals, WIDE)
    assert found.shape == WIDE.shape and found.dtype == np.float32
    assert low < np.median(found[np.isfinite(truth.depth)]) < high
    assert (found[np.isnan(truth.depth)] == 1.5).all()


@pytest.mark.parametrize("shape", ["sphere", "cylinder", "plane"])
@pytest.mark.parametrize(("eta", "share"), [(1.33, 0.7), (1.8, 0.5)])
def test_the_zenith_error_falls_with_the_index_found(shape, eta, share):
    truth, image, normals = seen(shape, papered(eta))
    fixed = zenith_error(disambiguate(image, normals, WIDE), truth)
    found = estimate_refractive_index(image, normals, WIDE)
    with_index = zenith_error(disambiguate(image, normals, WIDE, eta=found), truth)
    assert np.nanmedian(with_index) < share * np.nanmedian(fixed)


def test_an_index_near_the_typical_one_is_left_alone():
    for eta in (1.48, 1.5, 1.53):
        _, image, normals = seen("plane", papered(eta))
        assert (estimate_refractive_index(image, normals, WIDE) == 1.5).all()


def test_a_surface_that_only_mirrors_has_no_say():
    for eta in (1.33, 1.8):
        _, image, normals = seen("sphere", Material("glass", albedo=0.0, eta=eta))
        assert (estimate_refractive_index(image, normals, WIDE) == 1.5).all()


@pytest.mark.parametrize("albedo", [0.05, 0.2, 0.5, 0.8])
@pytest.mark.parametrize("texture", [None, NOISE])
def test_under_mixed_light_the_index_stays_and_nothing_is_a_metal(albedo, texture):
    _, image, normals = seen("sphere", Material("plastic", albedo=albedo, texture=texture))
    np.testing.assert_allclose(estimate_refractive_index(image, normals, WIDE), 1.5, atol=0.03)
    assert not find_metals(image, normals, WIDE).any()


def test_of_noise_nothing_is_found():
    _, image, normals = seen("sphere", papered(1.5))
    rng = np.random.default_rng(3)
    noise = replace(
        image,
        aolp=rng.uniform(0, np.pi, WIDE.shape).astype(np.float32),
        dolp=rng.uniform(0.1, 0.9, WIDE.shape).astype(np.float32),
        sigma_dolp=np.full(WIDE.shape, 0.01, np.float32),
        sigma_aolp=np.full(WIDE.shape, 0.05, np.float32),
    )
    assert (estimate_refractive_index(noise, normals, WIDE) == 1.5).all()
    assert not find_metals(noise, normals, WIDE).any()


def test_without_normals_or_known_pixels_nothing_is_found():
    _, image, normals = seen("sphere", papered(1.8))
    nothing, nowhere = np.full_like(normals, np.nan), np.zeros(WIDE.shape, bool)
    assert (estimate_refractive_index(image, nothing, WIDE) == 1.5).all()
    assert (estimate_refractive_index(image, normals, WIDE, known=nowhere) == 1.5).all()
    assert not find_metals(image, nothing, WIDE).any()


def test_known_pixels_vote_for_their_whole_region():
    _, image, normals = seen("plane", papered(1.8))
    known = np.zeros(WIDE.shape, bool)
    known[::2, ::2] = True
    wrong = np.where(known[..., None], normals, np.roll(normals, 40, axis=1)).astype(np.float32)
    found = estimate_refractive_index(image, wrong, WIDE, known=known)
    assert (found == found[0, 0]).mean() > 0.95 and found[0, 0] > 1.6


def test_a_typical_index_other_than_the_paper_s_is_kept_where_nothing_is_found():
    _, image, normals = seen("sphere", papered(1.5))
    nothing = np.full_like(normals, np.nan)
    found = estimate_refractive_index(image, nothing, WIDE, options=CueOptions(refractive_index=1.4))
    np.testing.assert_array_equal(found, np.float32(1.4))


def test_metals_of_the_built_in_scene_are_found_and_little_else():
    camera, truth, image, normals, metals = metal_table()
    found = find_metals(image, normals, camera) > 0
    metal = np.isin(truth.material, metals)
    assert found[metal].mean() > 0.3
    assert found[~metal].mean() < 0.002


def test_the_zenith_error_on_metals_falls_with_their_label():
    camera, truth, image, normals, _ = metal_table()
    metal = find_metals(image, normals, camera)
    plain, labelled = disambiguate(image, normals, camera), disambiguate(image, normals, camera, metal=metal)
    there = labelled.label == Reflection.METAL
    assert there.sum() > 2000 and (plain.label[there] == Reflection.SPECULAR).all()
    np.testing.assert_array_equal(labelled.azimuth, plain.azimuth)
    before, after = (np.median(zenith_error(c, truth, camera)[there]) for c in (plain, labelled))
    assert before > 12.0 and after < 5.0
    everywhere = [np.nanmean(zenith_error(c, truth, camera)) for c in (plain, labelled)]
    assert everywhere[1] < everywhere[0] - 0.5


@pytest.mark.parametrize("name", ["bare-room", "corridor", "table", "street", "room"])
def test_scenes_without_metal_have_none(name):
    built_in = built_in_scene(name)
    camera = DEFAULT_CAMERA.scaled(0.4)
    truth = render(built_in.scene, camera, built_in.path(frames=2)[1][0])
    found = find_metals(polarization_of(truth, TYPICAL, seed=1), perturbed(truth.normal, 1.0), camera)
    assert (found > 0).mean() < 0.002


def test_a_map_of_one_index_gives_what_the_option_gives():
    _, image, normals = seen("sphere", papered(1.8))
    by_map = disambiguate(image, normals, WIDE, eta=np.full(WIDE.shape, 1.8, np.float32))
    by_option = disambiguate(image, normals, WIDE, CueOptions(refractive_index=1.8))
    for name in ("azimuth", "zenith", "label", "confidence"):
        np.testing.assert_allclose(getattr(by_map, name), getattr(by_option, name), atol=1e-6)
    for typical in (1.1, 1.505, 3.0):
        options = CueOptions(refractive_index=typical)
        unchanged = disambiguate(image, normals, WIDE, options, eta=np.full(WIDE.shape, typical, np.float32))
        np.testing.assert_array_equal(unchanged.zenith, disambiguate(image, normals, WIDE, options).zenith)
    beyond = disambiguate(image, normals, WIDE, eta=np.full(WIDE.shape, 3.0, np.float32))
    edge = disambiguate(image, normals, WIDE, eta=np.full(WIDE.shape, 2.0, np.float32))
    np.testing.assert_array_equal(beyond.zenith, edge.zenith)


def test_pixels_follow_the_index_and_metal_they_are_given():
    _, image, normals = seen("sphere", Material.metal(STEEL))
    eta = np.full(WIDE.shape, 1.4, np.float32)
    eta[:, 60:] = 1.7
    metal = np.zeros(WIDE.shape, np.uint8)
    metal[45:] = STEEL_ID
    cues = disambiguate(image, normals, WIDE, CueOptions(vote_radius=0), eta, metal)
    for label, rows, columns, zeniths in (
        (Reflection.SPECULAR, slice(0, 45), slice(0, 60), lambda rho: specular_zeniths(rho, 1.4)),
        (Reflection.SPECULAR, slice(0, 45), slice(60, None), lambda rho: specular_zeniths(rho, 1.7)),
        (Reflection.METAL, slice(45, None), slice(0, None), lambda rho: metal_zeniths(rho, STEEL.n, STEEL.k)),
        (Reflection.DIFFUSE, slice(0, 45), slice(0, 60), lambda rho: (diffuse_zenith(rho, 1.4),) * 2),
    ):
        chosen = (cues.label[rows, columns] == label) & (image.dolp[rows, columns] < 0.4)  # ρ is flat at its top
        assert chosen.any() or label == Reflection.DIFFUSE
        zenith = cues.zenith[rows, columns][chosen]
        low, high = zeniths(image.dolp[rows, columns][chosen])
        assert (np.minimum(np.abs(zenith - low), np.abs(zenith - high)) < 1e-3).all()


def test_what_polarizes_like_a_body_is_no_metal_whatever_the_map_says():
    _, image, normals = seen("sphere", papered(1.5))
    everywhere = disambiguate(image, normals, WIDE, metal=np.full(WIDE.shape, STEEL_ID, np.uint8))
    clear = image.sigma_aolp < 0.05
    assert (everywhere.label[clear] == Reflection.DIFFUSE).mean() > 0.95


def test_options_switch_both_off():
    _, image, normals = seen("sphere", papered(1.8))
    off = estimate_materials(image, normals, WIDE, options=CueOptions(metals=False, estimate_refractive_index=False))
    assert off.eta is None and off.metal is None
    both = estimate_materials(image, normals, WIDE)
    np.testing.assert_array_equal(both.eta, estimate_refractive_index(image, normals, WIDE))
    np.testing.assert_array_equal(both.metal, find_metals(image, normals, WIDE))
    assert estimate_materials(image, normals, WIDE, options=CueOptions(orthographic=True)).eta is None


def test_the_mapper_reads_cues_with_the_index_that_stereo_points_tell():
    plane = scenes.plane(papered(1.8))
    errors = {}
    for estimate in (False, True):
        keyframes = []
        config = Config(cues=CueOptions(estimate_refractive_index=estimate))
        mapper = Mapper(WIDE, config=config, on_keyframe=keyframes.append)
        for i in range(3):
            T_world_camera = np.eye(4)
            T_world_camera[0, 3] = 0.2 * i
            truth = render(plane, WIDE, T_world_camera)
            mapper.process_image(polarization_of(truth, QUIET, seed=i), T_world_camera, 0.1 * i, i)
        mapper.finish()
        truth = render(plane, WIDE, keyframes[-1].T_world_camera)
        errors[estimate] = np.nanmedian(zenith_error(keyframes[-1], truth))
    assert errors[True] < 0.5 * errors[False]


def test_samples_know_their_kind_and_region():
    for material, kind, relation in (
        (papered(1.5), DIFFUSE, diffuse_dolp),
        (Material("b", 0.0), SPECULAR, specular_dolp),
    ):
        truth, image, _ = seen("sphere", material)
        samples = material_samples(image, truth.normal, WIDE)
        assert (samples.kind == kind).mean() > 0.98 and samples.stride == 1
        np.testing.assert_allclose(samples.dolp, relation(samples.zenith, 1.5), atol=0.05)
        assert samples.region.min() >= 0 and samples.region.max() < samples.count


def test_regions_end_at_creases_at_gaps_and_at_labels():
    normals = np.zeros((20, 30, 3), np.float32)
    normals[..., 2] = -1.0
    normals[:, 15:] = [np.sin(0.5), 0.0, -np.cos(0.5)]
    assert len(np.unique(smooth_regions(normals)[:19, :29])) == 3  # two, and the pixels between
    labels = np.zeros((20, 30), np.int32)
    labels[10:] = 7
    assert len(np.unique(smooth_regions(normals, labels)[:19, :29])) == 5
    normals[:, 5] = np.nan
    assert smooth_regions(normals)[3, 5] == 0 and len(np.unique(smooth_regions(normals)[:19, :29])) == 4


def test_regions_are_fitted_apart_and_robustly():
    rng = np.random.default_rng(0)
    n = 1200
    region = np.repeat([0, 1, 2], [n, n, 20])
    rng.shuffle(region)
    x, z = rng.normal(size=(2, region.size))
    value = np.where(region == 0, 1.0 + 0.3 * x, 2.0 - 0.1 * z) + 0.05 * rng.normal(size=region.size)
    value[::10] += 3.0
    fits = fit_regions(region, value, np.ones(region.size), x, z, count=4, least=100)
    np.testing.assert_allclose(fits.value[:2], [1.0, 2.0], atol=0.03)
    np.testing.assert_allclose(fits.slope[:2], [0.3, 0.0], atol=0.02)
    np.testing.assert_allclose(fits.drift[:2], [0.0, -0.35], atol=0.05)
    np.testing.assert_allclose(fits.scatter[:2], 0.05, rtol=0.3)
    assert np.isnan(fits.value[2:]).all()
    np.testing.assert_array_equal(fits.samples, [n, n, 20, 0])


def test_an_uncertain_estimate_is_drawn_to_the_typical_one():
    def fits(value, sigma=0.0, slope=0.0, slope_sigma=0.0, scatter=0.05):
        columns = (value, sigma, slope, slope_sigma, 0.0, scatter, 0.5, 500.0)
        return RegionFits(*(np.array([float(c)]) for c in columns))

    best = shrunk(fits(1.8), 1.5)[0]
    assert 1.75 < best < 1.8
    assert 1.6 < shrunk(fits(1.8, sigma=0.12), 1.5)[0] < best
    for worse in (fits(1.8, sigma=0.3), fits(1.8, slope=0.4), fits(1.8, slope_sigma=0.4), fits(1.8, scatter=1.0)):
        assert shrunk(worse, 1.5)[0] == 1.5
    for too_near in (1.44, 1.47, 1.53, 1.56):
        assert shrunk(fits(too_near), 1.5)[0] == 1.5
    assert shrunk(fits(2.6), 1.5)[0] == 1.5 and shrunk(fits(1.1), 1.5)[0] == 1.5
    assert shrunk(fits(1.2, sigma=9.0), 1.2)[0] == 1.2


def test_what_does_not_fit_is_refused():
    _, image, normals = seen("sphere", papered(1.5))
    for function in (estimate_refractive_index, find_metals):
        with pytest.raises(InputError, match=r"normals .* do not fit the camera"):
            function(image, normals[:-1], WIDE)
        with pytest.raises(InputError, match=r"regions .* do not fit the camera"):
            function(image, normals, WIDE, np.zeros((3, 3), int))
        with pytest.raises(InputError, match=r"known pixels .* do not fit the camera"):
            function(image, normals, WIDE, known=np.zeros((3, 3), bool))
    for eta in (np.full((3, 3), 1.5), np.full(WIDE.shape, 1.0), np.full(WIDE.shape, np.nan)):
        with pytest.raises(InputError, match="eta"):
            disambiguate(image, normals, WIDE, eta=eta)
    for metal in (np.zeros((3, 3), np.uint8), np.full(WIDE.shape, len(METALS) + 1, np.uint8)):
        with pytest.raises(InputError, match="metal"):
            disambiguate(image, normals, WIDE, metal=metal)


def test_the_metal_that_is_chosen_polarizes_as_the_true_one_does():
    camera, truth, image, normals, _ = metal_table()
    found = find_metals(image, normals, camera)
    materials = [material.name for material in built_in_scene("metals").scene.materials]
    for metal in (STEEL, COPPER):
        there = found[truth.material == materials.index(metal.name)]
        degrees = np.array([np.nan, *(metal_dolp(0.7, m.n, m.k) for m in METALS)])[there]
        assert np.isfinite(degrees).mean() > 0.7
        np.testing.assert_allclose(degrees[np.isfinite(degrees)], metal_dolp(0.7, metal.n, metal.k), rtol=0.25)
