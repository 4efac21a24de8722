"""The prior of a frame: a network where it fits the points, the points alone where it does not."""

from __future__ import annotations

import logging

import cv2
import numpy as np
import pytest
from onnx_files import answer

from polarmap.data.polarization_image import PolarizationImage
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.prior.alignment import Verdict
from polarmap.prior.bending import bend_to_points
from polarmap.prior.network import DepthNetwork
from polarmap.prior.options import PriorOptions
from polarmap.prior.prediction import Prediction
from polarmap.prior.priors import NetworkPrior, SparsePrior, make_prior

SHAPE = (120, 160)
CAMERA = PinholeCamera(160, 120, 140.0, 140.0, 79.5, 59.5)
V, U = np.mgrid[: SHAPE[0], : SHAPE[1]].astype(np.float32)
GREY = PolarizationImage.unpolarized(np.full(SHAPE, 0.5, np.float32))
HILLS = (0.5 + 0.0008 * U + 0.06 * np.sin(U / 20) * np.cos(V / 25)).astype(np.float32)  # inverse depth


class FixedNetwork:
    """Stands in for a network: its answer is given."""

    name = "fixed"

    def __init__(self, relative: np.ndarray) -> None:
        self.relative = relative.astype(np.float32)

    def predict(self, image: PolarizationImage, camera: PinholeCamera, hurry: bool = False) -> Prediction:
        return Prediction(self.relative)


class NetworkWithNormals(FixedNetwork):
    """Also says that everything faces the camera, to 0.2 radians."""

    def predict(self, image: PolarizationImage, camera: PinholeCamera, hurry: bool = False) -> Prediction:
        normal = np.broadcast_to(np.float32([0.0, 0.0, -1.0]), (*SHAPE, 3))
        return Prediction(self.relative, normal, sigma_normal=np.full(SHAPE, 0.2, np.float32))


class NetworkOfAMirror(FixedNetwork):
    """Also says how sure it is, and that the lower half mirrors."""

    def predict(self, image: PolarizationImage, camera: PinholeCamera, hurry: bool = False) -> Prediction:
        specular = np.where(V > 60, np.float32(0.9), np.float32(0.02))
        return Prediction(self.relative, specular=specular, sigma_depth=np.full(SHAPE, 0.05, np.float32))


def points_of(inverse_depth: np.ndarray, share: float = 0.01) -> np.ndarray:
    known = np.random.default_rng(0).random(inverse_depth.shape) < share
    return np.where(known, 1.0 / inverse_depth, np.nan).astype(np.float32)


def error(depth: np.ndarray, inverse_depth: np.ndarray) -> float:
    return float(np.mean(np.abs(depth * inverse_depth - 1.0)))


def test_sparse_is_the_name_of_a_prior():
    prior = make_prior("sparse")
    found = prior(GREY, points_of(HILLS, 0.1), CAMERA)
    assert isinstance(prior, SparsePrior)
    assert (found.source, found.alignment) == ("sparse", None)
    assert found.verdict == f"interpolated from {np.isfinite(points_of(HILLS, 0.1)).sum()} sparse points"
    assert found.depth.dtype == found.inverse_depth.dtype == np.float32
    np.testing.assert_allclose(found.depth * found.inverse_depth, 1.0, rtol=1e-5)
    assert error(found.depth, HILLS) < 0.01


@pytest.mark.parametrize("prior", [SparsePrior(), NetworkPrior(FixedNetwork(HILLS))])
def test_without_points_there_is_no_prior(prior):
    found = prior(GREY, np.full(SHAPE, np.nan, np.float32), CAMERA)
    assert np.isnan(found.depth).all()
    assert "no prior: 0 sparse points, 3 are needed" in found.verdict


def test_an_accepted_network_gives_its_shape():
    points = points_of(HILLS)
    found = NetworkPrior(FixedNetwork(30 * HILLS - 7))(GREY, points, CAMERA)
    assert (found.source, found.alignment.verdict) == ("fixed", Verdict.ACCEPTED)
    assert found.verdict.startswith("fixed accepted (rank correlation 1.00")
    assert error(found.depth, HILLS) < 0.5 * error(SparsePrior()(GREY, points, CAMERA).depth, HILLS)


def test_beside_a_network_stands_what_the_points_alone_give():
    points = points_of(HILLS)
    found = NetworkPrior(FixedNetwork(HILLS))(GREY, points, CAMERA)
    alone = SparsePrior()(GREY, points, CAMERA)
    np.testing.assert_array_equal(found.by_points, alone.depth)
    assert alone.by_points is None


@pytest.mark.parametrize(
    ("relative", "reason"),
    [
        (np.full(SHAPE, 3.0), "constant"),
        (-HILLS, "inverted"),
        (np.where(U > 70, np.nan, HILLS), "not finite"),
        (np.random.default_rng(1).random(SHAPE), "poor fit"),
    ],
)
def test_a_useless_network_leaves_the_sparse_prior(relative, reason):
    points = points_of(HILLS)
    found = NetworkPrior(FixedNetwork(relative))(GREY, points, CAMERA)
    expected = SparsePrior()(GREY, points, CAMERA)
    np.testing.assert_array_equal(found.depth, expected.depth)
    assert found.source == "sparse"
    assert found.verdict.startswith(f"fixed rejected: {reason}")
    assert expected.verdict in found.verdict


SKY = V < 40


def test_where_a_network_says_nothing_stand_the_points():
    points = points_of(HILLS, 0.05)
    found = NetworkPrior(FixedNetwork(np.where(SKY, np.nan, 30 * HILLS - 7)))(GREY, points, CAMERA)
    assert found.source == "fixed" and np.isfinite(found.depth).all()
    alone = SparsePrior()(GREY, points, CAMERA)
    np.testing.assert_allclose(found.aligned_depth[SKY], alone.depth[SKY], rtol=1e-5)
    np.testing.assert_allclose(found.aligned_depth[~SKY] * HILLS[~SKY], 1.0, rtol=0.01)


# A floor that begins under the horizon, with a post on it: depth goes with the row, but not all of it.
POST = (np.abs(U - 50) < 14) & (V > 30) & (V < 100)
FLOOR = np.where(POST, 0.75, 0.2 + 0.012 * np.maximum(V - 50, 0)).astype(np.float32)
TEXTURE = cv2.GaussianBlur(np.random.default_rng(3).standard_normal(SHAPE).astype(np.float32), (0, 0), 3)
BLIND = {
    "ramp": V,
    "power": V**4,
    "steps": np.floor(V / 12),
    "ramp and noise": V + 40 * TEXTURE,
    "corner": np.maximum(V - 50, 0) + 0.3 * np.abs(U - 80),
}


@pytest.mark.parametrize("name", BLIND)
def test_a_network_that_does_not_look_leaves_the_sparse_prior(name):
    points = points_of(FLOOR, 0.03)
    assert np.corrcoef(BLIND[name].ravel(), FLOOR.ravel())[0, 1] > 0.5  # no order of depths tells
    found = NetworkPrior(FixedNetwork(BLIND[name]))(GREY, points, CAMERA)
    assert found.verdict.startswith("fixed rejected: no better than the points (rank correlation 0."), found.verdict
    np.testing.assert_array_equal(found.depth, SparsePrior()(GREY, points, CAMERA).depth)


def test_a_network_that_looks_is_better_than_one_that_does_not():
    found = NetworkPrior(FixedNetwork(FLOOR + 0.01 * TEXTURE))(GREY, points_of(FLOOR, 0.03), CAMERA)
    assert found.source == "fixed", found.verdict


def test_points_in_one_place_cannot_tell_whether_a_network_looks():
    points = np.where((U < 20) & (V < 20), 1.0 / HILLS, np.nan).astype(np.float32)
    found = NetworkPrior(FixedNetwork(HILLS))(GREY, points, CAMERA)
    assert found.verdict.startswith("fixed rejected: too few anchors")


# --- output spaces known by a name alone ---


@pytest.mark.parametrize(
    ("name", "depth", "before", "now"),
    [
        ("midas_v21.onnx", 1.0 / HILLS, "inverse depth", "depth"),
        ("depth_anything_v2_vits_indoor.onnx", HILLS, "depth", "inverse depth"),
    ],
)
def test_a_name_that_is_wrong_about_the_output_is_found_out(tmp_path, caplog, name, depth, before, now):
    prior = make_prior(answer(tmp_path / name, depth, (1, 3, *SHAPE)))
    points = points_of(HILLS, 0.03)
    with caplog.at_level(logging.WARNING):
        found = [prior(GREY, points, CAMERA) for _ in range(4)]
    assert [prior_depth.source == "sparse" for prior_depth in found] == [True, False, False, False]
    assert "rejected: inverted" in found[0].verdict
    assert error(found[-1].depth, HILLS) < 0.03
    (line,) = [record.getMessage() for record in caplog.records]
    assert f"{name}: was taken for {before} by its name, but the stereo points fit it as {now}" in line
    assert "output_space in" in line and "\n" not in line


def test_a_declared_output_is_not_doubted(tmp_path, caplog):
    path = answer(tmp_path / "midas_v21.onnx", 1.0 / HILLS, (1, 3, *SHAPE))
    path.with_suffix(".yaml").write_text("output_space: inverse depth\n")
    prior = make_prior(path)
    found = [prior(GREY, points_of(HILLS, 0.03), CAMERA) for _ in range(4)]
    assert all(prior_depth.verdict.startswith("midas_v21 rejected: inverted") for prior_depth in found)
    assert not caplog.records


def test_a_network_that_is_right_by_its_name_is_not_turned_round(tmp_path, caplog):
    prior = make_prior(answer(tmp_path / "depth_anything_v2_vits_indoor.onnx", 1.0 / HILLS, (1, 3, *SHAPE)))
    upside_down = points_of(1.0 / HILLS, 0.03)  # points of another scene, once
    sources = [prior(GREY, points, CAMERA).source for points in (upside_down, *[points_of(HILLS, 0.03)] * 2)]
    assert sources == ["sparse", prior.network.name, prior.network.name]
    assert not caplog.records


def test_a_scale_that_differs_between_surfaces_is_bent_back():
    left = U < 80
    image = PolarizationImage.unpolarized(np.where(left, 0.9, 0.2).astype(np.float32))
    uneven = HILLS * np.where(left, 1.0, 1.3)
    points = points_of(HILLS, 0.05)
    bent = NetworkPrior(FixedNetwork(uneven))(image, points, CAMERA)
    affine = NetworkPrior(FixedNetwork(uneven), PriorOptions(refine=False))(image, points, CAMERA)
    assert bent.alignment == affine.alignment
    assert error(bent.depth, HILLS) < 0.1 * error(affine.depth, HILLS)


def test_bending_is_bounded_by_the_points():
    points = np.where(U < 10, 2.0, np.nan).astype(np.float32)
    wild = (0.5 + 5.0 * (U > 20)).astype(np.float32)
    bent = bend_to_points(wild, SparsePrior()(GREY, points, CAMERA).inverse_depth, GREY.intensity, points)
    assert bent.min() > 0.5 / 1.3
    assert bent.max() < 0.5 * 1.3


def test_shapes_must_fit_the_camera():
    for prior in (SparsePrior(), NetworkPrior(FixedNetwork(HILLS))):
        with pytest.raises(InputError, match=r"sparse depth \(3, 4\)"):
            prior(GREY, np.ones((3, 4), np.float32), CAMERA)
        with pytest.raises(InputError, match=r"intensity \(3, 4\)"):
            prior(PolarizationImage.unpolarized(np.ones((3, 4), np.float32)), GREY.intensity, CAMERA)


def test_a_missing_network_is_named(tmp_path):
    with pytest.raises(InputError, match=r"midas\.onnx: there is no such file"):
        make_prior(tmp_path / "midas.onnx")


# --- recorded scenes: points where a stereo method finds them, at strong gradients, with noise and outliers ---


def living_room(root, index: int) -> tuple[np.ndarray, np.ndarray]:
    mosaic = cv2.imread(str(root / f"livingroom/raw/{index:06d}.png"), cv2.IMREAD_UNCHANGED)
    depth = cv2.imread(str(root / f"livingroom/depth/{index:06d}.png"), cv2.IMREAD_UNCHANGED)
    return cv2.resize(mosaic, (640, 480), interpolation=cv2.INTER_AREA).astype(np.float32) / 255, depth / 5000.0


def office(root, index: int) -> tuple[np.ndarray, np.ndarray]:
    grey = cv2.imread(str(root / f"icl_office_kt0/gray/{index:04d}.png"), cv2.IMREAD_GRAYSCALE)
    depth = cv2.imread(str(root / f"icl_office_kt0/depth/{index:04d}.png"), cv2.IMREAD_UNCHANGED)
    return (grey.astype(np.float32) / 255) ** 2.2, depth / 5000.0


def gradient_points(intensity: np.ndarray, depth: np.ndarray, share: float) -> np.ndarray:
    rng = np.random.default_rng(0)
    smooth = cv2.GaussianBlur(np.sqrt(intensity), (0, 0), 1.0)
    gradient = np.hypot(cv2.Sobel(smooth, cv2.CV_32F, 1, 0), cv2.Sobel(smooth, cv2.CV_32F, 0, 1))
    seen = (depth > 0) & (gradient >= np.quantile(gradient, 1 - share))
    noisy = depth * (1 + 0.005 * rng.standard_normal(depth.shape))
    wrong = rng.random(depth.shape) < 0.05
    noisy[wrong] = rng.uniform(depth[depth > 0].min(), depth.max(), np.count_nonzero(wrong))
    return np.where(seen, noisy, np.nan).astype(np.float32)


def abs_rel(found: np.ndarray, depth: np.ndarray, points: np.ndarray) -> float:
    judged = (depth > 0) & ~np.isfinite(points)
    return float(np.mean(np.abs(found - depth)[judged] / depth[judged]))


ROOM = PinholeCamera(640, 480, 480.0, 480.0, 319.5, 239.5)


@pytest.mark.parametrize(("share", "bound"), [(0.05, 0.15), (0.2, 0.04)])
def test_the_living_room_is_interpolated(shared_data, share, bound):
    errors = []
    for index in (0, 24, 40):
        intensity, depth = living_room(shared_data, index)
        points = gradient_points(intensity, depth, share)
        errors.append(
            abs_rel(SparsePrior()(PolarizationImage.unpolarized(intensity), points, ROOM).depth, depth, points)
        )
    assert np.mean(errors) < bound


def test_a_network_is_used_where_it_works_and_refused_where_it_fails(shared_data, shared_models):
    prior = NetworkPrior(DepthNetwork(shared_models / "tcmonodepth_small_192x320.onnx"))
    for index in (0, 24, 40):
        intensity, depth = living_room(shared_data, index)
        points = gradient_points(intensity, depth, 0.05)
        found = prior(PolarizationImage.unpolarized(intensity), points, ROOM)
        assert found.alignment.accepted, found.verdict
        sparse = SparsePrior()(PolarizationImage.unpolarized(intensity), points, ROOM)
        assert abs_rel(found.depth, depth, points) < abs_rel(sparse.depth, depth, points)
    for index in (10, 70, 130, 250, 310, 430):  # ceilings, which this network has never seen
        intensity, depth = office(shared_data, index)
        found = prior(PolarizationImage.unpolarized(intensity), gradient_points(intensity, depth, 0.05), ROOM)
        assert found.source == "sparse"
        assert found.verdict.startswith("tcmonodepth_small_192x320 rejected: ")


def test_a_networks_own_view_is_kept_unless_it_is_rejected():
    points = points_of(HILLS, 0.1)
    found = NetworkPrior(NetworkWithNormals(2.0 * HILLS + 0.3))(GREY, points, CAMERA)
    accepted = found.prediction
    assert (accepted.normal[..., 2] == -1.0).all() and (accepted.sigma_normal == np.float32(0.2)).all()
    np.testing.assert_allclose(found.aligned_depth * HILLS, 1.0, rtol=0.01)  # in metres
    rejected = NetworkPrior(NetworkWithNormals(-HILLS))(GREY, points, CAMERA)
    assert rejected.source == "sparse" and rejected.prediction is None
    silent = NetworkPrior(FixedNetwork(HILLS))(GREY, points, CAMERA)
    assert silent.source == "fixed" and silent.prediction.normal is None
    assert SparsePrior()(GREY, points, CAMERA).prediction is None


def mirror_points(factor: float) -> tuple[np.ndarray, np.ndarray]:
    """Points of a floor, of which a patch lies `factor` times as far as the floor; and where that patch is."""
    points = points_of(HILLS, 0.1)
    patch = (V > 70) & (V < 100) & (U > 40) & (U < 110)
    points[patch] *= factor
    return points, patch


@pytest.mark.parametrize(("factor", "flagged"), [(1.6, True), (1.15, False), (0.6, False)])
def test_points_behind_what_the_network_takes_for_a_mirror_are_mirrored(factor, flagged):
    points, patch = mirror_points(factor)
    found = NetworkPrior(NetworkOfAMirror(3.0 * HILLS + 0.2))(GREY, points, CAMERA)
    known = np.isfinite(points)
    np.testing.assert_array_equal(found.mirrored, known & patch if flagged else np.zeros(SHAPE, bool))
    if flagged:
        assert error(found.depth[patch], HILLS[patch]) < 0.03
        assert error(found.by_points[patch], HILLS[patch]) < 0.1


def test_what_cannot_mirror_or_is_unsure_has_no_mirrored_points():
    points, _ = mirror_points(1.6)
    flipped = points[::-1].copy()  # the patch is in the upper half, which does not mirror
    mirror = NetworkPrior(NetworkOfAMirror(3.0 * HILLS[::-1] + 0.2))
    assert not mirror(GREY, flipped, CAMERA).mirrored.any()
    assert not NetworkPrior(FixedNetwork(3.0 * HILLS + 0.2))(GREY, points, CAMERA).mirrored.any()
