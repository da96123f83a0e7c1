"""A server for a published tree. Of what a client sends, only 64 hex digits ever reach the file system."""

from __future__ import annotations

import hashlib
import os
import re
from collections.abc import AsyncIterator
from pathlib import Path
from typing import Any

import anyio.to_thread
from starlette.applications import Starlette
from starlette.convertors import Convertor, register_url_convertor
from starlette.middleware import Middleware
from starlette.middleware.cors import CORSMiddleware
from starlette.requests import Request
from starlette.responses import JSONResponse, PlainTextResponse, Response, StreamingResponse
from starlette.routing import Route
from starlette.types import ASGIApp, Receive, Scope, Send

from oysterbench.core.errors import HubError
from oysterbench.version import VERSION

CHUNK = 1 << 20
"""Bytes of a file in memory for each client."""

FOREVER = "public, max-age=31536000, immutable"
CHANGING = "no-cache"
"""What caches may do: what is named by its hash never changes; index and page are asked for anew each time."""

KINDS = {
    "blobs": ("", "application/octet-stream"),
    "manifests": (".json", "application/json"),
    "croissant": (".json", "application/ld+json"),
    "pictures": (".jpg", "image/jpeg"),
}
"""Folder -> suffix and media type."""

LARGEST_HEADERS = 16 << 10
MOST_HEADERS = 100
CLIENTS = 512
"""Bytes and number of a request's headers, and clients at once, beyond which a request is refused."""

HEADERS = {"X-Content-Type-Options": "nosniff", "Referrer-Policy": "no-referrer"}
PAGE_HEADERS = {"Content-Security-Policy": "default-src 'none'; img-src 'self'; style-src 'unsafe-inline'"}


class Sha256(Convertor[str]):
    """A path parameter that is a hash and nothing else."""

    regex = "[0-9a-f]{64}"

    def convert(self, value: str) -> str:
        return value

    def to_string(self, value: str) -> str:
        return value


register_url_convertor("sha256", Sha256())


def application(tree: Path) -> Starlette:
    """The web application of a tree."""

    def addressed(folder: str) -> Route:
        suffix, media = KINDS[folder]

        async def get(request: Request) -> Response:
            digest = request.path_params["digest"]
            return await answer(request, tree / folder / f"{digest}{suffix}", media, FOREVER, digest)

        return Route(f"/{folder}/{{digest:sha256}}{suffix}", get)

    def changing(path: str, name: str, media: str, headers: dict[str, str]) -> Route:
        async def get(request: Request) -> Response:
            response = await answer(request, tree / name, media, CHANGING)
            response.headers.update(headers)
            return response

        return Route(path, get)

    async def health(request: Request) -> Response:
        ready = (tree / "index.json").is_file()
        body = {"status": "ok" if ready else "no index", "oysterbench": VERSION}
        return JSONResponse(body, 200 if ready else 503, {"Cache-Control": "no-store"})

    async def robots(request: Request) -> Response:
        return PlainTextResponse("User-agent: *\nDisallow: /blobs/\n")

    page = {**PAGE_HEADERS}
    return Starlette(
        routes=[
            changing("/", "index.html", "text/html; charset=utf-8", page),
            changing("/index.html", "index.html", "text/html; charset=utf-8", page),
            changing("/index.json", "index.json", "application/json", {}),
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
    )


class HeaderLimit:
    """Refuses floods of headers that came in one go, which the HTTP parser lets through."""

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


async def answer(request: Request, path: Path, media: str, caching: str, digest: str = "") -> Response:
    """A file, or the part of it that a Range header names (RFC 9110, sections 13 and 14).

    The entity tag is the SHA-256 of the file, so that it is the same on every mirror and after every restart. A request
    for several ranges is answered with the whole, as the standard allows.
    """
    try:
        handle, size = await anyio.to_thread.run_sync(_open, path)
    except (FileNotFoundError, IsADirectoryError):
        return PlainTextResponse("not found\n", 404)
    streaming = False
    try:
        tag = digest or await anyio.to_thread.run_sync(_hash, handle)
        headers = {"ETag": f'"{tag}"', "Cache-Control": caching, "Accept-Ranges": "bytes", **HEADERS}
        if (wanted := request.headers.get("if-match")) is not None and not _names(wanted, tag, weak=False):
            return Response(status_code=412, headers=headers)
        if (known := request.headers.get("if-none-match")) is not None and _names(known, tag, weak=True):
            return Response(status_code=304, headers=headers)
        start, end, status = 0, size, 200
        if request.method == "GET" and (asked := request.headers.get("range")) is not None:
            condition = request.headers.get("if-range")
            if condition is None or condition.strip() == f'"{tag}"':
                found = parse_range(asked, size)
                if found == (size, size):
                    headers |= {"Content-Range": f"bytes */{size}"}
                    return PlainTextResponse("range not satisfiable\n", 416, headers)
                if found is not None:
                    (start, end), status = found, 206
                    headers["Content-Range"] = f"bytes {start}-{end - 1}/{size}"
        headers["Content-Length"] = str(end - start)
        if request.method == "HEAD":
            return Response(status_code=status, headers=headers, media_type=media)
        streaming = True
        return FileResponse(handle, start, end, status, headers, media)
    finally:
        if not streaming:
            os.close(handle)


class FileResponse(StreamingResponse):
    """Bytes [start, end) of an open file, a chunk at a time: what a slow client has not taken yet is not read."""

    def __init__(self, handle: int, start: int, end: int, status: int, headers: dict[str, str], media: str) -> None:
        self._handle = handle
        super().__init__(self._chunks(start, end), status, headers, media)

    async def _chunks(self, start: int, end: int) -> AsyncIterator[bytes]:
        while start < end:
            data = await anyio.to_thread.run_sync(os.pread, self._handle, min(CHUNK, end - start), start)
            if not data:  # the file was cut while it was read: break off, so that the client notices
                raise OSError("a file of the tree became shorter while it was served")
            start += len(data)
            yield data

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            os.close(self._handle)


def _open(path: Path) -> tuple[int, int]:
    """A file's descriptor and size; links are not followed."""
    handle = os.open(path, os.O_RDONLY | os.O_NOFOLLOW | os.O_CLOEXEC)
    return handle, os.fstat(handle).st_size


def _hash(handle: int) -> str:
    """SHA-256 of a small open file."""
    return hashlib.sha256(os.pread(handle, os.fstat(handle).st_size, 0)).hexdigest()


def _names(header: str, tag: str, weak: bool) -> bool:
    """Whether a list of entity tags names this one, or any with `*`."""
    tags = [entry.strip() for entry in header.split(",")]
    tags = [entry.removeprefix("W/") for entry in tags] if weak else tags
    return "*" in tags or f'"{tag}"' in tags


def parse_range(header: str, size: int) -> tuple[int, int] | None:
    """The first byte of a Range header's only range, and the byte behind its last; both `size` where the file has none
    of it. None where the header says nothing that has to be obeyed: several ranges, another unit, bad spelling."""
    match = re.fullmatch(r"bytes=[ \t]*(\d{0,19})-(\d{0,19})[ \t]*", header, re.ASCII | re.IGNORECASE)
    if match is None or not (match[1] or match[2]):
        return None
    if not match[1]:  # the last n bytes
        start, end = max(0, size - int(match[2])), size
    else:
        start = int(match[1])
        end = min(int(match[2]) + 1, size) if match[2] else size
        if match[2] and int(match[2]) < start:
            return None
    return (start, end) if start < end else (size, size)


def serve(tree: Path, host: str, port: int) -> None:
    """Serve until interrupted; every request is logged on stderr."""
    import uvicorn

    uvicorn.run(**settings(tree, host, port))


def settings(tree: Path, host: str, port: int) -> dict[str, Any]:
    """How uvicorn serves a tree. Raises HubError where there is none."""
    if not (tree / "index.json").is_file():
        raise HubError(f"{tree}: expected a published tree (index.json is absent); `oysterbench publish` makes one")
    return {
        "app": application(tree),
        "host": host,
        "port": port,
        "http": "h11",
        "ws": "none",
        "lifespan": "off",
        "server_header": False,
        "h11_max_incomplete_event_size": LARGEST_HEADERS,
        "limit_concurrency": CLIENTS,
        "timeout_keep_alive": 30,
        "log_config": LOGGING,
    }


LOGGING = {
    "version": 1,
    "disable_existing_loggers": False,
    "formatters": {"plain": {"format": "%(asctime)s %(levelname)s %(message)s"}},
    "handlers": {"stderr": {"class": "logging.StreamHandler", "formatter": "plain", "stream": "ext://sys.stderr"}},
    "loggers": {"uvicorn": {"handlers": ["stderr"], "level": "INFO", "propagate": False}},
}
