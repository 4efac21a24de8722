"""What other keyframes contradict: depth that they measured, and pictures that a leaked depth does not explain."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import MATERIALS, TEXTURED, moved, pixel_rays, stereo_views, turned

from polarmap.data.view import Neighbour
from polarmap.densify.validate import contradicted, contradicts_depth, contradicts_intensity, local_mean
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.synth import Material, scenes

CAMERA = PinholeCamera(width=120, height=90, fx=90.0, fy=90.0, cx=59.5, cy=44.5)
POSES = (moved(0.0), moved(0.25, 0.02), turned((0.02, 0.05, 0.1), (-0.25, 0.0, 0.05)))
TOLERANCE = 0.02


def wall(z) -> np.ndarray:
    return np.full(CAMERA.shape, z, np.float32)


@pytest.mark.parametrize(("z", "contradicted"), [(2.0, False), (2.09, False), (2.11, True), (1.89, True)])
def test_a_depth_is_contradicted_beyond_the_tolerance(z, contradicted):
    result = contradicts_depth(wall(z), wall(2.0), CAMERA, np.eye(4), tolerance=0.1)
    assert result.dtype == bool and (result == contradicted).all()


def test_what_the_other_view_does_not_know_or_see_is_not_contradicted():
    other = wall(2.0)
    other[:, :40] = np.nan
    result = contradicts_depth(wall(3.0), other, CAMERA, moved(-0.5), tolerance=0.1)
    shift = round(90 * 0.5 / 3)  # pixels to the left
    np.testing.assert_array_equal(result, np.broadcast_to(np.arange(120) >= 40 + shift, CAMERA.shape))
    assert not contradicts_depth(wall(np.nan), wall(2.0), CAMERA, np.eye(4), 0.1).any()


@pytest.fixture(scope="module")
def edge_views():
    """A textured near half plane before a bare far one, and the pictures of three views."""
    truth, views = stereo_views(scenes.edge(TEXTURED, MATERIALS["matte"]), CAMERA, POSES)
    images = [local_mean(view.image.stable) for view in views]
    return truth, images[0], [(image, inverse(T)) for image, T in zip(images[1:], POSES[1:], strict=True)]


def test_the_true_depth_is_hardly_contradicted(edge_views):
    truth, image, others = edge_views
    contradicted = contradicts_intensity(truth.depth, image, others, CAMERA, TOLERANCE)
    border = np.abs(np.arange(120) - 59.5) < 4
    assert contradicted[:, ~border].mean() < 0.01


def test_far_depth_that_leaked_onto_a_near_bare_surface_is_contradicted():
    """From the right, what is within 6 pixels of the dark near plane's border would lie on the bright far one."""
    dark = Material("dark", albedo=0.2, gloss=0.0)
    truth, views = stereo_views(scenes.edge(dark, MATERIALS["matte"]), CAMERA, POSES[:2])
    image, other = (local_mean(view.image.stable) for view in views)
    leaked = truth.depth.copy()
    leaked[:, 50:60] = truth.depth[:, 60:61]
    rejected = contradicts_intensity(leaked, image, [(other, inverse(POSES[1]))], CAMERA, TOLERANCE)
    assert rejected[15:75, 55:59].all() and not rejected[15:75, :50].any()


def test_wrong_depth_on_texture_is_contradicted(edge_views):
    truth, image, others = edge_views
    textured = np.s_[10:80, 10:50]
    rejected = [
        contradicts_intensity(truth.depth * factor, image, others, CAMERA, TOLERANCE)[textured].mean()
        for factor in (1.0, 1.1)
    ]
    assert rejected[0] < 0.01 and rejected[1] > 0.1


def test_one_view_that_agrees_is_enough(edge_views):
    truth, image, others = edge_views
    wrong = truth.depth * 1.1
    same_picture = image, np.eye(4)
    assert contradicts_intensity(wrong, image, others, CAMERA, TOLERANCE).any()
    assert not contradicts_intensity(wrong, image, [*others, same_picture], CAMERA, TOLERANCE)[:-1, :-1].any()


def test_points_that_no_view_sees_are_not_contradicted(edge_views):
    truth, image, _ = edge_views
    unlike = (1.0 - image, turned((0.0, np.pi, 0.0)))
    for others in ([], [unlike]):
        assert not contradicts_intensity(truth.depth, image, others, CAMERA, TOLERANCE).any()
    assert not contradicts_intensity(wall(np.nan), image, [(1.0 - image, np.eye(4))], CAMERA, TOLERANCE).any()


def test_the_local_mean_is_that_of_3_by_3_pixels():
    image = np.random.default_rng(0).random((6, 8), np.float32)
    mean = local_mean(image)
    assert mean.shape == image.shape
    assert mean[2, 3] == pytest.approx(image[1:4, 2:5].mean(), rel=1e-6)


def test_the_difference_is_that_of_a_plain_loop():
    rng = np.random.default_rng(0)
    camera = PinholeCamera(30, 20, 25.0, 24.0, 14.0, 10.0)
    depth = rng.uniform(1.0, 3.0, camera.shape).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    image, *pictures = rng.random((3, *camera.shape), np.float32)
    motions = [turned((0.1, 0.0, 0.2), (0.1, 0.0, -1.2)), moved(0.1, -0.1, 0.2)]
    least = np.full(camera.shape, np.inf)
    for there, T in zip(pictures, motions, strict=True):
        points = pixel_rays(camera) * depth[..., None] @ T[:3, :3].T + T[:3, 3]
        for v, u in np.argwhere(points[..., 2] > 0):
            x, y = (camera.matrix @ points[v, u])[:2] / points[v, u, 2]
            if 0 <= x < camera.width - 1 and 0 <= y < camera.height - 1:
                i, j = int(x), int(y)
                a, b = x - i, y - j
                value = (1 - b) * ((1 - a) * there[j, i] + a * there[j, i + 1])
                value += b * ((1 - a) * there[j + 1, i] + a * there[j + 1, i + 1])
                least[v, u] = min(least[v, u], abs(value - image[v, u]))
    others = list(zip(pictures, motions, strict=True))
    for tolerance in (0.02, 0.1, 0.3):
        clear = np.abs(least - tolerance) > 1e-4
        expected = np.isfinite(least) & (least > tolerance)
        assert 0 < expected[clear].sum() < clear.sum()
        np.testing.assert_array_equal(
            contradicts_intensity(depth, image, others, camera, tolerance)[clear], expected[clear]
        )


def test_all_views_at_once_contradict_what_they_do_one_by_one():
    """Of intensity and depth, where no projection is within rounding of the border or another pixel."""
    rng = np.random.default_rng(1)
    camera = PinholeCamera(60, 40, 50.0, 49.0, 28.0, 21.0)
    depth = rng.uniform(1.0, 3.0, camera.shape).astype(np.float32)
    depth[rng.random(depth.shape) < 0.1] = np.nan
    image, *pictures = rng.random((4, *camera.shape), np.float32)
    maps = [rng.uniform(0.8, 3.5, camera.shape).astype(np.float32), None, np.full(camera.shape, np.nan, np.float32)]
    motions = [turned((0.1, 0.0, 0.2), (0.1, 0.0, -0.4)), moved(0.1, -0.1, 0.2), moved(-0.2, 0.1, -0.1)]
    others = [Neighbour(p, T, z) for p, T, z in zip(pictures, motions, maps, strict=True)]
    means = [(local_mean(picture), T) for picture, T in zip(pictures, motions, strict=True)]
    expected = contradicts_intensity(depth, local_mean(image), means, camera, 0.05)
    by_depth = contradicts_depth(depth, maps[0], camera, motions[0], np.float32(0.5) * depth)
    found = contradicted(depth, image, others, camera, 0.05, 0.5)
    inside = np.s_[4:-4, 4:-4]
    assert 0.02 < expected.mean() < 0.9 and 0.02 < by_depth.mean() < 0.9
    assert (found == (expected | by_depth))[inside].mean() > 0.99
    assert not contradicted(np.full_like(depth, np.nan), image, others, camera, 0.0, 0.0).any()
    assert not contradicted(depth, image, [], camera, 0.0, 0.0).any()
