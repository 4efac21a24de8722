"""ROS bags on the command line: the same map as of the same frames in a folder, and one line for what goes wrong."""

from __future__ import annotations

import shutil
import sys

import cv2
import numpy as np
import pytest
from bag_files import FRAME, IMAGES, Sent, header, image, pose, tf, transform, write_bag
from command_line import refused
from room_recording import CAMERA, SENSOR

from polarmap.data.times import nanoseconds_of
from polarmap.geometry.pose import from_quaternion, inverse
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.sequence import open_sequence
from polarmap.synth import built_in_scene, render_sequence
from polarmap.synth.recording import write_sequence

QUICK = ("--set", "fusion.min_faces=0")
T_BODY_CAMERA = from_quaternion([0.1, 0.02, 0.3], [-0.5, 0.5, -0.5, 0.5])


@pytest.fixture(scope="module")
def sequence(tmp_path_factory):
    """The folder of a recording of the room."""
    folder = tmp_path_factory.mktemp("room")
    room = built_in_scene("room")
    write_sequence(folder, render_sequence(room.scene, CAMERA, *room.path(11, step=0.06), SENSOR), CAMERA, SENSOR)
    return folder


@pytest.fixture(scope="module")
def messages(sequence):
    """The same recording as messages: images, and the poses of a robot that carries the camera."""
    recording = open_sequence(sequence)
    poses = recording.truth_trajectory().poses
    sent = [tf(transform(T_BODY_CAMERA, "base_link", FRAME, 0), topic="/tf_static")]
    for frame, T_world_camera in zip(recording, poses, strict=True):
        time = nanoseconds_of(frame.timestamp)
        sent.append(image(frame.mosaic, time, "mono16"))
        T_world_body = T_world_camera @ inverse(T_BODY_CAMERA)
        fields = {"header": header(time, "odom"), "child_frame_id": "base_link", "pose": {"pose": pose(T_world_body)}}
        sent.append(Sent("/odom", "nav_msgs/msg/Odometry", time, fields))
        sent.append(tf(transform(T_world_body, "odom", "base_link", time), recorded=time))
        camera = {"header": header(time, "odom"), "pose": pose(T_world_camera)}
        sent.append(Sent("/camera_pose", "geometry_msgs/msg/PoseStamped", time, camera))
    return sent


@pytest.fixture(scope="module")
def bags(sequence, messages, tmp_path_factory):
    """A bag of each kind, with the camera file beside them."""
    folder = tmp_path_factory.mktemp("bags")
    shutil.copy(sequence / "camera.yaml", folder)
    return {kind: write_bag(folder / f"room {kind}", kind, messages) for kind in ("ros1", "sqlite3", "mcap file")}


def depths(out):
    """The arrays of all keyframes."""
    found = {}
    for path in sorted((out / "keyframes").glob("*.npz")):
        with np.load(path, allow_pickle=False) as arrays:
            found[path.name] = {name: arrays[name] for name in arrays.files}
    return found


@pytest.fixture(scope="module")
def mapped(sequence, tmp_path_factory):
    """The map of the folder, with the true poses."""
    from polarmap import cli

    out = tmp_path_factory.mktemp("mapped") / "out"
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            sys, "argv",
            ["polarmap", "run", str(sequence), "--poses", str(sequence / "groundtruth.txt"), "--out", str(out), *QUICK],
        )  # fmt: skip
        with pytest.raises(SystemExit) as ended:
            cli.main()
    assert not ended.value.code
    return depths(out)


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap file"])
def test_a_bag_gives_the_same_depth_as_a_folder(polarmap, sequence, mapped, bags, tmp_path, kind):
    out = tmp_path / "out"
    poses = ("--poses", sequence / "groundtruth.txt")
    status, _, err = polarmap("run", bags[kind], "--topic", IMAGES, *poses, "--out", out, *QUICK)
    assert status == 0, err
    found = depths(out)
    assert len(found) >= 2 and found.keys() == mapped.keys()
    for name, arrays in mapped.items():
        assert arrays.keys() == found[name].keys()
        for key, values in arrays.items():
            assert values.tobytes() == found[name][key].tobytes(), (name, key)


@pytest.mark.parametrize(
    "poses",
    [("--pose-topic", "/odom"), ("--pose-topic", "/camera_pose"), ("--pose-topic", "/tf", "--world-frame", "odom"), ()],
)
def test_poses_of_a_bag_make_nearly_the_same_depth(polarmap, mapped, bags, tmp_path, poses):
    arguments = poses or ("--poses", f"{bags['ros1']}:/odom")  # of another bag
    status, _, err = polarmap("run", bags["mcap file"], *arguments, "--out", tmp_path / "out", *QUICK)
    assert status == 0, err
    found = depths(tmp_path / "out")
    assert found.keys() == mapped.keys()
    for name, arrays in mapped.items():
        both = np.isfinite(arrays["depth"]) & np.isfinite(found[name]["depth"])
        assert both.mean() > 0.5
        assert np.median(np.abs(arrays["depth"] - found[name]["depth"])[both] / arrays["depth"][both]) < 1e-3


def test_poses_of_a_bag_for_a_folder(polarmap, sequence, mapped, bags, tmp_path):
    out = tmp_path / "out"
    poses = ("--poses", f"{bags['sqlite3']}:/odom", "--camera-frame", FRAME)
    assert polarmap("run", sequence, *poses, "--out", out, *QUICK)[0] == 0
    assert depths(out).keys() == mapped.keys()
    ended = polarmap("run", sequence, "--poses", f"{bags['sqlite3']}:/odom", "--out", tmp_path / "other")
    refused(ended, "/odom", "--camera-frame")


@pytest.mark.parametrize("kind", ["ros1", "sqlite3", "mcap file"])
def test_a_bag_is_played_at_its_own_pace(polarmap, bags, tmp_path, kind):
    out = tmp_path / "out"
    status, _, err = polarmap("run", bags[kind], "--pose-topic", "/odom", "--realtime", "--out", out, *QUICK)
    assert status == 0, err
    assert (out / "mesh.ply").exists()


def test_inspect_and_odometry_read_bags(polarmap, bags, tmp_path):
    status, printed, _ = polarmap("inspect", bags["sqlite3"], "--samples", 2, "--out", tmp_path / "pictures")
    assert status == 0 and "11 frames" in " ".join(printed.split())
    assert len(list((tmp_path / "pictures").glob("*overview*"))) == 2
    out = tmp_path / "trajectory.txt"
    ended = polarmap("odometry", bags["ros1"], "--topic", "/none", "--out", out)
    refused(ended, "/none", f"{IMAGES} (mono16, 11 messages)")
    assert not out.exists()


def test_odometry_of_a_bag_is_that_of_the_folder(polarmap, sequence, bags, tmp_path):
    found = []
    for i, source in enumerate((sequence, bags["mcap file"])):
        assert polarmap("odometry", source, "--out", tmp_path / f"{i}.txt").status == 0
        found.append(read_trajectory(tmp_path / f"{i}.txt"))
    assert found[0].poses.tobytes() == found[1].poses.tobytes()
    assert np.abs(found[0].timestamps - found[1].timestamps).max() <= 1e-9  # a bag has whole nanoseconds


def test_camera_info_in_place_of_a_camera_file(polarmap, messages, tmp_path):
    fields = {
        "width": 2 * CAMERA.width, "height": 2 * CAMERA.height, "distortion_model": "plumb_bob", "d": [0.0] * 5,
        "k": [2 * CAMERA.fx, 0, 2 * CAMERA.cx + 0.5, 0, 2 * CAMERA.fy, 2 * CAMERA.cy + 0.5, 0, 0, 1],
    }  # fmt: skip
    path = write_bag(
        tmp_path / "room", "mcap", [*messages, Sent("/camera/camera_info", "sensor_msgs/msg/CameraInfo", 0, fields)]
    )
    refused(polarmap("inspect", path), "--layout", "--angle-direction", "--bit-depth", "--camera")
    sensor = ("--layout", "90,45,135,0", "--angle-direction", "counterclockwise", "--bit-depth", 12)
    status, printed, err = polarmap("inspect", path, *sensor)
    assert status == 0, err
    assert "160x120" in printed.replace(" ", "").replace("×", "x")
    refused(polarmap("inspect", path, "--layout", "90;45"), "--layout", "90,45,135,0")
    refused(polarmap("inspect", path, *sensor[:1], "90,45,45,0", *sensor[2:]), "mosaic")


def test_one_line_for_each_mistake(polarmap, sequence, bags, messages, tmp_path):
    out = ("--out", tmp_path / "out")
    bag = bags["mcap file"]
    refused(polarmap("run", bag, "--pose-topic", "/none", *out), "no topic /none", "/odom")
    refused(polarmap("run", bag, "--pose-topic", "/tf", *out), "--world-frame")
    refused(polarmap("run", bag, "--pose-topic", "/odom", "--body-frame", "cart", *out), "cart", FRAME)
    refused(polarmap("run", bag, "--poses", bag, *out), f"{bag}:/odom")
    refused(polarmap("run", bag, "--poses", f"{bag}:/odom", "--pose-topic", "/odom", *out), "give one")
    refused(polarmap("run", bag, "--world-frame", "odom", *out), "--world-frame", "leave it out")
    refused(polarmap("run", sequence, "--topic", IMAGES, *out), "no ROS bag", "--topic")
    refused(polarmap("run", sequence, "--pose-topic", "/odom", *out), "--poses BAG:TOPIC")
    refused(polarmap("run", tmp_path / "none.mcap", *out), "none.mcap", "no such file")
    refused(polarmap("eval", tmp_path, bag), "a ROS bag")
    (tmp_path / "cut.mcap").write_bytes(bag.read_bytes()[:100_000])
    refused(polarmap("run", tmp_path / "cut.mcap", *out), "cut.mcap", "mcap recover")
    jpeg_bytes = cv2.imencode(".jpg", np.zeros(CAMERA.shape, np.uint8))[1].ravel()
    jpeg = Sent(IMAGES, "sensor_msgs/msg/CompressedImage", 1, {"format": "jpeg", "data": jpeg_bytes})
    shutil.copy(sequence / "camera.yaml", tmp_path)
    refused(polarmap("run", write_bag(tmp_path / "jpeg", "mcap file", [jpeg]), *out), "JPEG", "destroys polarization")
    assert not (tmp_path / "out").exists()


def test_the_extra_is_named(polarmap, bags, monkeypatch, tmp_path):
    for name in [name for name in sys.modules if name.split(".")[0] == "rosbags"]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "rosbags", None)  # its import fails then
    refused(polarmap("inspect", bags["ros1"]), "pip install 'polarmap[bags]'")
