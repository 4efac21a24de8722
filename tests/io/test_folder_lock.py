"""One program at a time writes into a folder, and a lock never outlives its program."""

from __future__ import annotations

import errno
import gc
import os
import subprocess
import sys

import pytest

from polarmap.errors import InputError
from polarmap.io.files import remove_parts
from polarmap.io.folder_lock import LOCK_NAME, FolderLock, fcntl

pytestmark = pytest.mark.skipif(fcntl is None, reason="this system has no flock")

HOLDER = (
    "import sys, time; from pathlib import Path; from polarmap.io.folder_lock import FolderLock\n"
    "lock = FolderLock(Path(sys.argv[1])).acquire(); print('locked', flush=True); time.sleep(60)"
)


def test_the_second_is_refused_and_the_lock_removed(tmp_path):
    with FolderLock(tmp_path):
        assert (tmp_path / LOCK_NAME).read_text() == f"{os.getpid()}\n"
        with pytest.raises(InputError, match=rf"is being written by another run \(process {os.getpid()}\)"):
            FolderLock(tmp_path).acquire()
    assert not list(tmp_path.iterdir())
    with FolderLock(tmp_path):
        pass


def test_a_killed_holder_leaves_no_lock(tmp_path):
    with subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path)], stdout=subprocess.PIPE, text=True) as holder:
        assert holder.stdout.readline() == "locked\n"
        with pytest.raises(InputError, match=rf"process {holder.pid}"):
            FolderLock(tmp_path).acquire()
        holder.kill()
        holder.wait()
        assert (tmp_path / LOCK_NAME).exists()
        with FolderLock(tmp_path):
            assert (tmp_path / LOCK_NAME).read_text() == f"{os.getpid()}\n"


def test_a_lock_that_is_dropped_is_free(tmp_path):
    lock = FolderLock(tmp_path).acquire()
    del lock
    gc.collect()
    with FolderLock(tmp_path):
        pass


def test_a_file_that_was_replaced_meanwhile_is_not_removed(tmp_path):
    lock = FolderLock(tmp_path).acquire()
    (tmp_path / LOCK_NAME).unlink()
    with FolderLock(tmp_path) as other:
        lock.release()
        assert other.path.exists()


@pytest.mark.parametrize("number", [errno.ENOLCK, errno.EOPNOTSUPP, errno.EINVAL])
def test_where_there_are_no_locks_it_goes_on_and_says_so(tmp_path, monkeypatch, caplog, number):
    def unknown(file, operation):
        raise OSError(number, os.strerror(number))

    monkeypatch.setattr(fcntl, "flock", unknown)
    with FolderLock(tmp_path):
        assert "no lock" in caplog.text


def test_without_fcntl_it_goes_on(tmp_path, monkeypatch):
    monkeypatch.setattr("polarmap.io.folder_lock.fcntl", None)
    with FolderLock(tmp_path):
        assert not list(tmp_path.iterdir())


def test_a_link_in_its_place_is_not_followed(tmp_path):
    target = tmp_path / "mine.txt"
    target.write_text("mine")
    (tmp_path / LOCK_NAME).symlink_to(target)
    with FolderLock(tmp_path):
        pass
    assert target.read_text() == "mine"


def test_only_unfinished_files_of_this_program_are_removed(tmp_path):
    for name in (".polarmap-12-3.part", ".polarmap-x.part", "video.part", ".polarmap-12-3.part.bak"):
        (tmp_path / name).write_text("")
    remove_parts(tmp_path)
    remove_parts(tmp_path / "missing")
    assert sorted(p.name for p in tmp_path.iterdir()) == [".polarmap-12-3.part.bak", ".polarmap-x.part", "video.part"]
