"""Pages that the site takes unchanged from the repository: READMEs of its folders, data card, changelog.

They have the same paths in the site as in the repository, so that links between them work in both. The contents of
`docs/` are at the root of the site.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Callable, Iterator
from pathlib import Path
from urllib.parse import urlsplit

ROOT = Path(__file__).parents[2]
SINGLE = ("CHANGELOG.md", "CONTRIBUTING.md", "datasets/DATA_CARD.md")
ROOMS = ("oysterbench", "datasets", "baselines", "leaderboard", "containers", "notebooks")
FILES = (".toml", ".jpg", ".png", ".cff", ".yaml", ".conf", ".ipynb", "Caddyfile", "Containerfile", "LICENSE")
"""Endings of files that links may lead to besides pages, and that are copied into the site. A link to anything else is
replaced by the path."""

_LINK_OR_CODE = re.compile(
    r"^```.*?^```|(?P<picture>!?)\[(?P<text>(?:[^\[\]]|\[[^\]]*\])*)\]\((?P<target>[^()\s]+)\)|`[^`\n]*`", re.M | re.S
)


def repository_pages() -> dict[str, Path]:
    """Place in the site -> file, for the pages that are taken unchanged."""
    found = {name: ROOT / name for name in SINGLE}
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("README.md")):
            found[path.relative_to(ROOT).as_posix()] = path
    return found


def site_links(markdown: str, place: str, add_file: Callable[[str], None]) -> str:
    """Convert the links of a page from those of the repository to those of the site.

    place: of the page in the site. add_file: called with the path in the repository of each file that the site needs.
    """
    pages = repository_pages()
    source = place if place in pages else f"docs/{place}"

    def turned(match: re.Match[str]) -> str:
        if match["target"] is None:  # code
            return match.group()
        picture, text, parts = match["picture"], match["text"], urlsplit(match["target"])
        if parts.scheme or parts.netloc or not parts.path:
            return match.group()
        path = posixpath.normpath(posixpath.join(posixpath.dirname(source), parts.path))
        inside = _place_of(path, pages)
        if inside is None and not (ROOT / path).exists():
            return match.group()  # to a generated page, or dead: the link check will tell
        if inside is None:
            return f"{text} (`{path}`)" if text.strip("`") != path else f"`{path}`"
        if inside.endswith(FILES):
            add_file(path)
        anchor = f"#{parts.fragment}" if parts.fragment else ""
        return f"{picture}[{text}]({posixpath.relpath(inside, posixpath.dirname(place) or '.')}{anchor})"

    return _LINK_OR_CODE.sub(turned, markdown)


def _place_of(path: str, pages: dict[str, Path]) -> str | None:
    """Place in the site of a file of the repository; None if the site does not have it."""
    if path == "README.md":
        return "index.md"
    if path.startswith("docs/"):
        return path.removeprefix("docs/")
    if path in pages:
        return path
    if f"{path}/README.md" in pages:
        return f"{path}/README.md"
    return path if path.endswith(FILES) and (ROOT / path).is_file() else None


def linked_files(pages: dict[str, str]) -> Iterator[str]:
    """Paths in the repository of the files that pages (place -> Markdown) link to."""
    found: dict[str, None] = {}
    for place, text in pages.items():
        site_links(text, place, lambda path: found.setdefault(path))
    yield from found
