"""Links between pages of the site: by address on a server, by relative path between exported files."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import dataclass
from posixpath import relpath
from typing import Protocol
from urllib.parse import quote, urlencode

Query = Mapping[str, str | int | Iterable[str]]


class Links(Protocol):
    """How pages link to each other. static: whether pages are files, with no server that could answer a form."""

    @property
    def static(self) -> bool:
        """Whether pages are files."""

    def page(self, path: str, query: Query | None = None, suffix: str = "") -> str:
        """Link to a page, or to its representation with that suffix (".json"); empty where it does not exist."""

    def asset(self, name: str) -> str:
        """Link to a style sheet, script or image."""


@dataclass(frozen=True)
class ServerLinks:
    """Addresses below `root`, which is empty or the prefix that a proxy adds. version: of the assets, so that they can
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
    """Relative paths from the file of the page at `here` to others; `there` holds the paths of all exported pages.

    Of a query only the page number, and the two records to compare, are supported: other keys need a server.
    """

    here: str
    there: Collection[str]
    static: bool = True

    def page(self, path: str, query: Query | None = None, suffix: str = "") -> str:
        known = {key: str(value) for key, value in (query or {}).items() if str(value)}
        known.pop("size", None)  # exported pages have one size
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
    """Path of a page of a list by its number, from 1."""
    return path if page == 1 else f"{path}/page-{page}"


def pair_path(a: str, b: str) -> str:
    """Path of the comparison of two records by their digests, for files, where no server reads a query."""
    return f"/compare/{a[:16]}-{b[:16]}"


def file_of(path: str, suffix: str = "") -> str:
    """The file of a page, or of its representation, in an exported folder."""
    name = path.strip("/")
    if suffix:
        return f"{name or 'index'}{suffix}"
    return f"{name}/index.html" if name else "index.html"
