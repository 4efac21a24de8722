"""The network that comes with the package: the right file, fed rightly, better than nothing, refused where it fails."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from importlib.resources import files
from pathlib import Path

import numpy as np
import pytest

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.pipeline.mapper import Mapper
from polarmap.prior.alignment import align
from polarmap.prior.names import DEFAULT_PRIOR
from polarmap.prior.options import PriorOptions
from polarmap.prior.polarization_network import PolarNetwork, _input, _stokes
from polarmap.prior.priors import make_prior
from polarmap.synth import built_in_scene, render

CARD = Path(__file__).resolve().parents[2] / "docs/prior_network.md"
CAMERA = PinholeCamera(320, 240, 240.0, 240.0, 159.5, 119.5)


@pytest.fixture(scope="module")
def network() -> PolarNetwork:
    return PolarNetwork()


@pytest.fixture(scope="module")
def views() -> list[tuple[PolarizationImage, np.ndarray, np.ndarray]]:
    """Image, depth and normals of the built-in scenes, none of which the network was trained on."""
    found = []
    for name in ("room", "table", "corridor", "bare-room"):
        scene = built_in_scene(name)
        _, poses = scene.path(1)
        rendering = render(scene.scene, CAMERA, poses[0])
        found.append((image_of(rendering.stokes), rendering.depth, rendering.normal))
    return found


def image_of(stokes: np.ndarray) -> PolarizationImage:
    s0, s1, s2 = stokes
    grey = PolarizationImage.unpolarized(s0 / 2)
    return replace(grey, dolp=np.hypot(s1, s2) / s0, aolp=(0.5 * np.arctan2(s2, s1) % np.pi).astype(np.float32))


def relative_depth(network: PolarNetwork, image: PolarizationImage) -> np.ndarray:
    return network.predict(image, CAMERA).relative_inverse_depth


def rank_correlation(relative: np.ndarray, depth: np.ndarray) -> float:
    return align(relative, depth).rank_correlation


def test_the_file_is_the_one_that_the_model_card_describes():
    content = (files("polarmap.prior") / "polarnet.onnx").read_bytes()
    assert len(content) < 8_000_000
    (stated,) = re.findall(r"sha256 `([0-9a-f]{64})`", CARD.read_text(encoding="utf-8"))
    assert hashlib.sha256(content).hexdigest() == stated


def test_all_that_it_predicts_has_the_image_s_size(network, views):
    image, _, _ = views[0]
    found = network.predict(image, CAMERA)
    for array in (found.relative_inverse_depth, found.specular, found.sigma_depth, found.sigma_normal):
        assert (array.shape, array.dtype) == (CAMERA.shape, np.float32)
        assert np.isfinite(array).all()
    np.testing.assert_allclose(np.linalg.norm(found.normal, axis=-1), 1.0, atol=1e-4)
    assert 0.0 <= found.specular.min() <= found.specular.max() <= 1.0
    assert min(found.sigma_depth.min(), found.sigma_normal.min()) > 0.0


def test_it_tells_near_from_far(network, views):
    assert np.mean([rank_correlation(relative_depth(network, i), d) for i, d, _ in views]) > 0.7


def test_its_normals_face_the_camera_and_the_right_way(network, views):
    cosines = []
    for image, _, truth in views:
        normal = network.predict(image, CAMERA).normal
        assert np.mean((normal * CAMERA.rays()).sum(axis=-1) < 0) > 0.97
        cosines.append((normal * truth).sum(axis=-1).mean())
    assert np.mean(cosines) > 0.8


def test_in_a_hurry_it_looks_once(views):
    """What one look says is not what the mean of three does, but nearly."""
    image, _, _ = views[0]
    network = PolarNetwork(looks=3)
    three, hurried = network.predict(image, CAMERA), network.predict(image, CAMERA, hurry=True)
    once = PolarNetwork(looks=1).predict(image, CAMERA)
    np.testing.assert_array_equal(hurried.relative_inverse_depth, once.relative_inverse_depth)
    np.testing.assert_array_equal(hurried.normal, once.normal)
    assert not np.array_equal(three.relative_inverse_depth, once.relative_inverse_depth)
    assert np.corrcoef(three.relative_inverse_depth.ravel(), once.relative_inverse_depth.ravel())[0, 1] > 0.9


def test_the_prior_passes_on_how_often_it_looks_and_that_it_hurries(views):
    image, depth, _ = views[0]
    points = np.where(np.random.default_rng(0).random(depth.shape) < 0.02, depth, np.nan).astype(np.float32)
    three, one = (make_prior("polarnet", PriorOptions(looks=looks)) for looks in (3, 1))
    expected = one(image, points, CAMERA).aligned_depth
    np.testing.assert_array_equal(three(image, points, CAMERA, hurry=True).aligned_depth, expected)
    assert not np.array_equal(three(image, points, CAMERA).aligned_depth, expected)


def test_a_mirrored_look_sees_the_same_scene(network, views):
    for image, _, _ in views:
        tensor = _input(_stokes(image), CAMERA, (160, 192))
        (depth, normal, *_), (other_depth, other_normal, *_) = (network._look(tensor, m) for m in (False, True))
        assert np.corrcoef(depth.ravel(), other_depth.ravel())[0, 1] > 0.9
        assert (normal * other_normal).sum(axis=0).mean() > 0.9


def test_it_sees_polarization(network, views):
    image, _, _ = views[3]
    turned = replace(image, aolp=(image.aolp + np.pi / 3) % np.pi)
    ahead, misled, grey = (
        relative_depth(network, i) for i in (image, turned, PolarizationImage.unpolarized(image.intensity))
    )
    spread = np.std(ahead)
    assert np.abs(ahead - misled).mean() > 0.05 * spread
    assert np.abs(ahead - grey).mean() > 0.02 * spread


def test_clipped_and_dark_pixels_count_as_unpolarized(network, views):
    image, _, _ = views[0]
    wild = replace(image, dolp=np.full_like(image.dolp, 0.7), saturated=np.ones_like(image.saturated))
    grey = PolarizationImage.unpolarized(image.intensity)
    np.testing.assert_array_equal(relative_depth(network, wild), relative_depth(network, grey))


@pytest.mark.parametrize("shape", [(240, 320), (180, 320), (320, 240), (50, 70), (480, 480)])
def test_any_size_of_image_will_do(network, shape):
    camera = PinholeCamera(shape[1], shape[0], 1.1 * shape[1], 1.1 * shape[1], shape[1] / 2, shape[0] / 2)
    grey = PolarizationImage.unpolarized(np.random.default_rng(0).random(shape).astype(np.float32))
    found = network.predict(grey, camera).relative_inverse_depth
    assert found.shape == shape
    assert np.isfinite(found).all()


def test_an_image_of_another_camera_is_refused(network):
    with pytest.raises(InputError, match=r"intensity \(3, 4\) does not fit the camera \(240, 320\)"):
        network.predict(PolarizationImage.unpolarized(np.ones((3, 4), np.float32)), CAMERA)


def test_other_files_are_refused(tmp_path):
    with pytest.raises(InputError, match=r"gone\.onnx: there is no such file"):
        PolarNetwork(tmp_path / "gone.onnx")
    (tmp_path / "text.onnx").write_text("no network")
    with pytest.raises(InputError, match=r"text\.onnx: is not an ONNX network"):
        PolarNetwork(tmp_path / "text.onnx")


def test_other_networks_are_refused(shared_models):
    with pytest.raises(InputError, match="is not a network of this package"):
        PolarNetwork(shared_models / "tcmonodepth_small_192x320.onnx")


def test_as_a_prior_it_is_aligned_judged_and_bent(views):
    prior = make_prior("polarnet")
    rng = np.random.default_rng(0)
    for image, depth, _ in views:
        points = np.where(rng.random(depth.shape) < 0.02, depth, np.nan).astype(np.float32)
        found = prior(image, points, CAMERA)
        assert found.source == "polarnet", found.verdict
        assert np.nanmean(np.abs(found.depth / depth - 1.0)) < 0.1
        upside_down = np.where(np.isfinite(points), 1.0 / points, np.nan).astype(np.float32)
        refused = prior(image, upside_down, CAMERA)
        assert refused.source == "sparse"
        assert refused.verdict.startswith("polarnet rejected: ")


def test_the_mapper_takes_the_default_prior_with_its_options():
    options = PriorOptions()
    assert type(Mapper(CAMERA).steps.prior) is type(make_prior(DEFAULT_PRIOR, options))
    given = make_prior("sparse")
    assert Mapper(CAMERA, prior=given).steps.prior is given
