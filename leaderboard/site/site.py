"""What pages are made from: the index, numbers from the literature, and what is derived from all records at once."""

from __future__ import annotations

import threading
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, TypeVar

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench_leaderboard.boards.board import STATES, Literature, Query, Row
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.site.page import PageError
from oysterbench_leaderboard.site.paths import slug
from oysterbench_leaderboard.storage.record import Record
from oysterbench_leaderboard.storage.store import RecordStore, StatusChange

Known = TypeVar("Known")


@dataclass
class Site:
    """Everything that pages are made from. index: of the records; literature: numbers reported by others; form: path of
    the submission form, empty where this site accepts no submissions; accepted: splits to which it accepts them, as in
    `Catalogue.public`."""

    index: BoardIndex
    literature: Sequence[Literature] = ()
    form: str = ""
    accepted: Sequence[Mapping[str, Any]] = ()
    _known: dict[str, tuple[str, Any]] = field(default_factory=dict, repr=False)
    _lock: threading.RLock = field(default_factory=threading.RLock, repr=False)

    @property
    def store(self) -> RecordStore:
        return self.index.store

    def row(self, digest: str) -> Row:
        """Return the row of a record by its digest or the first digits of it. Raises PageError."""
        try:
            return self.index.row(digest)
        except ResultError:
            raise PageError(
                f"no record begins with {digest[:16]}, or several do: expected a record's digest, or enough of it",
                hints={"/": "all boards", "/log": "what became of records"},
            ) from None

    def record(self, digest: str) -> Record:
        """Return a record as it was published."""
        return self.store.record(digest)

    def is_whole(self, digest: str) -> bool:
        """Whether the file of a record is there, unchanged. One may be damaged after the index was made from it."""
        try:
            self.store.data(digest)
        except OysterbenchError:
            return False
        return True

    def some_record(self, board: str, first: str = "") -> Record | None:
        """One record of a board whose file is whole, in any state: `first` if possible. None where there is none."""
        query = Query(states=STATES)
        pages = range(1, self.index.page(board, query).pages + 1)
        others = (row.digest for number in pages for row in self.index.page(board, replace(query, page=number)).rows)
        digest = next((one for one in chain(filter(None, [first]), others) if self.is_whole(one)), None)
        return None if digest is None else self.record(digest)

    def conditions(self, board: str, digest: str) -> dict[str, Mapping[str, Any]]:
        """Sequence -> conditions on a board, from one of its records, or another where that one is damaged."""

        def make() -> dict[str, Mapping[str, Any]]:
            record = self.some_record(board, digest)
            return {result.sequence: result.conditions for result in record.results} if record else {}

        return self._once(f"conditions of {board} by {digest}", make)

    def has_disturbances(self, board: str, digest: str) -> bool:
        """Whether the sequences of a board are single disturbances, judging by one of its records."""
        return any("disturbance" in like for like in self.conditions(board, digest).values())

    def status_changes(self, digest: str) -> list[StatusChange]:
        """Status changes of a record, oldest first. Damaged ones are left out, as in the index."""
        return self._once("status_changes", self._status_changes).get(digest, [])

    def all_status_changes(self) -> list[StatusChange]:
        """Status changes of all records, oldest first."""
        by_record = self._once("status_changes", self._status_changes)
        return sorted((change for several in by_record.values() for change in several), key=lambda c: c.created)

    def _status_changes(self) -> dict[str, list[StatusChange]]:
        found: dict[str, list[StatusChange]] = {}
        for change in self.store.read_status_changes()[0]:
            found.setdefault(change.record, []).append(change)
        return found

    def methods(self) -> dict[str, str]:
        """Slug -> name of a method. Plain names, which are their own slugs, are left out."""
        return self._once("methods", lambda: {slug(m): m for m, _, _ in self.index.methods() if slug(m) != m})

    def _once(self, name: str, make: Callable[[], Known]) -> Known:
        """Return what `make` returns, made anew only when the index has changed. name: key under which it is kept."""
        with self._lock:
            revision = self.index.revision
            kept = self._known.get(name)
            if kept is None or kept[0] != revision:
                kept = self._known[name] = (revision, make())
            return kept[1]


def curves_of(site: Site, record: Record) -> dict[str, Any] | None:
    """Curves drawn on a record's page; None where there are none, or they cannot be read."""
    if not record.curves:
        return None
    try:
        return site.store.curves(record.curves)
    except OysterbenchError:
        return None
