"""Other programs' results as runs of a sequence: depth maps on its camera, poses and points, by frame.

| format     | what is read                                                                                     |
|------------|--------------------------------------------------------------------------------------------------|
| colmap     | `stereo/depth_maps` of a dense workspace with its `sparse` model; or a sparse model alone, whose  |
|            | points then are its depth                                                                        |
| openmvs    | `*.dmap`                                                                                          |
| depth-png  | NAME.png of 16 bits in the folder or its `depth`                                                 |
| depth-npy  | NAME.npy in the folder or its `depth`                                                            |
| ply        | a point cloud or mesh alone                                                                      |
| trajectory | a TUM, KITTI, EuRoC or log file alone                                                            |

NAME is that of a frame of the sequence, or ends in its index. A folder's `trajectory.txt` (TUM) gives poses where the
format has none, and a PLY of a usual name in it the surface.
"""

from __future__ import annotations

import logging
import os
import re
from collections.abc import Callable, Iterable
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Literal

import numpy as np

from polarmap.data.times import all_nanoseconds
from polarmap.data.trajectory import Trajectory
from polarmap.errors import InputError
from polarmap.evaluation.resampling import on_camera, project_points, resized, toward_camera
from polarmap.evaluation.trajectories import poses_at
from polarmap.io.formats.colmap import (
    ColmapImage,
    ColmapModel,
    count_images,
    has_colmap_model,
    read_colmap_map,
    read_colmap_model,
)
from polarmap.io.formats.depth_array import read_depth_array
from polarmap.io.formats.depth_png import read_depth_png
from polarmap.io.formats.openmvs import read_dmap, read_dmap_header
from polarmap.io.recording.sequence import Sequence
from polarmap.io.run_folder.folder import RESULTS_NAME

log = logging.getLogger(__name__)

ImportFormat = Literal["colmap", "openmvs", "depth-png", "depth-npy", "ply", "trajectory"]
OWN_FORMAT = "polarmap"
TRAJECTORY_NAME = "trajectory.txt"

_SURFACES = (
    "mesh.ply", "cloud.ply", "fused.ply", "dense/fused.ply", "meshed-poisson.ply", "meshed-delaunay.ply",
    "scene_dense_mesh.ply", "scene_dense.ply",
)  # fmt: skip
_COLMAP_MAP = re.compile(r"(?P<name>.+)\.(?P<kind>geometric|photometric)\.bin")
_TRAILING_NUMBER = re.compile(r".*?(\d{1,18})$")


@dataclass(frozen=True, eq=False)
class ImportedDepth:
    """Of the sequence's camera. depth: float32 H×W z in the run's unit, NaN where none. normal: float32 H×W×3 in the
    camera frame, toward the camera, NaN where none; None where the program gives none."""

    depth: np.ndarray
    normal: np.ndarray | None = None


@dataclass(frozen=True, eq=False)
class ImportedFrame:
    """A depth map that is not read yet. index: of the sequence's frame. source: the file, for messages.

    read raises InputError where the file is malformed or of another camera.
    """

    index: int
    source: Path
    read: Callable[[], ImportedDepth] = field(repr=False)


@dataclass(frozen=True, eq=False)
class ImportedRun:
    """What a program made of a sequence, in its own world and unit.

    frames: in the order of their index. poses: T_world_camera, float64 4×4, by index of the frame.
    trajectory: the poses over time; None where there is none, or the sequence has no times.
    surface: a PLY of points or triangles, or None. unmatched: names that no frame of the sequence has.
    sparse: whether depth is that of the sparse points alone.
    """

    path: Path
    format: ImportFormat
    frames: tuple[ImportedFrame, ...] = ()
    poses: dict[int, np.ndarray] = field(default_factory=dict)
    trajectory: Trajectory | None = None
    surface: Path | None = None
    unmatched: tuple[str, ...] = ()
    sparse: bool = False

    def depth(self, index: int) -> np.ndarray | None:
        """Depth of the frame of this index, float32 H×W of the sequence's camera with NaN; None where there is none."""
        frame = next((frame for frame in self.frames if frame.index == index), None)
        return None if frame is None else frame.read().depth


def detect_format(path: Path) -> str:
    """What a folder or file is of: "polarmap", or one of the formats of the table above.

    Raises InputError where it is none of them.
    """
    path = Path(path)
    if os.path.isfile(path):
        return {".ply": "ply", ".dmap": "openmvs"}.get(path.suffix.lower(), "trajectory")
    if os.path.exists(path / RESULTS_NAME):
        return OWN_FORMAT
    found = [name for name, there in _contents(path).items() if there]
    depth = [name for name in found if name not in ("ply", "trajectory")]
    if len(depth) > 1:
        log.warning("%s: is read as %s; it also holds %s (choose with --format)", path, depth[0], ", ".join(depth[1:]))
    if found:
        return found[0]
    if not os.path.exists(path):
        raise InputError(f"{path}: no such file or folder")
    raise InputError(
        f"{path}: no {RESULTS_NAME} of 'polarmap run' in it, and no results of another program that are known here: "
        "COLMAP, OpenMVS *.dmap, depth as *.png or *.npy, or a single .ply or trajectory file"
    )


def _contents(path: Path) -> dict[str, bool]:
    """Which formats a folder holds something of, the one that counts first."""
    return {
        "colmap": bool(_colmap_maps(path)) or _has_colmap_model(path),
        "openmvs": any(path.glob("*.dmap")),
        "depth-png": bool(_depth_files(path, "png")),
        "depth-npy": bool(_depth_files(path, "npy")),
        "ply": os.path.isdir(path) and _surface(path) is not None,
        "trajectory": os.path.exists(path / TRAJECTORY_NAME),
    }


def import_run(
    path: Path | str, sequence: Sequence, format: str = "auto", depth_scale: float | None = None
) -> ImportedRun:
    """Another program's results in a folder or file, matched with the frames of a sequence; no depth is read yet.

    depth_scale: values per unit of depth, of depth-png (by default the sequence's own) and depth-npy (by default 1).
    Raises InputError where the format is not known or not that of the folder, a file is malformed, or no frame of
    the sequence is named.
    """
    path = Path(path)
    name = detect_format(path) if format == "auto" else format
    if name not in _IMPORTERS:
        raise InputError(f"{path}: format {name!r} is not one of {', '.join(_IMPORTERS)}")
    if depth_scale is not None and not 0 < depth_scale < float("inf"):
        raise InputError(f"the scale of depth values must be positive and finite, not {depth_scale}")
    if not os.path.exists(path):
        raise InputError(f"{path}: no such file or folder")
    run = _IMPORTERS[name](path, sequence, depth_scale)
    if run.unmatched and not run.frames and not run.poses:
        raise InputError(
            f"{path}: none of its names, such as {run.unmatched[0]!r}, is that of a frame of {sequence.path}; "
            "name the files as the frames, or give them the frames' numbers"
        )
    return run


class _Frames:
    """Frames of a sequence by the names that other programs give them."""

    def __init__(self, sequence: Sequence) -> None:
        self._by_name = {files.name: files.index for files in sequence.files}
        self._by_name |= {path.stem: files.index for files in sequence.files for path in files.paths}
        self._indices = {files.index for files in sequence.files}

    def find(self, name: str) -> int | None:
        """The index of the frame that a file's name means; None where there is no such frame."""
        stem = PurePosixPath(name.replace("\\", "/")).name
        while stem:
            if stem in self._by_name:
                return self._by_name[stem]
            shorter = PurePosixPath(stem).stem
            if shorter == stem:
                break
            stem = shorter
        number = _TRAILING_NUMBER.fullmatch(stem)
        return int(number[1]) if number and int(number[1]) in self._indices else None

    def match(self, path: Path, names: Iterable[str]) -> tuple[dict[int, str], tuple[str, ...]]:
        """(name by index, in order; names without a frame). InputError where two names mean the same frame."""
        found, unmatched = {}, []
        for name in names:
            index = self.find(name)
            if index is None:
                unmatched.append(name)
            elif index in found:
                raise InputError(f"{path}: {found[index]!r} and {name!r} are both of frame {index}")
            else:
                found[index] = name
        return dict(sorted(found.items())), tuple(unmatched)


def _import_colmap(path: Path, sequence: Sequence, depth_scale: float | None) -> ImportedRun:
    workspace = _colmap_workspace(path)
    maps, folder = _colmap_maps(workspace), _colmap_model_folder(workspace)
    if folder is None:
        raise InputError(f"{path}: no COLMAP model in it or in sparse/, sparse/N/ (cameras and images, .bin or .txt)")
    model = read_colmap_model(folder)
    matched, unmatched = _Frames(sequence).match(path, [image.name for image in model.images])
    images = {image.name: image for image in model.images}
    poses = {index: images[name].T_world_camera for index, name in matched.items()}
    frames = []
    for index, name in matched.items():
        if not maps:
            frames.append(_sparse_frame(model, images[name], index, sequence))
        elif (file := _colmap_file(maps, name)) is not None:
            frames.append(_colmap_frame(file, model, images[name], index, sequence))
    surface = _surface(workspace) or _surface(path)
    return ImportedRun(
        path, "colmap", tuple(frames), poses, _timed(sequence, poses, path), surface, unmatched, sparse=not maps
    )


def _colmap_workspace(path: Path) -> Path:
    """The dense workspace in a project of several (dense/0, dense/1, as of COLMAP's automatic reconstruction)."""
    if _is_dense(path) or _is_dense(path / "dense"):
        return path
    dense = [folder for folder in _numbered_folders(path / "dense", path) if _is_dense(folder)]
    models = {folder / "sparse": folder for folder in dense if has_colmap_model(folder / "sparse")}
    return _with_most_images(models) or path


def _is_dense(folder: Path) -> bool:
    return (folder / "stereo" / "depth_maps").is_dir()


def _numbered_folders(*parents: Path) -> list[Path]:
    """Folders named by a number in the first of these folders that has any, as COLMAP names models of a project."""
    for parent in parents:
        found = [p for p in parent.iterdir() if p.is_dir() and p.name.isdecimal()] if parent.is_dir() else []
        if found:
            return sorted(found, key=lambda folder: int(folder.name))
    return []


def _with_most_images(models: dict[Path, Path]) -> Path | None:
    """Of folders by those of their sparse models, the one with most images; a warning says which of several it is."""
    if len(models) < 2:
        return next(iter(models.values()), None)
    counts = {folder: count_images(model) for model, folder in models.items()}
    best = max(counts, key=counts.__getitem__)
    others = ", ".join(f"{count} in {folder.name}" for folder, count in counts.items() if folder != best)
    log.warning("%s: the model with most images is taken, %d (%s)", best, counts[best], others[:120])
    return best


def _colmap_maps(path: Path) -> dict[str, Path]:
    """Dense depth maps by the image's name, those with geometric consistency before the others."""
    folders = [path / "stereo" / "depth_maps", path / "dense" / "stereo" / "depth_maps", path / "depth_maps", path]
    folder = next((f for f in folders if os.path.isdir(f) and any(f.rglob("*metric.bin"))), None)
    if folder is None:
        return {}
    found = {}
    for kind in ("photometric", "geometric"):
        for file in sorted(folder.rglob(f"*.{kind}.bin")):
            name = _COLMAP_MAP.fullmatch(file.relative_to(folder).as_posix())
            if name is not None:
                found[name["name"]] = file
    return found


def _colmap_file(maps: dict[str, Path], name: str) -> Path | None:
    return maps.get(name) or maps.get(PurePosixPath(name).name)


def _has_colmap_model(path: Path) -> bool:
    folders = [path, path / "sparse", path / "dense" / "sparse", path.parent.parent / "sparse"]
    numbered = (*_numbered_folders(path / "sparse", path), *_numbered_folders(path / "dense"))
    places = [*folders[: 4 if path.name == "depth_maps" else 3], *numbered, *(folder / "sparse" for folder in numbered)]
    return any(has_colmap_model(folder) for folder in places)


def _colmap_model_folder(path: Path) -> Path | None:
    """The sparse model of a workspace or project: the one that its depth maps are of, else that with most images."""
    near = [path, path / "sparse"]
    if not _is_dense(path) and _is_dense(path / "dense"):
        near.insert(0, path / "dense" / "sparse")
    if path.name == "depth_maps":
        near.append(path.parent.parent / "sparse")
    folder = next((folder for folder in near if has_colmap_model(folder)), None)
    if folder is not None:
        return folder
    models = {folder: folder for folder in _numbered_folders(path / "sparse", path) if has_colmap_model(folder)}
    found = _with_most_images(models)
    return found or next((f for f in (path / "dense" / "sparse",) if has_colmap_model(f)), None)


def _colmap_frame(file: Path, model: ColmapModel, image: ColmapImage, index: int, sequence: Sequence) -> ImportedFrame:
    camera, target = model.cameras[image.camera_id], sequence.camera_file.camera

    def read() -> ImportedDepth:
        if camera.distorted:
            raise InputError(
                f"{file}: of a distorted camera ({camera.model}); give the dense workspace of image_undistorter"
            )
        depth = read_colmap_map(file)
        source = resized(file, camera.pinhole, depth.shape)
        normals = Path(str(file).replace("depth_maps", "normal_maps"))
        normal = None
        if normals != file and os.path.exists(normals):
            normal = read_colmap_map(normals, channels=3)
            if normal.shape[:2] != depth.shape:
                raise InputError(f"{normals}: is not as large as {file.name}")
            normal = toward_camera(on_camera(normals, normal, source, target), target)
        return ImportedDepth(on_camera(file, depth, source, target), normal)

    return ImportedFrame(index, file, read)


def _sparse_frame(model: ColmapModel, image: ColmapImage, index: int, sequence: Sequence) -> ImportedFrame:
    """The depth of the points that were found in an image, each at its projection."""
    camera = sequence.camera_file.camera

    def read() -> ImportedDepth:
        points = model.positions_of(image.point_ids)
        points = points[np.isfinite(points).all(axis=1)]
        return ImportedDepth(project_points(points, camera, image.T_world_camera))

    return ImportedFrame(index, model.path, read)


def _import_openmvs(path: Path, sequence: Sequence, depth_scale: float | None) -> ImportedRun:
    files = sorted(path.glob("*.dmap")) if os.path.isdir(path) else [path]
    if not files:
        raise InputError(f"{path}: no *.dmap in it; OpenMVS keeps them with DensifyPointCloud --fusion-mode 1")
    headers = {file: read_dmap_header(file) for file in files}
    by_name = {headers[file].image_name or file.stem: file for file in files}
    matched, unmatched = _Frames(sequence).match(path, by_name)
    files_of = {index: by_name[name] for index, name in matched.items()}
    poses = {index: headers[file].T_world_camera for index, file in files_of.items()}
    frames = tuple(_dmap_frame(file, index, sequence) for index, file in files_of.items())
    return ImportedRun(path, "openmvs", frames, poses, _timed(sequence, poses, path), _surface(path), unmatched)


def _dmap_frame(file: Path, index: int, sequence: Sequence) -> ImportedFrame:
    target = sequence.camera_file.camera

    def read() -> ImportedDepth:
        found = read_dmap(file)
        depth = on_camera(file, found.depth, found.camera, target)
        if found.normal is None:
            return ImportedDepth(depth)
        return ImportedDepth(depth, toward_camera(on_camera(file, found.normal, found.camera, target), target))

    return ImportedFrame(index, file, read)


def _import_depth_png(path: Path, sequence: Sequence, depth_scale: float | None) -> ImportedRun:
    scale = depth_scale or sequence.camera_file.depth_scale
    if scale is None:
        raise InputError(f"{path}: how many values make a unit of depth? name it with --depth-scale")
    return _import_depth_files(path, sequence, "depth-png", lambda file: read_depth_png(file, scale))


def _import_depth_npy(path: Path, sequence: Sequence, depth_scale: float | None) -> ImportedRun:
    return _import_depth_files(path, sequence, "depth-npy", lambda file: read_depth_array(file, depth_scale or 1.0))


def _import_depth_files(
    path: Path, sequence: Sequence, format: ImportFormat, read: Callable[[Path], np.ndarray]
) -> ImportedRun:
    files = _depth_files(path, format.removeprefix("depth-"))
    if not files:
        raise InputError(f"{path}: no depth maps in it (*.{format.removeprefix('depth-')}, or in depth/)")
    by_name = {file.name: file for file in files}
    matched, unmatched = _Frames(sequence).match(path, by_name)
    camera = sequence.camera_file.camera

    def frame(index: int, file: Path) -> ImportedFrame:
        def read_resampled() -> ImportedDepth:
            depth = read(file)
            return ImportedDepth(on_camera(file, depth, resized(file, camera, depth.shape), camera))

        return ImportedFrame(index, file, read_resampled)

    frames = tuple(frame(index, by_name[name]) for index, name in matched.items())
    trajectory = sequence.read_poses(path / TRAJECTORY_NAME) if os.path.exists(path / TRAJECTORY_NAME) else None
    poses = _poses_at_frames(trajectory, sequence)
    return ImportedRun(path, format, frames, poses, trajectory, _surface(path), unmatched)


def _depth_files(path: Path, suffix: str) -> list[Path]:
    for folder in (path, path / "depth"):
        if files := sorted(folder.glob(f"*.{suffix}")):
            return files
    return []


def _import_ply(path: Path, sequence: Sequence, depth_scale: float | None) -> ImportedRun:
    surface = path if os.path.isfile(path) else _surface(path)
    if surface is None:
        raise InputError(f"{path}: no .ply in it of a usual name ({', '.join(_SURFACES[:3])}); name the file itself")
    trajectory = None
    if os.path.isdir(path) and os.path.exists(path / TRAJECTORY_NAME):
        trajectory = sequence.read_poses(path / TRAJECTORY_NAME)
    return ImportedRun(
        path, "ply", poses=_poses_at_frames(trajectory, sequence), trajectory=trajectory, surface=surface
    )


def _import_trajectory(path: Path, sequence: Sequence, depth_scale: float | None) -> ImportedRun:
    file = path if os.path.isfile(path) else path / TRAJECTORY_NAME
    trajectory = sequence.read_poses(file)
    return ImportedRun(path, "trajectory", poses=_poses_at_frames(trajectory, sequence), trajectory=trajectory)


def _poses_at_frames(trajectory: Trajectory | None, sequence: Sequence) -> dict[int, np.ndarray]:
    return poses_at(trajectory, {files.index: files.timestamp for files in sequence.files})


def _timed(sequence: Sequence, poses: dict[int, np.ndarray], path: Path) -> Trajectory | None:
    """Poses by index as a trajectory; None where there are none or the sequence has no times."""
    times = {files.index: files.timestamp for files in sequence.files}
    if not poses or any(np.isnan(times[index]) for index in poses):
        return None
    order = sorted(poses, key=times.__getitem__)
    stamps = [times[i] for i in order]
    return Trajectory(np.array(stamps), np.array([poses[i] for i in order]), str(path), all_nanoseconds(stamps))


def _surface(path: Path) -> Path | None:
    return next((path / name for name in _SURFACES if os.path.isfile(path / name)), None)


_IMPORTERS: dict[str, Callable[[Path, Sequence, float | None], ImportedRun]] = {
    "colmap": _import_colmap,
    "openmvs": _import_openmvs,
    "depth-png": _import_depth_png,
    "depth-npy": _import_depth_npy,
    "ply": _import_ply,
    "trajectory": _import_trajectory,
}
