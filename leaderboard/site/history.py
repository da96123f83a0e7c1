"""Changes to records: withdrawn, restored, superseded, rescored."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Literal

from oysterbench.core.errors import ResultError
from oysterbench_leaderboard.boards.board import Query, Row
from oysterbench_leaderboard.site.site import Site

MOST = 200
"""Number of superseded records of each board in the log: the latest ones. Every record's page shows its own status."""

Action = Literal["withdrawn", "restored", "superseded", "scored again"]


@dataclass(frozen=True)
class Event:
    """What happened to a record, when (UTC, ISO 8601), and why; by: the record that superseded it."""

    created: str
    action: Action
    record: Row
    reason: str
    by: Row | None = None


def successor(site: Site, row: Row) -> Row | None:
    """Return the record that replaced a superseded one: the one that names it, or else the team's current one on the
    same board. None where there is none whose file is whole, or the record is not superseded."""
    if row.state != "superseded":
        return None
    others = [other for other in site.index.method(row.method, row.team) if other.digest != row.digest]
    naming = [other for other in others if other.supersedes == row.digest and other.state != "withdrawn"]
    current = [other for other in others if other.board == row.board and other.state == "current"]
    return next((other for other in (*naming, *current) if site.is_whole(other.digest)), None)


def events(site: Site) -> list[Event]:
    """All events, latest first."""
    found = [*_status_changes(site), *_successions(site)]
    return sorted(found, key=lambda event: (event.created, event.record.digest, event.action), reverse=True)


def _status_changes(site: Site) -> Iterator[Event]:
    for change in site.all_status_changes():
        try:
            row = site.index.row(change.record)
        except ResultError:  # about a record that is not here
            continue
        yield Event(change.created, change.action, row, change.reason)


def _successions(site: Site) -> Iterator[Event]:
    for info in site.index.boards():
        query = Query(sort="created", descending=True, states=("superseded",), size=MOST)
        for row in site.index.page(info.id, query).rows:
            by = successor(site, row)
            if by is not None:
                reason = site.record(by.digest).reason if by.supersedes == row.digest else ""
                yield Event(by.created, "superseded" if by.board == row.board else "scored again", row, reason, by)
