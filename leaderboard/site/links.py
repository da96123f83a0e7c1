"""How a page of the site is linked to: from a server by its address, from exported files by their way to each other."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from posixpath import relpath
from typing import Protocol
from urllib.parse import quote, urlencode

Query = Mapping[str, str | int | Iterable[str]]


class Links(Protocol):
    """static: whether pages are files, with no server that could answer a form."""

    @property
    def static(self) -> bool:
        """Whether pages are files."""

    def page(self, path: str, query: Query | None = None, suffix: str = "") -> str:
        """A link to a page, or to its representation with that suffix (".json"); empty where it cannot be had."""

    def asset(self, name: str) -> str:
        """A link to a file of style or script."""


@dataclass(frozen=True)
class ServerLinks:
    """Addresses below `root`, which is empty or what a proxy puts before ours. version: of the assets, so that they may
    be cached for long."""

    root: str = ""
    version: str = ""
    static: bool = False

    def page(self, path: str, query: Query | None = None, suffix: str = "") -> str:
        bare = "/index" if path == "/" and suffix else path
        asked = urlencode({k: v if isinstance(v, str | int) else list(v) for k, v in (query or {}).items()}, doseq=True)
        return f"{self.root}{quote(bare, safe='/~+')}{suffix}" + (f"?{asked}" if asked else "")

    def asset(self, name: str) -> str:
        return f"{self.root}/static/{quote(name)}" + (f"?v={self.version}" if self.version else "")


@dataclass(frozen=True)
class FileLinks:
    """Ways from the file of the page at `here` to others, of which `there` are all paths that are written.

    Of a query only the number of the page is known, and which two are compared: its other keys need a server.
    """

    here: str
    there: Collection[str]
    static: bool = True

    def page(self, path: str, query: Query | None = None, suffix: str = "") -> str:
        known = {key: str(value) for key, value in (query or {}).items() if str(value)}
        known.pop("size", None)  # pages are written in one size
        target = numbered(path, int(known.pop("page", "1")))
        if path == "/compare":
            target = pair_path(known.pop("a", ""), known.pop("b", ""))
        if known or target not in self.there:
            return ""
        return self._to(file_of(target, suffix))

    def asset(self, name: str) -> str:
        return self._to(f"static/{name}")

    def _to(self, file: str) -> str:
        return quote(relpath(file, file_of(self.here).rpartition("/")[0] or "."), safe="/~+")


def numbered(path: str, page: int) -> str:
    """The path of a further page of a list."""
    return path if page == 1 else f"{path}/page-{page}"


def pair_path(a: str, b: str) -> str:
    """The path of two records head to head, by their digests, where no server could read them from a query."""
    return f"/compare/{a[:16]}-{b[:16]}"


def file_of(path: str, suffix: str = "") -> str:
    """The file of a page, or of its representation, in an exported folder."""
    name = path.strip("/")
    if suffix:
        return f"{name or 'index'}{suffix}"
    return f"{name}/index.html" if name else "index.html"
