"""Pages that the site takes from the repository as they are: READMEs of its folders, data card, changelog.

The site has them at the paths that they have in the repository, so that links between them hold in both. What lies in
`docs/` is at the root of the site.
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
"""What a link may lead to besides pages, and is copied into the site. Links to anything else become its path."""

_LINK_OR_CODE = re.compile(
    r"^```.*?^```|(?P<picture>!?)\[(?P<text>(?:[^\[\]]|\[[^\]]*\])*)\]\((?P<target>[^()\s]+)\)|`[^`\n]*`", re.M | re.S
)


def repository_pages() -> dict[str, Path]:
    """Place in the site -> file, of the pages that are taken as they are."""
    found = {name: ROOT / name for name in SINGLE}
    for room in ROOMS:
        for path in sorted((ROOT / room).rglob("README.md")):
            found[path.relative_to(ROOT).as_posix()] = path
    return found


def site_links(markdown: str, place: str, add_file: Callable[[str], None]) -> str:
    """A page with the links that it has in the repository turned into those of the site.

    place: of the page in the site. add_file: is told the path in the repository of each file that the site needs.
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
            return match.group()  # of a page that is generated, or dead: the check of links tells
        if inside is None:
            return f"{text} (`{path}`)" if text.strip("`") != path else f"`{path}`"
        if inside.endswith(FILES):
            add_file(path)
        anchor = f"#{parts.fragment}" if parts.fragment else ""
        return f"{picture}[{text}]({posixpath.relpath(inside, posixpath.dirname(place) or '.')}{anchor})"

    return _LINK_OR_CODE.sub(turned, markdown)


def _place_of(path: str, pages: dict[str, Path]) -> str | None:
    """Where the site has a file of the repository, or None where it has not."""
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
