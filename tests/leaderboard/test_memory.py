"""A board is read from its records alone as it is from the database, without a library for that."""

from __future__ import annotations

import subprocess

import pytest

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.boards.board import Query
from oysterbench_leaderboard.boards.memory import MemoryIndex
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.boards_opened import ALL, opened
from tests.helpers.extras import only
from tests.helpers.paths import COMMAND
from tests.helpers.records_made import fill

SORTS = ("rank", "method", "team", "created", "score", "coverage", "data_set")


@pytest.fixture(scope="module")
def both(tmp_path_factory):
    """The same records by way of the database, and without one."""
    store = RecordStore(tmp_path_factory.mktemp("memory") / "board")
    fill(store)
    return opened(store), MemoryIndex(store)


def test_boards_methods_and_problems_are_the_same(store):
    fill(store)
    index = opened(store)
    (store.folder / "records" / f"{'0' * 64}.json").write_text("{}")
    index.refresh()
    memory = MemoryIndex(store)
    assert memory.boards() == index.boards()
    assert memory.boards("slam") == index.boards("slam")
    assert memory.methods() == index.methods()
    assert memory.problems() == index.problems()
    assert len(memory.problems()) == 1


@pytest.mark.parametrize("descending", [False, True])
@pytest.mark.parametrize("sort", SORTS)
def test_pages_are_the_same_in_every_order(both, sort, descending):
    index, memory = both
    for board in index.boards():
        for query in (ALL, Query(text="A"), Query(tiers=("reported",)), Query(size=2, page=2)):
            asked = Query(**{**vars(query), "sort": sort, "descending": descending})
            assert memory.page(board.id, asked) == index.page(board.id, asked), (board.split, asked)


def test_columns_sort_alike(both):
    index, memory = both
    for board in index.boards():
        for key in board.columns:
            assert memory.page(board.id, Query(sort=key)) == index.page(board.id, Query(sort=key)), key


def test_records_and_histories_are_the_same(both):
    index, memory = both
    for method, team, _ in index.methods():
        assert memory.method(method) == index.method(method)
        assert memory.method(method, team) == index.method(method, team)
        for row in index.method(method):
            assert memory.row(row.digest[:10]) == row
            assert memory.sequence_means(row.digest) == index.sequence_means(row.digest)


@pytest.mark.parametrize("asked", ["0123", "f" * 8, "no digest", "0" * 64])
def test_what_is_not_there_is_refused_in_the_same_words(both, asked):
    said = []
    for one in both:
        with pytest.raises(ResultError) as refusal:
            one.row(asked)
        said.append(str(refusal.value))
    assert said[0] == said[1]


def test_an_order_that_there_is_not_is_refused(both):
    for one in both:
        with pytest.raises(ResultError, match="sort: expected one of rank, method"):
            one.page(one.boards()[0].id, Query(sort="colour"))


@pytest.mark.parametrize(
    "words", [("leaderboard", "--split", "slam-val"), ("compare", "gtsam_vi", "gtsam_full", "--split", "slam-mini")]
)
def test_commands_that_read_boards_need_only_what_the_demo_installs(words, tmp_path):
    environment = only(["render", "slam"], tmp_path / "start") | {"OYSTERBENCH_HOME": str(tmp_path)}
    done = subprocess.run([COMMAND, *words], env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "gtsam_full" in done.stdout


def test_writing_a_board_says_what_to_install(tmp_path):
    environment = only(["render", "slam"], tmp_path / "start") | {"OYSTERBENCH_HOME": str(tmp_path)}
    words = [COMMAND, "leaderboard", "rebuild"]
    done = subprocess.run(words, env=environment, capture_output=True, text=True, check=False)
    assert done.returncode == 1
    assert "pip install 'oysterbench[board]'" in done.stderr
    assert done.stderr.count("\n") == 1
