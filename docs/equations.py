"""Equations as MathML, which browsers draw themselves: no script, no fonts, no network."""

from __future__ import annotations

import html
import re

from latex2mathml.converter import convert

_ARITHMATEX = re.compile(r'<(span|div) class="arithmatex">\\([(\[])(.*?)\\[)\]]</\1>', re.S)


def with_mathml(page: str) -> str:
    """HTML of a page with its TeX, as pymdownx.arithmatex marks it, turned into MathML."""

    def turned(match: re.Match[str]) -> str:
        _, opening, tex = match.groups()
        display = "block" if opening == "[" else "inline"
        return str(convert(html.unescape(tex).strip(), display=display))

    return _ARITHMATEX.sub(turned, page)
