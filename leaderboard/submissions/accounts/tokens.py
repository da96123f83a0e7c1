"""Teams and their tokens, which are shown once and stored as hashes; and a limit on guessing."""

from __future__ import annotations

import hashlib
import hmac
import secrets
import threading
import time
from collections import deque
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Literal

from sqlalchemy import Connection, insert, select, update

from oysterbench.core.errors import ResultError
from oysterbench.core.text import alike, composed, spellings
from oysterbench.hub.addresses import network
from oysterbench_leaderboard.storage.record import MOST_TEXT, check_text
from oysterbench_leaderboard.submissions.database import SubmissionDatabase, log_event, teams, tokens, utc
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.settings import SubmissionSettings

PREFIX = "oyb"
SECRET_BYTES = 32
"""Bytes of entropy in a token: too many to guess, so that storing a plain hash is safe."""

LONGEST = 200  # characters of a token that are considered
NOBODY = hashlib.sha256(b"").hexdigest()
"""Hash that an unknown token is compared with, so that it takes as long as a known one."""


@dataclass(frozen=True)
class Holder:
    """The team that holds a token, and the token's id."""

    team: str
    token: str


def issue(database: SubmissionDatabase, team: str, held: Literal["refuse", "revoke", "keep"] = "refuse") -> str:
    """Issue a new token for a team, which is created if it is new. The token itself is not stored: a team that loses it
    has to ask for another one.

    held: what to do where the team has valid tokens. Raises ResultError where it has one and held is "refuse", and for
    an invalid team name, or a new one that a reader could take for that of another team.
    """
    check_text("team", team, MOST_TEXT["team"])
    if not team.strip() or team != team.strip():
        raise ResultError(f"expected the name of a team, without spaces around it, got {team!r}")
    id, secret = secrets.token_hex(6), secrets.token_urlsafe(SECRET_BYTES)
    at = utc(time.time())
    with database.writing() as connection:
        known = connection.execute(select(teams.c.name).order_by(teams.c.name)).scalars().all()
        team = next((name for name in known if name in spellings(team)), composed(team))
        if team not in known:
            _check_new(team, known)
            connection.execute(insert(teams).values(name=team, created=at))
        valid = (tokens.c.team == team) & (tokens.c.revoked == "")
        before = connection.execute(select(tokens.c.id, tokens.c.created).where(valid).order_by(tokens.c.created)).all()
        if before and held == "refuse":
            ids = ", ".join(f"{one.id} of {one.created[:10]}" for one in before)
            raise ResultError(
                f"team {team!r} has a token already ({ids}): add --replace to revoke it and print a new one, or "
                "--another for one more; nothing was changed"
            )
        if held == "revoke":
            connection.execute(update(tokens).where(valid).values(revoked=at))
            for one in before:
                log_event(connection, at, "operator", "token revoked", why=one.id)
        connection.execute(insert(tokens).values(id=id, team=team, hash=_hash(secret), created=at, revoked=""))
        log_event(connection, at, "operator", "token issued", why=f"{team}: {id}")
    return f"{PREFIX}_{id}_{secret}"


def _check_new(team: str, known: Iterable[str]) -> None:
    if "  " in team:
        raise ResultError(f"{team!r}: expected single spaces in the name of a team, got two in a row")
    twin = next((name for name in known if alike(name) == alike(team)), None)
    if twin is not None:
        raise ResultError(
            f"{team!r} looks like {twin!r}, a team that there is: names have to differ in more than case, spaces, "
            "accents, punctuation, 1/l/I and 0/O; choose another, or `team list` shows all"
        )


def revoke(database: SubmissionDatabase, name: str) -> list[str]:
    """Revoke a token by its id, or all tokens of a team; return the ids of those that were still valid. Raises
    ResultError where there is no such token or team."""
    at = utc(time.time())
    with database.writing() as connection:
        chosen = (tokens.c.id == name) | tokens.c.team.in_(spellings(name))
        found = connection.execute(select(tokens.c.id, tokens.c.revoked).where(chosen)).all()
        if not found:
            raise ResultError(f"no team and no token is named {name!r}; `oysterbench leaderboard team list` lists them")
        connection.execute(update(tokens).where(chosen, tokens.c.revoked == "").values(revoked=at))
        revoked = [id for id, before in found if not before]
        for id in revoked:
            log_event(connection, at, "operator", "token revoked", why=id)
    return revoked


def listed(database: SubmissionDatabase) -> list[dict[str, str]]:
    """Return the tokens of all teams, without their secrets."""
    columns = (tokens.c.team, tokens.c.id, tokens.c.created, tokens.c.revoked)
    with database.reading() as connection:
        rows = connection.execute(select(*columns).order_by(tokens.c.team, tokens.c.created, tokens.c.id))
        return [dict(row) for row in rows.mappings()]


def recognise(connection: Connection, token: str) -> Holder | None:
    """Return the holder of a token; None where it is invalid. A wrong secret takes as long as a right one."""
    if not (token.isascii() and token.isprintable()):  # such as with NUL, which PostgreSQL takes in no text
        return None
    prefix, _, rest = token[:LONGEST].partition("_")
    id, _, secret = rest.partition("_")
    found = connection.execute(select(tokens.c.team, tokens.c.hash, tokens.c.revoked).where(tokens.c.id == id)).first()
    right = hmac.compare_digest(_hash(secret), NOBODY if found is None else found.hash)
    if found is None or not right or found.revoked or prefix != PREFIX:
        return None
    return Holder(found.team, id)


def team_of(connection: Connection, token: str) -> str | None:
    """Return the team of a token, given by its id; None where it is unknown or revoked."""
    found = connection.execute(select(tokens.c.team, tokens.c.revoked).where(tokens.c.id == token)).first()
    return None if found is None or found.revoked else found.team


def _hash(secret: str) -> str:
    return hashlib.sha256(secret.encode()).hexdigest()


class Guesses:
    """Recent wrong tokens. An address that has sent too many is blocked for a while; when all addresses together have
    sent too many, so is every address that has sent one."""

    def __init__(self, settings: SubmissionSettings) -> None:
        self._settings = settings
        self._of: dict[str, deque[float]] = {}
        self._all: deque[float] = deque()
        self._lock = threading.Lock()

    def check(self, address: str) -> None:
        """Raises Refusal where this address is blocked for now."""
        key, limits = network(address), self._settings
        with self._lock:
            now = self._forget()
            mine = self._of.get(key, deque())
            if len(mine) >= limits.guesses_of_address or (mine and len(self._all) >= limits.guesses):
                wait_s = int(mine[0] + limits.guess_window_s - now) + 1
                raise Refusal("guessing", f"too many wrong tokens; try again in {wait_s} s", wait_s)

    def failed(self, address: str) -> None:
        """Count a wrong token from an address."""
        with self._lock:
            now = self._forget()
            self._of.setdefault(network(address), deque()).append(now)
            self._all.append(now)

    def _forget(self) -> float:
        now = time.monotonic()
        oldest = now - self._settings.guess_window_s
        while self._all and self._all[0] < oldest:
            self._all.popleft()
        for key in [key for key, times in self._of.items() if times[-1] < oldest]:
            del self._of[key]
        for times in self._of.values():
            while times[0] < oldest:
                times.popleft()
        return now
