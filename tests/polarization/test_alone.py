"""Normals of polarization alone: the truth, up to what a single picture leaves open."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import ROLLED, TYPICAL, WIDE, angle_between, polarization_of, turn_between, view_of

from polarmap.errors import InputError
from polarmap.geometry.surface import incidence_direction, zenith_of
from polarmap.polarization.alone import clearly_polarized, upward_normals
from polarmap.polarization.fresnel import diffuse_dolp
from polarmap.polarization.options import CueOptions
from polarmap.synth import render, scenes


def mirrored(normals: np.ndarray) -> np.ndarray:
    """The normals on the other side of the line of sight, 2(n·v)v - n."""
    rays = WIDE.rays()
    return 2.0 * np.einsum("hwc,hwc->hw", normals, rays)[..., None] * rays - normals


@pytest.mark.parametrize("rolled", [False, True])
def test_upward_normals_of_a_matte_sphere_are_the_truth_and_downward_ones_its_mirror_image(rolled):
    truth = view_of("sphere", "matte", rolled)
    image = polarization_of(truth)
    normals = upward_normals(image, WIDE)
    direction = incidence_direction(truth.normal, WIDE)
    known = np.isfinite(normals[..., 0]) & (image.dolp > 0.01)
    upward, downward = (known & (sign * direction[..., 1] < -1e-3) for sign in (1.0, -1.0))
    assert upward.sum() > 200 and downward.sum() > 200
    assert np.percentile(angle_between(normals, truth.normal)[upward], 99) < 0.5
    assert np.percentile(angle_between(normals, mirrored(truth.normal))[downward], 99) < 0.5
    assert (incidence_direction(normals, WIDE)[known][:, 1] < 1e-5).all()


@pytest.mark.parametrize("pose", [np.eye(4), ROLLED])
def test_more_polarization_than_diffuse_light_has_is_known_to_be_mirrored(pose):
    truth = render(scenes.sphere(scenes.BLACK_GLASS), WIDE, pose)
    image = polarization_of(truth)
    normals = upward_normals(image, WIDE)
    direction = incidence_direction(truth.normal, WIDE)
    below_brewster = zenith_of(truth.normal, WIDE) < np.arctan(1.5) - 0.05
    mirrors = below_brewster & (image.dolp > 1.05 * diffuse_dolp(np.pi / 2))
    upward, downward = (mirrors & (sign * direction[..., 1] < -1e-3) for sign in (1.0, -1.0))
    assert upward.sum() > 50 and downward.sum() > 50
    assert np.percentile(angle_between(normals, truth.normal)[upward], 99) < 1.0
    assert np.percentile(angle_between(normals, mirrored(truth.normal))[downward], 99) < 1.0
    taken_for_diffuse = np.isfinite(truth.depth) & (image.dolp < 0.3) & (zenith_of(truth.normal, WIDE) > 0.3)
    assert np.median(angle_between(normals, truth.normal)[taken_for_diffuse & (direction[..., 1] < 0)]) > 10.0


def test_nothing_is_said_where_noise_hides_the_angle():
    truth = view_of("sphere", "matte")
    image = polarization_of(truth, TYPICAL, seed=0)
    hidden = ~clearly_polarized(image)
    on_sphere, direction = np.isfinite(truth.depth), incidence_direction(truth.normal, WIDE)
    assert hidden[~on_sphere].mean() > 0.97  # unpolarized light
    assert 0.02 < hidden[on_sphere].mean() < 0.5
    turn = turn_between(2 * image.aolp, 2 * np.arctan2(direction[..., 1], direction[..., 0])) / 2
    assert np.percentile(turn[on_sphere & ~hidden], 95) < 0.35 < np.percentile(turn[on_sphere & hidden], 70)
    np.testing.assert_array_equal(np.isnan(upward_normals(image, WIDE)).any(axis=-1), hidden)
    nothing = upward_normals(replace(image, saturated=np.ones_like(hidden)), WIDE)
    assert np.isnan(nothing).all()


def test_an_orthographic_camera_looks_along_its_axis():
    image = polarization_of(view_of("plane", "matte"))
    clear = np.zeros(WIDE.shape, bool)
    flat = replace(
        image,
        saturated=clear,
        underexposed=clear,
        aolp=np.full_like(image.aolp, 0.7),
        dolp=np.full_like(image.dolp, 0.1),
    )
    normals = upward_normals(flat, WIDE, CueOptions(orthographic=True))
    assert np.ptp(normals.reshape(-1, 3), axis=0).max() < 1e-6
    assert np.arctan2(normals[0, 0, 1], normals[0, 0, 0]) == pytest.approx(0.7 - np.pi)
    assert np.ptp(upward_normals(flat, WIDE).reshape(-1, 3), axis=0).max() > 0.1


def test_an_image_of_another_size_is_refused():
    with pytest.raises(InputError, match="does not fit the camera"):
        upward_normals(polarization_of(view_of("plane", "matte")), WIDE.scaled(0.5))
