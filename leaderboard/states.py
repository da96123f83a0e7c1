"""Which records are current: one per method, team and board; the others are superseded or withdrawn, and stay."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

from oysterbench_leaderboard.board import State
from oysterbench_leaderboard.store import Notice


@dataclass(frozen=True, slots=True)
class Claim:
    """Of a record: what decides whether it is current."""

    digest: str
    board: str
    method: str
    team: str
    created: str
    supersedes: str


def withdrawn(notices: Iterable[Notice]) -> set[str]:
    """Digests of the records whose latest notice withdraws them; notices in any order."""
    latest = {n.record: n.action for n in sorted(notices, key=lambda n: (n.created, n.record, n.action))}
    return {digest for digest, action in latest.items() if action == "withdrawn"}


def states(claims: Iterable[Claim], gone: set[str], others: Iterable[Claim] = ()) -> dict[str, State]:
    """Digest -> state, for all records of some boards.

    A record is superseded by any of the same team that names it, on its own board or another (a new evaluator has a
    board of its own), or by the latest created one of its method, team and board; of two of one second the greater
    digest is the later. A withdrawn record supersedes nothing: what it took the place of comes back.

    gone: digests that are withdrawn; others: records of other boards, which may name those of these
    """
    known = {claim.digest: claim for claim in claims}
    named = {
        (claim.supersedes, claim.team)
        for claim in (*known.values(), *others)
        if claim.supersedes and claim.digest not in gone
    }
    found: dict[str, State] = {}
    latest: dict[tuple[str, str, str], Claim] = {}
    for claim in known.values():
        if claim.digest in gone:
            found[claim.digest] = "withdrawn"
        elif (claim.digest, claim.team) in named:
            found[claim.digest] = "superseded"
        else:
            key = (claim.board, claim.method, claim.team)
            other = latest.get(key)
            if other is None or (claim.created, claim.digest) > (other.created, other.digest):
                latest[key] = claim
            found[claim.digest] = "superseded"
    for claim in latest.values():
        found[claim.digest] = "current"
    return found
