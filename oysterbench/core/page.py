"""The frame of a self-contained HTML page: style for light and dark, wide and narrow screens; no script, no links."""

from __future__ import annotations

from importlib import resources

from oysterbench.core.html import render

STYLES = 8
"""Methods that can be told apart: each has a colour (after Okabe & Ito 2008) and a pattern of dashes of its own."""

STYLE = (resources.files("oysterbench.core") / "templates" / "style.css").read_text(encoding="utf-8")


def page(title: str, body: str) -> str:
    """A whole HTML document; body: HTML."""
    from markupsafe import Markup

    return render("page.html", {"title": title, "body": Markup(body)})
