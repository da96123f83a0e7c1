"""Equations as MathML, which browsers draw themselves: no script, no fonts, no network."""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

_ARITHMATEX = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)


def with_mathml(page: str) -> str:
    """Convert the TeX in the HTML of a page, as marked by pymdownx.arithmatex, to MathML."""

    def turned(match: re.Match[str]) -> str:
        _, opening, tex = match.groups()
        display = "block" if opening == "[" else "inline"
        return str(convert(html.unescape(tex).strip(), display=display))

    return _ARITHMATEX.sub(turned, page)
