"""Trajectory files: round trips, what is tolerated, one clear line for what is not; poses at a time."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.io.formats.trajectory import read_trajectory, write_trajectory

IDENTITY = "1 0 0 0\n0 1 0 0\n0 0 1 0\n0 0 0 1\n"
TUM = "0.1 1 2 3 0 0 0 1\n0.2 2 2 3 0 0 1 0\n"


def random_trajectory(seed: int, count: int) -> Trajectory:
    rng = np.random.default_rng(seed)
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, :3, :3] = Rotation.random(count, rng=rng).as_matrix()
    poses[:, :3, 3] = rng.normal(size=(count, 3)) * 10.0 ** rng.integers(-6, 6)
    return Trajectory(1.7e9 + np.cumsum(rng.uniform(0.001, 1.0, count)), poses)


@pytest.fixture
def read(tmp_path):
    def read(text, format="auto", **options):
        (tmp_path / "poses.txt").write_text(text)
        return read_trajectory(tmp_path / "poses.txt", format, **options)

    return read


@settings(max_examples=40, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.integers(0, 2**32 - 1), st.integers(1, 20), st.sampled_from(["tum", "kitti", "euroc", "log"]))
def test_round_trip(tmp_path, seed, count, format):
    trajectory = random_trajectory(seed, count)
    write_trajectory(tmp_path / "poses", trajectory, format)
    back = read_trajectory(tmp_path / "poses", timestamps=trajectory.timestamps)
    np.testing.assert_array_equal(back.timestamps, trajectory.timestamps)
    np.testing.assert_array_equal(back.nanoseconds, trajectory.nanoseconds)
    np.testing.assert_array_equal(back.poses[:, :3, 3], trajectory.poses[:, :3, 3])
    np.testing.assert_allclose(back.poses, trajectory.poses, atol=1e-12)


def test_tum(read):
    trajectory = read("# t tx ty tz qx qy qz qw\n\n" + TUM)
    np.testing.assert_array_equal(trajectory.timestamps, [0.1, 0.2])
    np.testing.assert_allclose(trajectory.poses[0], [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]])
    np.testing.assert_allclose(trajectory.poses[1, :3, :3], np.diag([-1, -1, 1]), atol=1e-15)


def test_byte_order_mark_windows_line_ends_and_rounded_quaternions(read):
    assert len(read("\ufeff" + TUM.replace("\n", "\r\n"))) == 2
    pose = read("0 0 0 0 0.38 0 0 0.92").poses[0]
    np.testing.assert_allclose(pose[:3, :3] @ pose[:3, :3].T, np.eye(3), atol=1e-12)


def test_kitti(read):
    line = "1 0 0 4 0 0 -1 5 0 1 0 6\n"
    trajectory = read(line * 2)
    np.testing.assert_array_equal(trajectory.timestamps, [0, 1])
    np.testing.assert_allclose(trajectory.poses[1], [[1, 0, 0, 4], [0, 0, -1, 5], [0, 1, 0, 6], [0, 0, 0, 1]])
    np.testing.assert_array_equal(read(line * 2, timestamps=[3.0, 4.5]).timestamps, [3.0, 4.5])
    with pytest.raises(InputError, match="2 poses, but 1 timestamps"):
        read(line * 2, timestamps=[3.0])


def test_euroc(read):
    header = "#timestamp, p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    trajectory = read(header + "1403636579763555584,1,2,3,0,0,0,1,0.1,0.2\n1403636579813555456,1,2,3,1,0,0,0,\n")
    np.testing.assert_allclose(trajectory.timestamps, [1403636579.763555584, 1403636579.813555456], rtol=1e-15)
    np.testing.assert_allclose(trajectory.poses[0, :3, :3], np.diag([-1, -1, 1]), atol=1e-15)


def test_log(read):
    moved = IDENTITY.replace("1 0 0 0", "0 -1 0 4", 1).replace("0 1 0 0", "1 0 0 5")
    trajectory = read("0 0 1\n" + IDENTITY + "1 1 3\n" + moved)
    np.testing.assert_array_equal(trajectory.timestamps, [0, 2])
    np.testing.assert_allclose(trajectory.poses[1], [[0, -1, 0, 4], [1, 0, 0, 5], [0, 0, 1, 0], [0, 0, 0, 1]])
    unnumbered = ("0 0 0\n" + IDENTITY) * 2
    np.testing.assert_array_equal(read(unnumbered, timestamps=[3.0, 4.5]).timestamps, [3.0, 4.5])


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("", r"no poses"),
        ("# only a comment\n", r"no poses"),
        (TUM + "0.3 1 2 3 0 0 1\n", r"line 3: 7 columns, expected 8 as in the first line"),
        (TUM + "0.3 1 2 3 0 0 1 0 0\n", r"line 3: 9 columns, expected 8"),
        (TUM + "0.3 1 2 3 0 0 1 x\n", r"line 3: not all numbers"),
        ("# c\n" + TUM + "0.3 nan 2 3 0 0 1 0\n", r"line 4: a number is NaN or infinite"),
        (TUM + "0.3 1 inf 3 0 0 1 0\n", r"line 3: a number is NaN or infinite"),
        (TUM + "0.3 1 2e20 3 0 0 1 0\n", r"line 3: a number is .* too large"),
        (TUM + "0.3 1 2 3 0 0 0 0\n", r"line 3: a quaternion of norm 0, expected 1"),
        (TUM + "1 0 0 0 2 3 0.3 1\n", r"line 3: a quaternion of norm 3.75, expected 1"),
        (TUM + "0.2 1 2 3 0 0 0 1\n", r"line 3: time 0.2 s does not come after 0.2 s"),
        (TUM + "0.1 1 2 3 0 0 0 1\n", r"line 3: time 0.1 s does not come after 0.2 s"),
        ("1 2 3 4\n", r"line 1: 4 columns are none of the known formats"),
        ("1 0 0 4 0 1 0 5 0 0 -1 6\n", r"line 1: not a rotation"),
        ("1 0 0 4 0 1 0 5 0 0 1 nan\n", r"line 1: a number is NaN"),
        ("5,1,2,3,1,0,0\n", r"line 1: 7 columns are none of the known formats"),
        ("0 0 1\n" + IDENTITY[:-8], r"line 1: 3 lines after it, expected the matrix's four"),
        ("0 0 1.5\n" + IDENTITY, r"line 1: '0 0 1.5' are not three whole numbers"),
        ("0 0 1\n" + IDENTITY + "0 0 1\n" + IDENTITY, r"line 6: frame 1 does not come after 1"),
        ("0 0 1\n" + IDENTITY.replace("0 1 0 0", "0 1 0"), r"line 3: 3 columns, expected 4"),
        ("0 0 1\n" + IDENTITY.replace("0 1 0 0", "0 -1 0 0"), r"line 1: not a rotation"),
        ("0 0 1\n" + IDENTITY.replace("0 0 0 1", "0 0 0 2"), r"line 5: the matrix's last row is not 0 0 0 1"),
    ],
)
def test_a_bad_line_is_named(read, text, message):
    with pytest.raises(InputError, match=message) as error:
        read(text)
    assert "poses.txt" in str(error.value) and "\n" not in str(error.value)


def test_files_that_are_none(tmp_path, read):
    with pytest.raises(InputError, match="no such file"):
        read_trajectory(tmp_path / "none.txt")
    (tmp_path / "b").write_bytes(b"\xff\xfe\x00")
    with pytest.raises(InputError, match="not a text file"):
        read_trajectory(tmp_path / "b")
    with pytest.raises(InputError, match="format 'bag' is not known"):
        read(TUM, "bag")


@settings(max_examples=150, deadline=None, suppress_health_check=[HealthCheck.function_scoped_fixture])
@given(st.text("0123456789.-+e,# \nnaif", max_size=120), st.sampled_from(["auto", "tum", "kitti", "euroc", "log"]))
def test_any_text_is_read_or_refused(tmp_path, text, format):
    (tmp_path / "poses").write_text(text)
    try:
        trajectory = read_trajectory(tmp_path / "poses", format)
    except InputError as error:
        assert "\n" not in str(error)
    else:
        assert np.isfinite(trajectory.poses).all()


@pytest.mark.parametrize(
    ("timestamps", "poses", "message"),
    [
        ([], np.empty((0, 4, 4)), "at least one pose"),
        ([0.0, 1.0], np.eye(4)[None], "one timestamp for each"),
        ([0.0], np.full((1, 4, 4), np.nan), "must be finite"),
        ([1.0, 1.0], np.tile(np.eye(4), (2, 1, 1)), "must increase"),
    ],
)
def test_a_trajectory_made_of_arrays_is_checked(timestamps, poses, message):
    with pytest.raises(InputError, match=message):
        Trajectory(np.array(timestamps), poses)


@pytest.fixture
def quarter_turn():
    """Poses at 0, 0.1 and 1 s: one metre along x and a quarter turn about z, then a jump."""
    poses = np.tile(np.eye(4), (3, 1, 1))
    poses[1, :3, :3] = Rotation.from_euler("z", 90, degrees=True).as_matrix()
    poses[1:, 0, 3] = 1.0, 9.0
    return Trajectory(np.array([0.0, 0.1, 1.0]), poses)


def test_poses_between_two_are_interpolated(quarter_turn):
    for i, timestamp in enumerate(quarter_turn.timestamps):
        np.testing.assert_allclose(quarter_turn.at(timestamp), quarter_turn.poses[i], atol=1e-12)
    pose = quarter_turn.at(0.04)
    np.testing.assert_allclose(pose[:3, 3], [0.4, 0, 0])
    np.testing.assert_allclose(pose[:3, :3], Rotation.from_euler("z", 36, degrees=True).as_matrix(), atol=1e-12)


def test_poses_elsewhere_are_the_nearest_or_none(quarter_turn):
    assert quarter_turn.at(-0.01)[0, 3] == 0.0
    assert quarter_turn.at(-0.03) is None
    assert quarter_turn.at(0.115)[0, 3] == 1.0
    assert quarter_turn.at(0.5) is None
    assert quarter_turn.at(0.985)[0, 3] == 9.0
    assert quarter_turn.at(1.03) is None
    assert quarter_turn.at(0.5, max_gap=1.0)[0, 3] == pytest.approx(1.0 + 8.0 * 0.4 / 0.9)
    assert quarter_turn.at(1.5, max_difference=1.0)[0, 3] == 9.0


def slow_poses(step: float, count: int = 12, start: float = 1_700_000_000.0) -> Trajectory:
    """A camera that moves one metre a second along x, its poses `step` seconds apart on a Unix clock, to the µs."""
    poses = np.tile(np.eye(4), (count, 1, 1))
    poses[:, 0, 3] = step * np.arange(count)
    return Trajectory(np.round(start + step * np.arange(count), 6), poses)


@pytest.mark.parametrize("step", [0.1, 0.1003, 0.099, 0.2, 0.5])
def test_the_poses_own_rate_decides_what_a_gap_is(step):
    trajectory = slow_poses(step)
    for time in np.arange(0, 11 * step, 1 / 30):
        assert trajectory.at(1_700_000_000.0 + time)[0, 3] == pytest.approx(time, abs=2e-6)
    lacking = Trajectory(np.delete(trajectory.timestamps, 5), np.delete(trajectory.poses, 5, axis=0))
    middle = float(trajectory.timestamps[5])
    assert lacking.at(middle) is None
    assert lacking.why_unknown(middle) == "its time is in a gap of the trajectory"
    assert trajectory.why_unknown(middle + 1000) == "its time is outside the trajectory's times"


def test_poses_a_second_apart_are_not_joined():
    trajectory = slow_poses(1.0)
    assert trajectory.at(1_700_000_003.0)[0, 3] == 3.0
    assert trajectory.at(1_700_000_003.4) is None


def test_frames_without_times_have_no_poses(quarter_turn):
    with pytest.raises(InputError, match=r"add timestamps\.txt to the sequence or frame_rate"):
        quarter_turn.at(float("nan"))


def test_overlap(quarter_turn):
    quarter_turn.require_overlap([-5.0, 0.05])
    with pytest.raises(InputError, match=r"poses from 0\.0+ to 1\.0+ s, but frames from 5\.0+ to 6\.0+ s"):
        quarter_turn.require_overlap([5.0, 6.0])


def test_the_recorded_trajectory(shared_data):
    trajectory = read_trajectory(shared_data / "livingroom" / "groundtruth.txt")
    assert len(trajectory) == 48
    np.testing.assert_allclose(trajectory.poses[0, :3, 3], [4.364000391, 0.929494669, -1.883392715])


def test_the_recorded_log(shared_data):
    trajectory = read_trajectory(shared_data / "redwood_livingroom1" / "trajectory.log")
    assert len(trajectory) == 211
    np.testing.assert_array_equal(trajectory.timestamps, np.arange(211))
    np.testing.assert_allclose(trajectory.poses[1, 0], [0.99999139, -0.00001393, 0.00415030, 0.00118646], atol=1e-7)
