"""The frame of a self-contained HTML page: style for light and dark, wide and narrow screens; no script, no links."""

from __future__ import annotations

from importlib import resources

STYLES = 8
"""Methods that can be distinguished: each has a colour (after Okabe & Ito 2008) and a pattern of dashes of its own."""

STYLE = (resources.files("oysterbench.core") / "templates" / "style.css").read_text(encoding="utf-8")
