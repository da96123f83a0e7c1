"""Waiting for what another thread or process brings about: until it is so, and never for a time that should do."""

from __future__ import annotations

import contextlib
import subprocess
import threading
import time
from collections.abc import Callable
from typing import Any

PATIENCE_S = 120.0
"""Far more than anything here takes, on a busy machine as well."""

POLL_S = 0.01
NEVER = threading.Event()
"""Is never set: `NEVER.wait(s)` is the pace of a slow server."""


def until(
    condition: Callable[[], object],
    process: subprocess.Popen[Any] | None = None,
    patience_s: float = PATIENCE_S,
    poll_s: float = POLL_S,
) -> None:
    """Return when a condition holds. Fails where it never does, or the process that is to bring it about has ended.

    poll_s: between two looks; longer where a look itself is work
    """
    end = time.monotonic() + patience_s
    while not condition():
        assert process is None or process.poll() is None, f"ended with {process.returncode}: {process.args!r}"
        assert time.monotonic() < end, f"not so after {patience_s:g} s"
        NEVER.wait(poll_s)


def run_for(process: subprocess.Popen[Any], seconds: float) -> None:
    """Let a process live until a random moment, at which it is to be killed."""
    with contextlib.suppress(subprocess.TimeoutExpired):
        process.wait(seconds)
