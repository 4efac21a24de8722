"""The RGB-D formats that are read, told apart by the files that they have.

icl       rgb/ (or gray/, color/, image/) and depth/ of numbered PNG files, 5000 per metre, and *.freiburg: the
          trajectory with frame numbers in place of times; associations.txt, if there, says which belong together
          (ICL-NUIM, also its TUM-compatible form)
icl-pov   scene_00_NNNN.png, .depth (text, metres along the ray) and .txt (ICL-NUIM as rendered by POV-Ray)
tum       rgb.txt, depth.txt (or associations.txt) and groundtruth.txt, 5000 per metre (TUM RGB-D)
redwood   image/ (or color/, rgb/) and depth/ in millimetres, trajectory.log (Redwood, Open3D)
replica   results/frameNNNNNN.jpg and depthNNNNNN.png, traj.txt of 16 numbers a line (Replica as NICE-SLAM has it)

ICL-NUIM's poses are of a y-up, left-handed camera (published with fy = -480): in OpenCV axes y is mirrored, in
positions and rotations. Copies with poses in OpenCV axes exist as well; which one it is, depth carried between
frames decides.
"""

from __future__ import annotations

import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.geometry.camera import PinholeCamera
from polarmap.geometry.pose import is_rigid, orthonormalized
from polarmap.io.files import data_lines, read_text, reason
from polarmap.io.formats.images import PICTURE_SUFFIXES
from polarmap.io.formats.trajectory import read_trajectory
from polarmap.io.recording.rgbd.intrinsics import RgbdCamera, read_intrinsics
from polarmap.io.recording.rgbd.listing import (
    PICTURE_FOLDERS,
    nearest_pairs,
    numbered,
    only_folder,
    paired,
    read_associations,
    read_listing,
)
from polarmap.io.recording.rgbd.pose_check import reprojection_error
from polarmap.io.recording.rgbd.recording import RgbdFiles, RgbdSequence

_FRAME_RATE = 30.0  # of formats without times
_MAX_DIFFERENCE = 0.02  # seconds between a picture and its depth, as in TUM's own tools
_MIRROR_Y = np.diag([1.0, -1.0, 1.0, 1.0])
_ROTATION_TOLERANCE = 0.02
_FARTHEST = 1e9  # metres, of a pose
_MOST_FRAMES = 10**9  # a larger number is a time

_ICL_CAMERA = PinholeCamera(640, 480, 481.2, 480.0, 319.5, 239.5)
_PRIMESENSE_CAMERA = PinholeCamera(640, 480, 525.0, 525.0, 319.5, 239.5)
_REPLICA_CAMERA = PinholeCamera(1200, 680, 600.0, 600.0, 599.5, 339.5)
_TUM_CAMERAS = {  # of the pictures, distortion left out
    "freiburg1": PinholeCamera(640, 480, 517.3, 516.5, 318.6, 255.3),
    "freiburg2": PinholeCamera(640, 480, 520.9, 521.0, 325.1, 249.7),
    "freiburg3": PinholeCamera(640, 480, 535.4, 539.2, 320.1, 247.6),
}


def open_rgbd(path: Path | str, format: str = "auto", camera: Path | None = None) -> RgbdSequence:
    """The recording in a folder; no picture is read yet but for a few that are checked.

    format: one of `FORMATS`, or auto. camera: a file of intrinsics in place of the format's own (see
    `read_intrinsics`), which may also give the depth scale.
    Raises InputError where the folder is of no known format, a file is missing, or counts or sizes do not fit.
    """
    path = Path(path)
    if not os.path.isdir(path):
        raise InputError(f"{path}: {'not a folder' if os.path.exists(path) else 'no such folder'}")
    if format != "auto" and format not in FORMATS:
        raise InputError(f"RGB-D format {format!r} is not known; known are auto, {', '.join(FORMATS)}")
    format = _detect(path) if format == "auto" else format
    given = None if camera is None else read_intrinsics(camera)
    sequence = FORMATS[format](path, given)
    if not sequence.files:
        raise InputError(f"{path}: no frame has a pose; times or frame numbers of pictures and trajectory do not meet")
    _require_files(sequence)
    _require_size(sequence, camera)
    return _in_opencv_axes(sequence) if format == "icl" else sequence


def _detect(folder: Path) -> str:
    try:
        names = {entry.name for entry in folder.iterdir()}
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({reason(error)})") from None
    if "results" in names:
        return "replica"
    if "trajectory.log" in names:
        return "redwood"
    if any(name.endswith(".freiburg") for name in names):
        return "icl"
    if any(re.fullmatch(r"scene_\d+_\d+\.depth", name) for name in names):
        return "icl-pov"
    if names & {"rgb.txt", "depth.txt", "groundtruth.txt"}:
        return "tum"
    raise InputError(
        f"{folder}: no RGB-D recording that is known; expected *.freiburg (ICL-NUIM), scene_*.depth (ICL-NUIM, "
        "POV-Ray), rgb.txt (TUM RGB-D), trajectory.log (Redwood), or results/ (Replica); see docs/simulator.md"
    )


def _require_files(sequence: RgbdSequence) -> None:
    for files in sequence.files:
        for path in (files.picture, files.depth):
            if not os.path.isfile(path):
                raise InputError(f"{path}: no such file, though a list of the recording names it")


def _require_size(sequence: RgbdSequence, camera: Path | None) -> None:
    """The first frame is read, so that a wrong size or kind is known before anything is written."""
    try:
        sequence[0]
    except InputError as problem:
        if camera is not None or "pixels, expected" not in str(problem):
            raise
        raise InputError(f"{problem}, the usual size; give the camera's intrinsics by --camera") from None


def _open_icl(folder: Path, given: RgbdCamera | None) -> RgbdSequence:
    trajectories = sorted(folder.glob("*.freiburg"))
    if len(trajectories) != 1:
        raise InputError(f"{folder}: {len(trajectories)} files *.freiburg, expected one trajectory")
    trajectory = read_trajectory(trajectories[0], "tum")
    if (trajectory.timestamps % 1).any() or np.abs(trajectory.timestamps).max() > _MOST_FRAMES:
        raise InputError(f"{trajectories[0]}: expected whole frame numbers in the first column, not times")
    pose_of = dict(zip(trajectory.timestamps.astype(int).tolist(), trajectory.poses, strict=True))
    frames = _icl_frames(folder)
    files = [_files(number, picture, depth, pose_of.get(number)) for number, picture, depth in frames]
    return _sequence(folder, "icl", given, RgbdCamera(_ICL_CAMERA, 5000.0), files)


def _icl_frames(folder: Path) -> list[tuple[int, Path, Path]]:
    associations = folder / "associations.txt"
    if os.path.exists(associations):
        return [(int(number), picture, depth) for _, picture, number, depth in read_associations(associations)]
    pictures = only_folder(folder, PICTURE_FOLDERS, "pictures")
    return paired(numbered(pictures), numbered(only_folder(folder, ("depth",), "depth images"), (".png",)))


def _in_opencv_axes(sequence: RgbdSequence) -> RgbdSequence:
    """The sequence with y mirrored in its poses, unless depth fits clearly better without."""
    mirrored = _MIRROR_Y @ sequence.poses @ _MIRROR_Y
    if reprojection_error(sequence) < 0.5 * reprojection_error(sequence, mirrored):
        return sequence
    files = (replace(files, T_world_camera=T) for files, T in zip(sequence.files, mirrored, strict=True))
    return replace(sequence, files=tuple(files))


def _open_icl_pov(folder: Path, given: RgbdCamera | None) -> RgbdSequence:
    prefix = _only_scene(folder)
    depths = numbered(folder, (".depth",), prefix)
    frames = paired(numbered(folder, (".png",), prefix), depths)
    files = [
        _files(number, picture, depth, _MIRROR_Y @ _read_pov_pose(depth.with_suffix(".txt")) @ _MIRROR_Y)
        for number, picture, depth in frames
    ]
    return _sequence(folder, "icl-pov", given, RgbdCamera(_ICL_CAMERA, 5000.0), files)


def _only_scene(folder: Path) -> str:
    """What the names of the one scene's files begin with; InputError where there are several."""
    found = sorted(
        {name[0] for path in folder.iterdir() if (name := re.match(r"scene_\d+_(?=\d+\.depth$)", path.name))}
    )
    if len(found) != 1:
        raise InputError(f"{folder}: files of {len(found)} scenes, expected scene_00_*; put each in its own folder")
    return found[0]


def _read_pov_pose(path: Path) -> np.ndarray:
    """Camera to world of a y-up, left-handed camera from POV-Ray's cam_pos, cam_dir and cam_up, 4×4."""
    text = read_text(path, 1 << 16)
    vectors = {}
    for key in ("cam_pos", "cam_dir", "cam_up"):
        found = re.search(rf"{key}\s*=\s*\[([^\]]{{1,200}})\]", text)
        try:
            vector = np.array([float(number) for number in found[1].split(",")])
        except (TypeError, ValueError):
            vector = np.zeros(0)
        if vector.shape != (3,) or not np.isfinite(vector).all():
            raise InputError(f"{path}: no line '{key} = [x, y, z]'")
        vectors[key] = vector
    z = vectors["cam_dir"] / max(np.linalg.norm(vectors["cam_dir"]), 1e-12)
    x = np.cross(vectors["cam_up"], z)
    if np.linalg.norm(x) < 1e-6:
        raise InputError(f"{path}: cam_up is parallel to cam_dir, or one of them is zero")
    x /= np.linalg.norm(x)
    T = np.eye(4)
    T[:3, :3] = np.stack([x, np.cross(z, x), z], axis=1)
    T[:3, 3] = vectors["cam_pos"]
    return T


def _open_tum(folder: Path, given: RgbdCamera | None) -> RgbdSequence:
    trajectory = read_trajectory(folder / "groundtruth.txt", "tum")
    usual = next((camera for name, camera in _TUM_CAMERAS.items() if name in folder.resolve().name), None)
    files = [_tum_files(picture, time, depth, trajectory) for picture, time, depth in _tum_frames(folder)]
    return _sequence(folder, "tum", given, RgbdCamera(usual or _PRIMESENSE_CAMERA, 5000.0), files)


def _tum_frames(folder: Path) -> list[tuple[Path, float, Path]]:
    """(picture, time of the depth image, depth image) of the frames that have both."""
    if not os.path.exists(folder / "rgb.txt") and os.path.exists(folder / "associations.txt"):
        return [(picture, time, depth) for _, picture, time, depth in read_associations(folder / "associations.txt")]
    picture_times, pictures = read_listing(folder / "rgb.txt")
    depth_times, depths = read_listing(folder / "depth.txt")
    pairs = nearest_pairs(picture_times, depth_times, _MAX_DIFFERENCE)
    if not pairs:
        raise InputError(f"{folder / 'depth.txt'}: no time within {_MAX_DIFFERENCE} s of one in rgb.txt")
    return [(pictures[i], float(depth_times[j]), depths[j]) for i, j in pairs]


def _tum_files(picture: Path, time: float, depth: Path, trajectory: Trajectory) -> RgbdFiles | None:
    T = trajectory.at(time)
    return None if T is None else RgbdFiles(time, picture, depth, T)


def _open_redwood(folder: Path, given: RgbdCamera | None) -> RgbdSequence:
    pictures = numbered(only_folder(folder, ("image", "color", "rgb"), "pictures"))
    depths = numbered(only_folder(folder, ("depth",), "depth images"), (".png",))
    frames = paired(pictures, depths)
    trajectory = read_trajectory(folder / "trajectory.log", "log")
    if len(trajectory) != len(frames):
        raise InputError(f"{folder / 'trajectory.log'}: {len(trajectory)} poses for {len(frames)} frames")
    usual = _found_intrinsics(folder, ("camera_intrinsic.json", "intrinsic.json", "camera.json"))
    files = [
        RgbdFiles(position / _FRAME_RATE, picture, depth, T)
        for position, ((_, picture, depth), T) in enumerate(zip(frames, trajectory.poses, strict=True))
    ]
    return _sequence(folder, "redwood", given, usual or RgbdCamera(_PRIMESENSE_CAMERA), files, depth_scale=1000.0)


def _open_replica(folder: Path, given: RgbdCamera | None) -> RgbdSequence:
    results = only_folder(folder, ("results",), "pictures and depth images")
    frames = paired(numbered(results, PICTURE_SUFFIXES, "frame"), numbered(results, (".png",), "depth"))
    poses = _read_matrices(folder / "traj.txt")
    if len(poses) != len(frames):
        raise InputError(f"{folder / 'traj.txt'}: {len(poses)} poses for {len(frames)} frames")
    names = "cam_params.json", "../cam_params.json"
    usual = _found_intrinsics(folder, names)
    files = [
        RgbdFiles(position / _FRAME_RATE, picture, depth, T)
        for position, ((_, picture, depth), T) in enumerate(zip(frames, poses, strict=True))
    ]
    return _sequence(folder, "replica", given, usual or RgbdCamera(_REPLICA_CAMERA), files, depth_scale=6553.5)


def _found_intrinsics(folder: Path, names: tuple[str, ...]) -> RgbdCamera | None:
    """The camera in the one file of these names; InputError where two of them give different ones."""
    paths = [folder / name for name in names if os.path.isfile(folder / name)]
    cameras = [read_intrinsics(path) for path in paths]
    other = next((path for path, camera in zip(paths, cameras, strict=True) if camera != cameras[0]), None)
    if other is not None:
        raise InputError(f"{other}: other intrinsics than in {paths[0]}; keep one of them, or name one by --camera")
    return cameras[0] if cameras else None


def _read_matrices(path: Path) -> list[np.ndarray]:
    """T_world_camera, 4×4, of each line of 16 numbers."""
    poses = []
    for number, text in data_lines(path):
        fields = text.split()
        if len(fields) != 16:
            raise InputError(f"{path}, line {number}: {len(fields)} columns, expected the 16 numbers of a 4x4 matrix")
        try:
            T = np.array(fields, float).reshape(4, 4)
        except ValueError:
            raise InputError(f"{path}, line {number}: holds something that is no number") from None
        if not is_rigid(T, _ROTATION_TOLERANCE):
            raise InputError(f"{path}, line {number}: not a rotation and translation, camera to world")
        poses.append(orthonormalized(T))
    if not poses:
        raise InputError(f"{path}: no poses; expected the 16 numbers of a 4x4 matrix a line")
    return poses


def _files(number: int, picture: Path, depth: Path, T_world_camera: np.ndarray | None) -> RgbdFiles | None:
    return None if T_world_camera is None else RgbdFiles(number / _FRAME_RATE, picture, depth, T_world_camera)


def _sequence(
    folder: Path,
    format: str,
    given: RgbdCamera | None,
    usual: RgbdCamera,
    files: Sequence[RgbdFiles | None],
    depth_scale: float | None = None,
) -> RgbdSequence:
    """The sequence of the frames that have a pose; a given camera goes before the folder's or the format's own."""
    scales = (given and given.depth_scale, usual.depth_scale, depth_scale)
    with_pose = tuple(entry for entry in files if entry is not None)
    far = next((entry for entry in with_pose if not np.abs(entry.T_world_camera).max() < _FARTHEST), None)
    if far is not None:
        raise InputError(f"{far.picture}: its pose is more than {_FARTHEST:g} m away; correct the trajectory")
    return RgbdSequence(
        path=folder,
        format=format,
        camera=given.camera if given else usual.camera,
        depth_scale=next(scale for scale in scales if scale is not None),
        files=with_pose,
        without_pose=len(files) - len(with_pose),
    )


FORMATS: dict[str, Callable[[Path, RgbdCamera | None], RgbdSequence]] = {
    "icl": _open_icl,
    "icl-pov": _open_icl_pov,
    "tum": _open_tum,
    "redwood": _open_redwood,
    "replica": _open_replica,
}
