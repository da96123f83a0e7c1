"""A store of records, the splits that submissions are for, and a PostgreSQL server."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from oysterbench_leaderboard.store import RecordStore
from oysterbench_leaderboard.submissions.catalogue import serve_split
from tests.helpers.postgres import running_postgres
from tests.helpers.served import lay_split


@pytest.fixture
def store(tmp_path: Path) -> RecordStore:
    return RecordStore(tmp_path / "board")


@pytest.fixture(scope="module")
def served(tmp_path_factory):
    """The splits, by name."""
    folder = tmp_path_factory.mktemp("splits")
    kinds = [("pool-test", "slam", True), ("pool-val", "slam", False), ("pool-masks", "segmentation", True)]
    kinds += [("pool-steer", "steering", True), ("pool-dive", "steering", False)]
    found = {}
    for name, track, hidden in kinds:
        recipe, truth = lay_split(folder, name, track, hidden)
        found[name] = serve_split(str(recipe), truth, folder / "cache")
    return found


@pytest.fixture(scope="module")
def postgres() -> Iterator[str]:
    """The URL of a server that lives as long as these tests."""
    pytest.importorskip("psycopg")
    if shutil.which("initdb") is None or shutil.which("pg_ctl") is None:
        pytest.skip("PostgreSQL is not installed")
    with running_postgres() as url:
        yield url
