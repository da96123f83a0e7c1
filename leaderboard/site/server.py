"""Pages over HTTP: cached by address and index revision, compressed, with entity tags. Of an internal error, clients
learn only that it occurred."""

from __future__ import annotations

import asyncio
import logging
import re
import time
from collections.abc import Callable, Hashable, Sequence
from typing import Any, TypeVar
from weakref import WeakValueDictionary

import anyio
import anyio.to_thread
from starlette.applications import Starlette
from starlette.convertors import StringConvertor, register_url_convertor
from starlette.exceptions import HTTPException
from starlette.middleware import Middleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, RedirectResponse, Response
from starlette.routing import BaseRoute
from starlette.routing import Route as HttpRoute
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from oysterbench.core.errors import OysterbenchError
from oysterbench.hub.addresses import network
from oysterbench.hub.canonical import canonical
from oysterbench.hub.serve import HeaderLimit
from oysterbench.version import VERSION
from oysterbench_leaderboard.site import render
from oysterbench_leaderboard.site.cache import Kept, PageCache
from oysterbench_leaderboard.site.openapi import describe
from oysterbench_leaderboard.site.page import PageError
from oysterbench_leaderboard.site.representations import represent
from oysterbench_leaderboard.site.routes import PATTERNS, ROUTES, Route
from oysterbench_leaderboard.site.site import Site

LOG = logging.getLogger("uvicorn.error")

Made = TypeVar("Made")

FRESH_S = 1.0
"""Time for which the revision of the index is not looked up again."""

MAKERS = 4
"""Number of pages and files made at once, each for another client; others wait instead of competing for the
processor."""

MOST_SETTLED = 1000
"""Number of queries of which it is remembered what they come to."""

SECURITY = {
    b"content-security-policy": (
        b"default-src 'none'; style-src 'self'; script-src 'self'; img-src 'self' data:; connect-src 'self'; "
        b"form-action 'self'; base-uri 'none'; frame-ancestors 'none'"
    ),
    b"x-content-type-options": b"nosniff",
    b"referrer-policy": b"same-origin",
    b"cross-origin-opener-policy": b"same-origin",
    b"permissions-policy": b"camera=(), geolocation=(), microphone=()",
}
"""Headers of every response, unless it sets them itself."""

CHANGING, FOREVER = "no-cache", "public, max-age=31536000, immutable"
HTML, JSON = "text/html; charset=utf-8", "application/json"


for _name, _pattern_of in PATTERNS.items():
    register_url_convertor(f"board_{_name}", type("Part", (StringConvertor,), {"regex": _pattern_of})())


class Pages:
    """Pages of a site, made on first request."""

    def __init__(self, site: Site, root: str = "", fresh_s: float = FRESH_S, most_bytes: int | None = None) -> None:
        self.site = site
        self.links = render.server_links(root)
        self.cache = PageCache(*([] if most_bytes is None else [most_bytes]))
        self.fresh_s = fresh_s
        self._revision, self._asked = "", -float("inf")
        self._asking: asyncio.Task[str] | None = None
        self._making: dict[Hashable, asyncio.Task[Kept]] = {}
        self._settled: dict[Hashable, Hashable] = {}
        self._makers: anyio.CapacityLimiter | None = None
        self._turns: WeakValueDictionary[str, asyncio.Lock] = WeakValueDictionary()

    async def revision(self) -> str:
        """Return the revision of the index, at most `fresh_s` old; concurrent callers share one lookup."""
        if time.monotonic() - self._asked < self.fresh_s:
            return self._revision
        if self._asking is None or self._asking.done():
            self._asking = asyncio.create_task(self._look())
        return await asyncio.shield(self._asking)

    async def _look(self) -> str:
        self._revision = await anyio.to_thread.run_sync(lambda: self.site.index.revision)
        self._asked = time.monotonic()
        return self._revision

    async def get(self, client: str, route: Route, given: dict[str, str], query: Any, suffix: str) -> Kept:
        """Return a page, or its representation."""
        asked = query if route.settle is None else await self._settle(client, route.path, route.settle, query)
        key = (route.path, tuple(sorted(given.items())), asked, suffix)
        return await self.made(client, key, lambda: self.make(route, given, asked, suffix))

    async def _settle(self, client: str, path: str, settle: Callable[[Site, Any], Hashable], query: Any) -> Hashable:
        """Return what a query comes to: remembered, as a page that is kept must not wait for one in the making."""
        spelled = (await self.revision(), path, query)
        if spelled not in self._settled:
            async with self._turn(client):
                found = await self._in_thread(lambda: settle(self.site, query))
            if len(self._settled) >= MOST_SETTLED:
                self._settled.clear()
            self._settled[spelled] = found
            return found
        return self._settled[spelled]

    async def made(self, client: str, key: Hashable, make: Callable[[], Kept]) -> Kept:
        """Return what `make` returns, called in a thread unless it is kept. Concurrent requests wait for one call, and
        those of one client for each other: however many it sends, the next page is made for another client."""
        if (kept := self.cache.get(await self.revision(), key)) is not None:
            return kept
        async with self._turn(client):
            revision = await self.revision()
            if (kept := self.cache.get(revision, key)) is not None:
                return kept
            making = self._making.get((revision, key))
            if making is None:
                making = self._making[revision, key] = asyncio.create_task(self._in_thread(make))
                making.add_done_callback(lambda _: self._making.pop((revision, key), None))
            kept = await asyncio.shield(making)
            self.cache.put(revision, key, kept)
            return kept

    def _turn(self, client: str) -> asyncio.Lock:
        """Lock that requests of a client hold while a page is made for them; it exists as long as one of them does."""
        return self._turns.setdefault(client, asyncio.Lock())

    async def _in_thread(self, make: Callable[[], Made]) -> Made:
        self._makers = self._makers or anyio.CapacityLimiter(MAKERS)
        return await anyio.to_thread.run_sync(make, limiter=self._makers)

    def make(self, route: Route, given: dict[str, str], asked: Any, suffix: str) -> Kept:
        """Make a page, or its representation, as bytes."""
        page = route.make(self.site, given, asked)
        if suffix:
            return Kept.of(represent(page, suffix), render.REPRESENTATIONS[suffix][1])
        return Kept.of(render.page_html(page, self.links).encode(), HTML)

    def error(self, request: Request, status: int, message: str, hints: dict[str, str]) -> Response:
        """Error response in place of a page, in the representation that was requested."""
        headers = {"Cache-Control": "no-store"}
        if request.url.path.endswith(".json") or request.url.path.startswith("/api/"):
            return JSONResponse({"error": message, "see": hints}, status, headers)
        if request.url.path.endswith((".csv", ".tex")):
            return PlainTextResponse(f"{message}\n", status, headers)
        context = {"title": TITLES.get(status, "Not as expected"), "message": message, "hints": hints, "status": status}
        return Response(render.html("error.html", self.links, context), status, headers, HTML)


TITLES = {400: "Invalid request", 404: "Not here", 405: "Not so", 409: "Not comparable", 500: "Our mistake"}


def application(
    site: Site,
    more: Sequence[BaseRoute] = (),
    root: str = "",
    fresh_s: float = FRESH_S,
    most_bytes: int | None = None,
) -> Starlette:
    """Make the web application. more: further routes, such as those of submissions; root: prefix that a proxy adds."""
    pages = Pages(site, root, fresh_s, most_bytes)
    description = Kept.of(canonical(describe(root)), JSON)

    def page_route(route: Route, suffix: str) -> HttpRoute:
        async def get(request: Request) -> Response:
            given = dict(request.path_params)
            if "digest" in given and len(given["digest"]) < 64:
                return await _to_full(request, route, given["digest"], suffix)
            asked = {key: request.query_params.getlist(key) for key in request.query_params}
            kept = await pages.get(_client(request), route, given, route.ask(asked), suffix)
            return send(request, kept, {"Access-Control-Allow-Origin": "*"} if suffix else {})

        return HttpRoute(_pattern(route.path, suffix), get, methods=["GET"])

    async def _to_full(request: Request, route: Route, digest: str, suffix: str) -> Response:
        row = await anyio.to_thread.run_sync(site.row, digest)
        return RedirectResponse(pages.links.page(route.path.format(digest=row.digest), None, suffix), 302)

    async def record(request: Request) -> Response:
        row = await anyio.to_thread.run_sync(site.row, request.path_params["digest"])
        key = "record", row.digest
        return send(
            request, await pages.made(_client(request), key, lambda: Kept.of(site.store.data(row.digest), JSON))
        )

    async def curves(request: Request) -> Response:
        row = await anyio.to_thread.run_sync(site.row, request.path_params["digest"])

        def make() -> Kept:
            if not (found := site.record(row.digest).curves):
                raise PageError("this record came without paths: its split is hidden, or none were kept")
            return Kept.of(site.store.data(found, "curves"), JSON)

        return send(request, await pages.made(_client(request), ("curves", row.digest), make))

    async def asset(request: Request) -> Response:
        name = request.path_params["name"]
        if name not in render.ASSETS:
            raise PageError(f"no file {name!r:.60}")
        key = "asset", name
        kept = await pages.made(_client(request), key, lambda: Kept.of(render.asset(name), render.ASSETS[name]))
        # Under the name of another version, which a page of another server may ask for, this file must not be kept.
        current = request.query_params.get("v") == render.assets_version()
        return send(request, kept, {"Cache-Control": FOREVER if current else CHANGING})

    async def openapi(request: Request) -> Response:
        return send(request, description, {"Access-Control-Allow-Origin": "*"})

    async def health(request: Request) -> Response:
        body = {"status": "ok", "revision": await pages.revision(), "oysterbench": VERSION}
        return JSONResponse(body, 200, {"Cache-Control": "no-store"})

    async def robots(request: Request) -> Response:
        return PlainTextResponse("User-agent: *\nDisallow: /compare\nDisallow: /*?\n")

    async def answer_error(request: Request, error: Exception) -> Response:
        """Answer an exception: what was expected and what there is, or only that an internal error was logged."""
        if isinstance(error, PageError):
            return pages.error(request, error.status, str(error), error.hints)
        if isinstance(error, HTTPException) and error.status_code < 500:
            message = "there is nothing at this address" if error.status_code == 404 else error.detail
            response = pages.error(request, error.status_code, message, {"/": "all boards", "/data": "data sets"})
            response.headers.update(error.headers or {})
            return response
        if isinstance(error, OysterbenchError):  # its message may name private files
            LOG.error("%s: %s", request.url.path, error)
        response = pages.error(
            request, 500, "this page could not be generated; the error has been logged", {"/": "all boards"}
        )
        for name, value in SECURITY.items():  # responses to failures bypass `Secured`
            response.headers[name.decode()] = value.decode()
        return response

    return Starlette(
        routes=[
            *more,
            *(page_route(route, suffix) for route in ROUTES for suffix in ("", *render.REPRESENTATIONS)),
            HttpRoute(_pattern("/records/{digest}/record", ".json"), record),
            HttpRoute(_pattern("/records/{digest}/curves", ".json"), curves),
            HttpRoute("/openapi.json", openapi),
            HttpRoute("/static/{name}", asset),
            HttpRoute("/health", health),
            HttpRoute("/robots.txt", robots),
        ],
        middleware=[Middleware(HeaderLimit), Middleware(Secured)],
        exception_handlers=dict.fromkeys((PageError, OysterbenchError, HTTPException, Exception), answer_error),
    )


def _client(request: Request) -> str:
    """Network that a request comes from."""
    return network(request.client.host if request.client else "")


def _pattern(path: str, suffix: str) -> str:
    """Path of a route in Starlette's syntax."""
    bare = "/index" if path == "/" and suffix else path
    return re.sub(r"\{(\w+)\}", r"{\1:board_\1}", bare) + suffix


def send(request: Request, kept: Kept, headers: dict[str, str] | None = None) -> Response:
    """Response with a page, compressed where the client accepts that; 304 where the client has it already."""
    small = bool(kept.small) and _takes_gzip(request.headers.get("accept-encoding", ""))
    tag = f'"{kept.tag}-gz"' if small else f'"{kept.tag}"'
    given = {"ETag": tag, "Cache-Control": CHANGING, "Vary": "Accept-Encoding", **(headers or {})}
    known = [entry.strip().removeprefix("W/") for entry in request.headers.get("if-none-match", "").split(",")]
    if tag in known or "*" in known:
        return Response(status_code=304, headers=given)
    if small:
        given["Content-Encoding"] = "gzip"
    return Response(kept.small if small else kept.body, 200, given, kept.media)


def _takes_gzip(header: str) -> bool:
    for entry in header.split(","):
        name, _, weight = entry.partition(";")
        if name.strip().lower() in ("gzip", "*"):
            return re.fullmatch(r"\s*q\s*=\s*0(\.0*)?\s*", weight) is None
    return False


class Secured:
    """Middleware that adds the headers of `SECURITY` to every response."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        async def with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                there = {name.lower() for name, _ in message["headers"]}
                lacking = [(name, value) for name, value in SECURITY.items() if name not in there]
                message = {**message, "headers": [*message["headers"], *lacking]}
            await send(message)

        await self.app(scope, receive, with_headers if scope["type"] == "http" else send)
