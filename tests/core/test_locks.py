"""Locks and temporary folders outlive no process that held them."""

from __future__ import annotations

import errno
import fcntl
import os
import re
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from oysterbench.core.locks import locked, locked_if_possible, scratch

KILLED = """
import os, signal
import pytest

from oysterbench.core.locks import scratch
with scratch() as folder:
    (folder / "left.txt").write_text("half")
    print(folder, flush=True)
    os.kill(os.getpid(), signal.SIGKILL)
"""


def test_what_a_killed_process_left_is_cleared_by_the_next_and_what_a_living_one_has_is_not(tmp_path, monkeypatch):
    monkeypatch.setenv("TMPDIR", str(tmp_path))
    monkeypatch.setattr(tempfile, "tempdir", None)
    with scratch() as mine:
        done = subprocess.run([sys.executable, "-c", KILLED], capture_output=True, text=True, check=False)
        left = Path(done.stdout.strip())
        assert left.parent == mine.parent == tmp_path
        assert {path.name for path in tmp_path.iterdir()} == {left.name, mine.name}
        (tmp_path / "oysterbench-run-link").symlink_to(tmp_path)
        (tmp_path / "oysterbench-run-file").touch()
        with scratch() as another:
            assert mine.is_dir()
            assert another.is_dir()
            assert not left.exists()
    assert {path.name for path in tmp_path.iterdir()} == {"oysterbench-run-link", "oysterbench-run-file"}, (
        "not its kind"
    )


def test_a_temporary_folder_that_another_process_clears_before_it_is_locked_is_made_again(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    lock, cleared = fcntl.flock, []

    def lock_too_late(handle, how):
        if not cleared:
            (made,) = tmp_path.iterdir()
            made.rmdir()
            cleared.append(made)
        lock(handle, how)

    monkeypatch.setattr(fcntl, "flock", lock_too_late)
    with scratch() as folder:
        assert [folder] == list(tmp_path.iterdir())
        assert cleared
        assert cleared != [folder]
    assert not list(tmp_path.iterdir())


def test_the_lock_file_of_another_user_is_held_too_and_keeps_what_is_in_it(tmp_path, monkeypatch):
    file = tmp_path / "lock"
    file.write_text("theirs")
    opened = os.open

    def of_another(path, flags, *mode):
        if flags & (os.O_RDWR | os.O_WRONLY):
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return opened(path, flags, *mode)

    with locked(file) as first:
        monkeypatch.setattr(os, "open", of_another)
        with locked(file, wait=False, read_only=True) as second:
            assert (first, second) == (True, False)
        with pytest.raises(PermissionError), locked(file):
            pass
    with locked(file, wait=False, read_only=True) as third:
        assert third
    with pytest.raises(PermissionError), locked(tmp_path / "none", read_only=True):
        pass
    assert file.read_text() == "theirs"


def test_a_lock_that_is_needed_is_done_without_on_a_disk_without_locks_only(tmp_path, monkeypatch):
    file, opened = tmp_path / "lock", os.open
    file.touch()

    def closed(path, *how):
        if path == file:
            raise PermissionError(errno.EACCES, os.strerror(errno.EACCES), str(path))
        return opened(path, *how)

    def no_lock(handle, how):
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(os, "open", closed)
    with locked_if_possible(file):
        pass
    with pytest.raises(PermissionError) as told, locked_if_possible(file, needed=True):
        pass
    assert told.value.filename == str(file)
    monkeypatch.setattr(os, "open", opened)
    monkeypatch.setattr(fcntl, "flock", no_lock)
    with locked_if_possible(file, needed=True):
        pass
    with pytest.raises(OSError, match=re.escape(str(file))), locked(file):
        pass
