"""Metals: the relation of polarization to zenith against complex amplitudes, its inverse, the simulator's metals."""

from __future__ import annotations

from xml.etree import ElementTree

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scenes import WIDE, azimuth_of, polarization_of, turn_between

from polarmap.data.codes import Reflection
from polarmap.errors import InputError
from polarmap.geometry.surface import zenith_of
from polarmap.polarization.fresnel import (
    metal_dolp,
    metal_reflectances,
    metal_zeniths,
    pseudo_brewster_angle,
    specular_dolp,
)
from polarmap.polarization.metals import ALUMINIUM, COPPER, GOLD, METALS, STEEL, Metal
from polarmap.synth import Material, PointLight, Rectangle, Scene, Sphere, Texture, render, scenes
from polarmap.synth.conductor import conductor_reflectances
from polarmap.synth.mitsuba.export import write_mitsuba_scene
from polarmap.synth.scene import Pattern
from polarmap.synth.scenes.placement import pose

ZENITHS = np.linspace(0.0, np.pi / 2 - 1e-3, 300)
every_metal = pytest.mark.parametrize("metal", METALS, ids=lambda m: m.name)


@every_metal
def test_reflectances_are_those_of_complex_amplitudes(metal):
    expected = conductor_reflectances(np.cos(ZENITHS), metal.n, metal.k)
    np.testing.assert_allclose(metal_reflectances(ZENITHS, metal.n, metal.k), expected, rtol=1e-9)
    r_s, r_p = expected
    np.testing.assert_allclose(metal_dolp(ZENITHS, metal.n, metal.k), (r_s - r_p) / (r_s + r_p), atol=1e-12)


@every_metal
def test_a_facing_metal_reflects_both_polarizations_alike_by_the_textbook_formula(metal):
    expected = ((metal.n - 1) ** 2 + metal.k**2) / ((metal.n + 1) ** 2 + metal.k**2)
    assert conductor_reflectances(1.0, metal.n, metal.k) == pytest.approx((expected, expected))
    assert metal_dolp(0.0, metal.n, metal.k) == 0.0


def test_without_absorption_the_relation_is_that_of_a_dielectric():
    np.testing.assert_allclose(metal_dolp(ZENITHS, 1.5, 1e-9), specular_dolp(ZENITHS, 1.5), atol=1e-7)


@every_metal
def test_the_degree_rises_to_the_pseudo_brewster_angle_and_falls_beyond(metal):
    top = pseudo_brewster_angle(metal.n, metal.k)
    assert 65.0 < np.degrees(top) < 85.0
    angles = np.linspace(0.0, np.pi / 2, 2000)
    steps = np.diff(metal_dolp(angles, metal.n, metal.k))
    assert (steps[angles[1:] < top - 1e-3] > 0).all() and (steps[angles[:-1] > top + 1e-3] < 0).all()
    assert metal_dolp(np.pi / 2, metal.n, metal.k) < 1e-9


@settings(deadline=None, max_examples=100)
@given(share=st.floats(0.0, 1.0), metal=st.sampled_from(METALS))
def test_both_zeniths_come_back(share, metal):
    top = pseudo_brewster_angle(metal.n, metal.k)
    most = metal_dolp(top, metal.n, metal.k)
    for zenith, side in ((share * top, 0), (np.pi / 2 - share * (np.pi / 2 - top), 1)):
        rho = metal_dolp(zenith, metal.n, metal.k)
        tolerance = 1e-3 if rho < 0.99 * most else 0.06  # where the roots meet, ρ is flat
        assert metal_zeniths(rho, metal.n, metal.k)[side] == pytest.approx(zenith, abs=tolerance)


def test_degrees_out_of_range_take_the_nearest_angle():
    top = pseudo_brewster_angle(STEEL.n, STEEL.k)
    below, above = metal_zeniths(np.array([-0.1, 1.0]), STEEL.n, STEEL.k)
    np.testing.assert_allclose(below, [0.0, top], atol=1e-6)
    np.testing.assert_allclose(above, [np.pi / 2, top], atol=1e-6)
    assert below.dtype == np.float32


@pytest.mark.parametrize(("n", "k"), [(0.0, 3.0), (1.5, 0.5), (np.nan, 3.0), (3.0, np.inf), (3.0, -1.0)])
def test_what_is_no_metal_is_refused(n, k):
    with pytest.raises(InputError, match="no metal's"):
        metal_zeniths(0.1, n, k)


@every_metal
def test_the_simulator_polarizes_a_sphere_of_metal_by_the_relation_and_across_the_plane_of_incidence(metal):
    view = render(scenes.sphere(Material.metal(metal)), WIDE, np.eye(4))
    hit = np.isfinite(view.depth)
    zenith = zenith_of(view.normal.astype(float), WIDE)
    inside = hit & (zenith < 1.4)
    dolp = np.hypot(view.stokes[1], view.stokes[2]) / np.where(hit, view.stokes[0], 1.0)
    np.testing.assert_allclose(dolp[inside], metal_dolp(zenith[inside], metal.n, metal.k), atol=2e-4)
    assert (view.reflection[hit & (zenith > 0.05)] == Reflection.SPECULAR).all()
    across = np.abs(turn_between(2 * polarization_of(view).aolp, 2 * azimuth_of(view.normal, WIDE)))
    near_axis = inside & (zenith > 0.2) & (np.linalg.norm(WIDE.normalized(), axis=-1) < 0.15)
    assert near_axis.sum() > 50 and across[near_axis].min() > np.pi - 0.1  # perpendicular but for perspective


def test_a_metal_has_no_body_light():
    bright = Material("steel", albedo=0.9, eta=STEEL.n, absorption=STEEL.k, gloss=0.0)
    lamp = PointLight((0.0, 0.0, -1.0), 4.0)
    view = render(Scene((Sphere(bright, pose((0.0, 0.0, 2.0)), radius=0.5),), lamp), WIDE, np.eye(4))
    assert (view.stokes[:, np.isfinite(view.depth)] == 0.0).all()


def test_a_mirrored_metal_is_as_bright_as_it_reflects_the_surround():
    wall = Rectangle(Material.metal(ALUMINIUM), pose((0.0, 0.0, -1.0), (0.0, 0.0, 1.0)))
    mirror = Rectangle(Material.metal(GOLD), pose((0.0, 0.0, 1.0), (0.0, 0.0, -1.0)))
    view = render(Scene((wall, mirror), surround=0.7), WIDE, np.eye(4))
    v, u = 44, 59
    cosine = 1.0 / np.hypot(1.0, np.linalg.norm(WIDE.normalized()[v, u]))
    facing = conductor_reflectances(1.0, ALUMINIUM.n, ALUMINIUM.k)[0]
    expected = 0.5 * sum(conductor_reflectances(cosine, GOLD.n, GOLD.k)) * facing * 0.7
    assert view.stokes[0, v, u] == pytest.approx(expected, rel=1e-5)


@pytest.mark.parametrize(
    ("make", "problem"),
    [
        (lambda: Material("lead", absorption=-1.0), "absorption of lead"),
        (lambda: Material("lead", absorption=np.nan), "absorption of lead"),
        (lambda: Material("lead", eta=0.0, absorption=3.0), "eta of lead, a metal"),
        (lambda: Material("lead", texture=Texture(Pattern.NOISE, 0.1), absorption=3.0), "no body that a texture"),
    ],
)
def test_metals_out_of_range_are_refused(make, problem):
    with pytest.raises(InputError, match=problem):
        make()


def test_an_index_below_that_of_air_is_for_metals_only():
    assert Material.metal(GOLD).eta == GOLD.n < 1.0
    with pytest.raises(InputError, match="eta of gold must be over 1"):
        Material("gold", eta=GOLD.n)


def test_metals_are_exported_to_mitsuba_as_conductors(tmp_path):
    write_mitsuba_scene(tmp_path / "ball.xml", scenes.sphere(Material.metal(COPPER, gloss=0.8)), WIDE, np.eye(4))
    root = ElementTree.parse(tmp_path / "ball.xml").getroot()
    (bsdf,) = root.findall(".//bsdf[@type='roughconductor']")
    values = {child.get("name"): float(child.get("value")) for child in bsdf}
    assert (values["eta"], values["k"], values["specular_reflectance"]) == (COPPER.n, COPPER.k, 0.8)


def test_metals_are_told_apart_by_name_and_all_have_indices_of_metals():
    assert len({metal.name for metal in METALS}) == len(METALS) and all(isinstance(m, Metal) for m in METALS)
    for metal in METALS:
        metal_zeniths(0.1, metal.n, metal.k)
