"""Files and folders that appear whole or not at all, whatever ends the process that fills them."""

from __future__ import annotations

import errno
import os
import signal
import subprocess
import sys
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from oysterbench.core.atomic import appearing, appearing_folder, write_atomically
from oysterbench.core.locks import locked
from oysterbench.core.permissions import closed_to_others, umask


def test_a_folder_appears_when_it_is_whole(tmp_path):
    with appearing_folder(tmp_path / "deep" / "out") as draft:
        (draft / "one").write_text("1")
        (draft / "sub").mkdir()
        assert not (tmp_path / "deep" / "out").exists()
    assert sorted(path.name for path in (tmp_path / "deep" / "out").iterdir()) == ["one", "sub"]
    assert [path.name for path in (tmp_path / "deep").iterdir()] == ["out"]


@pytest.mark.parametrize("mask", [0o000, 0o002, 0o022, 0o027, 0o077])
def test_files_follow_the_umask(tmp_path, mask):
    before = os.umask(mask)
    try:
        for name, mode in (("open", 0o666), ("private", 0o600)):
            with appearing(tmp_path / name, mode=mode) as file:
                file.write(b"1")
            assert (tmp_path / name).stat().st_mode & 0o777 == mode & ~mask
        assert umask() == mask
        assert bool(closed_to_others(tmp_path / "open")) == bool(mask & 0o004)
    finally:
        os.umask(before)


@pytest.mark.parametrize("error", [ValueError, KeyboardInterrupt])
def test_what_fails_or_is_interrupted_leaves_nothing(tmp_path, error):
    def fill():
        with appearing_folder(tmp_path / "out") as draft:
            (draft / "one").write_text("1")
            raise error

    with pytest.raises(error):
        fill()
    assert list(tmp_path.iterdir()) == []


def test_a_pipe_or_device_is_written_to_and_not_replaced(tmp_path):
    pipe = tmp_path / "pipe"
    os.mkfifo(pipe)
    with ThreadPoolExecutor(1) as pool:
        read = pool.submit(pipe.read_bytes)
        write_atomically(pipe, b"all of it")
        assert read.result(timeout=10) == b"all of it"
    assert pipe.is_fifo()
    assert list(tmp_path.iterdir()) == [pipe]


@pytest.mark.parametrize("folder", ["/dev/fd", "/proc/self/fd"])
def test_an_open_file_is_written_to_under_the_systems_name_for_it(tmp_path, folder):
    with open(tmp_path / "all.txt", "wb") as file:
        file.write(b"first ")
        file.flush()
        write_atomically(Path(folder) / str(file.fileno()), b"all of it")
    assert (tmp_path / "all.txt").read_bytes() == b"first all of it"


def test_an_empty_folder_is_filled_and_another_is_left_as_it_is(tmp_path):
    (tmp_path / "empty").mkdir()
    with appearing_folder(tmp_path / "empty") as draft:
        (draft / "one").write_text("1")
    assert (tmp_path / "empty" / "one").read_text() == "1"
    with pytest.raises(FileExistsError, match="left unchanged"), appearing_folder(tmp_path / "empty"):
        pytest.fail("it was entered")
    assert (tmp_path / "empty" / "one").read_text() == "1"


HOLDER = """
import sys, time
from oysterbench.core.atomic import appearing, appearing_folder
from oysterbench.core.locks import locked
with appearing_folder(sys.argv[1]) as draft:
    (draft / "half").write_text("of it")
    print("there", flush=True)
    time.sleep(60)
"""


def test_what_a_killed_process_left_is_cleared_and_one_that_runs_is_not_disturbed(tmp_path):
    holder = subprocess.Popen([sys.executable, "-c", HOLDER, str(tmp_path / "out")], stdout=subprocess.PIPE)
    assert holder.stdout is not None
    assert holder.stdout.readline() == b"there\n"
    try:
        with pytest.raises(BlockingIOError) as refused, appearing_folder(tmp_path / "out"):
            pytest.fail("it was entered")
        assert (refused.value.errno, refused.value.strerror) == (errno.EAGAIN, "another process is writing it")
        assert (tmp_path / ".out.draft" / "half").exists()
    finally:
        os.kill(holder.pid, signal.SIGKILL)
        holder.wait()
        holder.stdout.close()
    began = time.monotonic()
    with appearing_folder(tmp_path / "out") as draft:
        assert list(draft.iterdir()) == []
        (draft / "whole").write_text("all of it")
    assert [path.name for path in tmp_path.iterdir()] == ["out"]
    assert time.monotonic() - began < 5


def test_an_error_names_the_file_that_its_user_knows(tmp_path):
    """And never the name that this one, or what is in it, has for a while."""
    (tmp_path / "a.lock").mkdir()
    long = tmp_path / ("x" * 250)  # with the characters of a temporary name it is too long for any disk
    fills = {
        long: lambda: appearing(long),
        tmp_path / "out": lambda: appearing_folder(tmp_path / "out"),
        tmp_path: lambda: locked(tmp_path / "a.lock"),
    }
    for known, fill in fills.items():
        with pytest.raises(OSError, match=r".+") as raised, fill() as draft:
            open(draft / "absent" / "x", "wb").close()
        assert raised.value.filename == str(known)
        assert raised.value.filename2 is None
