"""Atomic writing: a file or a folder appears complete or not at all."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import IO

from oysterbench.core.permissions import umask


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file atomically: it appears complete or not at all."""
    with appearing(path) as file:
        file.write(data)


@contextlib.contextmanager
def appearing(path: str | os.PathLike[str], prefix: str | None = None, mode: int = 0o666) -> Iterator[IO[bytes]]:
    """Yield a file to write, which appears under its name, synced, when the block succeeds, and leaves nothing behind
    when it fails. prefix: of its temporary name until then; mode: its permissions after that, as far as the umask
    leaves them. A device, a pipe or the system's link to an open file (/dev/stdout) is written to as it is: a file in
    the place of /dev/null or /dev/stdout would break the machine."""
    path = Path(path)
    if _is_of_system(path):
        with naming(path), open(path, "ab") as file:  # appended to what else goes to an open file
            yield file
        return
    path.parent.mkdir(parents=True, exist_ok=True)
    prefix = prefix or f".{path.name}."
    with naming(path, path.parent / prefix):
        handle, temporary = tempfile.mkstemp(dir=path.parent, prefix=prefix)
    try:
        with naming(path), os.fdopen(handle, "w+b") as file:
            yield file
            file.flush()
            os.fsync(file.fileno())
        os.chmod(temporary, mode & ~umask())
        os.replace(temporary, path)
    except BaseException:
        os.unlink(temporary)
        raise


@contextlib.contextmanager
def appearing_folder(path: str | os.PathLike[str]) -> Iterator[Path]:
    """Yield a folder to fill, which appears under its name when the block succeeds, and leaves nothing behind when it
    fails.

    Leftovers of a killed process for the same folder are removed first. Raises OSError where `path` already exists and
    is not an empty folder, and where another process is filling the same one.
    """
    folder = Path(path)
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise FileExistsError(errno.EEXIST, "already exists and was left unchanged", str(folder))
    whole = folder.absolute()
    whole.parent.mkdir(parents=True, exist_ok=True)
    draft = whole.parent / f".{whole.name}.draft"
    with naming(folder, draft):
        draft.mkdir(exist_ok=True)
    handle = os.open(draft, os.O_RDONLY)
    try:
        try:
            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            raise BlockingIOError(errno.EAGAIN, "another process is writing it", str(folder)) from None
        try:
            for left in draft.iterdir():
                shutil.rmtree(left) if left.is_dir() and not left.is_symlink() else left.unlink()
            with naming(folder, draft):
                yield draft
            draft.replace(whole)
        except BaseException:
            shutil.rmtree(draft, ignore_errors=True)
            raise
    finally:
        os.close(handle)


def _is_of_system(path: Path) -> bool:
    if path.exists() and not path.is_file() and not path.is_dir():
        return True
    return path.is_symlink() and Path(os.path.realpath(path.parent)).parts[1:2] in (("dev",), ("proc",))


@contextlib.contextmanager
def naming(path: str | os.PathLike[str], stands_for_it: str | os.PathLike[str] | None = None) -> Iterator[None]:
    """Add this path to an OSError of the block that names no file, such as that of a full disk in `write`.

    stands_for_it: prefix of temporary names for this file, or for what is in this folder; as no user knows them, they
    are replaced too
    """
    try:
        yield
    except OSError as error:
        named = error.filename2 or error.filename
        hidden = stands_for_it is not None and isinstance(named, str) and named.startswith(os.fspath(stands_for_it))
        if error.errno is not None and (named is None or hidden):
            error.filename = os.fspath(path)
            error.filename2 = None
        raise
