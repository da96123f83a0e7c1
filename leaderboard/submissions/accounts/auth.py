"""Authentication, and responses to refusals: what the HTTP API and the web form share."""

from __future__ import annotations

import asyncio
import tempfile
from collections.abc import Awaitable, Callable, Iterator
from contextlib import AsyncExitStack, contextmanager, suppress
from typing import IO

import anyio
import anyio.to_thread
from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response
from starlette.routing import Route

from oysterbench.core.text import in_one_line, printable
from oysterbench.hub.canonical import SHA256
from oysterbench_leaderboard.submissions.accounts.tokens import Guesses, Holder, recognise
from oysterbench_leaderboard.submissions.database import Submission, is_disk_full
from oysterbench_leaderboard.submissions.places import Places
from oysterbench_leaderboard.submissions.reading.refusals import Refusal
from oysterbench_leaderboard.submissions.service import Service
from oysterbench_leaderboard.submissions.uploads import (
    announced_kind,
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
        self._publishing: anyio.CapacityLimiter | None = None

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
        """Count the body that is received in the block as one of the team's daily reads, whatever becomes of it: one
        that arrives too slowly, breaks off or is refused afterwards costs as much, and its sender could return at once.
        One whose place was taken away is not counted. Raises Refusal at once where the daily reads are used up."""
        self.service.reads.check(team)
        try:
            yield
        except BaseException as error:
            if not isinstance(error, Refusal) or error.kind != "busy":
                self.service.reads.count(team)
            raise
        self.service.reads.count(team)

    async def publish(self, team: str, id: str) -> Submission:
        """Publish a submission, one after the other: they wait for each other anyway, and must not take all threads of
        the server meanwhile. Raises Refusal."""
        self._publishing = self._publishing or anyio.CapacityLimiter(1)
        return await anyio.to_thread.run_sync(self.service.publish, team, id, limiter=self._publishing)

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
                    announced_kind(request)
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
                    if digest := fields.get("digest", "").lower():
                        check_digest(digest)
                        known = await run_in_threadpool(self.service.announced, team, asked, digest)
                        if known is not None:
                            return known, False
                    announced_kind(request)
                    with self._counting(team):
                        async with place.receiving():
                            await receive_file(request, body, settings)

                def take_in() -> tuple[Submission, bool]:
                    with kept(file, folder) as upload:
                        return self.service.submit(team, form_of(fields), upload)

                return await run_in_threadpool(take_in)

    def _note(self, request: Request, refusal: Refusal) -> None:
        """Log a refusal. Where that fails, as on a full disk, the client gets the refusal all the same."""
        team = getattr(request.state, "team", "")
        what = f"{request.method} {request.url.path}"
        try:
            self.service.refused(team or address_of(request), what, refusal, not team)
        except Exception as error:
            self.service.log.error("a refusal was not logged: %s: %s", printable(what), in_one_line(error))

    def route(self, path: str, show: Show, **handlers: Handler) -> Route:
        """Make the route of a path from the handler of each HTTP method; `show` shows refusals. Not a route for each
        method: where none fits, the answer would name those of the first alone as allowed."""

        async def handle(request: Request) -> Response:
            return await handlers["GET" if request.method == "HEAD" else request.method](request)

        return Route(path, self.answered(handle, show), methods=list(handlers))

    def answered(self, handler: Handler, show: Show) -> Handler:
        """Wrap a handler so that refusals are logged and shown, and internal errors are logged but not revealed."""

        async def respond(request: Request) -> Response:
            try:
                return await handler(request)
            except Refusal as refusal:
                if refusal.kind != "absent" or request.method != "GET":
                    await run_in_threadpool(self._note, request, refusal)
                response = await show(request, refusal)
                if refusal.retry_s:
                    response.headers["Retry-After"] = str(refusal.retry_s)
                response.headers["Connection"] = "close"  # do not wait for the rest of the body
                return response

        async def answer(request: Request) -> Response:
            try:
                response = await respond(request)
            except asyncio.CancelledError:
                raise
            except ClientDisconnect:  # the client is gone; not a server failure
                response = Response(status_code=400)
            except Exception as error:
                self.service.log.exception("%s %s", request.method, request.url.path)
                refusal = FULL if is_disk_full(error) else FAILED
                response = PlainTextResponse(refusal.reason, refusal.status)
                if refusal is FULL:  # not logged as a refusal: the database is full, too, and may not give the page
                    with suppress(Exception):
                        response = await show(request, refusal)
                response.headers["Connection"] = "close"
            for key, value in HEADERS.items():
                response.headers.setdefault(key, value)
            return response

        return answer


def check_digest(text: str) -> None:
    """Raises Refusal for what is no SHA-256."""
    if not SHA256.fullmatch(text):
        raise Refusal("request", f"digest: expected the SHA-256 of the body (64 hex digits), got {text!r:.80}")


def form_of(fields: dict[str, str]) -> Form:
    """Form made of the fields of a request; absent fields are empty."""
    return Form(**{key: fields.get(key, "") for key in ("method", "split", "track", "url", "summary")})


def address_of(request: Request) -> str:
    """Address of the client, as far as the server in front passes it on; "unknown" without one."""
    return request.client.host if request.client else "unknown"
