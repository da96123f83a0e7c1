"""What was sent, as files named by their SHA-256: in a folder, or in any store that fsspec has a URL for."""

from __future__ import annotations

import hashlib
import os
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from oysterbench.core.errors import ResultError


@dataclass(frozen=True)
class Upload:
    """What was received: a file in the private folder, with its SHA-256 and size."""

    path: Path
    digest: str
    size: int


def upload_of(path: Path) -> Upload:
    """A file that is there."""
    with open(path, "rb") as file:
        return Upload(path, hashlib.file_digest(file, "sha256").hexdigest(), path.stat().st_size)


@dataclass(frozen=True)
class Estimates:
    """Of a place: the path of a folder, or a URL such as s3://bucket/estimates. The environment has what a store wants
    to know besides (AWS_ENDPOINT_URL, AWS_ACCESS_KEY_ID, ...)."""

    place: str

    def keep(self, upload: Upload) -> None:
        """Take a file over; it is in the store, or on the disk, when this returns."""
        if self._is_far:
            self._store().put_file(str(upload.path), f"{self.place}/{upload.digest}")
            return
        with open(upload.path, "rb") as file:
            os.fsync(file.fileno())
        os.replace(upload.path, Path(self.place) / upload.digest)
        folder = os.open(self.place, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    @contextmanager
    def opened(self, digest: str) -> Iterator[Path]:
        """A file of that digest, for as long as the block runs. Raises ResultError where its bytes are others, and
        OSError where there is none."""
        with tempfile.TemporaryDirectory(prefix="oysterbench-") as folder:
            path = Path(folder if self._is_far else self.place) / digest
            if self._is_far:
                self._store().get_file(f"{self.place}/{digest}", str(path))
            if upload_of(path).digest != digest:
                raise ResultError(f"{self.place}/{digest}: its bytes do not match its name: it was changed")
            yield path

    @property
    def _is_far(self) -> bool:
        return "://" in self.place

    def _store(self) -> Any:
        try:
            import fsspec

            return fsspec.core.url_to_fs(self.place)[0]
        except (ImportError, ValueError) as error:
            raise ResultError(f"estimates in {self.place}: {error}; pip install 'oysterbench[s3]' for s3://") from None
