"""Rendering of pages as HTML: templates, in which every value is escaped, and the style sheet."""

from __future__ import annotations

import hashlib
import math
import os
from collections.abc import Mapping
from functools import lru_cache
from importlib import resources
from typing import Any

from jinja2 import ChoiceLoader, Environment, FileSystemLoader, PackageLoader, StrictUndefined

from oysterbench.core.html import capital
from oysterbench.core.page import STYLE
from oysterbench.version import VERSION
from oysterbench_leaderboard.site import frames, numbers
from oysterbench_leaderboard.site.links import Links, ServerLinks
from oysterbench_leaderboard.site.page import Page
from oysterbench_leaderboard.site.paths import slug

REPRESENTATIONS = {
    ".json": ("JSON", "application/json"),
    ".csv": ("CSV", "text/csv; charset=utf-8"),
    ".tex": ("LaTeX", "application/x-tex; charset=utf-8"),
}
"""Suffix of a representation of a page -> its name and media type."""

ASSETS = {
    "style.css": "text/css",
    "site.js": "text/javascript",
    "plots.js": "text/javascript",
    "icon.svg": "image/svg+xml",
    **{frames.file_name(split): "image/webp" for split in frames.pictures()},
}
"""Style sheets, scripts and images -> media type."""


@lru_cache(maxsize=8)
def environment(*folders: str | os.PathLike[str]) -> Environment:
    """Environment of the site's templates and those in further folders, which may extend `base.html`. Values are always
    escaped; an undefined name is an error."""
    loaders = [
        FileSystemLoader(folders),
        PackageLoader("oysterbench_leaderboard.site"),
        PackageLoader("oysterbench.report"),
    ]
    made = Environment(
        loader=ChoiceLoader(loaders if folders else loaders[1:]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        auto_reload=False,
    )
    made.globals |= {
        "VERSION": VERSION,
        "unit": numbers.unit,
        "ARROWS": numbers.ARROWS,
        "REPRESENTATIONS": REPRESENTATIONS,
    }
    made.filters |= {
        "px": px,
        "slug": slug,
        "capital": capital,
        "counted": numbers.count,
        "track_name": numbers.track_name,
    }
    return made


def px(value: float) -> str:
    """Format a coordinate of a drawing, px."""
    return f"{value:.1f}" if math.isfinite(value) else "0"


def html(template: str, links: Links, context: Mapping[str, Any], env: Environment | None = None) -> str:
    """Render a template that extends `base.html`.

    context: at least `title`; `path` of the page, for the navigation; `representations`, whether it has any.
    """
    given = {"path": "", "query": {}, "representations": False, **context}
    return (
        (env or environment())
        .get_template(template)
        .render(link=links.page, asset=links.asset, static=links.static, **given)
    )


def page_html(page: Page, links: Links) -> str:
    """Render a page as HTML."""
    context = {
        "title": page.title,
        "path": page.path,
        "query": page.query,
        "tables": page.tables,
        "representations": True,
    }
    return html(page.template, links, {**context, **page.context})


@lru_cache
def asset(name: str) -> bytes:
    """Bytes of a style sheet, script or image; the style sheet starts with the report's, so that colours and plots are
    the same."""
    if name.endswith(frames.SUFFIX):
        return frames.pictures()[frames.split_of(name)]
    if name == "plots.js":
        return (resources.files("oysterbench.report") / "templates" / "report.js").read_bytes()
    own = (resources.files("oysterbench_leaderboard.site") / "static" / name).read_text(encoding="utf-8")
    if name == "style.css":
        report = (resources.files("oysterbench.report") / "templates" / "report.css").read_text(encoding="utf-8")
        own = "\n".join((STYLE, report, own))
    return own.encode()


@lru_cache
def assets_version() -> str:
    """Version of the assets, which changes when any of them does."""
    return hashlib.sha256(b"\0".join(asset(name) for name in ASSETS)).hexdigest()[:12]


def server_links(root: str = "") -> Links:
    """Links of a server that is reached at `root`."""
    return ServerLinks(root, assets_version())
