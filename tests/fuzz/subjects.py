"""Every reader of the package with small sound files for it, in a form that can be changed and read again."""

from __future__ import annotations

import sys
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec
from pathlib import Path

import cv2
import numpy as np

from . import mutations
from .mutations import Mutation

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))  # of the samples of other tests

from import_samples import colmap_map_bytes, dmap_bytes, write_colmap_model

from polarmap.benchmark import configuration, spec
from polarmap.benchmark.cells import cells_of, read_result
from polarmap.data.sensor_presets import find_preset
from polarmap.evaluation.imported import import_run
from polarmap.evaluation.records import read_evaluation
from polarmap.evaluation.truth import truth_of
from polarmap.geometry.camera import PinholeCamera
from polarmap.io.files import read_bytes
from polarmap.io.formats.colmap import read_colmap_map, read_colmap_model
from polarmap.io.formats.depth_array import read_depth_array
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.images import read_header, read_image, read_picture
from polarmap.io.formats.normal_png import read_normal_png
from polarmap.io.formats.openmvs import read_dmap
from polarmap.io.formats.ply_reader import read_ply
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.calibrated_camera import SensorChoice, calibrated_camera
from polarmap.io.recording.camera_file import read_camera_file
from polarmap.io.recording.photometric import read_response, read_vignette
from polarmap.io.recording.rgbd import open_rgbd
from polarmap.io.recording.rgbd.intrinsics import read_intrinsics
from polarmap.io.recording.sequence import open_sequence
from polarmap.io.run_folder.folder import read_results
from polarmap.io.run_folder.keyframe_file import read_keyframe, replace_pose
from polarmap.pipeline.config import Config, read_config
from polarmap.prior.network_spec import network_spec

CAMERA = PinholeCamera(16, 12, 15.0, 15.0, 7.5, 5.5)
SIZE = (CAMERA.width, CAMERA.height)
POSES = np.stack([np.eye(4)] * 4)
POSES[:, 0, 3] = 0.1 * np.arange(4)
GREY = (np.arange(12 * 16) % 251).astype(np.uint8).reshape(12, 16)
GREY16 = GREY.astype(np.uint16) * 257
COLOUR = np.stack([GREY, GREY // 2, 255 - GREY], axis=-1)
DEPTH = np.linspace(1.0, 3.0, 12 * 16, dtype=np.float32).reshape(12, 16)

CAMERA_TEXT = """width: 16
height: 12
fx: 15.0
fy: 15
cx: 7.5
cy: 5.5
mosaic: none
angle_direction: clockwise
bit_depth: 8
noise: {full_well: 10000, read_noise: 2.5}
distortion: {model: radtan, coefficients: [0.1, -0.01, 0, 1.0e-3]}
frame_rate: 10
depth_scale: 5000
"""
PLAIN_TEXT = CAMERA_TEXT.replace("mosaic: none\nangle_direction: clockwise", "polarization: none").replace(
    "distortion: {model: radtan, coefficients: [0.1, -0.01, 0, 1.0e-3]}\n", ""
)
SPEC = """sequences:
  - {name: office, title: Office kt1, path: office, frames: "0:300:2", published: office-kt1, camera: camera.yaml}
  - {name: street, synth: scene street --frames 60}
methods:
  - {name: ours, poses: true, settings: [paper.max_steps=48]}
  - {name: own, poses: odometry, prior: nets/small.onnx}
  - {name: colmap, kind: import, format: colmap, path: "colmap/{sequence}", keyframes_of: ours}
seeds: [0, 3]
tables: [accuracy, confidence]
"""
PLY = (
    "ply\nformat {} 1.0\ncomment c\nelement vertex 4\nproperty float x\nproperty float y\nproperty float z\n"
    "property float nx\nproperty float ny\nproperty float nz\nelement face 2\n"
    "property list uchar int vertex_indices\nend_header\n"
)


@dataclass(frozen=True)
class Subject:
    """A reader. make: writes sound files into an empty folder. read: reads them. files: those that are changed.

    share: how often it is tried, against the others. finite: whether what it gives has no infinite numbers.
    """

    make: Callable[[Path], None]
    read: Callable[[Path], object]
    files: Sequence[str]
    changes: tuple[Mutation, ...]
    share: float = 1.0
    finite: bool = True


def _file(name: str, data: bytes | str, read: Callable[[Path], object], changes, **options) -> Subject:
    """A reader of one file."""

    def make(folder: Path) -> None:
        (folder / name).write_bytes(data.encode() if isinstance(data, str) else data)

    return Subject(make, lambda folder: read(folder / name), (name,), changes, **options)


def _image(suffix: str, image: np.ndarray, parameters: Sequence[int] = ()) -> bytes:
    return cv2.imencode(suffix, image, list(parameters))[1].tobytes()


def _read_any_picture(path: Path) -> object:
    """As a picture of a known and of an unknown size."""
    results = []
    for read in (lambda: read_image(path, SIZE), lambda: read_picture(path), lambda: read_header(path)):
        try:
            results.append(read())
        except Exception as error:
            results.append(error)
    return _first_error(results)


def _first_error(results: list) -> object:
    errors = [result for result in results if isinstance(result, Exception)]
    from polarmap.errors import PolarmapError

    foreign = [error for error in errors if not isinstance(error, PolarmapError)]
    if foreign or len(errors) == len(results):
        raise (foreign or errors)[0]
    return [result for result in results if not isinstance(result, Exception)]


def _read_setting(path: Path) -> object:
    return Config().with_settings([read_bytes(path).decode("utf-8", "replace")])


def _read_config(path: Path) -> object:
    config = read_config(path)
    config.to_yaml()
    return config


def _read_spec(path: Path) -> object:
    found = spec.read_spec(path)
    for cell in cells_of(found):
        configuration.configuration(cell)
    return found


def _tum(poses: np.ndarray, step: float = 0.1) -> str:
    return "# t tx ty tz qx qy qz qw\n" + "".join(
        f"{step * i} {T[0, 3]} {T[1, 3]} {T[2, 3]} 0 0 0 1\n" for i, T in enumerate(poses)
    )


def _euroc() -> str:
    return "#t,x,y,z,qw,qx,qy,qz\n" + "".join(
        f"{1403636579000000000 + 50000000 * i},{T[0, 3]},0,0,1,0,0,0,0,0\n" for i, T in enumerate(POSES)
    )


def _kitti() -> str:
    return "".join(" ".join(map(str, T[:3].ravel())) + "\n" for T in POSES)


def _log() -> str:
    rows = ("\n".join(" ".join(map(str, row)) for row in T) for T in POSES)
    return "".join(f"{i} {i} {i + 1}\n{text}\n" for i, text in enumerate(rows))


def _ply(kind: str) -> bytes:
    rng = np.random.default_rng(0)
    vertices = rng.random((4, 6)).astype("<f4")
    if kind == "ascii":
        rows = [" ".join(map(str, row)) for row in vertices.tolist()]
        return (PLY.format(kind) + "\n".join([*rows, "3 0 1 2", "4 0 1 2 3"]) + "\n").encode()
    faces = b"\x03" + np.array([0, 1, 2], "<i4").tobytes() + b"\x04" + np.array([0, 1, 2, 3], "<i4").tobytes()
    return PLY.format(kind).encode() + vertices.tobytes() + faces


def _npy() -> bytes:
    import io

    buffer = io.BytesIO()
    np.save(buffer, DEPTH)
    return buffer.getvalue()


def _make_model(binary: bool) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        poses = {f"{i:06d}.png": T for i, T in enumerate(POSES)}
        write_colmap_model(folder, CAMERA, poses, np.array([[0.0, 0.0, 2.0], [0.5, 0.0, 2.0]]), binary)

    return make


def _read_model(folder: Path) -> object:
    model = read_colmap_model(folder)
    return [model, *(model.positions_of(image.point_ids[:100]) for image in model.images[:3])]


def _make_sequence(folder: Path) -> None:
    (folder / "camera.yaml").write_text(PLAIN_TEXT)
    (folder / "images").mkdir()
    for i in range(4):
        (folder / "images" / f"{i:04d}.png").write_bytes(_image(".png", GREY))
    (folder / "times.txt").write_text("".join(f"{i:04d} {0.1 * i:.3f} {5.0}\n" for i in range(4)))
    (folder / "exposures.txt").write_text("5\n" * 4)
    (folder / "groundtruth.txt").write_text(_tum(POSES))
    (folder / "depth").mkdir()
    (folder / "depth" / "0000.png").write_bytes(_image(".png", (5000 * DEPTH).astype(np.uint16)))


def _make_listed(folder: Path) -> None:
    (folder / "camera.yaml").write_text(PLAIN_TEXT)
    (folder / "rgb").mkdir()
    for i in range(4):
        (folder / "rgb" / f"{i:04d}.raw").write_bytes(GREY.tobytes())
    (folder / "rgb.txt").write_text("".join(f"{0.1 * i:.3f} rgb/{i:04d}.raw\n" for i in range(4)))


def _make_csv(folder: Path) -> None:
    (folder / "camera.yaml").write_text(PLAIN_TEXT)
    (folder / "cam0" / "data").mkdir(parents=True)
    for i in range(4):
        (folder / "cam0" / "data" / f"{1403636579000000000 + i}.png").write_bytes(_image(".png", GREY))
    lines = [f"{1403636579000000000 + i},{1403636579000000000 + i}.png\n" for i in range(4)]
    (folder / "cam0" / "data.csv").write_text("#t,file\n" + "".join(lines))


def _make_polarized(folder: Path) -> None:
    text = CAMERA_TEXT.replace("mosaic: none", "mosaic: [90, 45, 135, 0]")
    (folder / "camera.yaml").write_text(text.replace("bit_depth: 8", "bit_depth: 12\npixel_format: Mono12Packed"))
    (folder / "raw").mkdir()
    for i in range(3):
        (folder / "raw" / f"{i:04d}.raw").write_bytes(bytes(32 * 24 * 3 // 2))
    (folder / "timestamps.txt").write_text("0\n0.1\n0.2\n")


def _read_sequence(folder: Path) -> object:
    sequence = open_sequence(folder)
    frame = sequence[0]
    return [frame, sequence.truth_depth(frame.index), sequence.truth_trajectory()]


def _make_import(folder: Path) -> None:
    (folder / "sequence").mkdir()
    _make_sequence(folder / "sequence")
    (folder / "run").mkdir()
    for i in range(3):
        (folder / "run" / f"{i:04d}.png").write_bytes(_image(".png", (5000 * DEPTH).astype(np.uint16)))
    (folder / "run" / "trajectory.txt").write_text(_tum(POSES))


def _read_import(folder: Path) -> object:
    run = import_run(folder / "run", open_sequence(folder / "sequence"))
    return [run.poses, run.trajectory, *(frame.read() for frame in run.frames)]


def _make_keyframe(folder: Path) -> None:
    np.savez(
        folder / "000003.npz", depth=DEPTH, normal=np.zeros((12, 16, 3), np.float32),
        **{name: np.zeros((12, 16), np.float32) for name in ("azimuth", "zenith", "sigma", "confidence")},
        **{name: np.zeros((12, 16), np.uint8) for name in ("label", "origin")},
        K=CAMERA.matrix, T_world_camera=np.eye(4), timestamp=np.float64(0.3),
    )  # fmt: skip


def _read_keyframe(folder: Path) -> object:
    found = read_keyframe(folder / "000003.npz")
    replace_pose(folder / "000003.npz", np.eye(4))
    return found


def _make_run(folder: Path) -> None:
    for name, data in _run_files().items():
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_bytes(data)


@cache
def _run_files() -> dict[str, bytes]:
    """The files of a small run with its evaluation, by name; made once, as its report takes a while."""
    from run_samples import sample_keyframe, true_depth, write_run, write_sequence

    from polarmap.evaluation.evaluate_run import evaluate_run
    from polarmap.evaluation.records import write_evaluation

    with tempfile.TemporaryDirectory() as name:
        out = write_run(Path(name, "run"), [sample_keyframe(i, true_depth(i)) for i in range(2)])
        evaluation = evaluate_run(out, truth_of(write_sequence(Path(name, "sequence"))))
        write_evaluation(out / "evaluation.json", evaluation)
        return {str(file.relative_to(name)): file.read_bytes() for file in out.rglob("*") if file.is_file()}


def _read_report(folder: Path) -> object:
    from polarmap.report.html import write_report

    return len(write_report(folder / "run").read_bytes())


def _make_cell(folder: Path) -> None:
    (folder / "result.json").write_text(
        '{"status": "complete", "sequence": "a", "method": "b", "seed": 0, "configuration": {"a": 1}, '
        '"started": "now", "seconds": 1.5, "figures": {"depth.abs_rel": 0.1, "x": null}, '
        '"curves": {"c": {"x": [1, 2], "y": [3, null]}}, '
        '"milliseconds": {"stereo": {"median": 1.0, "total": 2.0}}}'
    )


def _make_tum(folder: Path) -> None:
    for kind, image in (("rgb", COLOUR), ("depth", (5000 * DEPTH).astype(np.uint16))):
        (folder / kind).mkdir()
        for i in range(3):
            (folder / kind / f"{i}.png").write_bytes(_image(".png", image))
        (folder / f"{kind}.txt").write_text("".join(f"{0.1 * i} {kind}/{i}.png\n" for i in range(3)))
    (folder / "groundtruth.txt").write_text(_tum(POSES))
    (folder / "camera.json").write_text(OPEN3D)


def _make_associated(folder: Path) -> None:
    _make_tum(folder)
    (folder / "rgb.txt").unlink()
    (folder / "associations.txt").write_text("".join(f"{i} depth/{i}.png {i} rgb/{i}.png\n" for i in range(3)))
    (folder / "groundtruth.txt").rename(folder / "a.freiburg")
    (folder / "a.freiburg").write_text(_tum(POSES, step=1))


def _make_redwood(folder: Path) -> None:
    for kind, image in (("image", GREY), ("depth", (1000 * DEPTH).astype(np.uint16))):
        (folder / kind).mkdir()
        for i in range(4):
            suffix = ".jpg" if kind == "image" else ".png"
            (folder / kind / f"{i}{suffix}").write_bytes(_image(suffix, image))
    (folder / "trajectory.log").write_text(_log())
    (folder / "camera_intrinsic.json").write_text(OPEN3D)


def _make_replica(folder: Path) -> None:
    (folder / "results").mkdir()
    for i in range(4):
        (folder / "results" / f"frame{i:06d}.jpg").write_bytes(_image(".jpg", COLOUR))
        (folder / "results" / f"depth{i:06d}.png").write_bytes(_image(".png", (6553 * DEPTH).astype(np.uint16)))
    (folder / "traj.txt").write_text("".join(" ".join(map(str, T.ravel())) + "\n" for T in POSES))
    (folder / "cam_params.json").write_text(REPLICA)


def _make_pov(folder: Path) -> None:
    for i in range(2):
        (folder / f"scene_00_{i:04d}.png").write_bytes(_image(".png", COLOUR))
        (folder / f"scene_00_{i:04d}.depth").write_text(" ".join(f"{z:.4f}" for z in DEPTH.ravel()))
        (folder / f"scene_00_{i:04d}.txt").write_text(
            f"cam_pos = [{i}, 0, 0]';\ncam_dir = [0, 0, 1]';\ncam_up = [0, 1, 0]';\n"
        )
    (folder / "camera.json").write_text(OPEN3D)


def _rgbd(camera: str | None) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        sequence = open_rgbd(folder, camera=None if camera is None else folder / camera)
        return [sequence.timestamps, sequence.poses, sequence.camera, sequence.depth_scale, sequence[0]]

    return read


def _make_bag(kind: str) -> Callable[[Path], None]:
    def make(folder: Path) -> None:
        from bag_files import FRAME, Sent, header, image, pose, tf, transform, write_bag

        (folder / "camera.yaml").write_text(PLAIN_TEXT)
        sent = [image(GREY, 10**9 * (i + 1), "mono8") for i in range(3)]
        sent.append(tf(transform(np.eye(4), "base", FRAME, 0), topic="/tf_static"))
        for i, T in enumerate(POSES):
            time = 10**9 * (i + 1)
            fields = {"header": header(time, "odom"), "child_frame_id": "base", "pose": {"pose": pose(T)}}
            sent.append(Sent("/odom", "nav_msgs/msg/Odometry", time, fields))
            sent.append(tf(transform(T, "odom", "base", time), recorded=time))
        write_bag(folder / "a", kind, sent)

    return make


def _read_bag(name: str) -> Callable[[Path], object]:
    def read(folder: Path) -> object:
        from polarmap.io.recording.ros.opening import open_bag
        from polarmap.io.recording.ros.poses import PoseQuery, read_bag_poses

        results: list[object] = []
        for query in (PoseQuery("/odom"), PoseQuery("/tf", world_frame="odom")):
            try:
                found = read_bag_poses(folder / name, query, "camera_optical_frame", [1.0, 2.0, 2.5])
                results.append([found.timestamps, found.poses])
            except Exception as error:
                results.append(error)
        try:
            results.append(list(open_bag(folder / name)))
        except Exception as error:
            results.append(error)
        return _first_error(results)

    return read


def _read_calibrated(path: Path) -> object:
    return calibrated_camera(path, SensorChoice(find_preset("IMX250MYR"))).camera_file


OPENCV = (
    "%YAML:1.0\n---\nimage_width: 2448\nimage_height: 2048\ncamera_matrix: !!opencv-matrix\n   rows: 3\n   cols: 3\n"
    "   dt: d\n   data: [ 3800., 0., 1223.5, 0., 3800., 1023.5, 0., 0., 1. ]\n"
    "distortion_coefficients: !!opencv-matrix\n   rows: 5\n   cols: 1\n   dt: d\n   data: [ -0.1, 0.02, 0., 0., 0. ]\n"
)
OPEN3D = '{"width": 16, "height": 12, "intrinsic_matrix": [15, 0, 0, 0, 15, 0, 7.5, 5.5, 1]}'
REPLICA = '{"camera": {"w": 16, "h": 12, "fx": 15.0, "fy": 15.0, "cx": 7.5, "cy": 5.5, "scale": 6553.5}}'
SIDECAR = """output_space: depth
input_size: [256, 320]
multiple_of: 32
mean: [0.1, 0.2, 0.3]
std: [1, 1, 1]
output: 0
"""
POLARIZERS = "calibration: {angles: [1, 44.5, 90, 134.5], gains: [1.01, 0.99, 1, 1], efficiencies: [0.9, 1, 1, 1]}\n"
FEW_PARAMETERS = "densify: {max_steps: 5}\nstereo:\n  depth_min: 0.5\n"
PICTURES = "run/pictures/"
TIFF_PLAIN, TIFF_LZW, TIFF_DEFLATE = ([cv2.IMWRITE_TIFF_COMPRESSION, code] for code in (1, 5, 8))
K = CAMERA.matrix
M = mutations

SUBJECTS: dict[str, Subject] = {
    "camera file": _file("camera.yaml", CAMERA_TEXT, read_camera_file, M.TEXT, share=2),
    "camera file, calibrated": _file("camera.yaml", CAMERA_TEXT + POLARIZERS, read_camera_file, M.TEXT, share=0.5),
    "camera of a calibration": _file("opencv.yaml", OPENCV, _read_calibrated, M.TEXT, share=0.5),
    "configuration": _file("config.yaml", Config().to_yaml(), _read_config, M.TEXT, share=0.1),
    "few parameters": _file("config.yaml", FEW_PARAMETERS, _read_config, M.TEXT),
    "setting": _file("setting.txt", "paper.max_steps=48", _read_setting, M.TEXT),
    "benchmark": _file("spec.yaml", SPEC, _read_spec, M.TEXT, share=0.5),
    "sidecar": _file("net.yaml", SIDECAR, lambda path: network_spec(path.with_suffix(".onnx")), M.TEXT),
    "TUM trajectory": _file("a.txt", _tum(POSES), read_trajectory, M.TEXT),
    "EuRoC trajectory": _file("a.csv", _euroc(), read_trajectory, M.TEXT),
    "KITTI trajectory": _file("a.txt", _kitti(), read_trajectory, M.TEXT),
    "Redwood trajectory": _file("a.log", _log(), read_trajectory, M.TEXT),
    "PNG": _file("a.png", _image(".png", GREY), _read_any_picture, M.PNG),
    "PNG of 16 bits": _file("a.png", _image(".png", GREY16), _read_any_picture, M.PNG),
    "PNG in colour": _file("a.png", _image(".png", COLOUR), _read_any_picture, M.PNG),
    "TIFF": _file("a.tif", _image(".tif", GREY16, TIFF_PLAIN), _read_any_picture, M.TIFF),
    "TIFF, LZW": _file("a.tif", _image(".tif", GREY, TIFF_LZW), _read_any_picture, M.TIFF),
    "TIFF, deflate": _file("a.tif", _image(".tif", GREY16, TIFF_DEFLATE), _read_any_picture, M.TIFF),
    "PGM": _file("a.pgm", _image(".pgm", GREY), _read_any_picture, M.MIXED),
    "BMP": _file("a.bmp", _image(".bmp", GREY), _read_any_picture, M.BLIND),
    "JPEG": _file("a.jpg", _image(".jpg", COLOUR), _read_any_picture, M.BLIND),
    "depth": _file("a.png", _image(".png", GREY16), lambda path: read_depth_png(path, 5000.0, SIZE), M.PNG),
    "normals": _file(
        "a.png", _image(".png", COLOUR.astype(np.uint16) * 257), lambda path: read_normal_png(path, SIZE), M.PNG
    ),
    "depth array": _file("a.npy", _npy(), read_depth_array, M.NPY),
    "keyframe": Subject(_make_keyframe, _read_keyframe, ("000003.npz",), M.NPZ, share=2),
    "PLY in text": _file("a.ply", _ply("ascii"), read_ply, M.TEXT, finite=False),
    "PLY": _file("a.ply", _ply("binary_little_endian"), read_ply, M.MIXED, finite=False),
    "COLMAP in text": Subject(
        _make_model(False), _read_model, ("cameras.txt", "images.txt", "points3D.txt"), M.TEXT, share=2, finite=False
    ),
    "COLMAP": Subject(
        _make_model(True), _read_model, ("cameras.bin", "images.bin", "points3D.bin"), M.BLIND, share=2, finite=False
    ),
    "COLMAP depth": _file("a.bin", colmap_map_bytes(DEPTH), read_colmap_map, M.MIXED),
    "OpenMVS": _file("a.dmap", dmap_bytes("0.png", DEPTH, K, np.eye(4)), read_dmap, M.BLIND),
    "Open3D intrinsics": _file("a.json", OPEN3D, read_intrinsics, M.JSON),
    "Replica intrinsics": _file("a.json", REPLICA, read_intrinsics, M.JSON),
    "results": Subject(_make_run, lambda f: read_results(f / "run"), ("run/results.json",), M.JSON),
    "evaluation": Subject(
        _make_run, lambda f: read_evaluation(f / "run" / "evaluation.json"), ("run/evaluation.json",), M.JSON
    ),
    "cell": Subject(_make_cell, read_result, ("result.json",), M.JSON),
    "report": Subject(
        _make_run, _read_report,
        ("run/results.json", "run/results.json", "run/evaluation.json", "run/evaluation.json", "run/config.yaml"),
        M.JSON, share=0.02,
    ),
    "report's pictures": Subject(
        _make_run, _read_report, (PICTURES + "000000_depth.jpg", PICTURES + "000001_origin.png"), M.BLIND, share=0.01
    ),
    "response": _file("pcalib.txt", " ".join(str(float(i)) for i in range(256)), read_response, M.TEXT),
    "vignette": _file("vignette.png", _image(".png", GREY16), lambda path: read_vignette(path, SIZE), M.PNG),
    "sequence": Subject(
        _make_sequence, _read_sequence,
        ("camera.yaml", "times.txt", "exposures.txt", "groundtruth.txt"), M.TEXT,
    ),
    "listed sequence": Subject(_make_listed, _read_sequence, ("rgb.txt", "rgb/0000.raw"), M.TEXT),
    "EuRoC sequence": Subject(_make_csv, _read_sequence, ("cam0/data.csv",), M.TEXT),
    "packed sequence": Subject(
        _make_polarized, _read_sequence, ("camera.yaml", "timestamps.txt", "raw/0000.raw"), M.TEXT
    ),
    "imported run": Subject(_make_import, _read_import, ("run/trajectory.txt", "run/0000.png"), M.MIXED, share=0.5),
    "TUM recording": Subject(
        _make_tum, _rgbd("camera.json"), ("rgb.txt", "depth.txt", "groundtruth.txt"), M.TEXT, share=0.5
    ),
    "ICL recording": Subject(
        _make_associated, _rgbd("camera.json"), ("associations.txt", "a.freiburg"), M.TEXT, share=0.3
    ),
    "POV recording": Subject(
        _make_pov, _rgbd("camera.json"), ("scene_00_0000.txt", "scene_00_0000.depth"), M.TEXT, share=0.5
    ),
    "Redwood recording": Subject(
        _make_redwood, _rgbd(None), ("trajectory.log", "camera_intrinsic.json"), M.TEXT, share=0.5
    ),
    "Replica recording": Subject(_make_replica, _rgbd(None), ("traj.txt", "cam_params.json"), M.TEXT, share=0.5),
}  # fmt: skip

if find_spec("rosbags"):  # of the extra bags
    SUBJECTS |= {
        "ROS 1 bag": Subject(_make_bag("ros1"), _read_bag("a.bag"), ("a.bag",), M.MIXED),
        "MCAP": Subject(_make_bag("mcap"), _read_bag("a/a.mcap"), ("a/a.mcap",), M.MIXED),
        "ROS 2 folder": Subject(_make_bag("sqlite3"), _read_bag("a"), ("a/metadata.yaml", "a/a.db3"), M.MIXED),
    }
