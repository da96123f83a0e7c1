"""A store of records, the splits that submissions are for, a service of them, and a PostgreSQL server."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path

import pytest

from oysterbench_leaderboard.storage.store import RecordStore
from oysterbench_leaderboard.submissions.accounts.tokens import issue
from oysterbench_leaderboard.submissions.catalogue import serve_split
from oysterbench_leaderboard.submissions.sandbox import sandbox, sandbox_worker
from tests.helpers.pool import lay_split
from tests.helpers.postgres import running_postgres
from tests.helpers.served import FAST, make_service
from tests.helpers.serving import Clock


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


@pytest.fixture(scope="module")
def laid(tmp_path_factory):
    """Splits alone, which every test copies."""
    folder = tmp_path_factory.mktemp("laid")
    lay_split(folder / "splits", "pool-test")
    lay_split(folder / "splits", "pool-val", hidden=False)
    return folder


@pytest.fixture
def here(monkeypatch):
    """What the limited process does, done in this one: its answers are the same, and quicker."""

    def run(job, *args):
        return sandbox.Ended(json.loads(json.dumps(sandbox_worker.do(job))), "", "")

    monkeypatch.setattr(sandbox, "run", run)


@pytest.fixture
def service(laid, tmp_path, here):
    shutil.copytree(laid / "splits", tmp_path / "splits")
    made = make_service(tmp_path, **FAST)
    made.clock = Clock()
    issue(made.database, "reef lab")
    issue(made.database, "others")
    yield made
    made.close()
