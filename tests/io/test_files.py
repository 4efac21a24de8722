"""Files are written whole or not at all, and read only where they are regular files of a usual size."""

import errno
import os
import socket
from pathlib import Path

import pytest

from polarmap.errors import InputError, PolarmapError
from polarmap.io.files import MAX_LINES, data_lines, read_bytes, read_text, write_bytes


def test_a_file_is_replaced_whole(tmp_path):
    path = tmp_path / "file"
    for data in (b"long ago", b"new"):
        write_bytes(path, data)
        assert path.read_bytes() == data
    assert [entry.name for entry in tmp_path.iterdir()] == ["file"]


def test_a_pipe_is_written_to_and_stays(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    reader = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    write_bytes(pipe, b"data")
    assert os.read(reader, 100) == b"data" and pipe.is_fifo()
    os.close(reader)


def test_a_folder_in_the_way_is_said(tmp_path):
    with pytest.raises(PolarmapError, match="cannot be written"):
        write_bytes(tmp_path, b"data")


def test_a_file_on_a_read_only_disk_is_named(tmp_path, monkeypatch):
    def refuse(*_, **__):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS))

    monkeypatch.setattr(Path, "write_bytes", refuse)
    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(PolarmapError, match=r"figures\.json: cannot be written \(Read-only"):
        write_bytes(tmp_path / "figures.json", b"data")


def not_regular(folder: Path) -> dict[str, Path]:
    """One of each kind of thing that is no regular file, where this system has it."""
    pipe, sock = folder / "pipe", folder / "socket"
    os.mkfifo(pipe)
    with socket.socket(socket.AF_UNIX) as listening:
        os.chdir(folder)  # a socket's path may have 107 characters only
        listening.bind("socket")
    kinds = {"pipe": pipe, "socket": sock, "device": Path("/dev/zero"), "link": folder / "link"}
    kinds["link"].symlink_to("/dev/zero")
    return kinds


@pytest.mark.parametrize("kind", ["pipe", "socket", "device", "link"])
def test_only_regular_files_are_read(tmp_path, monkeypatch, kind):
    monkeypatch.chdir(tmp_path)
    path = not_regular(tmp_path)[kind]
    with pytest.raises(InputError, match="not a regular file but a pipe, socket or device"):
        read_bytes(path)


def test_a_pipe_that_takes_a_files_place_does_not_hang(tmp_path, monkeypatch):
    pipe, file = tmp_path / "pipe", tmp_path / "file"
    os.mkfifo(pipe)
    file.write_bytes(b"data")
    status = os.stat(file)
    monkeypatch.setattr(os, "stat", lambda *_, **__: status)
    with pytest.raises(InputError, match="not a regular file"):
        read_bytes(pipe)


@pytest.mark.parametrize(
    ("name", "problem"),
    [
        ("nowhere", "no such file"),
        ("", "a folder, where a file is expected"),
        ("x" * 3000, "File name too long"),
        ("a\0b", r"cannot be read \(embedded null byte\)"),
        ("file/inside", "Not a directory"),
        ("loop", "symbolic links"),
    ],
)
def test_names_that_no_file_has(tmp_path, name, problem):
    (tmp_path / "file").write_bytes(b"data")
    (tmp_path / "loop").symlink_to("loop")
    with pytest.raises(InputError, match=problem) as raised:
        read_text(tmp_path / name)
    assert len(str(raised.value)) < 500 and str(raised.value).isprintable()


def test_sizes_are_checked_before_anything_is_read(tmp_path):
    with open(tmp_path / "sparse", "wb") as file:
        file.truncate(1 << 40)
    with pytest.raises(InputError, match="1099511627776 bytes, more than the"):
        read_bytes(tmp_path / "sparse")


@pytest.mark.skipif(not os.path.exists("/proc/self/status"), reason="no files here that do not tell their size")
def test_files_that_do_not_tell_their_size_are_limited_too():
    assert b"VmPeak" in read_bytes(Path("/proc/self/status"), 100_000)
    with pytest.raises(InputError, match="more than the 100 bytes"):
        read_bytes(Path("/proc/self/status"), 100)


def test_lines_are_limited(tmp_path):
    (tmp_path / "times.txt").write_bytes(b"\n" * (MAX_LINES + 1))
    with pytest.raises(InputError, match="1000001 lines, more than the 1000000"):
        data_lines(tmp_path / "times.txt")
