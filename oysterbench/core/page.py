"""The frame of a self-contained HTML page: style for light and dark, wide and narrow screens; no script, no links."""

from __future__ import annotations

from importlib import resources

STYLES = 8
"""Number of methods that can be told apart: each has its own colour (after Okabe & Ito 2008) and dash pattern."""

STYLE = (resources.files("oysterbench.core") / "templates" / "style.css").read_text(encoding="utf-8")
