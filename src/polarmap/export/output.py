"""Where exports go: a folder or a file, made room for as a run does."""

from __future__ import annotations

import json
import os
import re
from pathlib import Path

from polarmap.errors import InputError
from polarmap.export.source import MapSource
from polarmap.io.files import printable, reason, remove_parts, write_bytes
from polarmap.io.formats.ply import offset_text
from polarmap.io.run_folder.folder import OFFSET_NAME
from polarmap.version import package_version

RECORD_NAME = "export.json"

_WRITTEN = {  # by folder
    "": r"offset\.xyz|transforms\.json|points\.ply|occupancy\.(pgm|yaml)|esdf\.npz",
    "images": r"\d{6,}\.png",
    "depth": r"\d{6,}\.png",
    "slices": r"\d{2}_distance\.png",
    "sparse": r"(cameras|images|points3D)\.bin",
    "sparse/0": r"(cameras|images|points3D)\.txt",
    "stereo": r"(fusion|patch-match)\.cfg",
    "stereo/depth_maps": r"\d{6,}\.png\.geometric\.bin",
    "stereo/normal_maps": r"\d{6,}\.png\.geometric\.bin",
}


def require_room(out: Path, force: bool) -> None:
    """InputError, before any work is done, where `prepare_folder` would refuse a folder since there is something."""
    try:
        if out.exists() and not out.is_dir():
            raise InputError(f"{out}: is no folder; choose another name")
        if not force and out.is_dir() and any(out.iterdir()):
            raise InputError(f"{out}: is not empty; choose another folder, or replace the export in it with --force")
    except OSError as error:
        raise InputError(f"{out}: cannot be used for output ({reason(error)}); choose another folder") from None


def prepare_folder(out: Path, force: bool) -> Path:
    """Make the folder of an export. With `force` the files of an earlier one are removed, and never any other.

    Raises InputError where it is not empty and `force` is not set, holds files of the same names that no export
    wrote, or cannot be written.
    """
    require_room(out, force)
    try:
        out.mkdir(parents=True, exist_ok=True)
        _clear(out)
        if not os.access(out, os.W_OK | os.X_OK):
            raise InputError(f"{out}: may not be written to; choose another folder or change its permissions")
    except OSError as error:
        raise InputError(f"{out}: cannot be used for output ({reason(error)}); choose another folder") from None
    return out


def prepare_file(out: Path, suffix: str, force: bool) -> Path:
    """Check that a file can be written; InputError where its name ends otherwise, it exists, or its folder does not."""
    if out.suffix.lower() != suffix:
        raise InputError(f"{out}: a file is written; let its name end with {suffix}")
    if not out.parent.is_dir():
        raise InputError(f"{out}: {out.parent} is no folder; make it first")
    if out.is_dir():
        raise InputError(f"{out}: is a folder; name a file")
    if out.exists() and not force:
        raise InputError(f"{out}: exists; choose another name, or replace it with --force")
    return out


def make_folder(path: Path) -> Path:
    """A folder within an export's; InputError where it cannot be made."""
    try:
        path.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise InputError(f"{path}: cannot be made ({reason(error)}); choose another folder") from None
    return path


def remarks(source: MapSource) -> list[str]:
    """What the reader of an exported file must know of its lengths, a line each, in ASCII."""
    lines = [f"written by polarmap {package_version() or ''}".rstrip(), f"lengths are in {source.unit}"]
    if source.results.poses != "given":
        lines[-1] += ", which are metres but for one factor that is not known"
    if source.origin.any():
        lines.append(f"counted from {offset_text(source.origin)} in the world of the run's poses")
    return lines


def write_record(out: Path, source: MapSource, kind: str, **further: object) -> None:
    """Write export.json, by which the folder is known as an export, and offset.xyz where there is an offset.

    It is written before all else, so that what an interrupted export leaves can be replaced.
    """
    record = {
        "format": kind,
        "map": printable(str(source.folder)),
        "segment": source.segment,
        "unit": source.unit,
        "offset": source.origin.tolist(),
        "remarks": remarks(source),
        **further,
    }
    write_bytes(out / RECORD_NAME, (json.dumps(record, indent=1) + "\n").encode())
    if source.origin.any():
        write_bytes(out / OFFSET_NAME, f"{offset_text(source.origin)}\n".encode())


def _clear(out: Path) -> None:
    written = _files_of_exports(out)
    record = out / RECORD_NAME
    if written and not record.is_file():
        raise InputError(f"{written[0]}: is in the way and not of an export; choose another folder")
    for folder in _WRITTEN if record.is_file() else ():
        remove_parts(out / folder)
    for path in written:
        path.unlink()


def _files_of_exports(out: Path) -> list[Path]:
    """Those that have the names an export gives."""
    folders = [(out / name, pattern) for name, pattern in _WRITTEN.items() if (out / name).is_dir()]
    return [path for folder, pattern in folders for path in folder.iterdir() if re.fullmatch(pattern, path.name)]
