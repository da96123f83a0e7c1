"""Where data is stored, and atomic writing of files and folders."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import IO


def home() -> Path:
    """Folder of rendered and downloaded data: `OYSTERBENCH_HOME`, or the user's data folder."""
    chosen = os.environ.get("OYSTERBENCH_HOME")
    if chosen:
        return Path(chosen).expanduser()
    import platformdirs

    return Path(platformdirs.user_data_dir("oysterbench"))


def home_problem() -> str:
    """Why the home folder cannot be made or used as a folder; empty where it can."""
    folder = home()
    there = next(path for path in (folder, *folder.absolute().parents) if os.path.lexists(path))
    if there.is_dir():
        return ""
    return f"{there} is a {'file' if there.exists() else 'link to something that is not there'}"


MODELS = "OYSTERBENCH_MODELS"
SCRATCH = "oysterbench-run-"
"""Prefix of temporary folders; those whose process was killed are removed later."""


def models() -> Path:
    """Folder of locally trained weights: `OYSTERBENCH_MODELS`, or `models` in the home folder."""
    return Path(os.environ.get(MODELS) or home() / "models").absolute()


def write_atomically(path: str | os.PathLike[str], data: bytes) -> None:
    """Write a file atomically: it appears complete or not at all."""
    with appearing(path) as file:
        file.write(data)


def leads_out(name: str) -> bool:
    """Whether a path, relative to a folder, leads out of that folder: names of files in it must not.

    >>> leads_out("clip/1.png"), leads_out("clip/../../1.png"), leads_out("/tmp/1.png")
    (False, True, True)
    """
    return os.path.isabs(name) or os.path.normpath(name).split(os.sep)[0] == os.pardir


def umask() -> int:
    """Permissions that new files do not get. Temporary files do not follow it by themselves."""
    try:
        with open("/proc/self/status") as file:
            return next(int(line.split()[1], 8) for line in file if line.startswith("Umask:"))
    except (OSError, StopIteration):  # not Linux: the only other way changes it for a moment, for all threads
        found = os.umask(0o077)
        os.umask(found)
        return found


def closed_to_others(*paths: Path) -> str:
    """What to tell whoever made a tree for a web server, if other users cannot read these paths of it; else empty."""
    if all(path.stat().st_mode & 0o005 == (0o005 if path.is_dir() else 0o004) for path in paths):
        return ""
    return (
        f"{paths[0]}: other users cannot read all of it (umask {umask():03o}), a web server of another user neither: "
        f"`chmod -R a+rX {paths[0]}`"
    )


def _is_of_system(path: Path) -> bool:
    if path.exists() and not path.is_file() and not path.is_dir():
        return True
    return path.is_symlink() and Path(os.path.realpath(path.parent)).parts[1:2] in (("dev",), ("proc",))


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


@contextlib.contextmanager
def locked(
    path: str | os.PathLike[str], wait: bool = True, before_waiting: Callable[[], None] | None = None
) -> Iterator[bool]:
    """Hold a lock file while the block runs; yield whether it is held. Another holder is waited for or, without `wait`,
    prevents that. The system releases the lock of a process that dies. before_waiting: called before such a wait."""
    path = Path(path)
    path.parent.mkdir(parents=True, exist_ok=True)
    with naming(path.parent, path):
        file = open(path, "w")  # noqa: SIM115  closed below; errors of the block are not this file's
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            if not wait:
                yield False
                return
            if before_waiting is not None:
                before_waiting()
            fcntl.flock(file, fcntl.LOCK_EX)
        yield True


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


def free_bytes(folder: Path) -> int:
    """Free bytes on the disk of a folder, which need not exist yet."""
    there = next(parent for parent in (folder, *folder.absolute().parents) if parent.exists())
    return shutil.disk_usage(there).free


def link(source: str, target: str) -> None:
    """Make a file available under a second name: by a hard link, or by a copy where that is impossible, as between
    disks."""
    try:
        os.link(os.path.realpath(source), target)
    except OSError:
        shutil.copy(source, target)
