"""RGB-D recordings: each format read as written, the mirrored one too, and one clear line for what is broken."""

from __future__ import annotations

import json

import cv2
import numpy as np
import pytest
import rgbd_folders as folders

from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.recording.rgbd import FORMATS, open_rgbd, reprojection_error
from polarmap.io.recording.rgbd.intrinsics import read_intrinsics
from polarmap.io.recording.rgbd.listing import nearest_pairs

WRITERS = {
    "icl": folders.write_icl,
    "icl-pov": folders.write_icl_pov,
    "tum": folders.write_tum,
    "redwood": folders.write_redwood,
    "replica": folders.write_replica,
}


def opened(folder, camera=True):
    return open_rgbd(folder, camera=folders.write_intrinsics(folder) if camera else None)


def refused(folder, *words, camera=True, read=False):
    with pytest.raises(InputError) as error:
        sequence = opened(folder, camera)
        if read:
            list(sequence)
    for word in words:
        assert str(word) in str(error.value)
    assert len(str(error.value).splitlines()) == 1


@pytest.mark.parametrize("format", list(FORMATS))
def test_every_format_is_told_and_read_as_it_was_written(tmp_path, format):
    folder = WRITERS[format](tmp_path / "recording")
    sequence = opened(folder)
    assert sequence.format == format and sequence.camera == folders.CAMERA
    first = 1 if format == "icl" else 0  # the trajectory there begins with the second frame
    assert len(sequence) == folders.COUNT - first and sequence.without_pose == first
    np.testing.assert_allclose(sequence.poses, folders.POSES[first:], atol=2e-6)
    np.testing.assert_allclose(np.diff(sequence.timestamps), 1 / 30, atol=1e-5)
    step = 1e-5 if format == "icl-pov" else 1 / sequence.depth_scale
    for i in (0, 5, len(sequence) - 1):
        frame = sequence[i]
        assert frame.picture.dtype == frame.depth.dtype == np.float32
        np.testing.assert_allclose(frame.depth, folders.DEPTHS[i + first], atol=0.52 * step)
        lossy = format in ("redwood", "replica")
        error = np.abs(frame.picture * 255 - folders.PICTURES[i + first])
        assert error.mean() < 4 if lossy else error.max() < 0.6
        np.testing.assert_array_equal(frame.T_world_camera, sequence.poses[i])


@pytest.mark.parametrize("y_up", [True, False])
@pytest.mark.parametrize("associations", [True, False])
def test_icl_poses_are_mirrored_where_depth_asks_for_it(tmp_path, y_up, associations):
    sequence = opened(folders.write_icl(tmp_path / "icl", y_up, associations, first=1))
    np.testing.assert_allclose(sequence.poses, folders.POSES[1:], atol=1e-9)
    assert sequence.timestamps[0] == pytest.approx(2 / 30)


def test_a_single_frame_of_icl_is_taken_as_published(tmp_path):
    folder = folders.write_icl(tmp_path / "icl")
    trajectory = folder / "traj0.gt.freiburg"
    trajectory.write_text(trajectory.read_text().splitlines()[0])
    np.testing.assert_allclose(opened(folder).poses, folders.POSES[1:2], atol=1e-9)


def test_the_reprojection_error_tells_right_poses_from_mirrored_ones(tmp_path):
    sequence = opened(folders.write_redwood(tmp_path / "redwood"))
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    right, wrong = reprojection_error(sequence), reprojection_error(sequence, mirror @ sequence.poses @ mirror)
    assert right < 0.02 and wrong > 4 * right  # half a pixel is 20 mm at 2.5 m
    assert np.isnan(reprojection_error(sequence[:1]))


def test_slices_are_sequences(tmp_path):
    sequence = opened(folders.write_redwood(tmp_path / "redwood"))
    part = sequence[2:9:3]
    assert len(part) == 3
    np.testing.assert_array_equal(part.poses, sequence.poses[[2, 5, 8]])
    np.testing.assert_array_equal(part[1].depth, sequence[5].depth)


def test_holes_stay_unknown(tmp_path):
    folder = folders.write_redwood(tmp_path / "redwood")
    depth = folders.DEPTHS[0].copy()
    depth[10:20, 30:40] = np.nan
    folders.write_depth(folder / "depth" / "00000.png", depth, 1000)
    np.testing.assert_array_equal(np.isnan(opened(folder)[0].depth), np.isnan(depth))


def test_sixteen_bit_and_colour_pictures_are_scaled_by_their_white(tmp_path):
    folder = folders.write_redwood(tmp_path / "redwood")
    (folder / "color" / "00000.jpg").unlink()
    folders.write_picture(folder / "color" / "00000.png", np.full((60, 80, 3), (0, 65535, 0), np.uint16))
    np.testing.assert_allclose(opened(folder)[0].picture, 0.587, atol=1e-4)


def test_tum_intrinsics_follow_the_folder_and_a_file_overrides(tmp_path):
    def with_size(folder):
        for path in [*folder.glob("rgb/*"), *folder.glob("depth/*")]:
            folders.write_picture(path, cv2.resize(cv2.imread(str(path), -1), (640, 480)))
        return folder

    for name, fx in (("rgbd_dataset_freiburg1_xyz", 517.3), ("fr3", 525.0)):
        folder = with_size(folders.write_tum(tmp_path / name))
        assert open_rgbd(folder).camera.fx == fx
    scaled = open_rgbd(folders.write_tum(tmp_path / "t"), camera=folders.write_intrinsics(tmp_path / "t", 2500.0))
    np.testing.assert_allclose(scaled[0].depth, 2 * folders.DEPTHS[0], atol=2e-4)


def test_folders_bring_their_intrinsics(tmp_path):
    assert opened(folders.write_redwood(tmp_path / "a"), camera=False).camera == folders.CAMERA
    replica = folders.write_replica(tmp_path / "scenes" / "room0")
    parameters = replica / "cam_params.json"
    parameters.rename(replica.parent / "cam_params.json")
    sequence = opened(replica, camera=False)
    assert sequence.camera == folders.CAMERA and sequence.depth_scale == 6553.5
    text = (replica.parent / "cam_params.json").read_text()
    parameters.write_text(text)
    assert opened(replica, camera=False).camera == folders.CAMERA
    parameters.write_text(text.replace("62", "63"))
    refused(replica, "other intrinsics than in", "keep one of them", camera=False)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("{", ["not a JSON"]),
        ("[]", ["intrinsic_matrix"]),
        ('{"width": 80, "height": 60, "intrinsic_matrix": [1, 2]}', ["missing"]),
        ('{"camera": {"w": 80, "h": 60, "fx": 60}}', ["missing"]),
        ('{"camera": {"w": 80, "h": 60, "fx": -60, "fy": 60, "cx": 1, "cy": 1}}', ["focal"]),
        ('{"camera": {"w": 1e9, "h": 60, "fx": 60, "fy": 60, "cx": 1, "cy": 1}}', ["more than"]),
        ('{"camera": {"w": 80, "h": 60, "fx": 60, "fy": 60, "cx": 1, "cy": 1, "scale": 0}}', ["scale"]),
    ],
)
def test_bad_intrinsics_are_refused(tmp_path, text, words):
    path = tmp_path / "camera.json"
    path.write_text(text)
    with pytest.raises(InputError) as error:
        read_intrinsics(path)
    for word in ("camera.json", *words):
        assert word in str(error.value)


def test_folders_that_are_no_recording(tmp_path):
    refused(tmp_path / "none", "no such folder", camera=False)
    (tmp_path / "empty").mkdir()
    refused(tmp_path / "empty", "empty", "rgb.txt", "trajectory.log", camera=False)
    with pytest.raises(InputError, match="known are auto, icl"):
        open_rgbd(tmp_path / "empty", "kitti")
    with pytest.raises(InputError, match=r"groundtruth\.txt"):
        open_rgbd(tmp_path / "empty", "tum")


@pytest.mark.parametrize("format", list(FORMATS))
def test_a_missing_picture_or_depth_image_is_named(tmp_path, format):
    folder = WRITERS[format](tmp_path / "recording")
    depth = sorted(path for path in folder.rglob("*") if "depth" in str(path.relative_to(folder)) and path.is_file()
                   and path.suffix in (".png", ".depth"))[3]  # fmt: skip
    depth.unlink()
    refused(folder, "depth")


@pytest.mark.parametrize("format", list(FORMATS))
def test_a_truncated_picture_is_named(tmp_path, format):
    folder = WRITERS[format](tmp_path / "recording")
    picture = opened(folder).files[4].picture
    picture.write_bytes(picture.read_bytes()[:-40])
    refused(folder, picture, "truncated", read=True)


@pytest.mark.parametrize("format", ["icl", "icl-pov", "tum"])
def test_pictures_of_another_size_need_their_camera(tmp_path, format):
    refused(WRITERS[format](tmp_path / "recording"), "expected 640x480", "--camera", camera=False)


def test_depth_of_eight_bits_or_another_size_is_refused(tmp_path):
    folder = folders.write_redwood(tmp_path / "redwood")
    folders.write_picture(folder / "depth" / "00000.png", np.zeros((60, 80), np.uint8))
    refused(folder, "00000.png", "expected 16")
    folders.write_picture(folder / "depth" / "00000.png", np.zeros((30, 40), np.uint16))
    refused(folder, "40x30 pixels, expected 80x60")


def test_icl_trajectories_must_be_one_and_of_frame_numbers(tmp_path):
    folder = folders.write_icl(tmp_path / "icl")
    trajectory = folder / "traj0.gt.freiburg"
    rows = trajectory.read_text().splitlines()
    trajectory.write_text("\n".join([*rows[:3], rows[3].rsplit(" ", 1)[0], *rows[4:]]))
    refused(folder, "line 4", "7 columns, expected 8")
    trajectory.write_text(rows[0].replace("1.0 ", "1.5 ", 1))
    refused(folder, "whole frame numbers")
    trajectory.write_text("5e9 0 0 0 0 0 0 1")
    refused(folder, "whole frame numbers")
    trajectory.write_text("1e300 0 0 0 0 0 0 1")
    refused(folder, "line 1", "too large")
    trajectory.write_text("500 0 0 0 0 0 0 1")
    refused(folder, "no frame has a pose")
    (folder / "traj1.gt.freiburg").write_text(rows[0])
    refused(folder, "2 files *.freiburg")


def test_pov_files_of_two_scenes_are_ambiguous(tmp_path):
    folder = folders.write_icl_pov(tmp_path / "pov")
    (folder / "scene_01_0000.depth").write_text("1")
    refused(folder, "files of 2 scenes")


def test_pov_files_are_checked(tmp_path):
    folder = folders.write_icl_pov(tmp_path / "pov")
    pose, depth = folder / "scene_00_0000.txt", folder / "scene_00_0000.depth"
    text, values = pose.read_text(), depth.read_text()
    pose.write_text(text.replace("cam_up", "cam_down"))
    refused(folder, pose, "cam_up")
    pose.write_text("cam_pos = [0, 0, 0]';\ncam_dir = [0, 1, 0]';\ncam_up = [0, 1, 0]';")
    refused(folder, pose, "parallel")
    pose.write_text(text)
    depth.write_text(values + " 1.0")
    refused(folder, depth, "4801 values, expected 80x60")
    depth.write_text("x" + values[1:])
    refused(folder, depth, "no number")
    depth.write_text(" ".join(["1e39", "nan", "-1", "inf", *values.split()[4:]]))
    assert (
        np.isnan(opened(folder).read_depth(0)[0, :4]).all() and np.isfinite(opened(folder).read_depth(0)[0, 4:]).all()
    )


def test_tum_lists_are_checked(tmp_path):
    folder = folders.write_tum(tmp_path / "tum")
    listing = folder / "depth.txt"
    good = listing.read_text()
    listing.write_text(good.replace(" depth/", "", 1))
    refused(folder, "depth.txt, line 1", "expected 2")
    listing.write_text("abc depth/1.png\n")
    refused(folder, "line 1", "not a time")
    listing.write_text(good + "\n" + good.splitlines()[0])
    refused(folder, "line 13", "does not come after")
    listing.write_text("100.0 ../../secret.png")
    refused(folder, "line 1", "inside the recording")
    listing.write_text("900.0 depth/100.005000.png")
    refused(folder, "no time within")
    listing.write_text("# nothing\n")
    refused(folder, "no lines")
    listing.unlink()
    refused(folder, "depth.txt", "no such file")


def test_pairs_are_each_others_nearest_in_time():
    times, others = np.array([0.0, 1.0, 1.1, 2.0, 5.0]), np.array([0.015, 1.085, 2.3, 4.99])
    assert nearest_pairs(times, others, 0.02) == [(0, 0), (2, 1), (4, 3)]
    assert nearest_pairs(times, others, 0.5) == [(0, 0), (2, 1), (3, 2), (4, 3)]
    assert nearest_pairs(times[:1], others[3:], 9.0) == [(0, 0)]
    assert nearest_pairs(times[:1], others[3:], 1.0) == []


def test_tum_associations_serve_in_place_of_lists(tmp_path):
    folder = folders.write_tum(tmp_path / "tum")
    rgb = (folder / "rgb.txt").read_text().splitlines()[1:-1]
    depth = (folder / "depth.txt").read_text().splitlines()
    (folder / "rgb.txt").unlink()
    (folder / "associations.txt").write_text("\n".join(f"{a} {b}" for a, b in zip(rgb, depth, strict=True)))
    sequence = opened(folder)
    assert len(sequence) == folders.COUNT and sequence.format == "tum"
    np.testing.assert_allclose(sequence.poses, folders.POSES, atol=2e-6)
    (folder / "associations.txt").write_text("1.0 rgb/a.png 1.0 b.png")
    refused(folder, "line 1", "'depth'")


@pytest.mark.parametrize("order", [[0, 2, 1], [0, 1, 1]])
def test_associations_must_increase_in_time(tmp_path, order):
    folder = folders.write_icl(tmp_path / "icl", associations=True)
    path = folder / "associations.txt"
    rows = path.read_text().splitlines()
    path.write_text("\n".join(rows[i] for i in order))
    refused(folder, "associations.txt, line 3", "does not come after")


def test_frames_without_a_pose_are_left_out(tmp_path):
    folder = folders.write_tum(tmp_path / "tum")
    rows = (folder / "groundtruth.txt").read_text().splitlines()
    (folder / "groundtruth.txt").write_text("\n".join(rows[:6]))
    sequence = opened(folder)
    assert (len(sequence), sequence.without_pose) == (5, 7)


def test_counts_of_poses_and_frames_must_match(tmp_path):
    redwood = folders.write_redwood(tmp_path / "redwood")
    text = (redwood / "trajectory.log").read_text().splitlines()
    (redwood / "trajectory.log").write_text("\n".join(text[:-5]))
    refused(redwood, "trajectory.log", "11 poses for 12 frames")
    replica = folders.write_replica(tmp_path / "replica")
    rows = (replica / "traj.txt").read_text().splitlines()
    for broken, words in (
        (rows[:-1], ["11 poses for 12 frames"]),
        ([*rows[:-1], rows[-1].rsplit(" ", 1)[0]], ["line 12", "15 columns"]),
        ([*rows[:-1], "2" + rows[-1]], ["line 12"]),
        (["a" + rows[0][1:]], ["line 1", "no number"]),
        ([], ["no poses"]),
    ):
        (replica / "traj.txt").write_text("\n".join(broken))
        refused(replica, "traj.txt", *words)


def test_two_folders_of_pictures_or_two_files_of_a_frame_are_ambiguous(tmp_path):
    folder = folders.write_redwood(tmp_path / "redwood")
    folders.write_picture(folder / "color" / "0.png", folders.PICTURES[0])
    refused(folder, "same frame")
    (folder / "color" / "0.png").rename(folder / "color" / "last.png")
    refused(folder, "no number")
    (folder / "rgb").mkdir()
    refused(folder, "both color/ and rgb/")


def test_poses_out_of_this_world_are_refused(tmp_path):
    folder = folders.write_replica(tmp_path / "room")
    rows = (folder / "traj.txt").read_text().splitlines()
    numbers = rows[3].split()
    rows[3] = " ".join([*numbers[:3], "1e300", *numbers[4:]])
    (folder / "traj.txt").write_text("\n".join(rows))
    refused(folder, "frame000003.jpg", "correct the trajectory")


def test_open3d_intrinsics_are_column_by_column(tmp_path):
    (tmp_path / "c.json").write_text(
        json.dumps({"width": 4, "height": 3, "intrinsic_matrix": [1, 0, 0, 0, 2, 0, 3, 4, 1]})
    )
    assert read_intrinsics(tmp_path / "c.json").camera == PinholeCamera(4, 3, 1.0, 2.0, 3.0, 4.0)


def test_the_recorded_icl_sequence_is_mirrored_and_fits(shared_data):
    sequence = open_rgbd(shared_data / "icl_office_kt0")
    assert (sequence.format, len(sequence), sequence.without_pose) == ("icl", 449, 1)
    assert sequence.camera.fy == 480.0
    assert reprojection_error(sequence) < 0.003
    mirror = np.diag([1.0, -1.0, 1.0, 1.0])
    assert reprojection_error(sequence, mirror @ sequence.poses @ mirror) > 0.02


def test_the_recorded_redwood_sequence_fits(shared_data):
    sequence = open_rgbd(shared_data / "redwood_livingroom1")
    assert (sequence.format, len(sequence)) == ("redwood", 211)
    assert reprojection_error(sequence) < 0.004
    assert np.isfinite(sequence[100].depth).mean() > 0.9
