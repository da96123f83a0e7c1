"""Namespaces around the sandbox, made by bubblewrap where the system permits it.

A process in them sees a read-only root that holds Python, our packages and the files of its job, and an empty folder in
memory; no other process (not even in /proc), no network, no device but /dev/null, zero and urandom. It runs as nobody,
and cannot create further namespaces. Everything that the sandbox itself forbids is forbidden there as well.
"""

from __future__ import annotations

import functools
import os
import shutil
import subprocess
import sys
from collections.abc import Iterable, Sequence

import oysterbench
import oysterbench_datasets
import oysterbench_leaderboard

SYSTEM = ("/usr", "/bin", "/lib", "/lib64", "/etc/ld.so.cache")
PACKAGES = (oysterbench, oysterbench_leaderboard, oysterbench_datasets)
DEVICES = ("/dev/null", "/dev/zero", "/dev/urandom")
PROGRAM = "bwrap"
NOBODY = "65534"
FOLDER = "/job"
PROBE_S = 30.0

OPTIONS = (
    *("--unshare-user", "--unshare-all", "--disable-userns", "--die-with-parent", "--new-session"),
    *("--cap-drop", "ALL", "--uid", NOBODY, "--gid", NOBODY),
)


def inside(command: Sequence[str], files: Iterable[str], folder_bytes: int, may_mount: bool = False) -> list[str]:
    """Command that runs `command` in such namespaces, starting in FOLDER, which holds at most `folder_bytes` bytes.

    files: what it can read; may_mount: whether it may create mounts and namespaces within its own
    """
    code = (*sys.path, *(place for package in PACKAGES for place in package.__path__))
    paths = (path for path in (*SYSTEM, sys.prefix, sys.base_prefix, *code, *files) if os.path.isabs(path))
    seen = [option for path in paths for option in ("--ro-bind-try", path, path)]
    devices = [option for path in DEVICES for option in ("--dev-bind", path, path)]
    proc = ["--proc", "/proc"]  # its own processes only; images in memory are decoded through names in /proc/self/fd
    empty = ["--size", str(folder_bytes), "--tmpfs", FOLDER, "--remount-ro", "/", "--chdir", FOLDER]
    rights = ["--cap-add", "CAP_SYS_ADMIN"] if may_mount else []
    return [PROGRAM, *OPTIONS, *rights, *seen, *devices, *proc, *empty, "--", *command]


@functools.cache
def missing() -> str:
    """Reason in one line why namespaces are not available here; empty where they are. Tried once only."""
    if shutil.which(PROGRAM) is None:
        return f"{PROGRAM} is not installed"
    command = inside([sys.executable, "-IB", "-c", "import oysterbench_leaderboard, numpy"], (), 1 << 20)
    try:
        tried = subprocess.run(command, capture_output=True, text=True, timeout=PROBE_S)
    except subprocess.TimeoutExpired:
        return f"{PROGRAM} did not end within {PROBE_S:g} s"
    return "" if tried.returncode == 0 else (tried.stderr.strip().splitlines() or [f"{PROGRAM} failed"])[-1][:200]
