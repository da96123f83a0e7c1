"""A PostgreSQL server of its own, in a temporary folder."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any


@contextmanager
def running_postgres() -> Iterator[str]:
    """The URL of a server that lives as long as the block."""
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
