"""Given poses that jump, with pictures that show whether the camera really did; and pictures that do not fit a pose."""

from __future__ import annotations

import numpy as np
import pytest
from scenes import TEXTURED, WIDE, moved, turned

from polarmap.data.codes import Status
from polarmap.data.polarization_image import PolarizationImage
from polarmap.pipeline.poses.follower import CONTRADICTED, SAME_PICTURE, PoseFollower
from polarmap.pipeline.poses.source import given_pose
from polarmap.sensing.front_end import GivenImage
from polarmap.synth import render, scenes

PERIOD = 1 / 30
COUNT = 24


class Trajectory:
    def __init__(self, poses) -> None:
        self.timestamps, self.poses = PERIOD * np.arange(len(poses)), np.array(poses)


def seen_from(T: np.ndarray, seed: int) -> PolarizationImage:
    picture = 0.4 * render(scenes.corner(TEXTURED), WIDE, T).stokes[0]
    noise = 0.003 * np.random.default_rng(seed).standard_normal(picture.shape)
    return PolarizationImage.unpolarized((picture + noise).astype(np.float32))


def true_pose(index: int) -> np.ndarray:
    return turned((0.0, 0.003 * index + 1e-9, 0.0), (0.02 * index - 0.25, 0.005 * index, 0.0))


POSES = [true_pose(i) for i in range(COUNT)]


@pytest.fixture(scope="module")
def images() -> list[PolarizationImage]:
    return [seen_from(T, i) for i, T in enumerate(POSES)]


def followed(images, poses, whole=True, keyframes=()) -> list:
    """The updates; of `keyframes` those whose picture fits, as a mapper would ask."""
    follower = PoseFollower(WIDE, Trajectory(poses) if whole else None)
    updates = []
    for i, (image, T) in enumerate(zip(images, poses, strict=True)):
        updates.append(follower.follow(given_pose(GivenImage(image, PERIOD * i, i), T)))
        if i in keyframes and updates[-1].candidates:
            reason = follower.contradiction(i)
            updates[-1] = reason or updates[-1]
    return updates


def left_out(updates) -> list[int]:
    return [i for i, update in enumerate(updates) if isinstance(update, str) or update.T_world_camera is None]


def with_jump(size: float, *positions: int) -> list[np.ndarray]:
    return [moved(size) @ T if i in positions else T for i, T in enumerate(POSES)]


@pytest.mark.parametrize("whole", [True, False])
def test_sound_poses_pass_as_they_are(images, whole):
    updates = followed(images, POSES, whole, keyframes=range(0, COUNT, 3))
    assert left_out(updates) == []
    assert PoseFollower(WIDE).segmented(set()) is None
    assert all(u.segment == 0 and u.status is Status.TRACKED and u.candidates for u in updates)
    np.testing.assert_array_equal([u.T_world_camera for u in updates], POSES)


@pytest.mark.parametrize("size", [1e4, 1.0, 0.3])
@pytest.mark.parametrize("positions", [(9,), (9, 10, 11), (COUNT - 1,)])
@pytest.mark.parametrize("whole", [True, False])
def test_poses_that_jump_are_left_out_with_the_reason(images, size, positions, whole):
    updates = followed(images, with_jump(size, *positions), whole)
    assert left_out(updates) == list(positions)
    for i in positions:
        update = updates[i]
        assert update.status is Status.LOST and update.reason.startswith("the pose jumps by") and not update.candidates
    assert all(u.segment == 0 for u in updates)


def test_the_first_pose_is_left_out_if_the_trajectory_is_known(images):
    assert left_out(followed(images, with_jump(5.0, 0))) == [0]


@pytest.mark.parametrize("whole", [True, False])
def test_a_jump_that_lasts_begins_a_segment(images, whole, caplog):
    more = [*images, *(seen_from(true_pose(i), i) for i in range(COUNT, 2 * COUNT))]
    poses = [true_pose(i) if i < COUNT else moved(2.0) @ true_pose(i) for i in range(2 * COUNT)]
    follower = PoseFollower(WIDE, Trajectory(poses) if whole else None)
    updates = [
        follower.follow(given_pose(GivenImage(image, PERIOD * i, i), T))
        for i, (image, T) in enumerate(zip(more, poses, strict=True))
    ]
    posed = follower.segmented({0, 30})
    assert [(p.index, p.segment) for p in posed] == [
        (i, u.segment) for i, u in enumerate(updates) if u.T_world_camera is not None
    ]
    assert {p.index for p in posed if p.is_keyframe} <= {0, 30}
    segments = [u.segment for u in updates if u.T_world_camera is not None]
    assert set(segments) == {0, 1} and segments == sorted(segments)
    assert segments.count(0) == COUNT and (segments.count(1) == COUNT if whole else segments.count(1) > 5)
    assert caplog.text.count("a new segment begins") == 1


@pytest.mark.parametrize("whole", [True, False])
def test_a_jump_that_the_pictures_show_is_motion(images, whole):
    """Frames were lost, and the times do not say so: far too fast, but so the pictures say too."""
    poses = [true_pose(i if i < 12 else i + 7) for i in range(COUNT - 7)]
    pictures = images[:12] + images[19:]
    updates = followed(pictures, poses, whole)
    assert left_out(updates) == [] and {u.segment for u in updates} == {0}


@pytest.mark.parametrize("offset", [moved(0.08), turned((0.0, 0.05, 0.0)), turned((0.0, 0.0, 0.05))])
def test_a_pose_that_is_a_little_wrong_makes_no_keyframe(images, offset):
    """Too little for a jump among these poses; the pictures contradict it."""
    poses = [T @ offset if i == 12 else T for i, T in enumerate(POSES)]
    updates = followed(images, poses, keyframes=range(0, COUNT, 3))
    assert left_out(updates) == [12]
    assert isinstance(updates[12], str) or updates[12].reason


def test_poses_that_never_fit_the_pictures_are_another_matter(images):
    """Of a wrong convention, say: nothing is gained by leaving out all."""
    poses = [np.linalg.inv(T) for T in POSES]
    assert left_out(followed(images, poses, keyframes=range(0, COUNT, 3))) == []


def test_a_picture_of_elsewhere_makes_no_keyframe(images):
    pictures = [images[2] if i == 15 else image for i, image in enumerate(images)]
    updates = followed(pictures, POSES, keyframes=range(0, COUNT, 3))
    assert left_out(updates) == [15] and updates[15] == CONTRADICTED


def test_a_frame_that_was_no_keyframe_spoils_none_after_it(images):
    """Frame 14 is from elsewhere, and nobody asks about it; 15 is fit all the same."""
    pictures = [images[1] if i == 14 else image for i, image in enumerate(images)]
    assert left_out(followed(pictures, POSES, keyframes=range(0, COUNT, 3))) == []


@pytest.mark.parametrize("odd", [True, False])
def test_the_first_frame_is_judged_with_the_third(images, odd):
    follower = PoseFollower(WIDE, Trajectory(POSES))
    found = []
    for i in range(5):
        follower.follow(given_pose(GivenImage(images[15 if odd and i == 0 else i], PERIOD * i, i), POSES[i]))
        found.append(follower.odd)
    assert found == [None, None, 0 if odd else None, None, None]


@pytest.mark.parametrize("length", [1, 4])
def test_a_frozen_picture_is_left_out(images, length):
    frozen = range(8, 8 + length)
    pictures = [
        PolarizationImage.unpolarized(images[7].intensity.copy()) if i in frozen else image
        for i, image in enumerate(images)
    ]
    updates = followed(pictures, POSES)
    assert left_out(updates) == list(frozen)
    assert {updates[i].reason for i in frozen} == {SAME_PICTURE}


def test_a_camera_that_stands_still_may_see_the_same(images):
    copies = [PolarizationImage.unpolarized(images[0].intensity.copy()) for _ in range(6)]
    assert left_out(followed(copies, [POSES[0]] * 6)) == []


def test_frames_without_a_pose_stay_without():
    update = PoseFollower(WIDE).follow(given_pose(GivenImage(seen_from(POSES[0], 0), 0.0, 0), None))
    assert update.reason == "no pose is given at its time" and update.T_world_camera is None


def test_frames_between_poses_are_left_out_with_either(images):
    """Poses at 15 Hz, frames at 30 Hz in between."""
    trajectory = Trajectory(with_jump(3.0, 10))
    trajectory.timestamps, trajectory.poses = trajectory.timestamps[::2], trajectory.poses[::2]
    follower = PoseFollower(WIDE, trajectory)
    poses = [moved({9: 1.5, 10: 3.0, 11: 1.5}.get(i, 0.0)) @ T for i, T in enumerate(POSES)]
    frames = [GivenImage(image, PERIOD * i, i) for i, image in enumerate(images)]
    updates = [follower.follow(given_pose(frame, T)) for frame, T in zip(frames, poses, strict=True)]
    assert left_out(updates) == [9, 10, 11]
