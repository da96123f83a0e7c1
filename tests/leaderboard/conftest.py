"""A store of records, the splits that submissions are for, and a PostgreSQL server."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from oysterbench_leaderboard.store import RecordStore
from oysterbench_leaderboard.submissions.catalogue import serve_split
from tests.helpers.served import (
    lay_split,
)


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
    folder = Path(tempfile.mkdtemp(prefix="oysterbench-postgres-"))
    as_user: dict[str, Any] = {}
    if os.geteuid() == 0:  # which the server refuses to be run as
        shutil.chown(folder, "postgres")
        as_user = {"user": "postgres"}
    data = folder / "data"
    try:
        run: dict[str, Any] = {"check": True, "capture_output": True, "timeout": 120, "cwd": folder, **as_user}
        subprocess.run(["initdb", "-D", data, "-U", "board", "-A", "trust", "-E", "UTF8"], **run)
        subprocess.run(
            ["pg_ctl", "-D", data, "-l", folder / "log", "-w", "-o", f"-c listen_addresses='' -k {folder}", "start"],
            **{**run, "capture_output": False, "stdout": subprocess.DEVNULL, "stderr": subprocess.DEVNULL},
        )
        yield f"postgresql+psycopg://board@/postgres?host={folder}"
    finally:
        subprocess.run(["pg_ctl", "-D", data, "-m", "immediate", "stop"], capture_output=True, cwd="/", **as_user)
        shutil.rmtree(folder, ignore_errors=True)
