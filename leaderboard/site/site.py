"""What pages are made from: the index, numbers from the literature, and what is derived from all records at once."""

from __future__ import annotations

import math
import threading
from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import chain
from typing import Any, TypeVar

from oysterbench.core.errors import OysterbenchError, ResultError
from oysterbench.evaluate.metrics import FAILED, find_metric
from oysterbench.results.records import ResultRecord
from oysterbench_leaderboard.boards.board import STATES, BoardInfo, Literature, Query, Row
from oysterbench_leaderboard.boards.index import BoardIndex
from oysterbench_leaderboard.publishing.truths import Stated, contradicted, held_since, stated_in
from oysterbench_leaderboard.site.page import PageError
from oysterbench_leaderboard.site.paths import slug
from oysterbench_leaderboard.storage.record import RANKED, Record
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
            found = {result.sequence: result.conditions for result in record.results} if record else {}
            lacking = set(self.index.page(board, Query(size=1)).board.sequences) - found.keys()
            return found | {result.sequence: result.conditions for result in self.results_on(board, lacking)}

        return self._once(f"conditions of {board} by {digest}", make)

    def results_on(self, board: str, sequences: Collection[str]) -> list[ResultRecord]:
        """Results of a board's records on some of its sequences, from as many of its first page as it takes to have
        all; they say what a sequence is that a record lacks."""
        found: list[ResultRecord] = []
        lacking = set(sequences)
        for row in self.index.page(board, Query(states=STATES)).rows if lacking else ():
            if self.is_whole(row.digest):
                results = self.record(row.digest).results
                found += [one for one in results if one.sequence in lacking and one.failure is None]
                lacking -= {one.sequence for one in found}
            if not lacking:
                break
        return found

    def lowest_scores(self, info: BoardInfo) -> dict[str, float]:
        """Sequence -> score of a record that lacks it, as in the ranking: the lowest of a ranked record there, or
        of any if none is ranked; without those where no score is lower than that of a failed run."""
        failed, metric = FAILED[info.track].get(info.metric, math.nan), find_metric(info.metric, info.track)
        if metric is None or not metric.range[0] < failed:
            return {}

        def make() -> dict[str, float]:
            lowest: dict[str, float] = {}
            ranked = Query(tiers=RANKED)
            query = ranked if self.index.page(info.id, ranked).total else Query(states=STATES)
            for number in range(1, self.index.page(info.id, query).pages + 1):
                rows = self.index.page(info.id, replace(query, page=number)).rows
                for scores in self.index.scores(row.digest for row in rows).values():
                    for name, score in scores.items():
                        lowest[name] = min(lowest.get(name, failed), score)
            return {name: score for name, score in lowest.items() if score < failed}

        return self._once(f"lowest scores of {info.id}", make)

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

    def contradicted(self, several: Collection[Stated]) -> dict[str, str]:
        """As `truths.contradicted`, of some records."""
        return contradicted(several, lambda: self._once("ground truths", lambda: held_since(*stated_in(self.store))))

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
