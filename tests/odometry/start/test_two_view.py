from __future__ import annotations

import numpy as np
import pytest
from scenes import TYPICAL, moved, plane_depth, stereo_views, turned

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import inverse
from polarmap.odometry.start.corner_tracks import CornerOptions, CornerTracks
from polarmap.odometry.start.epipolar import (
    Matches,
    direction_std,
    fit_rotation,
    plane_residual,
    refine_motion,
    refine_plane,
    rotation_flow,
    triangulate,
)
from polarmap.odometry.start.two_view import TwoViewGeometry, TwoViewOptions, TwoViewStarter
from polarmap.synth import Material, Pattern, Texture, built_in_scene, scenes

CAMERA = PinholeCamera(width=320, height=240, fx=240.0, fy=236.0, cx=159.5, cy=121.0)
PAPERED = Material("papered", albedo=0.45, texture=Texture(Pattern.NOISE, 0.2, 0.9, octaves=4, seed=1), gloss=0.0)
SCALES = np.concatenate([np.geomspace(20.0, 1.0, 8), np.ones(6)])
MOTION = turned((0.05, -0.03, 0.1), (0.1, 0.02, 0.03))  # T_second_first


def angle(a: np.ndarray, b: np.ndarray) -> float:
    """Between two vectors, degrees."""
    return float(np.degrees(np.arctan2(np.linalg.norm(np.cross(a, b)), a @ b)))


def turn(R: np.ndarray, S: np.ndarray) -> float:
    """Angle of the rotation between two, degrees."""
    return float(np.degrees(np.arccos(np.clip((np.trace(R.T @ S) - 1) / 2, -1, 1))))


def cloud(
    T: np.ndarray = MOTION, noise: float = 0.2, outliers: float = 0.0, depth=None, count: int = 500, seed: int = 0
):
    """Matches of random points at 1 to 4 m (or at the given depths), and the points' inverse depths."""
    rng = np.random.default_rng(seed)
    first = np.stack([rng.uniform(0, CAMERA.width - 1, count), rng.uniform(0, CAMERA.height - 1, count)], axis=1)
    rays = Matches.of(CAMERA, first, first).x1
    z = rng.uniform(1, 4, count) if depth is None else depth(rays)
    p = (rays * z[:, None]) @ T[:3, :3].T + T[:3, 3]
    second = p[:, :2] / p[:, 2:] * (CAMERA.fx, CAMERA.fy) + (CAMERA.cx, CAMERA.cy) + noise * rng.normal(size=(count, 2))
    wrong = int(outliers * count)
    second[:wrong] = rng.uniform(0, CAMERA.height, (wrong, 2))
    return Matches.of(CAMERA, first, second), 1 / z


def images(scene, poses, noise=TYPICAL) -> list[np.ndarray]:
    return [view.image.intensity for view in stereo_views(scene, CAMERA, poses, noise)[1]]


def start(frames, options: TwoViewOptions | None = None, camera: PinholeCamera = CAMERA):
    """The starter after the frames, what it found, and the index of the frame at which it did."""
    starter = TwoViewStarter(camera, options)
    starter.begin(frames[0])
    for index, frame in enumerate(frames[1:], 1):
        geometry = starter.add(frame)
        if geometry is not None:
            return starter, geometry, index
    return starter, None, None


def depth_error(geometry: TwoViewGeometry, depth: np.ndarray) -> float:
    """Median relative error of inverse depth after one scale."""
    u, v = geometry.pixels.astype(int).T
    ratio = geometry.inverse_depth * depth[v, u]
    return float(np.nanmedian(np.abs(ratio / np.nanmedian(ratio) - 1)))


def check_shapes(geometry: TwoViewGeometry) -> None:
    count = len(geometry.pixels)
    assert geometry.pixels.shape == geometry.second_pixels.shape == (count, 2)
    assert geometry.inverse_depth.shape == geometry.inverse_depth_std.shape == (count,)
    assert {a.dtype for a in (geometry.pixels, geometry.inverse_depth, geometry.inverse_depth_std)} == {np.dtype("f4")}
    assert geometry.T_second_first.dtype == np.float64 and geometry.T_second_first.shape == (4, 4)
    assert (geometry.inverse_depth > 0).all() and (geometry.inverse_depth_std > 0).all()
    assert geometry.inverse_depth.mean() == pytest.approx(1.0, abs=1e-4)


@pytest.fixture(scope="module")
def room():
    """Poses, images and true depth of the first image of a walk through the room."""
    built_in = built_in_scene("room")
    poses = built_in.path(6)[1]
    rendering, views = stereo_views(built_in.scene, CAMERA, poses)
    return poses, [view.image.intensity for view in views], rendering.depth


@pytest.fixture(scope="module")
def wall():
    """A papered wall, the same 25.5 mm to the side (3.06 pixels), and 0.45 m to the side."""
    return images(scenes.plane(PAPERED, tilt=0.0), [moved(0.0), moved(0.0255), moved(0.45)])


class TestMotion:
    def test_exact_matches_give_the_exact_motion(self):
        matches, q = cloud(noise=0.0)
        R, t, cost = refine_motion(matches, np.eye(3), np.array([1.0, 0.5, 0.0]), SCALES)
        t *= np.sign(t @ MOTION[:3, 3])
        assert turn(R, MOTION[:3, :3]) < 1e-3 and angle(t, MOTION[:3, 3]) < 1e-3 and cost < 1e-6
        seen = triangulate(matches, R, t * np.linalg.norm(MOTION[:3, 3]))
        np.testing.assert_allclose(seen.inverse_depth, q, rtol=1e-4)

    def test_a_third_of_wrong_matches(self):
        matches, _ = cloud(outliers=0.33)
        R, t, _ = refine_motion(matches, MOTION[:3, :3], np.array([1.0, 0.5, 0.6]), SCALES)
        assert turn(R, MOTION[:3, :3]) < 0.2 and angle(t * np.sign(t[0]), MOTION[:3, 3]) < 2.0

    def test_the_direction_is_as_uncertain_as_said(self):
        errors, stds = [], []
        for seed in range(12):
            matches, _ = cloud(seed=seed)
            R, t, _ = refine_motion(matches, MOTION[:3, :3], MOTION[:3, 3], SCALES)
            errors.append(np.radians(angle(t * np.sign(t[0]), MOTION[:3, 3])))
            stds.append(direction_std(matches, R, t, 1.0, 0.2))
        assert 0.4 < np.sqrt(np.mean(np.square(errors))) / np.mean(stds) < 1.7

    def test_the_slope_propagates_noise_to_inverse_depth(self):
        matches, q = cloud(noise=0.2, count=2000)
        seen = triangulate(matches, MOTION[:3, :3], MOTION[:3, 3])
        normalized = (seen.inverse_depth - q) * seen.slope / 0.2
        assert 1.4826 * np.median(np.abs(normalized)) == pytest.approx(1.0, abs=0.1)
        assert 1.4826 * np.median(np.abs(seen.error)) == pytest.approx(0.2, abs=0.02)

    def test_the_opposite_direction_puts_points_behind(self):
        matches, _ = cloud(noise=0.0)
        assert (triangulate(matches, MOTION[:3, :3], -MOTION[:3, 3]).disparity < 0).all()

    def test_rotation_alone(self):
        matches, _ = cloud(turned((0.1, -0.2, 0.1)), outliers=0.3)
        R = fit_rotation(matches, np.geomspace(100.0, 2.0, 10))
        assert turn(R, turned((0.1, -0.2, 0.1))[:3, :3]) < 0.05
        assert np.median(np.linalg.norm(rotation_flow(matches, R), axis=1)) < 1.0

    def test_a_plane_constrains_the_motion_better(self):
        plane = np.array([0.1, 0.2, 0.5])
        matches, _ = cloud(depth=lambda rays: 1 / (rays @ plane))
        t0 = MOTION[:3, 3] / 0.1 + 0.1
        R, t, found, std = refine_plane(matches, MOTION[:3, :3], t0, plane * 0.1, np.geomspace(8.0, 1.0, 12), 0.2)
        assert angle(t, MOTION[:3, 3]) < 4 * np.degrees(std) < 3.0
        np.testing.assert_allclose(found / np.linalg.norm(MOTION[:3, 3]), plane, rtol=0.1)
        assert np.abs(plane_residual(matches, R, t, found)).mean() < 0.2
        assert std < direction_std(matches, R, t, 1.0, 0.2)


class TestTracks:
    def test_subpixel_shift(self, wall):
        tracks = CornerTracks(wall[0])
        assert len(tracks) > 200
        tracks.advance(wall[1])
        error = tracks.current - tracks.first + np.array([240 * 0.0255 / 2, 0.0])
        assert np.median(np.abs(error)) < 0.05 and len(tracks) > 150

    def test_exposure_does_not_matter(self, wall):
        plain, dim = CornerTracks(wall[0]), CornerTracks(wall[0])
        plain.advance(wall[1])
        dim.advance(wall[1] * 0.3)
        assert len(dim) == pytest.approx(len(plain), rel=0.05)
        np.testing.assert_allclose(np.median(dim.current - dim.first, axis=0), [-3.06, 0.0], atol=0.05)

    def test_large_jumps_are_matched_by_descriptors(self, wall):
        tracks = CornerTracks(wall[0])
        tracks.advance(wall[2])
        right = np.abs(tracks.current - tracks.first + np.array([54.0, 0.0])).max(axis=1) < 0.5
        assert right.sum() > 60 and right.mean() > 0.8

    def test_corners_are_spread_and_apart(self, wall):
        options = CornerOptions(corners=64, spacing=6)
        corners = CornerTracks(wall[0], options).first
        distance = np.linalg.norm(corners[:, None] - corners, axis=2) + 1e3 * np.eye(len(corners))
        assert len(corners) == 64 and distance.min() > 6
        assert len(np.unique(corners // 40, axis=0)) > 40  # of 48 cells

    def test_nothing_to_follow(self):
        noise = np.random.default_rng(0).normal(0.4, 0.01, CAMERA.shape).astype(np.float32)
        assert len(CornerTracks(np.full(CAMERA.shape, 0.5, np.float32))) == 0
        tracks = CornerTracks(noise)
        tracks.advance(np.random.default_rng(1).normal(0.4, 0.01, CAMERA.shape).astype(np.float32))
        assert len(tracks) < 10

    def test_tiny_and_broken_images(self):
        tracks = CornerTracks(np.full((9, 9), np.nan, np.float32))
        tracks.advance(np.full((9, 9), np.inf, np.float32))
        assert len(tracks) == 0


class TestStart:
    def test_in_a_room(self, room):
        poses, frames, depth = room
        starter, geometry, index = start(frames)
        truth = inverse(poses[index]) @ poses[0]
        check_shapes(geometry)
        assert starter.reason == "" and not geometry.planar
        assert turn(geometry.T_second_first[:3, :3], truth[:3, :3]) < 0.1
        assert angle(geometry.T_second_first[:3, 3], truth[:3, 3]) < 1.5
        assert depth_error(geometry, depth) < 0.02
        assert geometry.parallax >= 4.0 and geometry.angle >= np.radians(0.75)

    def test_the_unit_is_that_of_the_points(self, room):
        poses, frames, depth = room
        _, geometry, index = start(frames)
        u, v = geometry.pixels.astype(int).T
        unit = np.nanmedian(depth[v, u] * geometry.inverse_depth)  # metres
        baseline = np.linalg.norm(poses[index][:3, 3] - poses[0][:3, 3])
        assert np.linalg.norm(geometry.T_second_first[:3, 3]) * unit == pytest.approx(baseline, rel=0.03)

    def test_the_points_project_onto_their_matches(self, room):
        _, geometry, _ = start(room[1])
        rays = Matches.of(CAMERA, geometry.pixels.astype(float), geometry.second_pixels.astype(float))
        T = geometry.T_second_first
        p = rays.x1 @ T[:3, :3].T + geometry.inverse_depth[:, None] * T[:3, 3]
        error = np.linalg.norm(rays.focal * (p[:, :2] / p[:, 2:] - rays.x2[:, :2]), axis=1)
        assert error.max() < 3.1 * geometry.noise

    def test_a_jump_across_all_frames(self, room):
        poses, frames, depth = room
        _, geometry, _ = start([frames[0], frames[-1]])
        truth = inverse(poses[-1]) @ poses[0]
        assert angle(geometry.T_second_first[:3, 3], truth[:3, 3]) < 1.0 and depth_error(geometry, depth) < 0.02

    def test_the_same_input_gives_the_same_numbers(self, room):
        one, other = start(room[1])[1], start(room[1])[1]
        assert all(np.array_equal(value, getattr(other, name)) for name, value in vars(one).items())

    def test_exposure_and_a_moving_thing(self, room):
        poses, frames, _ = room
        last = frames[-1] * 0.7
        last[60:200, 20:60] = 0.7 * frames[0][60:200, 25:65]  # moves by itself
        _, geometry, _ = start([frames[0], last])
        truth = inverse(poses[-1]) @ poses[0]
        assert angle(geometry.T_second_first[:3, 3], truth[:3, 3]) < 2.0

    def test_begin_anew(self, room):
        poses, frames, _ = room
        starter = TwoViewStarter(CAMERA)
        starter.begin(frames[0])
        starter.add(frames[1])
        starter.begin(frames[1])
        geometry = starter.add(frames[-1])
        truth = inverse(poses[-1]) @ poses[1]
        assert angle(geometry.T_second_first[:3, 3], truth[:3, 3]) < 1.0

    def test_a_plane_seen_from_the_side(self):
        poses = [turned((1e-9, 0.002 * k, 0.001 * k), (0.05 * k, 0.0, 0.0)) for k in range(4)]
        _, geometry, index = start(images(scenes.plane(PAPERED, tilt=0.3), poses))
        truth = inverse(poses[index]) @ poses[0]
        check_shapes(geometry)
        assert geometry.planar and angle(geometry.T_second_first[:3, 3], truth[:3, 3]) < 1.0
        normal = (np.sin(0.3) * np.cos(0.5), np.sin(0.3) * np.sin(0.5), -np.cos(0.3))
        assert depth_error(geometry, plane_depth(CAMERA, normal, 2.0)) < 0.02


class TestRefusals:
    def test_rotation_only(self, room):
        poses = [room[0][0] @ turned((1e-9, 0.03 * k, 0.01 * k)) for k in range(4)]
        starter, geometry, _ = start(images(built_in_scene("room").scene, poses))
        assert geometry is None and starter.reason.startswith("rotation only") and not starter.exhausted

    def test_too_little_parallax(self, room):
        poses = [room[0][0] @ moved(0.004 * k) for k in range(3)]
        starter, geometry, _ = start(images(built_in_scene("room").scene, poses))
        assert geometry is None and starter.reason.startswith("too little parallax")

    def test_standing_still(self, room):
        starter, geometry, _ = start([room[1][0]] * 3)
        assert geometry is None and starter.reason.startswith("too little parallax (0.0 px")

    def test_the_ambiguity_of_a_plane(self):
        """Forward and sideways toward a wall: its normal and the direction of motion may change places."""
        poses = [turned((0.003 * k + 1e-9, 0.002 * k, 0.001 * k), (0.04 * k, 0.0, 0.06 * k)) for k in range(4)]
        starter, geometry, _ = start(images(scenes.plane(PAPERED, tilt=0.3), poses))
        assert geometry is None and starter.reason == "two-fold ambiguity of a plane"

    def test_no_rigid_motion(self, room):
        frames = room[1]
        broken = frames[0].copy()
        for k in range(8):  # eight strips, each with a motion of its own
            broken[30 * k : 30 * k + 30] = np.roll(frames[0][30 * k : 30 * k + 30], (-1) ** k * (3 + 2 * k), axis=1)
        starter, geometry, _ = start([frames[0], broken])
        assert geometry is None and starter.reason

    @pytest.mark.parametrize("level", [0.0, 0.5, np.nan])
    def test_blank(self, level):
        blank = np.full(CAMERA.shape, level, np.float32)
        starter, geometry, _ = start([blank, blank])
        assert geometry is None and starter.exhausted
        assert starter.reason.startswith("too few corners (blank or blurred)")

    def test_the_lens_is_covered_later(self, room):
        starter, geometry, _ = start([room[1][0], np.zeros(CAMERA.shape, np.float32)])
        assert geometry is None and starter.exhausted and starter.reason.startswith("too few tracked corners")
        assert starter.add(room[1][1]) is None and starter.reason

    def test_wrong_use(self, room):
        starter = TwoViewStarter(CAMERA)
        with pytest.raises(InputError, match="begin"):
            starter.add(room[1][0])
        with pytest.raises(InputError, match="shape"):
            starter.begin(np.zeros((10, 10), np.float32))
        with pytest.raises(InputError, match="min_point"):
            TwoViewOptions(min_point=3)


@pytest.mark.parametrize(("first", "second"), [(8, 10), (24, 36), (12, 16)])
def test_living_room(shared_data, first, second):
    """2 frames, and jumps of 38 cm and 14 cm."""
    from polarmap.io.recording.sequence import open_sequence
    from polarmap.sensing.front_end import FrontEnd

    sequence = open_sequence(shared_data / "livingroom")
    front_end = FrontEnd(sequence.camera_file)
    frames = [front_end.polarization(sequence[i]).intensity for i in (first, second)]
    _, geometry, _ = start(frames, camera=PinholeCamera(640, 480, 480.0, 480.0, 319.5, 239.5))
    poses = sequence.truth_trajectory().poses
    truth = inverse(poses[second]) @ poses[first]
    assert turn(geometry.T_second_first[:3, :3], truth[:3, :3]) < 0.1
    assert angle(geometry.T_second_first[:3, 3], truth[:3, 3]) < 1.5
    assert depth_error(geometry, sequence.truth_depth(first)) < 0.02
