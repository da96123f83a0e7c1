"""Conversion of the layout of docstrings to Markdown: examples outside of a section, and lists of fields."""

from __future__ import annotations

import re

_EXAMPLE = re.compile(r"^>>> .*(?:\n(?!\n).+)*", re.M)
_SECTION = re.compile(r"^(?:Examples|Parameters|Returns|Raises)\n-+$", re.M)
_FIELD = re.compile(r"^(\w[\w, ]*): +(?=\S)", re.M)
_COLUMN = re.compile(r"^(\w[\w. ]*?) {2,}(?=\S)", re.M)


def as_markdown(docstring: str) -> str:
    """Convert a docstring: examples outside of sections become fenced, lists of fields become lists; sections stay."""
    section = _SECTION.search(docstring)
    end = section.start() if section else len(docstring)
    return "\n\n".join(map(_paragraph, docstring[:end].split("\n\n"))) + docstring[end:]


def _paragraph(text: str) -> str:
    if text.startswith(">>> "):
        return f"```pycon\n{text.rstrip()}\n```" + ("\n" if text.endswith("\n") else "")
    for pattern in (_FIELD, _COLUMN):
        starts = [line for line in text.splitlines() if line and not line.startswith(" ")]
        if len(starts) > 1 and all(pattern.match(line) for line in starts):
            return pattern.sub(lambda match: f"- `{match[1]}`: ", text)
    return text
