"""Who is asking, and how refusals are answered: what the interface for programs and the web form share."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager

from starlette.concurrency import run_in_threadpool
from starlette.requests import ClientDisconnect, Request
from starlette.responses import PlainTextResponse, Response

from oysterbench_leaderboard.submissions.intake import (
    Received,
    check_length,
    cleared,
    one_upload,
    receive_file,
    receive_form,
)
from oysterbench_leaderboard.submissions.refusals import Refusal
from oysterbench_leaderboard.submissions.service import Form, Service
from oysterbench_leaderboard.submissions.state import Submission
from oysterbench_leaderboard.submissions.tokens import Guesses, Holder, recognise

HEADERS = {
    "Cache-Control": "no-store",
    "X-Content-Type-Options": "nosniff",
    # Without a referrer at all, browsers send no origin with forms.
    "Referrer-Policy": "same-origin",
    "Content-Security-Policy": "default-src 'none'; style-src 'self'; img-src 'self' data:; script-src 'self'; "
    "form-action 'self'; base-uri 'none'; frame-ancestors 'none'",
}

FAILED = Refusal("failed", "something went wrong on the server, and nothing was changed; its operators can see what")

Handler = Callable[[Request], Awaitable[Response]]
Show = Callable[[Request, Refusal], Awaitable[Response]]


class Gate:
    """Of a service."""

    def __init__(self, service: Service) -> None:
        self.service = service
        self.guesses = Guesses(service.settings)
        self._receiving = 0

    async def holder(self, request: Request, token: str) -> Holder:
        """Who holds a token. Raises Refusal for a wrong one, and where too many wrong ones came."""
        address = address_of(request)
        self.guesses.check(address)

        def look() -> Holder | None:
            with self.service.state.reading() as connection:
                return recognise(connection, token)

        found = await run_in_threadpool(look)
        if found is None:
            self.guesses.failed(address)
            raise Refusal("token", "the token is not known, or was revoked; ask the operators of this board for one")
        return found

    @asynccontextmanager
    async def _slot(self) -> AsyncIterator[None]:
        if self._receiving >= self.service.settings.uploads_at_once:
            raise Refusal("busy", "too many uploads at once; try again in a minute", 60)
        self._receiving += 1
        try:
            yield
        finally:
            self._receiving -= 1

    async def submit(
        self, request: Request, team: str, before_files: Callable[[dict[str, str]], None] = lambda fields: None
    ) -> tuple[Submission, bool]:
        """Receive a body, one file or a form, and take it in. Raises Refusal."""
        settings, folder = self.service.settings, self.service.incoming
        check_length(request.headers.get("content-length"), settings)
        if request.headers.get("content-encoding", "identity") != "identity":
            raise Refusal("type", "expected the bytes as they are, got a content encoding")
        content_type = request.headers.get("content-type", "")
        asked = {key: request.query_params.get(key, "") for key in ("method", "split", "track", "url", "summary")}
        received = Received()
        async with self._slot():
            with cleared(received):
                if content_type.lower().startswith("multipart/"):

                    def check(fields: dict[str, str]) -> None:
                        before_files(fields)
                        self.service.check_form(form_of({**asked, **fields}))

                    await receive_form(request.stream(), content_type, received, folder, settings, check)
                    before_files(received.fields)
                else:
                    before_files({})
                    # What is wrong with the question is said before the answer is sent.
                    await run_in_threadpool(self.service.check_form, form_of(asked))
                    await receive_file(request.stream(), content_type, received, folder, settings)
                form = form_of({**asked, **received.fields})
                upload = await run_in_threadpool(one_upload, received, folder)
                return await run_in_threadpool(self.service.submit, team, form, upload)

    def answered(self, handler: Handler, show: Show) -> Handler:
        """The handler, with refusals logged and shown, and nothing told of what went wrong inside."""

        async def answer(request: Request) -> Response:
            try:
                response = await handler(request)
            except Refusal as refusal:
                who = getattr(request.state, "team", "") or address_of(request)
                if refusal.kind != "absent" or request.method != "GET":
                    await run_in_threadpool(self.service.refused, who, f"{request.method} {request.url.path}", refusal)
                response = await show(request, refusal)
                if refusal.retry_s:
                    response.headers["Retry-After"] = str(refusal.retry_s)
                response.headers["Connection"] = "close"  # what is still being sent is not waited for
            except (ClientDisconnect, asyncio.CancelledError):
                raise
            except Exception:
                self.service.log.exception("%s %s", request.method, request.url.path)
                response = PlainTextResponse(FAILED.reason, FAILED.status, {"Connection": "close"})
            for key, value in HEADERS.items():
                response.headers.setdefault(key, value)
            return response

        return answer


def form_of(fields: dict[str, str]) -> Form:
    """What a sender says of a submission."""
    return Form(**{key: fields.get(key, "") for key in ("method", "split", "track", "url", "summary")})


def address_of(request: Request) -> str:
    """Of the client, as far as the server in front tells it."""
    return request.client.host if request.client else "unknown"
