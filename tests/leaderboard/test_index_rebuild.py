"""An index made anew: nobody ever sees half of it, whatever interrupts it."""

from __future__ import annotations

import signal
import subprocess
import sys
import threading

import pytest

from oysterbench.core.errors import ResultError
from oysterbench.core.streams import stream
from oysterbench_leaderboard.boards.index import BoardIndex
from tests.helpers.boards_opened import opened, pages
from tests.helpers.records_made import fill, record_made
from tests.helpers.waiting import run_for


def test_readers_see_one_whole_index_while_it_is_made_anew(store):
    fill(store)
    index = opened(store)
    expected, wrong, stop = pages(index), [], threading.Event()

    def read() -> None:
        while not stop.is_set():
            try:
                if pages(index) != expected:
                    wrong.append("another page")
            except Exception as error:
                wrong.append(repr(error))

    threads = [threading.Thread(target=read) for _ in range(3)]
    for thread in threads:
        thread.start()
    for _ in range(4):
        index.rebuild()
    stop.set()
    for thread in threads:
        thread.join()
    assert wrong == []


REBUILD = """
import sys
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.storage.store import RecordStore
index = BoardIndex(sys.argv[2], RecordStore(sys.argv[1]))
print("begun", flush=True)
while True:
    index.rebuild()
"""


def test_a_killed_rebuild_leaves_the_old_index(store):
    fill(store)
    index = opened(store)
    expected = pages(index)
    draw = stream(1, b"", "tests", "kills")
    for _ in range(3):
        process = subprocess.Popen(
            [sys.executable, "-c", REBUILD, str(store.folder), str(store.folder.parent / "index.sqlite")],
            stdout=subprocess.PIPE,
        )
        assert process.stdout is not None
        assert process.stdout.readline() == b"begun\n"
        run_for(process, float(draw.uniform(0, 0.4)))
        process.send_signal(signal.SIGKILL)
        process.wait()
        process.stdout.close()
        assert pages(index) == expected
    index.rebuild()
    assert pages(index) == expected


def test_an_index_is_read_as_it_is_where_nothing_can_be_written(store):
    """As on a full disk, where SQLite cannot make the file that it shares between readers."""
    fill(store)
    expected = pages(opened(store))
    path = store.folder.parent / "index.sqlite"
    blocked = path.with_name("index.sqlite-shm")
    blocked.symlink_to("nowhere")
    assert pages(opened(store)) == expected
    store.add(record_made("carp", skill=0.5, team="late"))
    with pytest.raises(
        ResultError, match=r"index.sqlite: .*; make room on its disk, or let this user write to"
    ) as told:
        opened(store)
    assert "rebuild" not in str(told.value)
    assert pages(BoardIndex(path, store)) == expected
    blocked.unlink()
    assert pages(opened(store)) != expected


def test_an_index_with_changes_that_are_not_in_its_file_is_not_read_without_them(store):
    fill(store)
    opened(store)
    path = store.folder.parent / "index.sqlite"
    path.with_name("index.sqlite-shm").symlink_to("nowhere")
    path.with_name("index.sqlite-wal").write_bytes(b"changes")
    with pytest.raises(ResultError, match="make room on its disk"):
        BoardIndex(path, store).boards()


def test_an_index_of_another_version_or_none_is_made_anew(store):
    fill(store)
    path = store.folder.parent / "index.sqlite"
    expected = pages(opened(store))
    path.write_bytes(b"this is no database, and never was one" * 100)
    assert pages(opened(store)) == expected
    path.unlink()
    with pytest.raises(ResultError, match="oysterbench leaderboard rebuild"):
        BoardIndex(path, store).boards()
    assert pages(opened(store)) == expected
