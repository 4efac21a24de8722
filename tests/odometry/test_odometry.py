"""Odometry from images to poses, on rendered scenes with known answers."""

from __future__ import annotations

from functools import lru_cache
from itertools import pairwise
from typing import NamedTuple

import cv2
import numpy as np
import pytest
from scenes import turned

from polarmap.data.codes import Status
from polarmap.data.odometry import OdometryResult, OdometryUpdate
from polarmap.data.trajectory import PosedFrame
from polarmap.errors import InputError
from polarmap.evaluation.alignment import Similarity, umeyama
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import is_rigid
from polarmap.odometry.odometry import Odometry
from polarmap.synth import built_in_scene, handheld_path, render

CAMERA = PinholeCamera(width=256, height=192, fx=192.0, fy=190.0, cx=127.5, cy=96.0)
ROOM = built_in_scene("room")
FRAMES = 44
STEP = 0.03  # metres from frame to frame
_FIRST = ROOM.path(FRAMES, STEP)[1]
_ROTATIONS = np.stack([turned((1e-9, 0.012 * k, 0.004 * k)) for k in range(24)])
PATHS = {
    "walk": _FIRST,
    "slow": ROOM.path(30, 0.008, seed=1)[1],
    "fast": ROOM.path(24, 0.1, seed=2)[1],
    "elsewhere": handheld_path((1.2, -1.0, 1.5), (-2.4, 1.5, 1.2), frames=20, step=2 * STEP, seed=3)[1],
    "turn": _FIRST[0] @ _ROTATIONS,
    "turn at the end": _FIRST[-1] @ _ROTATIONS[1:],
}
WALK = tuple(("walk", k) for k in range(FRAMES))


class Run(NamedTuple):
    updates: list[OdometryUpdate]
    result: OdometryResult


@lru_cache(maxsize=256)
def view(path: str, number: int, camera: PinholeCamera = CAMERA) -> np.ndarray:
    """What the camera sees at a pose of a path, 8-bit values in [0, 1] with a grey value of noise."""
    radiance = render(ROOM.scene, camera, PATHS[path][number], supersample=2).stokes[0]
    noise = np.random.default_rng(number).normal(0, 1 / 255, radiance.shape)
    image = (0.7 * radiance / _white() + noise).clip(0, 1)
    return (np.round(255 * image) / 255).astype(np.float32)


@lru_cache
def _white() -> float:
    return float(np.quantile(render(ROOM.scene, CAMERA, _FIRST[0], supersample=2).stokes[0], 0.99))


def along(path: str, first: int = 0, last: int | None = None) -> list[tuple[str, int]]:
    return [(path, k) for k in range(len(PATHS[path]))][first:last]


def track(
    images, indices=None, exposures=None, camera: PinholeCamera = CAMERA, odometry: Odometry | None = None
) -> Run:
    """Odometry over images at 30 per second."""
    odometry = odometry or Odometry(camera)
    indices = range(len(images)) if indices is None else indices
    exposures = exposures if exposures is not None else [None] * len(images)
    steps = zip(images, indices, exposures, strict=True)
    updates = [odometry.process(image, index / 30.0, index, exposure) for image, index, exposure in steps]
    odometry.finish()
    return Run(updates, odometry.result())


def track_views(views, **keywords) -> Run:
    return track([view(*v) for v in views], **keywords)


@lru_cache
def plain() -> Run:
    return track_views(WALK)


def replaced(numbers, change) -> list[np.ndarray]:
    """The walk with some frames changed."""
    return [change(view(*v)) if v[1] in numbers else view(*v) for v in WALK]


def aligned(frames: list[PosedFrame], truth: dict[int, np.ndarray]) -> tuple[Similarity, np.ndarray, float]:
    """The similarity to the truth, the frames' distances from it, and the length of the true path, in metres."""
    found = np.array([frame.T_world_camera[:3, 3] for frame in frames])
    true = np.array([truth[frame.index][:3, 3] for frame in frames])
    similarity = umeyama(found, true)
    return (
        similarity,
        np.linalg.norm(similarity.apply(found) - true, axis=1),
        float(np.linalg.norm(np.diff(true, axis=0), axis=1).sum()),
    )


def frames_of(result: OdometryResult, segment: int = 0) -> list[PosedFrame]:
    return [frame for frame in result.frames if frame.segment == segment]


def check_poses(result: OdometryResult, views, indices=None, rms: float = 0.003, worst: float = 0.01) -> None:
    """Every segment's positions and rotations are true but for a similarity; errors are shares of the path."""
    indices = range(len(views)) if indices is None else indices
    truth = {index: PATHS[path][number] for index, (path, number) in zip(indices, views, strict=True)}
    assert result.segments
    for segment in result.segments:
        frames = frames_of(result, segment)
        _, error, length = aligned(frames, truth)
        assert np.sqrt(np.mean(error**2)) < rms * length
        assert error.max() < worst * length
        assert turns(frames, truth).max() < 0.5
        assert all(is_rigid(frame.T_world_camera, 1e-9) for frame in frames)


def turns(frames: list[PosedFrame], truth: dict[int, np.ndarray]) -> np.ndarray:
    """Errors of the rotations in degrees, after the one rotation that fits them best.

    A path along a line says nothing about the rotation around it, so that of the positions will not do.
    """
    between = np.stack([truth[frame.index][:3, :3] @ frame.T_world_camera[:3, :3].T for frame in frames])
    U, _, Vt = np.linalg.svd(between.sum(axis=0))
    traces = np.einsum("ij,nij->n", U @ Vt, between)
    return np.degrees(np.arccos(np.minimum(1.0, (traces - 1) / 2)))


def lost(run: Run) -> list[int]:
    return [update.index for update in run.updates if update.status is Status.LOST]


def check_accounts(run: Run) -> None:
    """Every frame has a pose or a reason, in the updates and in the result."""
    for update in run.updates:
        posed = update.T_world_camera is not None
        assert posed == (update.status is Status.TRACKED)
        assert posed != bool(update.reason)
    posed = [frame.index for frame in run.result.frames]
    without = [index for index, reason in run.result.without_pose if reason]
    assert posed == sorted(posed)
    assert sorted(posed + without) == [update.index for update in run.updates]


# Motion


def test_a_walk_is_recovered_from_its_first_frame_on():
    run = plain()
    assert [frame.index for frame in run.result.frames] == list(range(FRAMES))
    assert run.result.segments == (0,)
    check_poses(run.result, WALK, rms=0.002, worst=0.005)
    check_accounts(run)


@pytest.mark.slow
@pytest.mark.parametrize(("path", "rms", "worst"), [("slow", 0.015, 0.03), ("fast", 0.001, 0.003)])
def test_slow_and_fast_motion(path, rms, worst):
    run = track_views(along(path))
    assert len(run.result.frames) == len(run.updates)
    check_poses(run.result, along(path), rms=rms, worst=worst)


@pytest.mark.slow
def test_backwards():
    views = WALK[::-1]
    run = track_views(views)
    assert len(frames_of(run.result)) == FRAMES
    check_poses(run.result, views)


@pytest.mark.slow
def test_only_turning_never_gives_a_pose_until_the_camera_moves():
    turning = along("turn")[::-1]
    views = [*turning, *WALK[:30]]
    run = track_views(views)
    for update in run.updates[: len(turning)]:
        assert update.status is Status.STARTING
        assert "rotation" in update.reason or update.index < 2
    assert run.updates[-1].status is Status.TRACKED
    moved = [frame for frame in run.result.frames if frame.index >= len(turning)]
    assert len(moved) > 15
    check_poses(run.result, views, rms=0.01, worst=0.03)


@pytest.mark.slow
def test_turning_after_the_start_is_tracked():
    views = [*WALK, *along("turn at the end")]
    run = track_views(views)
    assert len(frames_of(run.result)) == len(views)
    check_poses(run.result, views)


def test_a_camera_at_rest_never_gives_a_pose():
    still = view("walk", 0)
    noise = np.random.default_rng(0).normal(0, 1 / 255, (70, *still.shape)).astype(np.float32)
    run = track([np.clip(still + n, 0, 1) for n in noise])
    assert not run.result.frames
    assert all("parallax" in update.reason or "rotation" in update.reason for update in run.updates[1:])
    assert all(len(update.held) <= 1 for update in run.updates)


# Brightness


def _gains(kind: str) -> np.ndarray:
    frames = np.arange(FRAMES)
    if kind == "smooth":
        return 1.0 + 0.4 * np.sin(0.3 * frames)
    if kind == "sudden":
        return np.where(frames // 8 % 2 == 0, 1.0, 0.6)
    return np.random.default_rng(0).uniform(0.6, 1.6, FRAMES)


@pytest.mark.parametrize(
    ("kind", "known"), [("smooth", False), ("sudden", True), ("sudden", False), ("flicker", True), ("flicker", False)]
)
def test_exposure_may_change(kind, known):
    gains = _gains(kind)
    images = [np.clip(gain * view(*v), 0, 1).astype(np.float32) for gain, v in zip(gains, WALK, strict=True)]
    run = track(images, exposures=0.004 * gains if known else None)
    assert len(frames_of(run.result)) == FRAMES
    check_poses(run.result, WALK)


# Loss


def _blurred(image: np.ndarray) -> np.ndarray:
    return cv2.blur(image, (23, 23))


def _filled(value: float):
    def fill(image: np.ndarray) -> np.ndarray:
        noise = np.random.default_rng(0).normal(0, 1 / 255, image.shape)
        return np.clip(value + noise, 0, 1).astype(np.float32)

    return fill


@pytest.mark.parametrize(
    "change",
    [_blurred, _filled(0.0), _filled(0.5), _filled(1.0)],
    ids=["blur", "black", "blank wall", "white"],
)
def test_frames_that_show_nothing_are_lost_and_the_map_goes_on(change):
    bad = range(18, 24)
    run = track(replaced(bad, change))
    assert lost(run) == list(bad)
    assert run.result.segments == (0,)
    assert len(run.result.frames) == FRAMES - len(bad)
    check_poses(run.result, WALK)
    check_accounts(run)


def test_another_place_begins_another_segment():
    views = [*WALK[:20], *along("elsewhere")]
    run = track_views(views)
    assert run.updates[20].status is Status.LOST
    assert [frame.index for frame in frames_of(run.result)] == list(range(20))
    there = frames_of(run.result, 1)
    assert 20 <= there[0].index <= 30 and len(there) == len(views) - there[0].index
    assert np.allclose(there[0].T_world_camera, np.eye(4), atol=1e-3)
    check_poses(run.result, views)
    check_accounts(run)


@pytest.mark.parametrize("missing", [5, 10, 20])
def test_frames_that_are_missing(missing):
    numbers = [*range(14), *range(14 + missing, FRAMES)]
    views = [WALK[k] for k in numbers]
    run = track_views(views, indices=numbers)
    check_poses(run.result, views, numbers)
    check_accounts(run)


# Input


def test_times_and_numbers_must_increase():
    odometry = Odometry(CAMERA)
    odometry.process(view("walk", 0), 1.0, 5)
    with pytest.raises(InputError, match="same time"):
        odometry.process(view("walk", 1), 1.0, 6)
    with pytest.raises(InputError, match="earlier time"):
        odometry.process(view("walk", 1), 0.5, 6)
    with pytest.raises(InputError, match="no time"):
        odometry.process(view("walk", 1), float("nan"), 6)
    with pytest.raises(InputError, match="index"):
        odometry.process(view("walk", 1), 2.0, 5)


def test_a_refused_frame_leaves_no_trace():
    odometry = Odometry(CAMERA)
    odometry.process(view("walk", 0), 1.0, 0)
    for image, time in [(view("walk", 1)[:-1], 2.0), (view("walk", 1), 1.0), (view("walk", 1), float("inf"))]:
        with pytest.raises(InputError):
            odometry.process(image, time, 1)
    odometry.process(view("walk", 1), 1.1, 1)
    assert [index for index, _ in odometry.result().without_pose] == [0, 1]


@pytest.mark.parametrize("shape", [(192, 255), (192, 256, 3), (192,)])
def test_an_image_must_fit_the_camera(shape):
    with pytest.raises(InputError, match="does not fit the camera"):
        Odometry(CAMERA).process(np.zeros(shape, np.float32), 0.0, 0)


@pytest.mark.parametrize("share", [0.01, 1.0])
def test_pixels_that_are_no_number_are_refused(share):
    odometry = Odometry(CAMERA)
    for k in range(12):
        odometry.process(view(*WALK[k]), k / 30, k)
    broken = view(*WALK[12]).copy()
    broken[: max(1, int(share * CAMERA.height))] = np.nan
    with pytest.raises(InputError, match="frame 12"):
        odometry.process(broken, 12 / 30, 12)
    assert odometry.process(view(*WALK[13]), 13 / 30, 13).status is Status.TRACKED


@pytest.mark.parametrize("exposure", [float("nan"), float("inf"), 0.0, -1.0])
def test_an_exposure_without_sense_is_as_good_as_none(exposure):
    run = track_views(WALK[:8], exposures=[exposure] * 8)
    for update, other in zip(run.updates, plain().updates, strict=False):
        assert update.status is other.status
        if update.T_world_camera is not None:
            assert np.array_equal(update.T_world_camera, other.T_world_camera)


# Sizes


def test_odd_sizes():
    camera = PinholeCamera(251, 189, CAMERA.fx, CAMERA.fy, CAMERA.cx, CAMERA.cy)
    views = WALK[:30]
    run = track([np.ascontiguousarray(view(*v)[:189, :251]) for v in views], camera=camera)
    assert len(run.result.frames) == len(views)
    check_poses(run.result, views, rms=0.005, worst=0.02)


def test_a_tiny_image_is_tracked_or_refused_with_a_reason():
    camera = CAMERA.scaled(0.25)
    small = [cv2.resize(view(*v), (64, 48), interpolation=cv2.INTER_AREA) for v in WALK]
    run = track(small, camera=camera)
    check_accounts(run)
    if run.result.frames:
        _, error, length = aligned(frames_of(run.result), dict(enumerate(PATHS["walk"])))
        assert error.max() < 0.1 * length


@pytest.mark.slow
def test_a_large_image():
    camera = CAMERA.scaled(4.0)
    views = WALK[:9:4]
    run = track([view(*v, camera) for v in views], camera=camera)
    assert len(run.result.frames) == len(views)
    check_poses(run.result, views)


# What is returned


def test_keyframe_poses_tell_every_change_of_a_keyframe():
    run = plain()
    announced: set[int] = set()
    last: dict[int, np.ndarray] = {}
    held: tuple[int, ...] = ()
    for update in run.updates:
        assert set(update.keyframes) <= {update.index, *held}
        assert list(update.keyframes) == sorted(update.keyframes)
        announced |= set(update.keyframes)
        assert set(update.keyframes) <= set(update.keyframe_poses) <= announced
        assert all(is_rigid(T, 1e-6) for T in update.keyframe_poses.values())
        if update.index in update.keyframes:
            assert np.allclose(update.keyframe_poses[update.index], update.T_world_camera, atol=1e-9)
        last |= update.keyframe_poses
        held = update.held
    final = {frame.index: frame.T_world_camera for frame in run.result.frames if frame.is_keyframe}
    assert set(final) == announced == set(last)
    assert all(np.allclose(final[index], last[index], atol=1e-6) for index in final)


def test_depths_of_new_keyframes_are_those_of_the_map():
    """z of what the keyframe shows, in the map's unit: so are the points that were first seen in it."""
    run = plain()
    points = run.result.points
    for update in run.updates:
        assert set(update.keyframe_depths) == set(update.keyframes)
        for index, depths in update.keyframe_depths.items():
            assert depths.dtype == np.float32 and len(depths) > 100 and (depths > 0).all()
            own = points.inverse_depth[(points.host == index) & (points.inverse_depth > 0)]
            if len(own) > 100:
                assert np.median(depths) == pytest.approx(np.median(1.0 / own), rel=0.3)


def test_a_keyframe_that_leaves_the_window_stays_where_it_was():
    updates = plain().updates
    gone: set[int] = set()
    for before, update in pairwise(updates):
        gone |= set(before.keyframe_poses) - set(update.keyframe_poses)
        assert not gone & set(update.keyframe_poses)
    assert gone


def test_the_world_is_the_first_keyframe():
    frames = plain().result.frames
    first = min(frame.index for frame in frames if frame.is_keyframe)
    assert first == 0
    assert np.allclose(frames[0].T_world_camera, np.eye(4), atol=1e-3)


def test_frames_wait_before_the_start():
    run = plain()
    starting = [update for update in run.updates if update.status is Status.STARTING]
    assert [update.index for update in starting] == list(range(len(starting)))
    assert all(update.held == (0,) and not update.keyframes for update in starting)
    begun = run.updates[len(starting)]
    assert begun.keyframes == (0, begun.index)


def test_points_lie_on_the_surfaces():
    result = plain().result
    points, truth = result.points, dict(enumerate(PATHS["walk"]))
    similarity, _, _ = aligned(frames_of(result), truth)
    error = np.full(len(points.host), np.nan)
    for host in np.unique(points.host):
        own = points.host == host
        u, v = np.round(points.pixel[own]).astype(int).T
        depth = render(ROOM.scene, CAMERA, truth[host], supersample=1).depth
        error[own] = points.inverse_depth[own] - similarity.scale / depth[v, u]
    assert len(error) > 1500 and np.isfinite(error).all()
    relative = np.abs(error) / points.inverse_depth
    assert np.median(relative) < 0.012
    assert np.quantile(relative, 0.9) < 0.06
    normalized = np.abs(error) / points.inverse_depth_std
    assert 0.35 < np.median(normalized) < 1.4  # 0.67 of a normal error
    assert np.mean(normalized < 3) > 0.8


def test_points_go_with_their_keyframes():
    result = plain().result
    points = result.points
    poses = {frame.index: frame.T_world_camera for frame in result.frames if frame.is_keyframe}
    assert set(points.host.tolist()) <= set(poses)
    rays = np.ones((len(points.host), 3))
    rays[:, :2] = (points.pixel - [CAMERA.cx, CAMERA.cy]) / [CAMERA.fx, CAMERA.fy]
    local = rays / points.inverse_depth[:, None].astype(float)
    T = np.stack([poses[host] for host in points.host.tolist()])
    expected = np.einsum("nij,nj->ni", T[:, :3, :3], local) + T[:, :3, 3]
    assert np.allclose(points.position, expected, rtol=1e-6, atol=1e-6)
    assert (points.segment == 0).all()
    assert (points.inverse_depth_std > 0).all()
    u, v = np.round(points.pixel).astype(int).T
    seen = np.array([view("walk", host)[y, x] for host, y, x in zip(points.host.tolist(), v, u, strict=True)])
    assert np.allclose(points.intensity, seen, atol=1e-3)


def test_a_result_at_any_time():
    odometry = Odometry(CAMERA)
    assert odometry.result().frames == () and len(odometry.result().points.position) == 0
    for k, v in enumerate(WALK[:20]):
        update = odometry.process(view(*v), k / 30, k)
        result = odometry.result()
        assert len(result.frames) + len(result.without_pose) == k + 1
        if update.T_world_camera is not None:
            assert np.allclose(result.frames[-1].T_world_camera, update.T_world_camera, atol=1e-6)
    again = plain().updates[19].T_world_camera
    assert np.array_equal(update.T_world_camera, again)  # asking changes nothing


def test_finish_may_be_called_before_anything_came():
    odometry = Odometry(CAMERA)
    odometry.finish()
    assert odometry.result().segments == ()


def test_the_same_images_and_seed_give_the_same_result():
    one, other = plain().result, track_views(WALK).result
    assert all(
        np.array_equal(a.T_world_camera, b.T_world_camera) for a, b in zip(one.frames, other.frames, strict=True)
    )
    assert np.array_equal(one.points.position, other.points.position)


def test_another_seed_gives_about_the_same_poses():
    result = track_views(WALK, odometry=Odometry(CAMERA, seed=7)).result
    assert not np.array_equal(result.frames[-1].T_world_camera, plain().result.frames[-1].T_world_camera)
    check_poses(result, WALK)


def test_pixels_outside_the_lens_are_not_used():
    valid = np.ones(CAMERA.shape, bool)
    valid[:, :60] = False
    images = [np.where(valid, view(*v), 0).astype(np.float32) for v in WALK]
    run = track(images, odometry=Odometry(CAMERA, valid=valid))
    assert (run.result.points.pixel[:, 0] > 58).all()
    check_poses(run.result, WALK)
