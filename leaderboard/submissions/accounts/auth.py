"""Authentication, and responses to refusals: what the HTTP API and the web form share."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, contextmanager
from typing import IO

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from oysterbench_leaderboard.submissions.accounts.tokens import Guesses, Holder, recognise
from oysterbench_leaderboard.submissions.database import Submission, is_disk_full
from oysterbench_leaderboard.submissions.places import Places
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.service import Service
from oysterbench_leaderboard.submissions.uploads import (
    check_headers,
    kept,
    one_file,
    receive_file,
    receive_form,
    texts_of,
)
from oysterbench_leaderboard.submissions.words import Form

HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    # With no referrer at all, browsers send no Origin header with forms.
    "Referrer-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'self'; img-src 'self' data:; script-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
}

FULL = Refusal("full", "the server's disk is full; try again later, or tell its operators")

FAILED = Refusal("failed", "something went wrong on the server; try again later, its operators can see the cause")

Handler = Callable[[Request], Awaitable[Response]]
Show = Callable[[Request, Refusal], Awaitable[Response]]


class Auth:
    """Tokens of a service, and the uploads that arrive with them."""

    def __init__(self, service: Service) -> None:
        self.service = service
        self.guesses = Guesses(service.settings)
        self.places = Places(service.settings)

    async def holder(self, request: Request, token: str) -> Holder:
        """Return the holder of a token. Raises Refusal where it is wrong or missing, and after too many failures."""
        address = address_of(request)
        self.guesses.check(address)
        if not token:
            self.guesses.failed(address)
            raise Refusal("token", "expected a token, in the header 'Authorization: Bearer TOKEN' or in the form")

        def look() -> Holder | None:
            with self.service.database.reading() as connection:
                return recognise(connection, token)

        found = await run_in_threadpool(look)
        if found is None:
            self.guesses.failed(address)
            raise Refusal("token", "the token is unknown or revoked; ask the operators of this board for one")
        return found

    @contextmanager
    def _counting(self, team: str) -> Iterator[None]:
        """Count a body that arrives too slowly, or breaks off, as one that was read: otherwise a client that is turned
        away could return at once and block a place all day. Raises Refusal at once where the team's daily reads are
        used up."""
        self.service.reads.check(team)
        try:
            yield
        except (Refusal, ClientDisconnect) as error:
            if isinstance(error, ClientDisconnect) or error.kind == "slow":
                self.service.reads.count(team)
            raise

    async def submit(
        self, request: Request, team: str, check_fields: Callable[[dict[str, str]], None] = lambda fields: None
    ) -> tuple[Submission, bool]:
        """Receive a request body, one file or a form, and submit it; return the submission and whether it is new.
        Raises Refusal."""
        settings, folder = self.service.settings, self.service.incoming
        check_headers(request, settings)
        fields = dict(request.query_params)
        async with AsyncExitStack() as stack:
            place = stack.enter_context(self.places.hold(team, address_of(request)))
            with tempfile.TemporaryFile(dir=folder) as body:
                file: IO[bytes] = body
                if request.headers.get("content-type", "").lower().startswith("multipart/"):
                    with self._counting(team):
                        async with place.receiving():
                            form = await receive_form(request, settings)
                    stack.push_async_callback(form.close)
                    fields |= texts_of(form)
                    check_fields(fields)
                    self.service.check_form(form_of(fields))
                    file = await run_in_threadpool(one_file, form, body)
                else:
                    check_fields({})
                    # Report what is wrong with the fields before receiving the body.
                    asked, _ = self.service.check_form(form_of(fields))
                    if digest := fields.get("digest"):
                        known = await run_in_threadpool(self.service.announced, team, asked, digest)
                        if known is not None:
                            return known, False
                    with self._counting(team):
                        async with place.receiving():
                            await receive_file(request, body, settings)

                def take_in() -> tuple[Submission, bool]:
                    with kept(file, folder) as upload:
                        return self.service.submit(team, form_of(fields), upload)

                return await run_in_threadpool(take_in)

    def route(self, path: str, show: Show, **handlers: Handler) -> Route:
        """Make the route of a path from the handler of each HTTP method; `show` shows refusals. Not a route for each
        method: where none fits, the answer would name those of the first alone as allowed."""

        async def handle(request: Request) -> Response:
            return await handlers["GET" if request.method == "HEAD" else request.method](request)

        return Route(path, self.answered(handle, show), methods=list(handlers))

    def answered(self, handler: Handler, show: Show) -> Handler:
        """Wrap a handler so that refusals are logged and shown, and internal errors are logged but not revealed."""

        async def answer(request: Request) -> Response:
            try:
                response = await handler(request)
            except Refusal as refusal:
                team = getattr(request.state, "team", "")
                who = team or address_of(request)
                if refusal.kind != "absent" or request.method != "GET":
                    await run_in_threadpool(
                        self.service.refused, who, f"{request.method} {request.url.path}", refusal, not team
                    )
                response = await show(request, refusal)
                if refusal.retry_s:
                    response.headers["Retry-After"] = str(refusal.retry_s)
                response.headers["Connection"] = "close"  # do not wait for the rest of the body
            except asyncio.CancelledError:
                raise
            except ClientDisconnect:  # the client is gone; not a server failure
                response = Response(status_code=400)
            except Exception as error:
                self.service.log.exception("%s %s", request.method, request.url.path)
                if is_disk_full(error):
                    response = await show(request, FULL)  # not logged as a refusal: the database is full, too
                    response.headers["Connection"] = "close"
                else:
                    response = PlainTextResponse(FAILED.reason, FAILED.status, {"Connection": "close"})
            for key, value in HEADERS.items():
                response.headers.setdefault(key, value)
            return response

        return answer


def form_of(fields: dict[str, str]) -> Form:
    """Form made of the fields of a request; absent fields are empty."""
    return Form(**{key: fields.get(key, "") for key in ("method", "split", "track", "url", "summary")})


def address_of(request: Request) -> str:
    """Address of the client, as far as the server in front passes it on; "unknown" without one."""
    return request.client.host if request.client else "unknown"
