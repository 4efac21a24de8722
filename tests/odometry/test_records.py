"""What is kept for good: frames that move with their keyframe, and points that do."""

from __future__ import annotations

import numpy as np
from odometry_scenes import CAMERA, motion

from polarmap.geometry.pose import inverse
from polarmap.odometry import records
from polarmap.odometry.points import ActivePoints
from polarmap.odometry.records import FrameRecord, KeyframeRecord, PointArchive


def points_of(hosts, inverse_depth=None, information=100.0) -> ActivePoints:
    hosts = np.asarray(hosts, np.int32)
    count = len(hosts)
    rng = np.random.default_rng(count)
    depth = rng.uniform(0.2, 1.0, count) if inverse_depth is None else np.full(count, inverse_depth)
    return ActivePoints(
        hosts, rng.uniform(5, 100, (count, 2)).astype(np.float32), depth.astype(np.float32),
        rng.uniform(0, 255, (count, 8)).astype(np.float32), np.ones((count, 8), np.float32),
        np.ones((count, 4), np.uint8), np.full(count, information, np.float32), np.zeros(count, np.int32),
    )  # fmt: skip


def keyframe(index: int, segment: int = 0) -> KeyframeRecord:
    return KeyframeRecord(index, segment, motion(0.1 * index, 0.2, 0.3, 0.1, -0.05 * index, 0.2))


def test_frames_move_with_their_keyframe():
    reference = keyframe(3, segment=2)
    T_frame_reference = motion(0.1, 0.0, 0.2, 0.0, 0.1, 0.0)
    frame = FrameRecord(5, 0.5, reference, T_frame_reference)
    np.testing.assert_allclose(inverse(frame.T_world_camera) @ reference.T_world_camera, T_frame_reference, atol=1e-12)
    reference.T_world_camera = motion(1, 2, 3, 0.3, 0.2, 0.1)
    posed = frame.posed()
    np.testing.assert_allclose(inverse(posed.T_world_camera) @ reference.T_world_camera, T_frame_reference, atol=1e-12)
    assert (posed.index, posed.timestamp, posed.segment, posed.is_keyframe) == (5, 0.5, 2, False)
    assert FrameRecord(3, 0.3, reference, np.eye(4)).posed().is_keyframe


def test_points_lie_on_their_pixels_rays_where_their_keyframe_is_now():
    archive = PointArchive()
    by_slot = {0: keyframe(4), 2: keyframe(9, segment=1)}
    points = points_of([0, 2, 2, 0, 2])
    archive.add(points, by_slot, noise=2.0)
    by_slot[2].T_world_camera = motion(1, 2, 3, 0.3, 0.2, 0.1)
    found = archive.points(CAMERA)
    np.testing.assert_array_equal(found.host, [4, 4, 9, 9, 9])
    np.testing.assert_array_equal(found.segment, [0, 0, 1, 1, 1])
    order = np.argsort(points.host, kind="stable")
    np.testing.assert_array_equal(found.pixel, points.pixel[order])
    # eight pixels of a pattern that err together know no more than one
    np.testing.assert_allclose(found.inverse_depth_std, 2.0 * np.sqrt(8 / 100.0), rtol=1e-6)
    np.testing.assert_allclose(found.intensity, points.color[order, 4] / 255, rtol=1e-6)
    for n, record in enumerate([by_slot[0]] * 2 + [by_slot[2]] * 3):
        p = inverse(record.T_world_camera) @ np.append(found.position[n], 1.0)
        pixel = CAMERA.matrix @ p[:3] / p[2]
        np.testing.assert_allclose(pixel[:2], found.pixel[n], atol=1e-4)
        np.testing.assert_allclose(1 / p[2], found.inverse_depth[n], rtol=1e-6)


def test_a_joined_archive_leaves_the_first_as_it_was():
    archive, by_slot = PointArchive(), {0: keyframe(1), 1: keyframe(2)}
    archive.add(points_of([0] * 4), by_slot, 1.0)
    joined = archive.joined(points_of([1] * 6), by_slot, 1.0)
    assert len(joined.points(CAMERA).position) == 10
    assert len(archive.points(CAMERA).position) == 4


def test_too_many_points_are_thinned_evenly(monkeypatch):
    monkeypatch.setattr(records, "_MAX_POINTS", 100)
    archive, by_slot = PointArchive(), {0: keyframe(1), 1: keyframe(2)}
    for _ in range(20):
        archive.add(points_of([0] * 7 + [1] * 9), by_slot, 1.0)
    found = archive.points(CAMERA)
    assert 40 <= len(found.position) <= 100
    assert len(found.host) == len(found.pixel) == len(found.position)
    assert set(found.host) == {1, 2}


def test_an_empty_archive_gives_no_points():
    found = PointArchive().points(CAMERA)
    assert found.position.shape == (0, 3) and found.pixel.shape == (0, 2) and len(found.host) == 0


def test_a_point_without_information_has_a_large_finite_uncertainty():
    archive = PointArchive()
    archive.add(points_of([0], information=0.0), {0: keyframe(1)}, 1.0)
    std = archive.points(CAMERA).inverse_depth_std
    assert np.isfinite(std).all() and std[0] > 100
