"""Ground truths that records say they were scored against: those of one board are compared, so each of its sequences
must have one."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.text import composed
from oysterbench_leaderboard.boards.ranking import Claim, states, withdrawn
from oysterbench_leaderboard.storage.record import RANKED, Record
from oysterbench_leaderboard.storage.store import RecordStore, StatusChange

DAMAGED = (OysterbenchError, ArithmeticError, ValueError, TypeError, RecursionError)
"""What reading a damaged record raises, which `verify` reports."""

DO = "render the split again and evaluate on it; or, if it is that record that is wrong, have it withdrawn"


@dataclass(frozen=True)
class Stated:
    """What a record says of its ground truths. owner: its method and team, which have one current record on a board;
    supersedes: digest of the one that it names as replaced; truths: sequence -> digest, where it says one"""

    digest: str
    board: str
    is_ranked: bool
    created: str
    name: str
    owner: tuple[str, str]
    supersedes: str
    truths: Mapping[str, str]

    @classmethod
    def of(cls, digest: str, record: Record) -> Stated:
        """What a record says."""
        truths = {result.sequence: result.truth_digest for result in record.results if result.truth_digest}
        owner = composed(record.method), composed(record.team)
        name = f"{digest[:8]}, {record.method} by {record.team}"
        return cls(digest, record.board, record.tier in RANKED, record.created, name, owner, record.supersedes, truths)


@dataclass(frozen=True)
class Absence:
    """Time in which a record was not on the board: another one that is withdrawn now was in its place, or it was
    withdrawn itself. instead: that other one, or itself"""

    instead: Stated
    ended: str

    def of(self, one: Stated) -> bool:
        """Whether this record was absent then, by the rules of `ranking.states`."""
        instead = self.instead
        named = one.digest == instead.supersedes and one.owner[1] == instead.owner[1]
        earlier = (one.board, one.owner) == (instead.board, instead.owner) and one.created <= instead.created
        return (named or earlier) and one.is_ranked <= instead.is_ranked


def by_trust(several: Iterable[Stated], absences: Sequence[Absence]) -> list[Stated]:
    """Ranked records first, as anybody can write reported results down, and of these those that have been on the board
    longest without a break: what came in meanwhile was checked without them."""

    def order(one: Stated) -> tuple[bool, str, str, str]:
        since = max([one.created, *(absence.ended for absence in absences if absence.of(one))])
        return not one.is_ranked, since, one.created, one.digest

    return sorted(several, key=order)


def absences_in(store: RecordStore) -> list[Absence]:
    """Absences that ended when a record was withdrawn or restored."""
    latest = {each.record: each.created for each in sorted(store.read_status_changes()[0], key=StatusChange.order)}
    found = []
    for digest, ended in latest.items():
        with suppress(*DAMAGED):
            found.append(Absence(Stated.of(digest, store.record(digest)), ended))
    return found


def contradicted(several: Iterable[Stated], store: RecordStore) -> dict[str, str]:
    """Digest of a record -> in what its ground truth is another than that of one on its board that is trusted more."""
    listed = by_trust(several, [])
    return contradicting(by_trust(listed, absences_in(store))) if contradicting(listed) else {}  # reading takes long


def contradicting(several: Iterable[Stated]) -> dict[str, str]:
    """Digest of a record -> in what its ground truth is another than that of a record before it on the same board."""
    known: dict[tuple[str, str], Stated] = {}
    found = {}
    for one in several:
        before = {name: known.get((one.board, name), one) for name in one.truths}
        if odd := [name for name, other in before.items() if other.truths[name] != one.truths[name]]:
            found[one.digest] = f"{odd[0]}: scored against another ground truth than record {before[odd[0]].name}"
            continue
        known |= {(one.board, name): other for name, other in before.items()}
    return found


def other_truth(store: RecordStore, records: Sequence[Record]) -> str:
    """Why the first of some new records is not to be on the board: its ground truth is another than that of a record
    there, or of another new one; and what to do. Empty where there is none. A ranked one need only agree with ranked
    ones."""
    new = [Stated.of(record.digest, record) for record in records]
    replaced = {(one.board, one.owner) for one in new}
    there = stated_in(store, {record.split_digest for record in records})
    there = [one for one in there if (one.board, one.owner) not in replaced]
    if any(one.is_ranked for one in new):
        there = [one for one in there if one.is_ranked]
    if not contradicting([*there, *new]):
        return ""
    found = contradicting([*by_trust(there, absences_in(store)), *new])
    return next((f"{found[one.digest]}: {DO}" for one in new if one.digest in found), "")


def stated_in(store: RecordStore, split_digests: Collection[str] = ("",)) -> list[Stated]:
    """What the current records of a store say that are of one of some recipes, by default of any. Those that cannot be
    read are left out."""
    gone = withdrawn(store.read_status_changes()[0])
    claims, found = [], []
    for digest in store.digests():
        try:
            data = b"" if digest in gone else store.data(digest)
            if data and any(split.encode() in data for split in split_digests):  # as parsing takes longer
                record = store.record(digest)
                claims.append(Claim.of(digest, record))
                found.append(Stated.of(digest, record))
        except DAMAGED:
            continue
    state = states(claims, gone)
    return [one for one in found if state[one.digest] == "current"]
