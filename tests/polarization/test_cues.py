"""Golden physics: what the simulator's Stokes vectors say about normals must be the truth."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from scenes import TYPICAL, WIDE, angle_between, azimuth_of, polarization_of, turn_between, view_of

from polarmap.data.codes import Reflection
from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.surface import incidence_direction, zenith_of
from polarmap.polarization.cues import disambiguate, zenith_tables
from polarmap.polarization.fresnel import diffuse_dolp, diffuse_zenith, specular_zeniths
from polarmap.polarization.options import CueOptions
from polarmap.synth import built_in_scene, render, scenes

KIND = {"matte": Reflection.DIFFUSE, "glass": Reflection.SPECULAR}
every_surface = pytest.mark.parametrize("shape", ["sphere", "plane", "cylinder"])
every_kind = pytest.mark.parametrize("material", KIND)


def perturbed(normals: np.ndarray, degrees: float) -> np.ndarray:
    """Normals turned by up to about this angle, differently at each pixel."""
    noise = np.random.default_rng(5).uniform(-1, 1, normals.shape) * np.tan(np.radians(degrees)) / np.sqrt(2)
    turned = normals + noise
    return (turned / np.linalg.norm(turned, axis=-1, keepdims=True)).astype(np.float32)


def image_of(aolp: float, dolp: float, shape=(1, 1), sigma_aolp: float = 0.01, **changes) -> PolarizationImage:
    flat = {
        "intensity": 0.5, "dolp": dolp, "aolp": aolp, "sigma_dolp": 0.01, "sigma_aolp": sigma_aolp,
        "saturated": False, "underexposed": False, **changes,
    }  # fmt: skip
    return PolarizationImage(
        **{name: np.full(shape, v, np.float32 if type(v) is float else bool) for name, v in flat.items()}
    )


def tilted_prior(azimuth: float, zenith: float, shape=(1, 1)) -> np.ndarray:
    normal = [np.sin(zenith) * np.cos(azimuth), np.sin(zenith) * np.sin(azimuth), -np.cos(zenith)]
    return np.broadcast_to(np.float32(normal), (*shape, 3))


def axis_camera(shape=(1, 1)) -> PinholeCamera:
    """So long a lens that every ray is the optical axis."""
    return PinholeCamera(shape[1], shape[0], 1e5, 1e5, (shape[1] - 1) / 2, (shape[0] - 1) / 2)


@every_kind
@every_surface
@pytest.mark.parametrize("rolled", [False, True])
def test_cues_are_the_truth(shape, material, rolled):
    truth = view_of(shape, material, rolled)
    cues = disambiguate(polarization_of(truth), truth.normal, WIDE)
    hit = np.isfinite(truth.depth)
    known = hit & (cues.label > 0)
    zenith = zenith_of(truth.normal, WIDE)
    assert known.sum() > 0.99 * hit.sum()
    assert (cues.label[known] == KIND[material]).all()
    tilted = known & (zenith > 0.1)
    assert np.degrees(turn_between(cues.azimuth, azimuth_of(truth.normal, WIDE)))[tilted].max() < 0.05
    assert np.degrees(np.abs(cues.zenith - zenith))[tilted].max() < 0.2
    off = angle_between(cues.normals(WIDE), truth.normal)
    assert off[tilted].max() < 0.2 and off[known].max() < 1.5
    assert np.median(cues.confidence[known]) > 0.99


@every_kind
def test_what_hits_nothing_has_no_cue(material):
    truth = view_of("sphere", material)
    cues = disambiguate(polarization_of(truth), truth.normal, WIDE)
    nothing = np.isnan(truth.depth)
    assert (cues.label[nothing] == Reflection.NONE).all() and (cues.confidence[nothing] == 0).all()
    assert np.isnan(cues.azimuth[nothing]).all() and np.isnan(cues.zenith[nothing]).all()


@every_kind
@every_surface
def test_a_prior_that_is_off_by_10_degrees_is_good_enough(shape, material):
    truth = view_of(shape, material)
    cues = disambiguate(polarization_of(truth), perturbed(truth.normal, 10.0), WIDE)
    zenith = zenith_of(truth.normal, WIDE)
    clear = (
        np.isfinite(truth.depth) & (zenith > np.radians(25.0)) & (np.abs(zenith - np.arctan(1.5)) > np.radians(15.0))
    )
    assert clear.sum() > 500
    assert (cues.label[clear] == KIND[material]).all()
    assert angle_between(cues.normals(WIDE), truth.normal)[clear].max() < 0.2


@every_kind
@every_surface
def test_the_orthographic_reading_is_visibly_wrong_off_the_axis(shape, material):
    truth = view_of(shape, material)
    cues = disambiguate(polarization_of(truth), truth.normal, WIDE, CueOptions(orthographic=True))
    known = np.isfinite(truth.depth) & (cues.label > 0)
    assert np.median(angle_between(cues.normals(WIDE, orthographic=True), truth.normal)[known]) > 8.0


@every_kind
def test_through_a_long_lens_the_orthographic_reading_is_right(material):
    camera = PinholeCamera(61, 61, 4000.0, 4000.0, 30.0, 30.0)
    scene = scenes.sphere(scenes.MATTE if material == "matte" else scenes.BLACK_GLASS, (0.0, 0.0, 2.0), radius=0.02)
    truth = render(scene, camera, np.eye(4))
    cues = disambiguate(polarization_of(truth), truth.normal, camera, CueOptions(orthographic=True))
    tilted = zenith_of(truth.normal, camera) > 0.1
    assert tilted.sum() > 1000
    assert angle_between(cues.normals(camera, orthographic=True), truth.normal)[tilted].max() < 1.0


def test_a_camera_rolled_by_90_degrees_sees_the_azimuth_turned_back():
    """In the world it is the same normal: the world's x axis is the rolled camera's -y."""
    upright, rolled = (
        disambiguate(polarization_of(view), view.normal, WIDE)
        for view in (view_of("plane", "matte"), view_of("plane", "matte", rolled=True))
    )
    centre = 44, 59
    assert turn_between(rolled.azimuth[centre], upright.azimuth[centre] - np.pi / 2) < 0.02
    assert rolled.zenith[centre] == pytest.approx(upright.zenith[centre], abs=0.02)


@every_surface
def test_noise_moves_the_azimuth_as_much_as_its_sigma_says(shape):
    truth = view_of(shape)
    image = polarization_of(truth, TYPICAL, seed=2)
    cues = disambiguate(image, truth.normal, WIDE)
    clear = (cues.label == Reflection.DIFFUSE) & (image.sigma_aolp < 0.1)
    error = (cues.azimuth - azimuth_of(truth.normal, WIDE) + np.pi) % (2 * np.pi) - np.pi
    assert clear.sum() > 800
    assert np.std((error / image.sigma_aolp)[clear]) == pytest.approx(1.0, abs=0.1)


@every_kind
@every_surface
def test_with_typical_noise_labels_hold_and_normals_stay_near(shape, material):
    truth = view_of(shape, material)
    cues = disambiguate(polarization_of(truth, TYPICAL, seed=3), perturbed(truth.normal, 10.0), WIDE)
    clear = (cues.confidence > 0.5) & (zenith_of(truth.normal, WIDE) < 1.2)
    assert clear.sum() > 0.35 * np.isfinite(truth.depth).sum()
    assert (cues.label[clear] == KIND[material]).mean() > 0.99
    assert np.median(angle_between(cues.normals(WIDE), truth.normal)[clear]) < (6.0 if material == "matte" else 2.5)


def test_where_both_kinds_mix_the_label_is_the_stronger_one():
    room = built_in_scene("room")
    truth = render(room.scene, WIDE, room.path(frames=1)[1][0])
    image = polarization_of(truth)
    label = disambiguate(image, truth.normal, WIDE, CueOptions(vote_radius=0)).label
    polarized = (label > 0) & (image.dolp > 0.005)
    assert min(np.bincount(truth.reflection[polarized])[1:]) > 1000
    assert (label == truth.reflection)[polarized].mean() > 0.999


def test_the_prior_chooses_between_the_specular_zeniths():
    low, high = specular_zeniths(0.6)
    for prior, expected in ((0.2, low), (low + 0.1, low), (high - 0.1, high), (1.5, high)):
        cues = disambiguate(image_of(0.5, 0.6), tilted_prior(0.5 + np.pi / 2, prior), axis_camera())
        assert cues.label[0, 0] == Reflection.SPECULAR
        assert cues.zenith[0, 0] == pytest.approx(float(expected), abs=1e-3)


def test_a_glass_sphere_has_normals_on_either_side_of_the_brewster_angle():
    truth = view_of("sphere", "glass")
    cues = disambiguate(polarization_of(truth), truth.normal, WIDE)
    for side in (cues.zenith < 0.9, cues.zenith > 1.05):
        assert side.sum() > 100
        assert angle_between(cues.normals(WIDE), truth.normal)[side & (cues.zenith > 0.1)].max() < 0.2


@pytest.mark.parametrize("eta", [1.3, 1.5, 1.8])
def test_more_polarization_than_diffuse_light_can_have_is_specular(eta):
    most = float(diffuse_dolp(np.pi / 2, eta))
    along = tilted_prior(0.5, 0.7)  # the prior votes for diffuse
    for dolp, kind in ((most - 0.02, Reflection.DIFFUSE), (most + 0.1, Reflection.SPECULAR)):
        cues = disambiguate(image_of(0.5, dolp), along, axis_camera(), CueOptions(refractive_index=eta))
        assert cues.label[0, 0] == kind


@pytest.mark.parametrize("prior_azimuth", np.arange(-3.0, 3.1, 0.5))
def test_the_candidate_nearest_to_the_prior_is_taken(prior_azimuth):
    cues = disambiguate(image_of(0.4, 0.1), tilted_prior(prior_azimuth, 0.6), axis_camera())
    candidates = 0.4 + np.pi / 2 * np.arange(4)
    nearest = int(np.argmin(turn_between(candidates, prior_azimuth)))
    assert turn_between(cues.azimuth[0, 0], candidates[nearest]) < 1e-4
    assert cues.label[0, 0] == (Reflection.DIFFUSE if nearest % 2 == 0 else Reflection.SPECULAR)
    expected = diffuse_zenith(0.1) if nearest % 2 == 0 else specular_zeniths(0.1)[0]
    if nearest % 2 == 0:
        assert cues.zenith[0, 0] == pytest.approx(float(expected), abs=1e-3)


def chosen_by_loop(image, prior, camera):
    """Azimuth and label of the nearest of four candidates at each pixel, and its lead on the other kind."""
    azimuth, label, margin = np.zeros(camera.shape), np.zeros(camera.shape, int), np.zeros(camera.shape)
    d, xy = incidence_direction(prior, camera), camera.normalized().astype(float)
    for v, u in np.ndindex(camera.shape):
        phi, x = image.aolp[v, u], xy[v, u]
        across = (np.eye(2) + np.outer(x, x)) @ [-np.sin(phi), np.cos(phi)]
        angles = np.array([phi, phi + np.pi, *(np.arctan2(across[1], across[0]) + np.pi * np.arange(2))])
        away = turn_between(angles, np.arctan2(d[v, u, 1], d[v, u, 0]))
        azimuth[v, u] = angles[away.argmin()]
        label[v, u] = 1 + away.argmin() // 2
        margin[v, u] = abs(away[:2].min() - away[2:].min())
    return azimuth, label, margin


def test_any_prior_and_any_angle_agree_with_a_plain_loop():
    rng = np.random.default_rng(7)
    normals = rng.normal(size=(*WIDE.shape, 3)) * [0.5, 0.5, 0.0] - [0.0, 0.0, 1.0]
    prior = (normals / np.linalg.norm(normals, axis=-1, keepdims=True)).astype(np.float32)
    image = replace(image_of(0.0, 0.2, WIDE.shape), aolp=rng.uniform(0, np.pi, WIDE.shape).astype(np.float32))
    cues = disambiguate(image, prior, WIDE, CueOptions(vote_radius=0))
    azimuth, label, margin = chosen_by_loop(image, prior, WIDE)
    clear = (margin > 0.3) & (zenith_of(prior, WIDE) > 0.05)
    assert clear.sum() > 5000
    np.testing.assert_array_equal(cues.label[clear], label[clear])
    assert turn_between(cues.azimuth, azimuth)[clear].max() < 1e-3


def test_neighbours_outvote_a_pixel_whose_prior_is_wrong():
    shape = (9, 9)
    prior = tilted_prior(0.4, 0.6, shape).copy()
    prior[4, 4] = tilted_prior(0.4 + np.pi / 2, 0.6)[0, 0]
    image = image_of(0.4, 0.1, shape)
    alone = disambiguate(image, prior, axis_camera(shape), CueOptions(vote_radius=0))
    assert alone.label[4, 4] == Reflection.SPECULAR and (alone.label == Reflection.DIFFUSE).sum() == 80
    voted = disambiguate(image, prior, axis_camera(shape), CueOptions(vote_radius=2))
    assert (voted.label == Reflection.DIFFUSE).all()
    assert voted.confidence[4, 4] == pytest.approx(alone.confidence[0, 0] * 23 / 25, abs=0.01)


def test_a_network_decides_the_kind_where_angles_do_not():
    shape = (5, 5)
    between = tilted_prior(0.4 + np.pi / 4 + 0.01, 0.6, shape)  # the angle fits specular light a little better
    image = image_of(0.4, 0.1, shape)

    def cues_of(weight, chance):
        specular = None if chance is None else np.full(shape, chance, np.float32)
        return disambiguate(image, between, axis_camera(shape), CueOptions(expected_kind=weight), specular=specular)

    alone = cues_of(0.5, None)
    assert (alone.label == Reflection.SPECULAR).all()
    assert (cues_of(0.5, 0.1).label == Reflection.DIFFUSE).all()
    assert (cues_of(0.5, 0.9).label == Reflection.SPECULAR).all()
    for nothing in (cues_of(0.5, 0.5), cues_of(0.0, 0.1)):  # undecided, or not asked
        np.testing.assert_array_equal(nothing.label, alone.label)
        np.testing.assert_allclose(nothing.confidence, alone.confidence, atol=1e-6)
    clear = disambiguate(image, tilted_prior(0.4, 0.6, shape), axis_camera(shape), specular=np.ones(shape, np.float32))
    assert (clear.label == Reflection.DIFFUSE).all(), "a clear angle outvotes the network"


@pytest.mark.parametrize(
    "change",
    [{"saturated": True}, {"underexposed": True}, {"dolp": 1.2}, {"sigma_aolp": 0.5}, {"dolp": 0.0, "sigma_aolp": 0.9}],
)
def test_degenerate_pixels_have_no_cue_and_no_vote(change):
    shape = (7, 7)
    image, bad = image_of(0.4, 0.1, shape), np.zeros(shape, bool)
    bad[3, 3] = True
    for name, value in change.items():
        array = getattr(image, name).copy()
        array[bad] = value
        image = replace(image, **{name: array})
    prior = tilted_prior(0.4, 0.6, shape).copy()
    prior[bad] = tilted_prior(0.4 + np.pi / 2, 0.6)[0, 0]
    cues = disambiguate(image, prior, axis_camera(shape))
    assert (cues.label[~bad] == Reflection.DIFFUSE).all() and cues.label[3, 3] == Reflection.NONE
    assert np.isnan(cues.azimuth[3, 3]) and np.isnan(cues.zenith[3, 3]) and cues.confidence[3, 3] == 0
    clean = disambiguate(image_of(0.4, 0.1, shape), tilted_prior(0.4, 0.6, shape), axis_camera(shape))
    np.testing.assert_allclose(cues.confidence[~bad], clean.confidence[~bad], rtol=1e-5)


def test_confidence_falls_with_noise_to_zero_at_the_limit():
    confidences = [
        float(disambiguate(image_of(0.4, 0.1, sigma_aolp=s), tilted_prior(0.4, 0.6), axis_camera()).confidence[0, 0])
        for s in (0.0, 0.1, 0.2, 0.29, 0.3)
    ]
    np.testing.assert_allclose(confidences, 1.0 - (np.array([0.0, 0.1, 0.2, 0.29, 0.3]) / 0.3) ** 2, atol=1e-4)


def test_where_the_prior_says_nothing_there_is_no_cue():
    truth = view_of("sphere")
    prior, hole = truth.normal.copy(), np.zeros(WIDE.shape, bool)
    hole[::4, ::4] = True
    prior[hole] = np.nan
    cues = disambiguate(polarization_of(truth), prior, WIDE)
    assert (cues.label[hole] == Reflection.NONE).all() and np.isnan(cues.azimuth[hole]).all()


@pytest.mark.parametrize("eta", [1.3, 1.5, 1.8])
def test_the_zenith_tables_hold_the_inverses(eta):
    rho = np.linspace(0.0, 1.0, zenith_tables(eta).shape[1]) ** 2
    expected = [diffuse_zenith(rho, eta), *specular_zeniths(rho, eta)]
    np.testing.assert_allclose(zenith_tables(eta), expected, atol=1e-6)


def test_shapes_that_do_not_fit_are_refused():
    image, prior = image_of(0.4, 0.1, (4, 4)), tilted_prior(0.4, 0.6, (4, 4))
    for wrong in ((image, prior[:3], axis_camera((4, 4))), (image, prior, axis_camera((5, 4)))):
        with pytest.raises(InputError, match="do not fit the camera"):
            disambiguate(*wrong)


@pytest.mark.parametrize("options", [{"refractive_index": 1.0}, {"max_sigma_aolp": 0.0}, {"vote_radius": -1}])
def test_options_out_of_range_are_refused(options):
    with pytest.raises(InputError, match=next(iter(options))):
        CueOptions(**options)
