"""Store of records and their status changes, from which boards are made: files named by their hash, never changed."""

from __future__ import annotations

import errno
import json
import os
from collections.abc import Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import asdict, dataclass
from datetime import datetime, timedelta
from pathlib import Path
from typing import Any, Literal

from oysterbench.core.atomic import write_atomically
from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.core.locks import locked_if_possible
from oysterbench.core.text import composed
from oysterbench.hub.canonical import SHA256, canonical, parse, sha256
from oysterbench.results.records import checked, now
from oysterbench_leaderboard.storage.record import Record, check_time

FORMAT = "oysterbench-status-change/1"
KINDS = ("records", "changes", "curves")

UNREADABLE = (errno.EACCES, errno.EPERM, errno.EISDIR, errno.EIO)
"""Errors of the system that are faults of a file."""

Action = Literal["withdrawn", "restored"]


@dataclass(frozen=True)
class StatusChange:
    """The withdrawal of a record (it is no longer ranked, and its page says so) or its restoration, with the reason.
    The latest change of a record counts. created: UTC, ISO 8601."""

    record: str
    action: Action
    reason: str
    created: str

    def __post_init__(self) -> None:
        check_time("created", self.created)

    def order(self) -> tuple[str, str, str]:
        """Sort key of changes."""
        return self.created, self.record, self.action


class RecordStore:
    """A folder with `records/`, `changes/` and `curves/`, each file named by the SHA-256 of its bytes."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = Path(folder)

    def add(self, record: Record) -> str:
        """Store a record, unless it is stored already; return its digest."""
        return self._keep("records", record.data)

    def publishing(self) -> AbstractContextManager[None]:
        """Lock between looking at what is there and adding to it, so that no other process adds anything meanwhile.
        Raises OSError where its file is closed to this user."""
        return locked_if_possible(self.folder / ".publishing.lock", needed=True)

    def add_status_change(self, change: StatusChange) -> str:
        """Store a change of a record's status; return the change's digest."""
        return self._keep("changes", canonical({"format": FORMAT, **asdict(change)}))

    def change_status(self, record: str, action: Action, reason: str) -> str:
        """Withdraw or restore a record now; return the change's digest. Its time is made later than that of all earlier
        changes of the record: the order of two changes in the same second would be lost."""
        last = max((each.created for each in self.read_status_changes()[0] if each.record == record), default="")
        at = now()
        if at <= last:
            at = (datetime.fromisoformat(last) + timedelta(seconds=1)).strftime("%Y-%m-%dT%H:%M:%SZ")
        return self.add_status_change(StatusChange(record, action, reason, at))

    def add_curves(self, document: dict[str, Any]) -> str:
        """Store the curves for a record's page; return their digest."""
        return self._keep("curves", canonical(document))

    def digests(self) -> list[str]:
        """Digests of all records, sorted."""
        return self.names("records")

    def data(self, digest: str, kind: str = "records") -> bytes:
        """Return the bytes of a record, or of a file of another kind. Raises ResultError where there is none of that
        digest, or its file was changed."""
        return self._read(kind, digest)

    def record(self, digest: str) -> Record:
        """Read a record. Raises ResultError where there is none of that digest, or its file was changed."""
        data = self._read("records", digest)
        return Record.from_dict(parse(data, str(self._path("records", digest))), f"record {digest[:12]}")

    def records_by(self, team: str, method: str) -> list[tuple[str, Record]]:
        """Records of a team's method on all boards, with their digests; names match in any Unicode form.
        Unreadable ones are skipped; `verify` reports them."""
        found, names = [], (composed(team), composed(method))
        for digest in self.digests():
            try:
                # Most are of other methods, and parsing them takes long.
                text = composed(self.data(digest).decode(errors="replace"))
                if json.dumps(names[1], ensure_ascii=False) not in text:
                    continue
                record = self.record(digest)
            except OysterbenchError:
                continue
            if (composed(record.team), composed(record.method)) == names:
                found.append((digest, record))
        return found

    def curves(self, digest: str) -> dict[str, Any]:
        """Read curves stored by `add_curves`. Raises ResultError."""
        return parse(self._read("curves", digest), str(self._path("curves", digest)))

    def status_changes(self) -> list[StatusChange]:
        """All status changes, oldest first. Raises ResultError where one of them cannot be used."""
        found, wrong = self.read_status_changes()
        for reason in wrong.values():
            raise ResultError(reason)
        return found

    def read_status_changes(self) -> tuple[list[StatusChange], dict[str, str]]:
        """Status changes that can be used, oldest first; and digests of those that cannot -> reason."""
        found, wrong = [], {}
        for name in self.names("changes"):
            try:
                found.append(self.status_change(name))
            except OysterbenchError as error:
                wrong[name] = str(error)
        return sorted(found, key=StatusChange.order), wrong

    def status_change(self, name: str) -> StatusChange:
        """Read the status change of that digest. Raises ResultError where it cannot be used."""
        path = str(self._path("changes", name))
        return checked(parse(self._read("changes", name), path), StatusChange, FORMAT, path)

    def _path(self, kind: str, digest: str) -> Path:
        if not SHA256.fullmatch(digest):
            raise ResultError(f"expected a SHA-256 (64 hex digits), got {digest!r:.80}")
        return self.folder / kind / f"{digest}.json"

    def names(self, kind: str) -> list[str]:
        """Digests of all files of a kind, sorted."""
        folder = self.folder / kind  # files left by a killed writer have other names, and are skipped
        names = os.listdir(folder) if folder.is_dir() else []
        return sorted(name[:64] for name in names if name[64:] == ".json" and SHA256.fullmatch(name[:64]))

    def _keep(self, kind: str, data: bytes) -> str:
        digest = sha256(data)
        path = self._path(kind, digest)
        if not path.is_dir() and not _holds(path, data):  # also one that was damaged since
            write_atomically(path, data)
        return digest

    def _read(self, kind: str, digest: str) -> bytes:
        path = self._path(kind, digest)
        try:
            data = path.read_bytes()
        except FileNotFoundError:
            raise ResultError(f"no such {kind.removesuffix('s')}: {digest[:12]}") from None
        except OSError as error:
            if error.errno not in UNREADABLE:  # such as too many open files, which says nothing of this one
                raise
            raise ResultError(f"{path}: cannot be read: {error.strerror}; it was not used") from None
        if sha256(data) != digest:
            raise ResultError(f"{path}: its bytes do not match its name: it was changed, and was not used")
        return data


def _holds(path: Path, data: bytes) -> bool:
    try:
        return path.read_bytes() == data
    except OSError:
        return False


def copied_curves(source: RecordStore, target: RecordStore, digest: str) -> str:
    """Store curves of one store in another. Return why the other one has none that can be used; empty where it has."""
    try:
        target.add_curves(source.curves(digest))
    except OysterbenchError as error:
        try:
            target.curves(digest)
        except OysterbenchError:
            return str(error)
    return ""


def usable(stores: Sequence[RecordStore], *digests: str) -> Record | None:
    """First of some records of which one of the stores has an undamaged file; None where there is none."""
    for digest in digests:
        for store in stores:
            with suppress(OysterbenchError):
                return store.record(digest)
    return None
