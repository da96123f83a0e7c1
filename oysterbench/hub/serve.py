"""A server for a published tree. Of what a client sends, only 64 hex digits ever reach the file system."""

from __future__ import annotations

import base64
import hashlib
import os
import re
import stat
from collections.abc import Callable, Sequence
from pathlib import Path

import anyio.to_thread
from starlette.applications import Starlette
from starlette.convertors import Convertor, register_url_convertor
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import FileResponse, JSONResponse, PlainTextResponse, Response
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from oysterbench.core.errors import HubError
from oysterbench.hub.canonical import sha256
from oysterbench.hub.connections import LARGEST_HEADERS, MOST_HEADERS, address, listen, run
from oysterbench.hub.pages import SCRIPT
from oysterbench.version import VERSION

FOREVER = "public, max-age=31536000, immutable"
CHANGING = "no-cache"
"""Cache-Control values: files named by their hash never change; index and page are revalidated each time."""

KINDS = {
    "blobs": ("", "application/octet-stream"),
    "manifests": (".json", "application/json"),
    "models": (".json", "application/json"),
    "cards": (".html", "text/html"),
    "croissant": (".json", "application/ld+json"),
    "pictures": (".jpg", "image/jpeg"),
}
"""Folder -> suffix and media type of its files."""

HEADERS = {"Accept-Ranges": "bytes", "X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
SCRIPT_HASH = base64.b64encode(hashlib.sha256(SCRIPT.encode()).digest()).decode()
PAGE_HEADERS = {
    "Content-Security-Policy": "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'; "
    f"script-src 'sha256-{SCRIPT_HASH}'"
}

ONE_RANGE = re.compile(rb"bytes=[ \t]*(?:(\d{1,19})-(\d{0,19})|-\d{1,19})[ \t]*", re.IGNORECASE)


class Sha256Convertor(Convertor[str]):
    """A path parameter that is a hash and nothing else."""

    regex = "[0-9a-f]{64}"

    def convert(self, value: str) -> str:
        return value

    def to_string(self, value: str) -> str:
        return value


register_url_convertor("sha256", Sha256Convertor())


def application(tree: Path) -> Starlette:
    """The web application of a tree."""

    def addressed(folder: str) -> Route:
        suffix, media = KINDS[folder]

        async def get(request: Request) -> Response:
            digest = request.path_params["digest"]
            path = tree / folder / f"{digest}{suffix}"
            headers = tagged(digest, FOREVER) | (PAGE_HEADERS if media == "text/html" else {})
            try:
                found = await anyio.to_thread.run_sync(os.lstat, path)
            except FileNotFoundError:
                return PlainTextResponse("not found\n", 404)
            if not stat.S_ISREG(found.st_mode):  # links are not followed
                return PlainTextResponse("not found\n", 404)
            return unneeded(request, digest, headers) or BlobResponse(path, 200, headers, media, stat_result=found)

        return Route(f"/{folder}/{{digest:sha256}}{suffix}", get)

    def changing(path: str, name: str, media: str, **further: str) -> Route:
        async def get(request: Request) -> Response:
            # Read all at once, as the file may be replaced while a slow client downloads.
            data = await anyio.to_thread.run_sync((tree / name).read_bytes)
            digest = sha256(data)
            headers = tagged(digest, CHANGING) | further
            return unneeded(request, digest, headers) or Response(data, 200, headers, media)

        return Route(path, get)

    async def health(request: Request) -> Response:
        ready = (tree / "index.json").is_file()
        body = {"status": "ok" if ready else "no index", "oysterbench": VERSION}
        return JSONResponse(body, 200 if ready else 503, {"Cache-Control": "no-store"})

    async def robots(request: Request) -> Response:
        return PlainTextResponse("User-agent: *\nDisallow: /blobs/\n")

    async def absent(request: Request, error: Exception) -> Response:
        return PlainTextResponse("not found\n", 404)

    return Starlette(
        routes=[
            changing("/", "index.html", "text/html", **PAGE_HEADERS),
            changing("/index.html", "index.html", "text/html", **PAGE_HEADERS),
            changing("/index.json", "index.json", "application/json"),
            *(addressed(folder) for folder in KINDS),
            Route("/health", health),
            Route("/robots.txt", robots),
        ],
        middleware=[
            Middleware(HeaderLimit),
            Middleware(
                CORSMiddleware,
                allow_origins=["*"],
                allow_methods=["GET", "HEAD"],
                allow_headers=["Range", "If-None-Match", "If-Match", "If-Range"],
                expose_headers=["Accept-Ranges", "Content-Length", "Content-Range", "ETag"],
                max_age=86400,
            ),
        ],
        exception_handlers={FileNotFoundError: absent},
    )


class HeaderLimit:
    """Middleware that refuses excessive headers received in one go, which the HTTP parser lets through."""

    def __init__(self, app: ASGIApp) -> None:
        self.app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        headers = scope.get("headers", [])
        size = sum(len(name) + len(value) for name, value in headers)
        if size > LARGEST_HEADERS or len(headers) > MOST_HEADERS:
            refusal = PlainTextResponse("too many headers\n", 431, {"Connection": "close"})
            await refusal(scope, receive, send)
            return
        await self.app(scope, receive, send)


def tagged(digest: str, caching: str) -> dict[str, str]:
    """Headers of a file. The entity tag is its SHA-256, the same on every mirror and after every restart."""
    return {"ETag": f'"{digest}"', "Cache-Control": caching, **HEADERS}


def unneeded(request: Request, digest: str, headers: dict[str, str]) -> Response | None:
    """Response where a condition on the entity tag means that no body is wanted (RFC 9110, section 13), or None."""
    wanted, known = request.headers.get("if-match"), request.headers.get("if-none-match")
    if wanted is not None and not _names(wanted, digest):
        return Response(status_code=412, headers=headers)
    if known is not None and _names(known.replace("W/", ""), digest):
        return Response(status_code=304, headers=headers)
    return None


def _names(header: str, digest: str) -> bool:
    """Whether a list of entity tags has this one, or `*` for any."""
    return bool({"*", f'"{digest}"'} & {entry.strip() for entry in header.split(",")})


class BlobResponse(FileResponse):
    """A file, or the range of it that a GET requests. Where the standard allows it, the response is the whole file: for
    several ranges, another unit, or bad syntax (RFC 9110, section 14.2)."""

    chunk_size = 1 << 20  # bytes in memory per client

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        found = ONE_RANGE.fullmatch(dict(scope["headers"]).get(b"range", b""))
        backwards = found is not None and found[2] and int(found[2]) < int(found[1])
        if scope["method"] != "GET" or found is None or backwards:
            scope = {**scope, "headers": [(name, value) for name, value in scope["headers"] if name != b"range"]}
        await super().__call__(scope, receive, send)


def serve(
    tree: Path, host: str, port: int, proxies: Sequence[str] = (), ready: Callable[[str], None] = lambda url: None
) -> None:
    """Serve a tree until interrupted; every request is logged on stderr. Raises HubError where there is no tree,
    or the address is taken.

    proxies: addresses trusted to state the client that they forward for; ready: called with the address of the page,
    once the server listens there
    """
    if not (tree / "index.json").is_file():
        raise HubError(f"{tree}: expected a published tree (index.json is absent); `oysterbench publish` makes one")
    listening = listen(host, port)
    ready(address(host, listening))
    run(application(tree), listening, proxies=proxies)
