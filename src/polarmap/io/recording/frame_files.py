"""Which files of a folder make which frame: layouts and numbering.

mosaics          raw/NAME.png, or NAME.png in the folder itself
angle folders    0/NAME.png, 45/NAME.png, 90/NAME.png, 135/NAME.png
angle suffixes   NAME_0.png, NAME_45.png, NAME_90.png, NAME_135.png

The pictures of the latter two may lie in raw/ as well, and all may be raw buffers (.raw, .bin).

plain pictures   NAME.png or NAME.jpg, colour or grey, in images/, image/, gray/, grey/, rgb/, cam0/data/, raw/, or
                 the folder itself: where the camera file says polarization: none

Another folder of pictures can be named in the camera file (`images`).
"""

from __future__ import annotations

import logging
import math
import re
from collections import defaultdict
from dataclasses import dataclass
from pathlib import Path

from polarmap.data.camera_file import CameraFile
from polarmap.errors import InputError
from polarmap.io.files import reason
from polarmap.io.formats.images import IMAGE_SUFFIXES, PICTURE_SUFFIXES, read_header
from polarmap.io.recording.frame_order import FrameOrder, order_frames, times_in_names
from polarmap.io.recording.frame_times import Shot, find_shots, with_exposures

log = logging.getLogger(__name__)

ANGLES = (0, 45, 90, 135)
RAW_SUFFIXES = (".raw", ".bin")

_ANGLE = r"(?:(?:i|pol|angle|deg)[_-]?)?(?P<angle>0{1,3}|0?45|0?90|135)(?:deg)?"
_ANGLE_FOLDER = re.compile(_ANGLE, re.IGNORECASE)
_ANGLE_SUFFIX = re.compile(rf"(?:(?P<name>.*)[_-])?{_ANGLE}", re.IGNORECASE)
_PLAIN_FOLDERS = ("images", "image", "gray", "grey", "rgb", "cam0/data", "mav0/cam0/data", "raw")


@dataclass(frozen=True)
class FrameFiles:
    """A frame that is not read yet: the file of a mosaic or plain picture, or four files in the order of `ANGLES`.

    index: the number in its name, or its position where names are not numbered. timestamp: seconds, or NaN.
    exposure: seconds, or NaN.
    """

    index: int
    timestamp: float
    name: str
    paths: tuple[Path, ...]
    exposure: float = math.nan


def find_frames(folder: Path, camera_file: CameraFile) -> tuple[FrameFiles, ...]:
    """The frames in a folder, in order.

    Times come from a file of the sequence (`frame_times`), else from names that are times, else they are
    index / frame_rate, else NaN; exposures from exposures.txt or times.txt, else they are NaN. Raises InputError where
    there are no pictures, one of an angle or a frame is missing, the order of the frames is not clear, or such a file
    does not fit the frames.
    """
    try:
        source = _source(folder, camera_file)
        paths = _paths_by_name(source, camera_file)
        order = order_frames(source, list(paths))
        shots = with_exposures(folder, _shots(folder, source, order, camera_file.frame_rate), order)
    except OSError as error:
        raise InputError(f"{folder}: cannot be read ({reason(error)})") from None
    return tuple(
        FrameFiles(index, shot.timestamp, name, paths[name], shot.exposure)
        for (name, index), shot in zip(order.indices.items(), shots, strict=True)
    )


def _source(folder: Path, camera_file: CameraFile) -> Path:
    """The folder of the pictures in that of the sequence."""
    if camera_file.images is not None:
        if not (folder / camera_file.images).is_dir():
            raise InputError(f"{folder}: no folder {camera_file.images}, which the camera file names as that of images")
        return folder / camera_file.images
    usual = ("raw",) if camera_file.polarized else _PLAIN_FOLDERS
    found = [name for name in usual if (folder / name).is_dir()]
    if len(found) > 1:
        raise InputError(f"{folder}: pictures may be in {' or '.join(found)}; name one in the camera file, as images:")
    source = folder / found[0] if found else folder
    _say_what_is_left(folder, source)
    return source


def _say_what_is_left(folder: Path, source: Path) -> None:
    """A warning where a second camera's pictures, or a second set of them, lie beside those that are read."""
    others = [path for path in sorted(source.parent.parent.glob("cam[0-9]/data")) if path != source]
    if source.name == "data" and source.parent.name == "cam0" and others:
        log.warning("%s: is read; %s is another camera's and is not", source, others[0])
    if source != folder and len(_angle_folders(folder)) == len(ANGLES):
        log.warning("%s: is read; the folders 0, 45, 90 and 135 beside it are not", source)


def _paths_by_name(source: Path, camera_file: CameraFile) -> dict[str, tuple[Path, ...]]:
    if not camera_file.polarized:
        return _plain_pictures(source)
    angle_folders, pictures = _angle_folders(source), _pictures(source)
    if len(angle_folders) == len(ANGLES) or (angle_folders and not pictures):
        return _from_angle_folders(source, angle_folders)
    if not pictures:
        suffixes = ", ".join(IMAGE_SUFFIXES + RAW_SUFFIXES)
        raise InputError(f"{source}: no pictures ({suffixes}) and no folders 0, 45, 90 and 135 of pictures")
    suffixes = {name: _ANGLE_SUFFIX.fullmatch(name) for name in pictures}
    unmarked = next((name for name, suffix in suffixes.items() if not suffix), None)
    if unmarked is None and not _is_mosaic(next(iter(pictures.values())), camera_file):
        return _from_angle_suffixes(source, pictures, suffixes)
    if camera_file.layout is None:
        raise InputError(
            f"{pictures[unmarked]}: no angle in its name, such as {unmarked}_45, but the camera file says "
            "mosaic: none; rename the pictures, or give the mosaic's layout"
        )
    return {name: (path,) for name, path in pictures.items()}


def _plain_pictures(source: Path) -> dict[str, tuple[Path, ...]]:
    pictures = _files(source, PICTURE_SUFFIXES + RAW_SUFFIXES)
    if not pictures:
        raise InputError(f"{source}: no pictures ({', '.join(PICTURE_SUFFIXES + RAW_SUFFIXES)})")
    return {name: (path,) for name, path in pictures.items()}


def _pictures(folder: Path) -> dict[str, Path]:
    """The image and raw files of a folder by their names without suffix; none of them JPEG."""
    pictures = _files(folder, IMAGE_SUFFIXES + RAW_SUFFIXES)
    jpeg = None if pictures else next(iter(_files(folder, (".jpg", ".jpeg")).values()), None)
    if jpeg is not None:
        raise InputError(
            f"{jpeg}: JPEG compression destroys polarization; record PNG, TIFF or raw files "
            "(for a plain camera, write polarization: none in the camera file)"
        )
    return pictures


def _files(folder: Path, suffixes: tuple[str, ...]) -> dict[str, Path]:
    """The files of a folder with one of these suffixes by their names without it; hidden files are none."""
    files: dict[str, Path] = {}
    for path in sorted(folder.iterdir()):
        if path.name.startswith(".") or path.suffix.lower() not in suffixes or not path.is_file():
            continue
        if path.stem in files:
            raise InputError(f"{path}: the same frame as {files[path.stem].name}; keep one of them")
        files[path.stem] = path
    return files


def _is_mosaic(path: Path, camera_file: CameraFile) -> bool:
    """Whether pictures whose names all end in an angle are mosaics nevertheless, by the size of one."""
    if camera_file.layout is None:
        return False
    width, height = camera_file.mosaic_size
    if path.suffix.lower() in RAW_SUFFIXES:
        return path.stat().st_size == camera_file.pixel_format.byte_count((height, width))
    header = read_header(path)
    return (header.width, header.height) == (width, height)


def _angle_folders(folder: Path) -> dict[int, Path]:
    folders: dict[int, Path] = {}
    for path in sorted(folder.iterdir()):
        angle = _ANGLE_FOLDER.fullmatch(path.name)
        if angle and path.is_dir():
            other = folders.setdefault(int(angle["angle"]), path)
            if other is not path:
                raise InputError(f"{path}: {other.name} holds the same angle; keep one of them")
    return folders


def _from_angle_folders(source: Path, folders: dict[int, Path]) -> dict[str, tuple[Path, ...]]:
    for angle in ANGLES:
        if angle not in folders:
            raise InputError(f"{source}: no folder for {angle} degrees beside {next(iter(folders.values())).name}")
    frames: dict[str, dict[int, Path]] = defaultdict(dict)
    for angle, folder in folders.items():
        for name, path in _pictures(folder).items():
            frames[name][angle] = path
    return _four_each(source, frames)


def _from_angle_suffixes(
    source: Path, pictures: dict[str, Path], suffixes: dict[str, re.Match]
) -> dict[str, tuple[Path, ...]]:
    frames: dict[str, dict[int, Path]] = defaultdict(dict)
    for picture, suffix in suffixes.items():
        name, angle = suffix["name"] or source.name, int(suffix["angle"])
        if angle in frames[name]:
            raise InputError(f"{pictures[picture]}: the same angle as {frames[name][angle].name}; keep one")
        frames[name][angle] = pictures[picture]
    return _four_each(source, frames)


def _four_each(source: Path, frames: dict[str, dict[int, Path]]) -> dict[str, tuple[Path, ...]]:
    if not frames:
        raise InputError(f"{source}: the folders 0, 45, 90 and 135 hold no pictures")
    for name, by_angle in frames.items():
        for angle in ANGLES:
            if angle not in by_angle:
                raise InputError(f"{source}: frame {name} has no picture for {angle} degrees")
    return {name: tuple(by_angle[angle] for angle in ANGLES) for name, by_angle in frames.items()}


def _shots(folder: Path, source: Path, order: FrameOrder, frame_rate: float | None) -> list[Shot]:
    lost = order.lost()
    shots = find_shots(folder, source, order)
    if shots is not None:
        if lost is not None:
            log.warning("%s: frame %s is missing after %s; the times of the others are their own", source, *lost)
        return shots
    times = times_in_names(list(order.indices))
    if times is not None:
        return [Shot(time) for time in times]
    if frame_rate is None:
        return [Shot()] * len(order.indices)
    if lost is not None:
        raise InputError(
            f"{folder}: frame {lost[0]} is missing after {lost[1]}; restore it, renumber the others, or list the "
            "frames' times in timestamps.txt"
        )
    return [Shot(index / frame_rate) for index in order.indices.values()]
