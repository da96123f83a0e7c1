"""Check of a built site, offline: every link and anchor leads somewhere, and no page loads anything from outside.

python -m docs.check build/docs
"""

from __future__ import annotations

import re
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from html.parser import HTMLParser
from pathlib import Path
from urllib.parse import unquote, urlsplit

LOADS = {"script": "src", "img": "src", "iframe": "src", "source": "src", "video": "src", "link": "href"}
"""Elements that load something, and the attribute that names it."""

LINK_RELATIONS_THAT_LOAD = {"stylesheet", "icon", "preload", "manifest", "modulepreload"}
HOST = re.compile(r"([\w-]+\.)+[a-z]{2,}|localhost(:\d+)?|[\d.]+(:\d+)?", re.I)


@dataclass
class Page(HTMLParser):
    """Parser of a page: collects its links, what it loads, and its anchors."""

    links: list[str] = field(default_factory=list)
    loads: list[str] = field(default_factory=list)
    anchors: set[str] = field(default_factory=set)

    def __post_init__(self) -> None:
        super().__init__()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        values = dict(attrs)
        self.anchors.update(value for key in ("id", "name") if (value := values.get(key)))
        target = values.get(LOADS.get(tag, ""))
        relations = set((values.get("rel") or "").split())
        if target and (tag != "link" or relations & LINK_RELATIONS_THAT_LOAD):
            self.loads.append(target)
        elif tag == "a" and values.get("href"):
            self.links.append(values["href"] or "")


def problems(site: Path) -> Iterator[str]:
    """Iterate over problems, one line for each dead link and each external resource that is loaded."""
    pages = {path.resolve(): _read(path) for path in sorted(site.rglob("*.html"))}
    for path, page in pages.items():
        place = path.relative_to(site.resolve())
        for target in (*page.links, *page.loads):
            if why := _problem(target, path, pages, site.resolve(), loads=target in page.loads):
                yield f"{place}: {target}: {why}"


def _read(path: Path) -> Page:
    page = Page()
    page.feed(path.read_text(encoding="utf-8"))
    return page


def _problem(target: str, path: Path, pages: dict[Path, Page], site: Path, loads: bool) -> str:
    """What is wrong with a link; empty if nothing is."""
    parts = urlsplit(target)
    if parts.scheme in ("data", "mailto", "javascript"):
        return ""
    if parts.scheme or parts.netloc:
        if loads:
            return "loaded from outside"
        good = parts.scheme in ("http", "https") and HOST.fullmatch(parts.netloc)
        return "" if good else "no address of http or https"
    if target.startswith("/"):
        file = site / unquote(parts.path).lstrip("/")
    else:
        file = (path.parent / unquote(parts.path)).resolve() if parts.path else path
    if file.is_dir():
        file /= "index.html"
    if not file.is_file():
        return "no such file"
    anchor = unquote(parts.fragment)
    if anchor and not anchor.startswith(":~:") and file in pages and anchor not in pages[file].anchors:
        return "no such anchor"
    return ""


def main(site: Path) -> int:
    """Print all problems; return 1 if there are any, else 0."""
    found = list(problems(site))
    print("\n".join(found) or f"{site}: every link leads somewhere, and nothing is loaded from outside", flush=True)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1])))
