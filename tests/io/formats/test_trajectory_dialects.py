"""Trajectories as people have them: separators, headers, units of time, encodings and matrices, read or refused."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.io.formats.trajectory import read_trajectory, write_trajectory

COUNT = 12
TIMES = np.round(np.arange(COUNT) / 30, 6)
CLOCK = 1_700_000_000
ROS = "field.header.seq,field.header.stamp,field.header.frame_id"
ROS_POSE = (
    ",".join(f"field.pose.position.{a}" for a in "xyz") + "," + ",".join(f"field.pose.orientation.{a}" for a in "xyzw")
)
IMU_HEADER = (
    "#timestamp [ns],p_RS_R_x [m],p_RS_R_y [m],p_RS_R_z [m],q_RS_w [],q_RS_x [],q_RS_y [],q_RS_z [],"
    "v_RS_R_x [m s^-1],b_w_RS_S_x [rad s^-1]"
)


def truth() -> np.ndarray:
    """T_world_camera N×4×4, whose quaternions differ in all four components."""
    poses = np.tile(np.eye(4), (COUNT, 1, 1))
    turns = np.arange(COUNT)[:, None] * [0.02, -0.03, 0.05] + [0.3, 0.2, -0.5]
    poses[:, :3, :3] = Rotation.from_rotvec(turns).as_matrix()
    poses[:, :3, 3] = np.arange(COUNT)[:, None] * [0.1, 0.02, -0.03] + [1, 2, 3]
    return poses


POSES = truth()
POSITIONS = POSES[:, :3, 3]
XYZW = Rotation.from_matrix(POSES[:, :3, :3]).as_quat()
WXYZ = XYZW[:, [3, 0, 1, 2]]


def numbers(row) -> list[str]:
    return [f"{value:.12f}" for value in row]


def lines(times, quaternions=XYZW, separator=" ", before=(), after=()) -> str:
    """A line for each time, given as text, with columns before and after."""
    rows = zip(times, POSITIONS, quaternions, strict=True)
    return "".join(
        separator.join([*(f"{i}" for _ in before), t, *numbers(p), *numbers(q), *after]) + "\n"
        for i, (t, p, q) in enumerate(rows)
    )


def matrices(rows: int, before=None) -> str:
    """Three or four rows of each matrix in a line, after a column of text."""
    texts = [" ".join(numbers(pose[:rows].ravel())) for pose in POSES]
    return "".join(f"{'' if before is None else before[i]} {text}\n" for i, text in enumerate(texts))


SECONDS = [f"{t:.6f}" for t in TIMES]
MILLISECONDS = [f"{float(t) * 1e3:.3f}" for t in SECONDS]
UNIX = [f"{CLOCK + t:.6f}" for t in TIMES]
NANOSECONDS = [str(round(t * 1e6) * 1000) for t in TIMES]
UNIX_NANOSECONDS = [str(CLOCK * 10**9 + int(n)) for n in NANOSECONDS]
PARTED = [f"{CLOCK}{sep}{n}" for n in NANOSECONDS for sep in ","]
DATES = [f"2023-11-14 22:13:20.{int(n):09d}" for n in NANOSECONDS]
TUM_NAMES = "timestamp tx ty tz qx qy qz qw\n"
GERMAN = lines(SECONDS, separator=";").replace(".", ",")

READ = {
    "commas, header": ("#timestamp,x,y,z,qx,qy,qz,qw\n" + lines(SECONDS, separator=","), 0),
    "commas, Unix seconds": (lines(UNIX, separator=","), CLOCK),
    "commas, blanks": (lines(SECONDS, separator=" , "), 0),
    "commas, w first by header": ("t,x,y,z,qw,qx,qy,qz\n" + lines(SECONDS, WXYZ, ","), 0),
    "quaternion before position": (
        "time,qw,qx,qy,qz,px,py,pz\n"
        + "".join(",".join([t, *numbers(WXYZ[i]), *numbers(POSITIONS[i])]) + "\n" for i, t in enumerate(SECONDS)),
        0,
    ),
    "semicolons": ("Time;PosX;PosY;PosZ;QuatX;QuatY;QuatZ;QuatW\n" + lines(SECONDS, separator=";"), 0),
    "decimal commas": (GERMAN, 0),
    "tabs, Windows, byte order mark": ("\ufeff" + lines(SECONDS, separator="\t").replace("\n", "\r\n"), 0),
    "old Mac line ends": (lines(SECONDS).replace("\n", "\r"), 0),
    "header without #": (TUM_NAMES + lines(SECONDS), 0),
    "header, w first": ("# timestamp [s] tx ty tz qw qx qy qz\n" + lines(SECONDS, WXYZ), 0),
    "ORB-SLAM3, nanoseconds": (lines([f"{n}.000000" for n in NANOSECONDS]), 0),
    "ORB-SLAM3, Unix nanoseconds": (lines([f"{n}.000000" for n in UNIX_NANOSECONDS]), CLOCK),
    "Unix microseconds": (lines([n[:-3] for n in UNIX_NANOSECONDS]), CLOCK),
    "microseconds by header": ("# time_us x y z qx qy qz qw\n" + lines([f"{float(t) * 1e6:.1f}" for t in SECONDS]), 0),
    "milliseconds by header": ("t[ms],x,y,z,qx,qy,qz,qw\n" + lines(MILLISECONDS, XYZW, ","), 0),
    "milliseconds by step": (lines(MILLISECONDS), 0),
    "EuRoC without a header": (lines(UNIX_NANOSECONDS, WXYZ, ","), CLOCK),
    "EuRoC, relative, without a header": (lines(NANOSECONDS, WXYZ, ","), 0),
    "EuRoC with velocities": (IMU_HEADER + "\n" + lines(UNIX_NANOSECONDS, WXYZ, ",", after=("9", "8")), CLOCK),
    "MCD": ("num,t,x,y,z,qx,qy,qz,qw\n" + lines(SECONDS, separator=",", before=("num",)), 0),
    "rostopic echo -p": (
        f"%time,{ROS},{ROS_POSE}\n"
        + "".join(
            ",".join([str(int(n) + 5 * 10**6), str(i), n, "map", *numbers(p), *numbers(q)]) + "\n"
            for i, (n, p, q) in enumerate(zip(NANOSECONDS, POSITIONS, XYZW, strict=True))
        ),
        0,
    ),
    "seconds and nanoseconds": (
        "header.stamp.sec,header.stamp.nanosec,pose.position.x,pose.position.y,pose.position.z,"
        "pose.orientation.x,pose.orientation.y,pose.orientation.z,pose.orientation.w\n" + lines(PARTED, separator=","),
        CLOCK,
    ),
    "dates": ("time,x,y,z,qx,qy,qz,qw\n" + lines(DATES, separator=","), CLOCK),
    "dates, ISO": (lines([date.replace(" ", "T") + "Z" for date in DATES]), CLOCK),
    "time and 12 numbers": (matrices(3, UNIX), CLOCK),
    "nanoseconds and 12 numbers, commas": (matrices(3, UNIX_NANOSECONDS).replace(" ", ","), CLOCK),
    "time and 16 numbers": (matrices(4, SECONDS), 0),
    "16 numbers": (matrices(4), 0),
    "frame and 16 numbers": (matrices(4, range(COUNT)), 0),
    "frame numbers": (lines([str(i) for i in range(COUNT)]), 0),
    "frame numbers by name": ("frame,x,y,z,qx,qy,qz,qw\n" + lines(map(str, range(COUNT)), separator=","), 0),
}  # fmt: skip


def read(tmp_path, text: str, start: float = 0, encoding="utf-8") -> Trajectory:
    """The trajectory in this text, for frames 0, 1, ... at the true times."""
    path = tmp_path / "poses.txt"
    path.write_bytes(text.encode(encoding))
    return read_trajectory(path, timestamps=(start + TIMES).tolist(), indices=range(COUNT))


@pytest.mark.parametrize("name", READ)
def test_the_same_poses_in_every_dialect(tmp_path, name):
    text, start = READ[name]
    trajectory = read(tmp_path, text, start)
    np.testing.assert_allclose(trajectory.poses, POSES, atol=1e-9)
    expected = [start * 10**9 + int(n) for n in NANOSECONDS]
    np.testing.assert_array_equal(trajectory.nanoseconds, expected)
    np.testing.assert_array_equal(trajectory.timestamps, [n / 10**9 for n in expected])


@pytest.mark.parametrize("encoding", ["utf-16-le", "utf-16-be"])
def test_utf_16(tmp_path, encoding):
    trajectory = read(tmp_path, "\ufeff" + lines(SECONDS).replace("\n", "\r\n"), encoding=encoding)
    np.testing.assert_allclose(trajectory.poses, POSES, atol=1e-9)


REFUSED = {
    "no header, counted": (lines(SECONDS, separator=",", before=("num",)), "line 1: 9 columns are none of the known"),
    "KITTI, one short": (matrices(3).partition("\n")[2], "11 poses, but 12 timestamps for them"),
    "two trajectories": (
        "t,x,y,z,qx,qy,qz,qw,gt_x\n" + lines(SECONDS, separator=",", after=("1",)),
        "'x' and 'gt_x' both give tx; keep the columns of one trajectory",
    ),
    "two cameras": (
        "t,x,y,z,qx,qy,qz,qw,camera\n" + "".join(
            f"{line},{'left' if i % 2 else 'right'}\n" for i, line in enumerate(lines(SECONDS, separator=",").split())
        ),
        "column 'camera' has lines of 'right' and of 'left'; keep the lines of one camera",
    ),
    "two times": ("time,timestamp,x,y,z,qx,qy,qz,qw\n" + lines(SECONDS, separator=",", before="n"), "are both times"),
    "unknown names": ("when a b c d e f g\n" + lines(SECONDS), "does not name time, position and quaternion; write it"),
    "times in nanoseconds by header": (
        "timestamp [ns],x,y,z,qx,qy,qz,qw\n" + lines(UNIX, separator=","), "nanoseconds by header or format, but",
    ),
    "unsorted": (lines([*SECONDS[1:], SECONDS[0]]), r"line 12: time 0\.0 s does not come after"),
    "duplicate": (lines([*SECONDS[:-1], SECONDS[-2]]), "sort the lines and remove duplicates"),
    "frames counted from 1": (lines([str(i + 1) for i in range(COUNT)]), "numbers 1 to 12 in place of times, but the"),
    "transposed matrices": ("".join(" ".join(numbers(p.T.ravel())) + "\n" for p in POSES), "last row is not 0 0 0 1"),
    "no time": (lines(["soon"] * COUNT), "line 1: not all numbers; 'soon' is no time"),
    "a header alone": (TUM_NAMES, "not all numbers"),
    "COLMAP's images": (
        "#   IMAGE_ID, QW, QX, QY, QZ, TX, TY, TZ, CAMERA_ID, NAME\n1 1 0 0 0 1 2 3 1 a.png\n", "10 columns are none",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", REFUSED)
def test_what_may_mean_two_things_is_refused(tmp_path, name):
    text, message = REFUSED[name]
    with pytest.raises(InputError, match=message) as error:
        read(tmp_path, text)
    assert "poses.txt" in str(error.value) and "\n" not in str(error.value)


def test_a_guess_is_said(tmp_path, caplog):
    read(tmp_path, READ["commas, Unix seconds"][0], CLOCK)
    assert "no header; its columns are taken for t tx ty tz qx qy qz qw" in caplog.text
    read(tmp_path, READ["milliseconds by step"][0])
    assert "its times are taken for milliseconds" in caplog.text
    read(tmp_path, READ["frame numbers"][0])
    assert "the first column is taken for the numbers of the frames" in caplog.text
    caplog.clear()
    for name in ("commas, header", "EuRoC with velocities", "header without #", "dates", "Unix microseconds"):
        read(tmp_path, *READ[name])
    assert not caplog.records


def test_an_open_unit_is_that_in_which_the_times_meet_the_frames(tmp_path):
    steps = 5000 * np.arange(COUNT)  # 5 s or 5 ms
    path = tmp_path / "poses.txt"
    path.write_text(lines(map(str, steps)))
    for scale in (1e-3, 1e-6):
        times = (scale * steps).tolist()
        np.testing.assert_allclose(read_trajectory(path, timestamps=times, indices=range(COUNT)).timestamps, times)
    with pytest.raises(InputError, match=r"5000 apart may be milliseconds or microseconds; .* '# timestamp \[us"):
        read_trajectory(path)
    path.write_text(lines(map(str, 20 * np.arange(COUNT))))  # a frame every 20 s, or 50 a second
    slow = read_trajectory(path, timestamps=(20.0 * np.arange(COUNT)).tolist(), indices=range(COUNT))
    assert slow.timestamps[-1] == 220.0


@pytest.mark.parametrize("format", ["tum", "euroc"])
def test_nanoseconds_come_through_unchanged(tmp_path, format):
    exact = np.array([1403636579763555584 + 49999872 * i for i in range(COUNT)])
    path = tmp_path / "data.csv"
    path.write_text(lines(map(str, exact), WXYZ, ","))
    write_trajectory(tmp_path / "again", read_trajectory(path), format)
    again = read_trajectory(tmp_path / "again")
    np.testing.assert_array_equal(again.nanoseconds, exact)
    write_trajectory(tmp_path / "back", again, "euroc")
    assert [line.split(",")[0] for line in (tmp_path / "back").read_text().splitlines()[1:]] == list(map(str, exact))
    for time, pose in zip(exact.tolist(), POSES, strict=True):
        np.testing.assert_allclose(again.at(time / 10**9), pose, atol=1e-12)
        np.testing.assert_array_equal(again.at(time / 10**9), again.poses[np.searchsorted(exact, time)])
