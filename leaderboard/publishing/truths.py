"""Ground truths that records say they were scored against: those of one board are compared, so each of its sequences
must have one."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass

from oysterbench.core.errors import OysterbenchError
from oysterbench.core.text import composed
from oysterbench_leaderboard.boards.ranking import Claim, states, withdrawn
from oysterbench_leaderboard.storage.record import RANKED, Record
from oysterbench_leaderboard.storage.store import RecordStore, StatusChange

DAMAGED = (OysterbenchError, ArithmeticError, ValueError, TypeError, RecursionError)
"""What reading a damaged record raises, which `verify` reports."""

Said = tuple[str, str, str, bool]
"""Board, sequence, digest of its ground truth, and whether ranked records alone count."""

Moment = tuple[str, bool]
"""A time, UTC, and whether it is that of a status change, which comes after the records of the same second."""

STILL: Moment = ("3", False)
"""Later than the time of any record."""

DO = "render the split again and evaluate on it; or, if it is that record that is wrong, have it withdrawn"


@dataclass(frozen=True, eq=False)
class Stated:
    """What a record says of its ground truths. claim: what decides whether it is current; truths: sequence -> digest,
    where it says one"""

    claim: Claim
    truths: Mapping[str, str]

    @classmethod
    def of(cls, digest: str, record: Record) -> Stated:
        """What a record says."""
        truths = {result.sequence: result.truth_digest for result in record.results if result.truth_digest}
        return cls(Claim.of(digest, record), truths)

    @property
    def name(self) -> str:
        """Start of its digest, method and team."""
        return f"{self.claim.digest[:8]}, {self.claim.method} by {self.claim.team}"

    @property
    def owner(self) -> tuple[str, str, str]:
        """Board, method and team, of which one record is current."""
        return self.claim.board, composed(self.claim.method), composed(self.claim.team)

    @property
    def is_ranked(self) -> bool:
        """Whether its tier is."""
        return self.claim.tier in RANKED

    def said(self, ranked: bool) -> set[Said]:
        """Its ground truths, as keys of `held_since`."""
        return {(self.claim.board, *truth, ranked) for truth in self.truths.items()}


def held_since(every: Collection[Stated], changes: Sequence[StatusChange]) -> dict[Said, Moment]:
    """Since when each ground truth has been on its board without a break, whichever records said so; STILL where none
    does now.

    every: records, whatever their state; changes: of their status
    """
    methods = {one.claim.digest: one.owner[1] for one in every}
    mixed = {one.owner[2] for one in every if methods.get(one.claim.supersedes, one.owner[1]) != one.owner[1]}
    apart: dict[tuple[str, str], list[Stated]] = defaultdict(list)
    for one in every:  # whole teams take long, and few, if any, name a record of another method as replaced
        _, method, team = one.owner
        apart["" if team in mixed else method, team].append(one)
    times: dict[Said, list[tuple[Moment, Moment]]] = defaultdict(list)
    for several in apart.values():
        for one, start, end in _times_of(several, changes):
            for said in one.said(False) | one.said(one.is_ranked):
                times[said].append((end, start))
    found = dict.fromkeys(times, STILL)
    for said, spans in times.items():
        for end, start in sorted(spans, reverse=True):
            if end >= found[said]:
                found[said] = min(start, found[said])
    return found


def _times_of(several: Sequence[Stated], changes: Sequence[StatusChange]) -> Iterator[tuple[Stated, Moment, Moment]]:
    """Start and end of each time in which one of some records was current: STILL where it is. several: all that take
    the place of one another"""
    digests = {one.claim.digest for one in several}
    changes = sorted((each for each in changes if each.record in digests), key=StatusChange.order)
    first = {each.record: each.created for each in reversed(changes)}
    came = {one: (min(one.claim.created, first.get(one.claim.digest, STILL[0])), False) for one in several}
    since: dict[Stated, Moment] = {}
    for at in sorted({*came.values(), *((each.created, True) for each in changes)}):
        gone = withdrawn(each for each in changes if (each.created, True) <= at)
        state = states((one.claim for one in several if came[one] <= at), gone)
        for one in several:
            if state.get(one.claim.digest) == "current":
                since.setdefault(one, at)
            elif one in since:
                yield one, since.pop(one), at
    yield from ((one, start, STILL) for one, start in since.items())


def by_trust(several: Iterable[Stated], since: Mapping[Said, Moment]) -> list[tuple[Stated, str]]:
    """Records with each sequence of which they name the ground truth: those of ranked records first, as anybody can
    write reported results down, and of these those that have been on the board longest without a break: what came in
    meanwhile was checked without others. since: `held_since`"""

    def order(pair: tuple[Stated, str]) -> tuple[bool, Moment, str, str]:
        one, name = pair
        said = one.claim.board, name, one.truths[name], one.is_ranked
        return not one.is_ranked, since.get(said, STILL), one.claim.created, one.claim.digest

    return sorted(((one, name) for one in several for name in one.truths), key=order)


def contradicted(several: Collection[Stated], since: Callable[[], Mapping[Said, Moment]]) -> dict[str, str]:
    """Digest of a record -> in what its ground truth is another than that of one on its board that is trusted more.
    since: returns `held_since`, which takes long, and is asked only where two differ"""
    of: dict[tuple[str, str], list[Stated]] = defaultdict(list)
    for one in several:
        for name in one.truths:
            of[one.claim.board, name].append(one)
    found: dict[str, str] = {}
    if all(one.truths[name] == those[0].truths[name] for (_, name), those in of.items() for one in those):
        return found
    for one, name in by_trust(several, since()):
        if one.claim.digest in found:
            continue
        for other in of.pop((one.claim.board, name), ()):
            if other.truths[name] != one.truths[name]:
                why = f"{name}: scored against another ground truth than record {one.name}"
                found.setdefault(other.claim.digest, why)
    return found


def other_truth(store: RecordStore, records: Sequence[Record]) -> str:
    """Why the first of some new records is not to be on the board: its ground truth is another than that of a record
    there, or of another new one; and what to do. Empty where there is none. A ranked one need only agree with ranked
    ones."""
    new = [Stated.of(record.digest, record) for record in records]
    replaced = {one.owner for one in new}
    every, changes = stated_in(store, {record.split_digest for record in records})
    there = [one for one in current(every, changes) if one.owner not in replaced]
    found = contradicted([*there, *new], lambda: held_since(every, changes))
    return next((f"{found[one.claim.digest]}: {DO}" for one in new if one.claim.digest in found), "")


def current(every: Collection[Stated], changes: Sequence[StatusChange]) -> list[Stated]:
    """Those of all records that are current."""
    state = states((one.claim for one in every), withdrawn(changes))
    return [one for one in every if state[one.claim.digest] == "current"]


def stated_in(store: RecordStore, recipes: Collection[str] = ("",)) -> tuple[list[Stated], list[StatusChange]]:
    """What the records of a store say that are of one of some recipes, by default of any, whatever their state; and all
    status changes. Those that cannot be read are left out."""
    found = []
    for digest in store.digests():
        try:
            data = store.data(digest)
            if any(recipe.encode() in data for recipe in recipes):  # as parsing takes longer
                found.append(Stated.of(digest, store.record(digest)))
        except DAMAGED:
            continue
    return found, store.read_status_changes()[0]
