"""Locks between processes, and temporary folders that the next process removes if theirs was killed."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path

from oysterbench.core.atomic import naming

SCRATCH = "oysterbench-run-"
"""Prefix of temporary folders; those whose process was killed are removed later."""

NO_LOCKS = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP)
"""Errors of a disk without locks."""


@contextlib.contextmanager
def locked(
    path: str | os.PathLike[str],
    wait: bool = True,
    before_waiting: Callable[[], None] | None = None,
    read_only: bool = False,
) -> Iterator[bool]:
    """Hold a lock file while the block runs; yield whether it is held. Another holder is waited for or, without `wait`,
    prevents that. The system releases the lock of a process that dies.

    before_waiting: called before such a wait; read_only: also where the file is another user's, and can only be read
    """
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    file = _opened(path, read_only)
    try:
        try:
            with naming(path):
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if not wait:
                yield False
                return
            if before_waiting is not None:
                before_waiting()
            with naming(path):
                fcntl.flock(file, fcntl.LOCK_EX)
        yield True
    finally:
        os.close(file)


def _opened(path: Path, read_only: bool) -> int:
    """Descriptor of a lock file. To read is enough to lock it, but not on NFS."""
    try:
        with naming(path.parent, path):
            return os.open(path, os.O_RDWR | os.O_CREAT | os.O_CLOEXEC, 0o666)
    except PermissionError:
        if not read_only or not path.exists():
            raise
        return os.open(path, os.O_RDONLY | os.O_CLOEXEC)


@contextlib.contextmanager
def locked_if_possible(path: str | os.PathLike[str], needed: bool = False) -> Iterator[None]:
    """Hold a lock file while the block runs; where that cannot be, as on some network disks or in a folder that is only
    to be read, it runs all the same. needed: on a disk without locks only; OSError is raised elsewhere."""
    with contextlib.ExitStack() as stack:
        try:
            stack.enter_context(locked(path, read_only=True))
        except OSError as error:
            if needed and error.errno not in NO_LOCKS:
                raise
        yield


@contextlib.contextmanager
def scratch() -> Iterator[Path]:
    """Yield a temporary folder that exists for as long as the block runs. Those left by killed processes of this user
    are removed first: each folder is locked by its process, and the system releases the lock of a process that dies."""
    root = Path(tempfile.gettempdir())
    for left in root.glob(f"{SCRATCH}*"):
        with contextlib.suppress(OSError), _held(left) as mine:
            if mine:
                shutil.rmtree(left, ignore_errors=True)
    while True:
        folder = Path(tempfile.mkdtemp(prefix=SCRATCH))
        with _held(folder, wait=True) as mine:
            if not mine:  # removed by another process before it was locked
                continue
            try:
                yield folder
            finally:
                shutil.rmtree(folder, ignore_errors=True)
            return


@contextlib.contextmanager
def _held(folder: Path, wait: bool = False) -> Iterator[bool]:
    """Lock a folder; yield whether it is now locked, still exists under its name and belongs to this user.

    On a disk without locks, a process holds its own folders (`wait`) all the same, and none may remove another's.
    """
    try:
        handle = os.open(folder, os.O_RDONLY | os.O_DIRECTORY | os.O_NOFOLLOW)
    except FileNotFoundError:
        yield False
        return
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | (0 if wait else fcntl.LOCK_NB))
            free = True
        except OSError:
            free = wait
        there = os.fstat(handle)
        try:
            same = os.path.samestat(there, os.lstat(folder))
        except FileNotFoundError:
            same = False
        yield free and same and there.st_uid == os.geteuid()
    finally:
        os.close(handle)
