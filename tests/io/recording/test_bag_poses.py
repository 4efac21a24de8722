"""Trajectories in ROS bags, and the chain of frames from the world to the camera."""

from __future__ import annotations

import numpy as np
import pytest
from bag_files import FRAME, Sent, header, pose, tf, transform, write_bag

from polarmap.errors import InputError
from polarmap.geometry.pose import from_quaternion, inverse
from polarmap.io.recording.ros.poses import PoseQuery, read_bag_poses

START = 1_700_000_000_000_000_000
STEP = 100_000_000
SECONDS = [(START + i * STEP) / 1e9 for i in range(6)]
T_BODY_CAMERA = from_quaternion([0.1, 0.02, 0.3], [-0.5, 0.5, -0.5, 0.5])  # optical axes in those of a robot
T_BODY_MOUNT = from_quaternion([0.0, 0.0, 0.25], [0.0, 0.0, 0.2, 1.0])
KINDS = ["ros1", "mcap", "sqlite3"]


def at(i: float) -> np.ndarray:
    """T_world_body after i steps: it turns evenly as it goes."""
    angle = 0.05 * i
    return from_quaternion([0.2 * i, -0.1 * i, 0.0], [0.0, 0.0, np.sin(angle / 2), np.cos(angle / 2)])


def time(i: float) -> int:
    return START + round(i * STEP)


def static(*transforms) -> Sent:
    return tf(*(transform(T, parent, child, 0) for T, parent, child in transforms), topic="/tf_static", recorded=START)


MOUNTED = static(
    (T_BODY_MOUNT, "base_link", "mount"), (inverse(T_BODY_MOUNT) @ T_BODY_CAMERA, "mount", FRAME)
)  # the camera hangs on a mount


def odometry(i: int, body: str = "base_link", **changes) -> Sent:
    fields = {"header": header(time(i), "odom"), "child_frame_id": body, "pose": {"pose": pose(at(i))}} | changes
    return Sent("/poses", "nav_msgs/msg/Odometry", time(i), fields)


def stamped(i: int) -> Sent:
    return Sent(
        "/poses", "geometry_msgs/msg/PoseStamped", time(i), {"header": header(time(i), "map"), "pose": pose(at(i))}
    )


def with_covariance(i: int) -> Sent:
    fields = {"header": header(time(i), "map"), "pose": {"pose": pose(at(i))}}
    return Sent("/poses", "geometry_msgs/msg/PoseWithCovarianceStamped", time(i), fields)


def moved(i: int) -> Sent:
    fields = transform(at(i), "map", "base_link", time(i))
    return Sent("/poses", "geometry_msgs/msg/TransformStamped", time(i), fields)


def path_of(count: int) -> Sent:
    poses = [{"header": header(time(i), "map"), "pose": pose(at(i))} for i in range(count)]
    return Sent("/poses", "nav_msgs/msg/Path", time(count), {"header": header(time(count), "map"), "poses": poses})


def read(path, topic="/poses", camera=FRAME, **query):
    return read_bag_poses(path, PoseQuery(topic, **query), camera, SECONDS)


def refused(*words):
    return pytest.raises(InputError, match="".join(f"(?=.*{word})" for word in words))


def same(trajectory, of_camera: np.ndarray, count: int = 6) -> None:
    assert len(trajectory) == count
    assert trajectory.nanoseconds.tolist() == [time(i) for i in range(count)]
    np.testing.assert_allclose(trajectory.poses, [at(i) @ of_camera for i in range(count)], atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("message", [odometry, moved])
def test_poses_of_a_body_are_carried_to_the_camera(tmp_path, kind, message):
    path = write_bag(tmp_path / "bag", kind, [MOUNTED, *map(message, range(6))])
    same(read(path), T_BODY_CAMERA)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("message", [stamped, with_covariance])
def test_poses_that_name_no_body_are_those_of_the_camera(tmp_path, kind, message, caplog):
    path = write_bag(tmp_path / "bag", kind, [MOUNTED, *map(message, range(6))])
    same(read(path), np.eye(4))
    assert "does not name whose poses" in caplog.text
    same(read(path, body_frame="base_link"), T_BODY_CAMERA)
    same(read(path, body_frame="/mount", camera_frame="base_link"), inverse(T_BODY_MOUNT))


@pytest.mark.parametrize("kind", KINDS)
def test_the_last_path_counts(tmp_path, kind):
    same(read(write_bag(tmp_path / "bag", kind, map(path_of, (2, 4, 6)))), np.eye(4))


def test_poses_of_the_camera_itself(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", [odometry(i, body=f"/{FRAME}") for i in range(6)])
    same(read(path), np.eye(4))


def test_poses_come_in_order_of_time_and_once(tmp_path):
    messages = [odometry(i, FRAME)._replace(recorded=START - i) for i in (3, 1, 0, 2, 2, 5, 4)]
    same(read(write_bag(tmp_path / "bag", "mcap", messages)), np.eye(4))


def test_bodies_without_a_way_to_the_camera(tmp_path):
    bare = write_bag(tmp_path / "bare", "ros1", map(odometry, range(6)))
    with refused(f"from base_link to {FRAME}", "do not know base_link", "they know none"):
        read(bare)
    with refused("images do not name the camera's frame", "--camera-frame"):
        read(bare, camera="")
    parts = static((T_BODY_MOUNT, "base_link", "mount"), (T_BODY_MOUNT, "head", FRAME))
    split = write_bag(tmp_path / "split", "ros1", [parts, *map(odometry, range(6))])
    with refused(f"from base_link to {FRAME}", f"base_link hangs on base_link, {FRAME} on head"):
        read(split)
    turning = [tf(transform(at(i), "base_link", FRAME, time(i)), recorded=time(i)) for i in range(6)]
    with refused(f"{FRAME} moves against base_link", "--pose-topic /tf"):
        read(write_bag(tmp_path / "turning", "ros1", [*turning, *map(odometry, range(6))]))


def test_transforms_that_are_told_again_and_again_do_not_move(tmp_path):
    repeated = [tf(transform(T_BODY_CAMERA, "base_link", FRAME, time(i)), recorded=time(i)) for i in range(6)]
    same(read(write_bag(tmp_path / "bag", "ros1", [*repeated, *map(odometry, range(6))])), T_BODY_CAMERA)


T_MAP_ODOM = from_quaternion([5.0, 1.0, 0.0], [0.0, 0.0, 0.1, 1.0])


def moving(i: float) -> Sent:
    return tf(transform(at(i), "odom", "base_link", time(i)), recorded=time(i))


@pytest.mark.parametrize("kind", KINDS)
def test_tf_is_composed_and_interpolated(tmp_path, kind):
    corrections = [tf(transform(T_MAP_ODOM, "map", "odom", time(i)), recorded=time(i)) for i in (-1, 2, 7)]
    between = [moving(i + 0.5) for i in range(-1, 6)]  # never at the time of a frame
    path = write_bag(tmp_path / "bag", kind, [MOUNTED, *corrections, *between])
    found = read(path, "/tf", world_frame="map")
    assert len(found) == 6 and np.allclose(found.timestamps, SECONDS, rtol=0, atol=1e-6)
    for i, T in enumerate(found.poses):  # turns along the arc, goes along the line
        expected = T_MAP_ODOM @ at(i) @ T_BODY_CAMERA
        np.testing.assert_allclose(T, expected, atol=1e-6)
    odom = read(path, "/tf", world_frame="/odom")
    np.testing.assert_allclose(odom.poses[3], at(3) @ T_BODY_CAMERA, atol=1e-6)


def test_tf_to_a_frame_beside_the_chain(tmp_path):
    door = static((from_quaternion([1.0, 2.0, 3.0], [0, 0, 0.6, 0.8]), "map", "door"))
    fixed = static((T_MAP_ODOM, "map", "odom"))
    path = write_bag(tmp_path / "bag", "mcap", [MOUNTED, door, fixed, *map(moving, range(6))])
    T_map_door = from_quaternion([1.0, 2.0, 3.0], [0, 0, 0.6, 0.8])
    found = read(path, "/tf", world_frame="door")
    np.testing.assert_allclose(found.poses[2], inverse(T_map_door) @ T_MAP_ODOM @ at(2) @ T_BODY_CAMERA, atol=1e-6)


def test_gaps_of_tf_are_gaps(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", [MOUNTED, *(moving(i / 4) for i in (*range(9), *range(16, 21)))])
    assert [round((t - SECONDS[0]) / 0.1) for t in read(path, "/tf", world_frame="odom").timestamps] == [0, 1, 2, 4, 5]


def test_tf_that_cannot_be_used(tmp_path):
    path = write_bag(tmp_path / "bag", "mcap", [MOUNTED, *map(moving, range(6))])
    with refused("--world-frame", f"above {FRAME} are odom, base_link, mount"):
        read(path, "/tf")
    with refused("do not know earth", "base_link"):
        read(path, "/tf", world_frame="earth")
    with refused("--camera-frame"):
        read(path, "/tf", camera="", world_frame="odom")
    with refused("--world-frame is for tf"):
        read(write_bag(tmp_path / "odometry", "mcap", [odometry(0)]), world_frame="odom")
    late = write_bag(tmp_path / "late", "mcap", [MOUNTED, *(moving(i) for i in range(100, 106))])
    with refused("tf connects odom", "but frames are from"):
        read(late, "/tf", world_frame="odom")


def test_trees_that_are_none(tmp_path):
    circle = static((T_BODY_MOUNT, "a", "b"), (T_BODY_MOUNT, "b", "a"))
    with refused("its own ancestor"):
        read(write_bag(tmp_path / "circle", "ros1", [circle]), "/tf_static", "a", world_frame="b")
    double = static((T_BODY_MOUNT, "a", "c"), (T_BODY_MOUNT, "b", "c"))
    with refused("c has two parents, a and b"):
        read(write_bag(tmp_path / "double", "ros1", [double]), "/tf_static", "c", world_frame="a")


def test_transforms_that_are_none_are_left_out(tmp_path, caplog):
    wrong = {"header": header(START, "x"), "child_frame_id": "y"}  # a quaternion of zeros
    bag = [MOUNTED, tf(wrong, recorded=START), *map(moving, range(6))]
    assert len(read(write_bag(tmp_path / "bag", "mcap", bag), "/tf", world_frame="odom")) == 6
    assert "1 transforms of /tf are left out (y in x: a quaternion of norm 0" in caplog.text


def test_topics_without_poses(tmp_path):
    note = Sent("/note", "std_msgs/msg/String", START, {"data": "hello"})
    path = write_bag(tmp_path / "bag", "ros1", [note, odometry(0, pose={})])
    with refused("/note has messages of std_msgs/msg/String", "Odometry", "TFMessage"):
        read(path, "/note")
    with refused("no topic /none", "/note, /poses"):
        read(path, "/none")
    with refused("/poses, pose 1: a quaternion of norm 0"):
        read(path)
    unstamped = Sent("/path", "nav_msgs/msg/Path", START, {"poses": [{"pose": pose(np.eye(4))}]})
    with refused("have no times of their own"):
        read(write_bag(tmp_path / "path", "mcap", [unstamped]), "/path")


def test_numbers_that_are_not_finite(tmp_path):
    nan = odometry(0, FRAME)
    nan.fields["pose"]["pose"]["position"] = {"x": float("nan")}
    with refused("pose 1: .*finite"):
        read(write_bag(tmp_path / "bag", "mcap", [nan]))
