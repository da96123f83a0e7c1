"""Confines a process before it runs untrusted code: folders that it cannot open or write to, no network, no
privileges, limits on memory, time and files. A standalone program, for Linux, that imports only the standard library
and then becomes the command:

    python -I -S sandbox.py '{"hidden": ["/srv/truth"], "network": false, "cpu_s": 60}' COMMAND...

Folders are hidden by Landlock (Linux 5.13 and later; see `can_hide`), which needs no privilege, applies to root too,
is inherited by every child and cannot be undone. Landlock only grants, never denies, so everything beside a hidden path
is granted: the folders above it can be traversed but not listed, and whatever is created in them later is inaccessible.
Before Linux 6.12, which can confine signals, processes outside are out of its reach only where it has no network.
"""

from __future__ import annotations

import ctypes
import json
import os
import resource
import signal
import stat
import struct
import sys
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass

PR_SET_PDEATHSIG, PR_SET_NO_NEW_PRIVS = 1, 38  # linux/prctl.h
CAPABILITY_VERSION, DAC_OVERRIDE = 0x20080522, 1 << 1  # linux/capability.h
CLONE_NEWNET, CLONE_NEWUSER = 0x40000000, 0x10000000  # linux/sched.h

CREATE_RULESET, ADD_RULE, RESTRICT_SELF = 444, 445, 446  # system call numbers, the same on every architecture
VERSION, PATH_BENEATH = 1, 1  # linux/landlock.h, like everything that follows
EXECUTE, WRITE_FILE, READ_FILE, READ_DIR, TRUNCATE, IOCTL_DEV = (1 << bit for bit in (0, 1, 2, 3, 14, 15))
OF_FILES = EXECUTE | WRITE_FILE | READ_FILE | TRUNCATE | IOCTL_DEV
READ = READ_FILE | READ_DIR | EXECUTE
RIGHTS = {1: (1 << 13) - 1, 2: (1 << 14) - 1, 3: (1 << 15) - 1, 4: (1 << 15) - 1, 5: (1 << 16) - 1}
"""Landlock version -> all file rights that it knows; for later versions, the last entry is used."""

TCP, SINCE_TCP = 0b11, 4  # bind and connect
SOCKETS, SIGNALS, SINCE_OUTSIDE = 0b01, 0b10, 6  # abstract sockets of outside processes, and signals to them


@dataclass(frozen=True)
class Sandbox:
    """What a process may not do. A limit of None leaves the limit of whoever starts it.

    hidden:       files and folders that cannot be opened
    visible:      files and folders inside these that can be read nevertheless
    listed:       folders above hidden ones that can be listed, names of what is hidden included
    writable:     the only folders that can be written to, even inside hidden ones; None for all that are not hidden
    fixed:        files and folders inside writable ones that can be read, and not written to
    network:      whether it has network access
    memory_bytes: limit of its address space; file_bytes: of each file it writes; open_files: of files open at once
    cpu_s:        limit of its CPU time; it then gets SIGXCPU, and two seconds later SIGKILL
    """

    hidden: tuple[str, ...] = ()
    visible: tuple[str, ...] = ()
    listed: tuple[str, ...] = ()
    writable: tuple[str, ...] | None = None
    fixed: tuple[str, ...] = ()
    network: bool = True
    memory_bytes: int | None = None
    file_bytes: int | None = None
    open_files: int | None = None
    cpu_s: int | None = None

    def command(self, command: Sequence[str]) -> list[str]:
        """Return the command that runs `command` in this sandbox."""
        return [sys.executable, "-I", "-S", os.path.abspath(__file__), json.dumps(asdict(self)), *command]

    def enter(self) -> None:
        """Confine the calling process irrevocably; it is also killed when its parent dies. Raises OSError."""
        libc = ctypes.CDLL(None, use_errno=True)
        libc.prctl(PR_SET_PDEATHSIG, ctypes.c_ulong(signal.SIGKILL), 0, 0, 0)
        libc.prctl(PR_SET_NO_NEW_PRIVS, ctypes.c_ulong(1), 0, 0, 0)
        # A new network namespace needs a privilege, which a new user namespace grants.
        if not self.network and libc.unshare(CLONE_NEWNET) != 0:
            libc.unshare(CLONE_NEWUSER | CLONE_NEWNET)
        _drop_privileges(libc)
        for kind, most in (
            (resource.RLIMIT_CORE, 0),
            (resource.RLIMIT_AS, self.memory_bytes),
            (resource.RLIMIT_FSIZE, self.file_bytes),
            (resource.RLIMIT_NOFILE, self.open_files),
        ):
            if most is not None:
                resource.setrlimit(kind, (most, most))
        if self.cpu_s is not None:
            resource.setrlimit(resource.RLIMIT_CPU, (self.cpu_s, self.cpu_s + 2))
        _restrict(libc, self)


def can_hide() -> bool:
    """Whether this machine's kernel can hide folders."""
    return landlock_version() > 0


def landlock_version() -> int:
    """Version of Landlock; 0 or negative if there is none."""
    libc = ctypes.CDLL(None, use_errno=True)
    return int(libc.syscall(CREATE_RULESET, None, ctypes.c_size_t(0), ctypes.c_uint32(VERSION)))


def _drop_privileges(libc: ctypes.CDLL) -> None:
    """Give up the privileges of root, which can read other processes, except for opening files of other users: the data
    of a container is often theirs."""
    header, held = struct.pack("=Ii", CAPABILITY_VERSION, 0), ctypes.create_string_buffer(24)
    _done(libc.capget(header, held))
    kept = struct.unpack("=6I", held.raw)[1] & DAC_OVERRIDE
    _done(libc.capset(header, struct.pack("=6I", kept, kept, 0, 0, 0, 0)))


def _restrict(libc: ctypes.CDLL, sandbox: Sandbox) -> None:
    """Restrict with Landlock: all rights where it may write, read rights elsewhere, none on what is hidden."""
    version = landlock_version()
    if version <= 0:
        return
    hidden = {os.path.realpath(path) for path in sandbox.hidden}
    rights = RIGHTS[min(version, max(RIGHTS))] if hidden or sandbox.writable is not None else 0
    tcp = TCP if not sandbox.network and version >= SINCE_TCP else 0
    outside = SIGNALS if sandbox.network else SIGNALS | SOCKETS
    if version < SINCE_OUTSIDE:
        outside = 0
    if not rights | tcp | outside:
        return
    attributes = struct.pack("=QQQ", rights, tcp, outside)
    rules = _done(libc.syscall(CREATE_RULESET, attributes, ctypes.c_size_t(len(attributes)), ctypes.c_uint32(0)))
    if rights:
        for path, granted in _grants(sandbox, hidden, rights):
            _grant(libc, rules, path, granted)
    _done(libc.syscall(RESTRICT_SELF, rules, ctypes.c_uint32(0)))
    os.close(rules)


def _grants(sandbox: Sandbox, hidden: set[str], rights: int) -> Iterator[tuple[str, int]]:
    """Paths, and what is granted on them."""
    for path in _beside(hidden, "/"):
        yield path, rights if sandbox.writable is None else rights & READ
    fixed = {os.path.realpath(path) for path in sandbox.fixed}
    for folder in sandbox.writable or ():
        for path in _beside(hidden | fixed, os.path.realpath(folder)):
            yield path, rights
    for path in sandbox.visible:
        yield os.path.realpath(path), rights & READ
    for path in (os.path.realpath(path) for path in sandbox.listed):
        if any(_is_inside(other, path) for other in hidden):
            yield path, READ_DIR


def _beside(left_out: set[str], folder: str) -> Iterator[str]:
    """Smallest set of paths that covers a folder without some of the paths inside it."""
    if not any(_is_inside(path, folder) for path in left_out):
        yield folder
        return
    try:
        names = os.listdir(folder)
    except OSError:
        return
    for path in (os.path.join(folder, name) for name in names):
        if path not in left_out and not os.path.islink(path):  # its target is granted or hidden by its own path
            yield from _beside(left_out, path)


def _is_inside(path: str, folder: str) -> bool:
    return path.startswith(folder.rstrip("/") + "/")


def _grant(libc: ctypes.CDLL, rules: int, path: str, rights: int) -> None:
    try:
        place = os.open(path, os.O_PATH | os.O_CLOEXEC | os.O_NOFOLLOW)
    except OSError:  # deleted in the meantime, or not accessible to us anyway
        return
    try:
        if not stat.S_ISDIR(os.fstat(place).st_mode):
            rights &= OF_FILES
        _done(libc.syscall(ADD_RULE, rules, PATH_BENEATH, struct.pack("=Qi", rights, place), ctypes.c_uint32(0)))
    finally:
        os.close(place)


def _done(result: int) -> int:
    if result < 0:
        raise OSError(ctypes.get_errno(), f"the sandbox: {os.strerror(ctypes.get_errno())}")
    return result


def main(settings: str, *command: str) -> None:
    """Enter the sandbox and become the command."""
    Sandbox(**json.loads(settings)).enter()
    os.execvp(command[0], command)


if __name__ == "__main__":
    main(*sys.argv[1:])
