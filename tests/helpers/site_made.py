"""A site over the records of `records_made`, and a client that needs no socket."""

from __future__ import annotations

import asyncio
import gzip
import json
from collections import Counter
from dataclasses import dataclass
from html.parser import HTMLParser
from pathlib import Path
from typing import Any
from urllib.parse import unquote

from oysterbench_leaderboard.boards.board import Literature
from oysterbench_leaderboard.boards.index import open_index
from oysterbench_leaderboard.site.site import Site
from oysterbench_leaderboard.storage.store import RecordStore
from tests.helpers.records_made import fill

LITERATURE = (
    Literature(
        "slam", "ORB-SLAM <b>", "ATE, m", "0.13", "harbour <1>", "Somebody 2020", "https://example.org/a?b=1&c=2"
    ),
    Literature("slam", "scheme", "ATE, m", "9", "lake", "Nobody 2021", "javascript:alert(1)"),
)

PAIRS = 3
"""Of records, whose comparisons are followed."""


def make_site(folder: Path) -> tuple[Site, dict[str, str]]:
    """The site, and the digests of its records by their short names."""
    store = RecordStore(folder)
    digests = fill(store)
    return Site(open_index(store, str(folder / "index.sqlite")), LITERATURE), digests


@dataclass(frozen=True)
class Answer:
    """Of a request. headers: in lower case."""

    status: int
    headers: dict[str, str]
    body: bytes

    @property
    def text(self) -> str:
        data = gzip.decompress(self.body) if self.headers.get("content-encoding") == "gzip" else self.body
        return data.decode()

    def json(self) -> Any:
        return json.loads(self.text)


class Client:
    """Asks an ASGI application in this process."""

    def __init__(self, app: Any) -> None:
        self.app, self.loop = app, asyncio.new_event_loop()

    def close(self) -> None:
        self.loop.close()

    def get(self, address: str, method: str = "GET", **headers: str) -> Answer:
        return self.loop.run_until_complete(self.ask(address, method, **headers))

    async def ask(self, address: str, method: str = "GET", **headers: str) -> Answer:
        """headers: with _ for -."""
        path, _, query = address.partition("?")
        scope = {
            "type": "http",
            "asgi": {"version": "3.0"},
            "http_version": "1.1",
            "method": method,
            "scheme": "http",
            "path": unquote(path),
            "raw_path": path.encode(),
            "root_path": "",
            "query_string": query.encode(),
            "headers": [
                (b"host", b"test"),
                *((k.replace("_", "-").encode(), v.encode()) for k, v in headers.items()),
            ],
            "server": ("test", 80),
            "client": ("test", 1),
        }
        sent: list[Any] = []

        async def receive() -> dict[str, Any]:
            return {"type": "http.request", "body": b"", "more_body": False}

        async def send(message: Any) -> None:
            sent.append(message)

        try:
            await self.app(scope, receive, send)
        except Exception:  # Starlette raises what it has answered with 500, for the log
            if not sent or sent[0]["status"] != 500:
                raise
        body = b"".join(message.get("body", b"") for message in sent[1:])
        found = {name.decode().lower(): value.decode() for name, value in sent[0]["headers"]}
        return Answer(sent[0]["status"], found, body)


class Reading(HTMLParser):
    """What is in a page: elements with their attributes, links, and the text."""

    VOID = frozenset(["meta", "link", "input", "br", "img", "hr", "wbr"])

    def __init__(self, html: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.open: list[str] = []
        self.texts: list[str] = []
        self.wrong: list[str] = []
        self.feed(html)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag not in self.VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        if not self.open or self.open[-1] != tag:
            self.wrong.append(f"</{tag}> closes {self.open[-1:]}")
        else:
            self.open.pop()

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())

    def all(self, tag: str) -> list[dict[str, str | None]]:
        """Attributes of every element of that name."""
        return [attributes for name, attributes in self.elements if name == tag]

    def links(self) -> list[str]:
        """Where this page leads to, and what it loads."""
        pairs = (("a", "href"), ("link", "href"), ("script", "src"), ("img", "src"), ("form", "action"))
        return [str(one[key]) for tag, key in pairs for one in self.all(tag) if one.get(key) is not None]


def crawl(client: Client, alike: int) -> dict[str, Answer]:
    """What pages lead to from the first one, with its answer; of addresses that differ in a name or a digest alone, so
    many; and of pairs, which are too many, PAIRS."""
    todo, seen, of_kind = ["/"], dict[str, Answer](), Counter[tuple[str, ...]]()
    while todo:
        address = todo.pop(0)
        path, _, query = address.partition("?")
        parts = path.split("/")
        asked = sorted(part.partition("=")[0] for part in query.split("&"))
        kind = parts[1], str(len(parts)), Path(parts[-1]).suffix, *asked
        if address in seen or of_kind[kind] >= (min(alike, PAIRS) if path.startswith("/compare") else alike):
            continue
        of_kind[kind] += 1
        answer = seen[address] = client.get(address)
        if answer.headers.get("content-type", "").startswith("text/html"):
            links = [link.partition("#")[0] for link in Reading(answer.text).links()]
            todo += [link for link in links if link.startswith("/") and link != "/compare"]  # a form, sent empty
    return seen
