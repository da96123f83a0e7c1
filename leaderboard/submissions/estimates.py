"""Uploads, stored as files named by their SHA-256, in a folder or in any store that fsspec has a URL for."""

from __future__ import annotations

import errno
import hashlib
import os
import shutil
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oysterbench.core.atomic import appearing
from oysterbench.core.errors import ResultError


@dataclass(frozen=True)
class Upload:
    """A received file in the private folder, with its SHA-256 and its size in bytes."""

    path: Path
    digest: str
    size: int


def upload_of(path: Path) -> Upload:
    """Upload of an existing file; computes its SHA-256."""
    with open(path, "rb") as file:
        return Upload(path, hashlib.file_digest(file, "sha256").hexdigest(), path.stat().st_size)


def remove_left(folder: Path, most_s: float) -> None:
    """Delete files that were being received when a server ended: receiving takes `most_s` seconds at most."""
    oldest = time.time() - most_s
    for path in folder.iterdir():
        with suppress(FileNotFoundError):
            if path.stat().st_mtime < oldest:
                path.unlink()


@dataclass(frozen=True)
class Estimates:
    """Uploads at a place: the path of a folder, or a URL such as s3://bucket/estimates. A store takes further settings
    from the environment (AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, ...)."""

    place: str

    @property
    def folder(self) -> Path | None:
        """The folder; None for a store."""
        return None if "://" in self.place else Path(self.place)

    def keep(self, upload: Upload) -> None:
        """Store an upload; it is in the store, or synced to disk, when this returns. A folder has the file moved in,
        unless it has these bytes already: a sandbox that is reading them was granted that file, and no other one of its
        name."""
        if self.folder is None:
            self._store().put_file(str(upload.path), f"{self.place}/{upload.digest}")
            return
        with open(upload.path, "rb") as file:
            os.fsync(file.fileno())
        self.folder.mkdir(parents=True, exist_ok=True)
        place = self.folder / upload.digest
        if place.is_file() and upload_of(place).digest == upload.digest:
            upload.path.unlink()
        else:
            _move(upload.path, place)
        folder = os.open(self.folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    @contextmanager
    def opened(self, digest: str) -> Iterator[Path]:
        """Path of the file of that digest, valid while the block runs. Raises ResultError where its bytes do not match
        the digest, and OSError where there is no such file."""
        with tempfile.TemporaryDirectory(prefix="oysterbench-") as folder:
            path = (self.folder or Path(folder)) / digest
            if self.folder is None:
                self._store().get_file(f"{self.place}/{digest}", str(path))
            if upload_of(path).digest != digest:
                raise ResultError(f"{self.place}/{digest}: its bytes do not match its name: it was changed")
            yield path

    def _store(self) -> Any:
        try:
            import fsspec

            return fsspec.core.url_to_fs(self.place)[0]
        except (ImportError, ValueError) as error:
            raise ResultError(f"estimates in {self.place}: {error}; pip install 'oysterbench[s3]' for s3://") from None


def _move(source: Path, target: Path) -> None:
    """Move a file, also to another disk, so that there is never a part of it."""
    try:
        os.replace(source, target)
    except OSError as error:
        if error.errno != errno.EXDEV:
            raise
        with appearing(target, mode=0o600) as copy, open(source, "rb") as file:
            shutil.copyfileobj(file, copy)
        source.unlink()
