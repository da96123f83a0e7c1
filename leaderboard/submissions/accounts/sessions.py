"""Sessions of the web form: sign-in with a cookie that no script and no other site can use."""

from __future__ import annotations

import contextlib
import hashlib
import hmac
import os
import secrets
from urllib.parse import urlsplit

from sqlalchemy import delete, insert, select
from starlette.requests import Request
from starlette.responses import Response

from oysterbench_leaderboard.submissions.accounts.tokens import Holder, team_of
from oysterbench_leaderboard.submissions.database import sessions
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.service import Service

COOKIE = "oysterbench_session"
BYTES = 32


class Sessions:
    """Sessions of the web form. A session starts without a team, so that the sign-in form is protected as well."""

    def __init__(self, service: Service) -> None:
        self._service = service
        self._key = _key(service)

    def value(self, request: Request) -> str:
        """Return the value of the session cookie; a new one where there is none, or an invalid one."""
        found = request.cookies.get(COOKIE, "")
        good = len(found) == 2 * BYTES and all(c in "0123456789abcdef" for c in found)
        return found if good else secrets.token_hex(BYTES)

    def csrf(self, value: str) -> str:
        """CSRF token that every form of a session carries."""
        return hmac.new(self._key, b"csrf " + value.encode(), hashlib.sha256).hexdigest()

    def check(self, request: Request, value: str, csrf: str) -> None:
        """Raises Refusal for a form that does not come from a page of this site and session."""
        check_origin(request)
        own = csrf.isascii() and hmac.compare_digest(self.csrf(value), csrf)  # which takes no text that is not ASCII
        if request.cookies.get(COOKIE) != value or not own:
            raise Refusal("origin", "the form is too old, or was not made by this site; open the page again")

    def holder(self, value: str) -> Holder | None:
        """Return who is signed in; None for nobody."""
        now = self._service.clock()
        with self._service.database.reading() as connection:
            query = select(sessions.c.token, sessions.c.expires).where(sessions.c.hash == _hash(value))
            found = connection.execute(query).first()
            if found is None or found.expires < now:
                return None
            team = team_of(connection, found.token)
        return None if team is None else Holder(team, found.token)

    def begin(self, holder: Holder, old: str) -> str:
        """Sign in and return the new session value, so that one known before the sign-in is worth nothing."""
        value, now = secrets.token_hex(BYTES), self._service.clock()
        with self._service.database.writing() as connection:
            connection.execute(delete(sessions).where((sessions.c.expires < now) | (sessions.c.hash == _hash(old))))
            expires = now + self._service.settings.session_s
            connection.execute(insert(sessions).values(hash=_hash(value), token=holder.token, expires=expires))
        return value

    def end(self, value: str) -> None:
        """Sign out."""
        with self._service.database.writing() as connection:
            connection.execute(delete(sessions).where(sessions.c.hash == _hash(value)))


def set_cookie(request: Request, response: Response, value: str, path: str) -> Response:
    """Set the session cookie on a response, and return the response."""
    secure = request.url.scheme == "https"
    response.set_cookie(COOKIE, value, path=path, secure=secure, httponly=True, samesite="strict")
    return response


def check_origin(request: Request) -> None:
    """Raises Refusal for a request that a page of another site made the browser send."""
    origin, site = request.headers.get("origin"), request.headers.get("sec-fetch-site")
    own = request.headers.get("host", "")
    if (origin is None or _host(origin) != own) and not (origin is None and site == "same-origin"):
        raise Refusal("origin", f"expected a form of this site, got one from {origin or 'nowhere'!r:.80}")


def _host(origin: str) -> str | None:
    """Host and port of an Origin header; None where it is no address."""
    try:
        return urlsplit(origin).netloc
    except ValueError:
        return None


def _hash(value: str) -> str:
    return hashlib.sha256(value.encode()).hexdigest()


def _key(service: Service) -> bytes:
    """Return the secret key of this server, which is generated on first use."""
    path = service.settings.folder / "key"
    with contextlib.suppress(FileExistsError):
        draft = path.with_name(f"key.{secrets.token_hex(8)}")
        with open(os.open(draft, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o600), "wb") as file:
            file.write(secrets.token_bytes(BYTES))
        try:
            os.link(draft, path)  # atomic: the key is complete, or not there
        finally:
            draft.unlink()
    return path.read_bytes()
