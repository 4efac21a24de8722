"""Files are written whole or not at all."""

import errno
import os
from pathlib import Path

import pytest

from polarmap.errors import PolarmapError
from polarmap.io.files import write_bytes


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
